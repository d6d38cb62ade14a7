//! XML and binary over TCP, with TLS or without (M14, M17).

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use bytes::{Bytes, BytesMut};
use mom_proto::binary::{BinaryDecoder, PREFACE};
use mom_proto::codec::{Decoder, Encoded, Form};
use mom_proto::{Code, Limits, Parcel, WireError};
use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpStream;
use tokio::time::timeout;

use crate::reader::{Reader, Source};
use crate::spare::ReadBuffer;
use crate::tls::{HANDSHAKE, TlsLink};
use crate::writer::{Progress, Sink, Writer};
use crate::{
    Address, ClientTls, NetError, Outgoing, Privacy, ServerTls, Takes, Transceiver, options, socket,
};

/// How long a peer that is refused may take to hear so and to close, and how much it may send meanwhile.
const FAREWELL: Duration = Duration::from_secs(1);
const UNREAD: usize = 64 * 1024;

/// Connects to a hub and speaks the address's form, with TLS if the address says so.
///
/// # Errors
/// A link that cannot be had, or a hub that is not to be trusted.
pub async fn connect(
    address: &Address,
    limits: &Limits,
    tls: Option<&ClientTls>,
) -> Result<Transceiver, NetError> {
    let client = match (address.tls, tls) {
        (false, _) => None,
        (true, Some(tls)) => Some(tls.connection(&address.host)?),
        (true, None) => return Err(io::Error::from(io::ErrorKind::Unsupported).into()),
    };
    let stream = TcpStream::connect((address.host.as_str(), address.port)).await?;
    let arrived = match client {
        None => Arrived::plain(stream),
        Some(client) => Arrived::Tls(TlsLink::handshake(stream, client.into(), &[]).await?),
    };
    let decoder = match address.form {
        Form::Binary => Decoder::Binary(Box::new(BinaryDecoder::for_peer(limits))),
        form => Decoder::new(form, limits),
    };
    start(arrived, address.form, decoder, BytesMut::new()).await
}

/// Waits for a peer's first bytes, tells by them whether it speaks TLS, for which the hub needs a certificate, and which form. When
/// `too_late` comes before, or the bytes begin no form, or none that is taken here, the peer is told so with what `answer` makes of
/// the error.
///
/// # Errors
/// Bytes that begin no form that is taken, or that come too late, after an answer in XML; or a link that failed.
pub async fn accept(
    stream: TcpStream,
    tls: Option<&ServerTls>,
    takes: Takes,
    limits: &Limits,
    too_late: impl Future<Output = WireError>,
    answer: impl FnOnce(&WireError) -> Parcel,
) -> Result<Transceiver, NetError> {
    let mut first = BytesMut::with_capacity(4096);
    let mut arrived = Arrived::plain(stream);
    let form = tokio::select! {
        form = first_form(&mut arrived, tls, takes, &mut first) => form,
        error = too_late => Err(error.into()),
    };
    match form {
        Ok(form) => start(arrived, form, Decoder::new(form, limits), first).await,
        Err(error) => {
            if let NetError::Wire(error) = &error {
                arrived.refuse(&answer(error)).await;
            }
            Err(error)
        }
    }
}

/// A connection whose form is not known yet.
enum Arrived {
    /// None while hands are shaken: whoever is told off then is told nothing.
    Plain(Option<TcpStream>),
    Tls(Arc<TlsLink>),
}

impl Arrived {
    fn plain(stream: TcpStream) -> Arrived {
        Arrived::Plain(Some(stream))
    }

