//! XML and binary over TCP (M14, M17).

use std::collections::VecDeque;
use std::io;
use std::time::Duration;

use bytes::{Bytes, BytesMut};
use mom_proto::binary::{BinaryDecoder, PREFACE};
use mom_proto::codec::{Decoder, Encoded, Form};
use mom_proto::{Code, Limits, Parcel, WireError};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::time::timeout;

use crate::reader::{Reader, Source};
use crate::spare::ReadBuffer;
use crate::writer::{Progress, Sink, Writer};
use crate::{Address, NetError, Outgoing, Transceiver, options};

/// How long a peer that is refused may take to hear so and to close, and how much it may send meanwhile.
const FAREWELL: Duration = Duration::from_secs(1);
const UNREAD: usize = 64 * 1024;

/// Connects to a hub and speaks the address's form.
///
/// # Errors
/// A link that cannot be had.
pub async fn connect(address: &Address, limits: &Limits) -> Result<Transceiver, NetError> {
    let stream = TcpStream::connect((address.host.as_str(), address.port)).await?;
    let decoder = match address.form {
        Form::Binary => Decoder::Binary(Box::new(BinaryDecoder::for_peer(limits))),
        form => Decoder::new(form, limits),
    };
    start(stream, address.form, decoder, BytesMut::new()).await
}

/// Waits for a peer's first bytes, tells by them which form it speaks, and speaks it. When `too_late` comes
/// before, or the bytes begin no form, the peer is told so with what `answer` makes of the error.
///
/// # Errors
/// Bytes that begin no form, or that come too late, after an answer in XML; or a link that failed.
pub async fn accept(
    stream: TcpStream,
    limits: &Limits,
    too_late: impl Future<Output = WireError>,
    answer: impl FnOnce(&WireError) -> Parcel,
) -> Result<Transceiver, NetError> {
    let mut first = BytesMut::with_capacity(4096);
    let form = tokio::select! {
        form = first_form(&stream, &mut first) => form,
        error = too_late => Err(error.into()),
    };
    match form {
        Ok(form) => start(stream, form, Decoder::new(form, limits), first).await,
        Err(error) => {
            if let NetError::Wire(error) = &error {
                refuse(stream, &answer(error)).await;
            }
            Err(error)
        }
    }
}

async fn first_form(stream: &TcpStream, first: &mut BytesMut) -> Result<Form, NetError> {
    loop {
        if let Some(form) = Form::sniff(first)? {
            return Ok(form);
        }
        stream.readable().await?;
        match stream.try_read_buf(first) {
            Ok(0) => return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into()),
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(error) => return Err(error.into()),
        }
    }
}

/// Says why in XML, the form that people can read, to a peer that is not even a peer, and closes.
pub async fn refuse(mut stream: TcpStream, answer: &Parcel) {
    let Ok(encoded) = Form::Xml.encode(answer) else {
        return;
    };
    // Best effort: it is closed either way.
    let said = async {
        stream.writable().await?;
        stream.try_write(&encoded.head)?;
        stream.shutdown().await?;
        // What a peer has sent and nobody has read would make of the close a reset, which overtakes the answer.
        let mut unread = BytesMut::with_capacity(4096);
        let mut left = UNREAD;
        while left > 0 {
            unread.clear();
            match stream.read_buf(&mut unread).await? {
                0 => break,
                count => left = left.saturating_sub(count),
            }
        }
        io::Result::Ok(())
    };
    let _ = timeout(FAREWELL, said).await;
}

async fn start(
    stream: TcpStream,
    form: Form,
    decoder: Decoder,
    buffer: BytesMut,
) -> Result<Transceiver, NetError> {
    options::set(&stream)?;
    let (stream, sink) = stream.into_split();
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
    Ok(Transceiver { reader, writer })
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
