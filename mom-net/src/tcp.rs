//! From an address or a listener to a connection: what carries it, and which form it speaks (M14, M17).

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;

use bytes::{Bytes, BytesMut};
use mom_proto::binary::{BinaryDecoder, PREFACE};
use mom_proto::codec::{Decoder, Encoded, Form};
use mom_proto::{Code, Limits, Parcel, WireError};
use tokio::net::TcpStream;

use crate::carrier::Carrier;
use crate::dial::Dialer;
use crate::reader::{Reader, Source};
use crate::socket::{ReadHalf, WriteHalf};
use crate::spare::ReadBuffer;
use crate::tls::{HANDSHAKE, TlsLink};
use crate::writer::{Progress, Sink, Stream, Writer};
use crate::{
    Address, ClientTls, Door, HttpStream, NetError, Outgoing, Privacy, ServerTls, Takes, Transceiver, Tunnel,
    WebSocketUpgrade, http, socket, tunnel, websocket,
};

/// Connects to a hub and speaks the address's form through the address's door, with TLS if the address says so.
///
/// # Errors
/// A link that cannot be had, or a hub that is not to be trusted.
pub async fn connect(
    address: &Address,
    limits: &Limits,
    tls: Option<&ClientTls>,
) -> Result<Transceiver, NetError> {
    let dialer = Dialer::to(address, tls)?;
    match address.door {
        Door::Stream => {
            let decoder = client_decoder(address.form, limits);
            start(dialer.dial().await?, address.form, decoder, BytesMut::new()).await
        }
        Door::WebSocket => {
            let link = websocket::connect(dialer.dial().await?, address).await?;
            let (form, privacy) = (address.form, link.privacy());
            let decoder = client_decoder(form, limits);
            begin(socket::websocket(link), privacy, form, decoder, BytesMut::new()).await
        }
        Door::Tunnel { .. } => {
            let (pipe, privacy) = tunnel::connect(dialer).await?;
            let decoder = client_decoder(address.form, limits);
            begin(
                socket::tunnel(pipe),
                privacy,
                address.form,
                decoder,
                BytesMut::new(),
            )
            .await
        }
    }
}

/// A decoder for what a hub says.
pub(crate) fn client_decoder(form: Form, limits: &Limits) -> Decoder {
    match form {
        Form::Binary | Form::Packed => Decoder::Binary(Box::new(BinaryDecoder::for_peer(limits))),
        form => Decoder::new(form, limits),
    }
}

impl WebSocketUpgrade {
    /// Goes on as a WebSocket once the answer is written. `read` = what has arrived behind the request.
    ///
    /// # Errors
    /// A link that failed.
    pub async fn start(
        self,
        stream: HttpStream,
        read: &[u8],
        limits: &Limits,
    ) -> Result<Transceiver, NetError> {
        let (form, link) = (self.form(), self.granted(stream, read)?);
        let (privacy, decoder) = (link.privacy(), Decoder::new(form, limits));
        begin(socket::websocket(link), privacy, form, decoder, BytesMut::new()).await
    }
}

impl Tunnel {
    /// Waits for a peer's first bytes, as [`accept`] does, and tells it what is wrong through the tunnel.
    ///
    /// # Errors
    /// Bytes that begin no form, or come too late.
    pub async fn greet(
        &self,
        privacy: Privacy,
        limits: &Limits,
        too_late: impl Future<Output = WireError>,
        answer: impl FnOnce(&WireError) -> Parcel,
    ) -> Result<Transceiver, NetError> {
        let (form, first) = self.first_words(too_late, answer).await?;
        let halves = socket::tunnel(Arc::clone(self.pipe()));
        begin(halves, privacy, form, Decoder::new(form, limits), first).await
    }
}

/// What has come to a listener.
#[derive(Debug)]
pub enum Accepted {
    /// A peer that has said in which form it speaks.
    Peer(Transceiver),
    /// The first bytes of an HTTP request.
    Http(HttpStream),
}