    async fn read(&self, first: &mut BytesMut) -> io::Result<usize> {
        let stream = match self {
            Arrived::Tls(link) => return link.read(first).await,
            Arrived::Plain(Some(stream)) => stream,
            Arrived::Plain(None) => return Ok(0),
        };
        loop {
            stream.readable().await?;
            match stream.try_read_buf(first) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                read => return read,
            }
        }
    }

    async fn refuse(self, answer: &Parcel) {
        let Ok(encoded) = Form::Xml.encode(answer) else {
            return;
        };
        // Best effort: it is closed either way.
        let _ = timeout(FAREWELL, self.say_last(&encoded.head)).await;
    }

    async fn say_last(mut self, bytes: &[u8]) -> io::Result<()> {
        match &mut self {
            Arrived::Plain(None) => return Ok(()),
            Arrived::Plain(Some(stream)) => {
                stream.writable().await?;
                stream.try_write(bytes)?;
                stream.shutdown().await?;
            }
            Arrived::Tls(link) => {
                link.try_write(&[io::IoSlice::new(bytes)])?;
                link.finish();
            }
        }
        // What a peer has sent and nobody has read would make of the close a reset, which overtakes the answer.
        let mut unread = BytesMut::with_capacity(4096);
        let mut left = UNREAD;
        while left > 0 {
            unread.clear();
            match self.read(&mut unread).await? {
                0 => break,
                count => left = left.saturating_sub(count),
            }
        }
        Ok(())
    }
}

async fn first_form(
    arrived: &mut Arrived,
    tls: Option<&ServerTls>,
    takes: Takes,
    first: &mut BytesMut,
) -> Result<Form, NetError> {
    loop {
        if let (Arrived::Plain(_), Some(begin)) = (&*arrived, first.first()) {
            takes.check_tls(*begin == HANDSHAKE)?;
        }
        if let (Arrived::Plain(stream), Some(&HANDSHAKE)) = (&mut *arrived, first.first()) {
            let tls =
                tls.ok_or_else(|| WireError::new(Code::BAD_FRAME, "this hub has no certificate for TLS"))?;
            let stream = stream.take().ok_or(io::ErrorKind::UnexpectedEof);
            let stream = stream.map_err(io::Error::from)?;
            *arrived = Arrived::Tls(TlsLink::handshake(stream, tls.connection()?.into(), first).await?);
            first.clear();
        }
        if let Some(form) = Form::sniff(first)? {
            takes.check(form.into())?;
            return Ok(form);
        }
        if arrived.read(first).await? == 0 {
            return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into());
        }
    }
}

/// Says why in XML, the form that people can read, to a peer that is not even a peer, and closes.
pub async fn refuse(stream: TcpStream, answer: &Parcel) {
    Arrived::plain(stream).refuse(answer).await;
}

async fn start(
    arrived: Arrived,
    form: Form,
    decoder: Decoder,
    buffer: BytesMut,
) -> Result<Transceiver, NetError> {
    let ((stream, sink), privacy) = match arrived {
        Arrived::Plain(None) => return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into()),
        Arrived::Plain(Some(stream)) => {
            options::set(&stream)?;
            (socket::tcp(stream), Privacy::Plain)
        }
        Arrived::Tls(link) => {
            link.prepare()?;
            let certificate = link.certificate();
            (socket::tls(link), Privacy::Tls { certificate })
        }
    };
    let writer = Writer::new(Sink::Stream { stream: sink, form });
    if form == Form::Binary {
        let preface = Encoded {
            head: Bytes::from_static(&PREFACE),
            body: Bytes::new(),
        };
        let mut queue = VecDeque::from([Outgoing::Encoded(preface)]);
        while writer.try_write(&mut queue)? == Progress::Blocked {
            writer.ready().await?;
        }
    }
    let reader = Reader::new(Source::Stream {
        stream,
        buffer: ReadBuffer::new(buffer),
        decoder,
        form,
    });
    Ok(Transceiver {
        reader,
        writer,
        privacy,
    })
}

/// The error for a connection on which nothing can be answered any more.
impl From<NetError> for WireError {
    fn from(error: NetError) -> WireError {
        match error {
            NetError::Wire(error) => error,
            other => WireError::new(Code::DISCONNECTED, other.to_string()),
        }
    }
}