/// Waits for a peer's first bytes, tells by them whether it speaks TLS, for which the hub needs a certificate, and which form, or
/// HTTP. When `too_late` comes before, or the bytes begin nothing, or nothing that is taken here, the peer is told so with what
/// `answer` makes of the error; one that has said nothing in time is told nothing where HTTP is taken.
///
/// # Errors
/// Bytes that begin no form that is taken, or that come too late; or a link that failed.
pub async fn accept(
    stream: TcpStream,
    tls: Option<&ServerTls>,
    takes: Takes,
    limits: &Limits,
    too_late: impl Future<Output = WireError>,
    answer: impl FnOnce(&WireError) -> Parcel,
) -> Result<Accepted, NetError> {
    let mut first = BytesMut::with_capacity(4096);
    // None while hands are shaken: a peer that is refused then is told nothing.
    let mut arrived = Some(Carrier::Tcp(stream));
    let told = tokio::select! {
        told = first_words(&mut arrived, tls, takes, &mut first) => told,
        error = too_late => Err(error.into()),
    };
    match (told, arrived) {
        (Ok(Spoken::Form(form)), Some(carrier)) => {
            let peer = start(carrier, form, Decoder::new(form, limits), first).await?;
            Ok(Accepted::Peer(peer))
        }
        (Ok(Spoken::Http), Some(carrier)) => {
            carrier.prepare()?;
            Ok(Accepted::Http(HttpStream::new(carrier, first)))
        }
        (Ok(_), None) => Err(io::Error::from(io::ErrorKind::UnexpectedEof).into()),
        (Err(error), arrived) => {
            if let (NetError::Wire(error), Some(carrier)) = (&error, arrived) {
                // A browser opens connections before it needs them, and takes an answer that it did not ask for as nonsense.
                let may_be_browser =
                    first.is_empty() && error.code == Code::LOGIN_TIMEOUT && takes.check_http().is_ok();
                if !may_be_browser {
                    tell(&carrier, &answer(error)).await;
                }
            }
            Err(error)
        }
    }
}

/// What first bytes begin.
enum Spoken {
    Form(Form),
    Http,
}

async fn first_words(
    arrived: &mut Option<Carrier>,
    tls: Option<&ServerTls>,
    takes: Takes,
    first: &mut BytesMut,
) -> Result<Spoken, NetError> {
    loop {
        if let (Some(Carrier::Tcp(_)), Some(begin)) = (&*arrived, first.first()) {
            takes.check_tls(*begin == HANDSHAKE)?;
        }
        if let (Some(Carrier::Tcp(_)), Some(&HANDSHAKE)) = (&*arrived, first.first()) {
            let tls =
                tls.ok_or_else(|| WireError::new(Code::BAD_FRAME, "this hub has no certificate for TLS"))?;
            if let Some(Carrier::Tcp(stream)) = arrived.take() {
                let link = TlsLink::handshake(stream, tls.connection()?.into(), first).await?;
                *arrived = Some(Carrier::Tls(link));
            }
            first.clear();
        }
        let http = http::sniff(first);
        if http == Some(true) {
            takes.check_http()?;
            return Ok(Spoken::Http);
        }
        if http == Some(false)
            && let Some(form) = Form::sniff(first)?
        {
            takes.check(form.into())?;
            return Ok(Spoken::Form(form));
        }
        let Some(carrier) = &*arrived else {
            return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into());
        };
        if carrier.read(first).await? == 0 {
            return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into());
        }
    }
}

/// Says why in XML, the form that people can read, to a peer that is not even a peer, and closes.
pub async fn refuse(stream: TcpStream, answer: &Parcel) {
    tell(&Carrier::Tcp(stream), answer).await;
}

async fn tell(carrier: &Carrier, answer: &Parcel) {
    let Ok(encoded) = Form::Xml.encode(answer) else {
        return;
    };
    carrier.say_last(&encoded.head).await;
}

async fn start(
    carrier: Carrier,
    form: Form,
    decoder: Decoder,
    buffer: BytesMut,
) -> Result<Transceiver, NetError> {
    carrier.prepare()?;
    let privacy = carrier.privacy();
    begin(socket::plain(carrier), privacy, form, decoder, buffer).await
}

/// Begins to speak a form on two halves; `buffer` = what has arrived.
pub(crate) async fn begin(
    halves: (ReadHalf, WriteHalf),
    privacy: Privacy,
    form: Form,
    decoder: Decoder,
    buffer: BytesMut,
) -> Result<Transceiver, NetError> {
    let peer = speaking(halves, privacy, form, decoder, buffer);
    let mut first = first_bytes(form);
    while peer.writer.try_write(&mut first)? == Progress::Blocked {
        peer.writer.ready().await?;
    }
    Ok(peer)
}

/// What goes first in a form.
pub(crate) fn first_bytes(form: Form) -> VecDeque<Outgoing> {
    let preface = Encoded {
        head: Bytes::from_static(&PREFACE),
        body: Bytes::new(),
    };
    form.is_binary()
        .then_some(Outgoing::Encoded(preface))
        .into_iter()
        .collect()
}

/// Two halves that speak a form, of which nothing is said yet.
pub(crate) fn speaking(
    (stream, sink): (ReadHalf, WriteHalf),
    privacy: Privacy,
    form: Form,
    decoder: Decoder,
    buffer: BytesMut,
) -> Transceiver {
    let writer = Writer::new(Sink::Stream {
        stream: Stream::new(sink),
        form,
    });
    let reader = Reader::new(Source::Stream {
        stream,
        buffer: ReadBuffer::new(buffer),
        decoder,
        form,
        unpacker: None,
    });
    Transceiver {
        reader,
        writer,
        privacy,
    }
}
