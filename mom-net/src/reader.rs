//! The half that gives frames.

use std::future::poll_fn;
use std::io;
use std::sync::Arc;
use std::task::{Context, Poll};

use bytes::{Buf, BufMut};
use mom_proto::binary::Plain;
use mom_proto::codec::{Decoder, Deferred, Form, Frame};
use mom_proto::{Compression, ContextNumber, Limits, Parcel, Path, WireError, check_message_name};
use tokio::sync::mpsc;

use crate::NetError;
use crate::compressed::Unpacker;
use crate::socket::ReadHalf;
use crate::spare::ReadBuffer;

/// The most that one system call reads: it does not return before all that has come is copied, and others wait for the
/// thread.
const AT_ONCE: usize = 256 * 1024;

/// Gives the frames of a connection.
#[derive(Debug)]
pub struct Reader {
    source: Source,
    /// The bytes that have arrived since it began.
    received: u64,
}

#[derive(Debug)]
pub(crate) enum Source {
    Stream {
        stream: ReadHalf,
        buffer: ReadBuffer,
        decoder: Decoder,
        form: Form,
        /// Once the other side may compress all that follows.
        unpacker: Option<Box<Unpacker>>,
    },
    Local {
        receiver: mpsc::Receiver<Arc<Parcel>>,
        /// What was waited for.
        arrived: Option<Arc<Parcel>>,
    },
}

impl Reader {
    pub(crate) fn new(source: Source) -> Reader {
        let received = match &source {
            Source::Stream { buffer, .. } => buffer.bytes.len() as u64,
            Source::Local { .. } => 0,
        };
        Reader { source, received }
    }

    /// The bytes that have arrived since it began; none counted inside a process.
    pub fn received(&self) -> u64 {
        self.received
    }

    /// As many, and those that were opened of them: what the other side keeps until it is told that it was read.
    pub fn brought(&self) -> u64 {
        let opened = match &self.source {
            Source::Stream {
                unpacker: Some(unpacker),
                ..
            } => unpacker.opened(),
            _ => 0,
        };
        self.received + opened
    }

    /// The wire form, none inside a process.
    pub fn form(&self) -> Option<Form> {
        match &self.source {
            Source::Stream { form, .. } => Some(*form),
            Source::Local { .. } => None,
        }
    }

    /// Changes the limits, as after login.
    pub fn set_limits(&mut self, limits: &Limits) {
        if let Source::Stream { decoder, .. } = &mut self.source {
            decoder.set_limits(limits);
        }
    }

    /// Gives the numbers of contexts that the other side may use without their paths.
    pub fn know(&mut self, contexts: Vec<(ContextNumber, Path)>) {
        if let Source::Stream { decoder, .. } = &mut self.source {
            decoder.know(contexts);
        }
    }

    /// From now on, takes compressed content: both ends have agreed on it.
    pub fn take_packed(&mut self) {
        if let Source::Stream { decoder, .. } = &mut self.source {
            decoder.take_packed();
        }
    }

    /// From now on, opens so what the other side has compressed, from where that begins: both ends agree on it, or will.
    pub fn take_compressed(&mut self, way: Compression) {
        if let Source::Stream {
            stream,
            unpacker,
            form,
            ..
        } = &mut self.source
            && unpacker.is_none()
        {
            stream.take_binary();
            *unpacker = Some(Box::new(Unpacker::new(way, *form)));
        }
    }

    /// Tells the link that its peer has logged in: a tunnel changes its id then.
    pub fn trust(&self) {
        if let Source::Stream { stream, .. } = &self.source {
            stream.trust();
        }
    }

    /// From now on, leaves large frames of the text forms unread, for [`Reader::take_deferred`].
    pub fn defer_above(&mut self, bytes: usize) {
        if let Source::Stream { decoder, .. } = &mut self.source {
            decoder.defer_above(bytes);
        }
    }

    /// The whole frame in front of which [`Reader::try_next`] has stopped; it goes on behind it.
    pub fn take_deferred(&mut self) -> Option<Deferred> {
        match &mut self.source {
            Source::Stream { decoder, .. } => decoder.take_deferred(),
            Source::Local { .. } => None,
        }
    }

    /// The next frame, or `None` at the end of the connection. Safe to cancel.
    ///
    /// # Errors
    /// A failed link, a broken frame, or an end in the middle of one; nothing follows.
    pub async fn next(&mut self) -> Result<Option<Frame>, NetError> {
        loop {
            if let Some(frame) = self.try_next()? {
                return Ok(Some(frame));
            }
            if !self.arrive().await? {
                return Ok(None);
            }
        }
    }

    /// Waits until something more has arrived, which need not be a whole frame; false at the end of the
    /// connection. Safe to cancel.
    ///
    /// # Errors
    /// A failed link, or an end in the middle of a frame.
    pub async fn arrive(&mut self) -> Result<bool, NetError> {
        match &mut self.source {
            Source::Local { receiver, arrived } => {
                if arrived.is_none() {
                    *arrived = receiver.recv().await;
                }
                Ok(arrived.is_some())
            }
            Source::Stream {
                stream,
                buffer,
                decoder,
                unpacker,
                ..
            } => {
                let announced = announced(decoder, &buffer.bytes);
                if let Some(unpacker) = unpacker.as_deref_mut().filter(|unpacker| unpacker.is_open()) {
                    // Apart: few connections are compressed, and the others need no room for it.
                    let arrived = Box::pin(open_some(stream, buffer, unpacker, announced)).await?;
                    self.received += arrived.unwrap_or_default() as u64;
                    return Ok(arrived.is_some());
                }
                match poll_fn(|context| poll_read(stream, buffer, announced, context)).await? {
                    0 if buffer.bytes.is_empty() => Ok(false),
                    0 => Err(io::Error::from(io::ErrorKind::UnexpectedEof).into()),
                    count => {
                        self.received += count as u64;
                        Ok(true)
                    }
                }
            }
        }
    }

    /// The plain message in front of what has arrived, if there is one and this link speaks the binary form.
    /// The taker says so by [`Reader::consume`].
    pub fn plain(&self) -> Option<Plain<'_>> {
        match &self.source {
            Source::Stream {
                buffer,
                decoder: Decoder::Binary(decoder),
                ..
            } => decoder.plain(&buffer.bytes),
            _ => None,
        }
    }

    /// A plain message that lies in front as a parcel without its content.
    pub fn plain_head(&mut self) -> Option<Box<Parcel>> {
        match &mut self.source {
            Source::Stream {
                buffer,
                decoder: Decoder::Binary(decoder),
                ..
            } => {
                let plain = decoder.plain(&buffer.bytes)?;
                decoder.head(&plain)
            }
            _ => None,
        }
    }

    /// How many bytes have arrived and wait to be looked at.
    pub fn waiting(&self) -> usize {
        match &self.source {
            Source::Stream { buffer, .. } => buffer.bytes.len(),
            Source::Local { .. } => 0,
        }
    }

    /// The bytes that are here of parcels whose end has not come.
    pub fn held(&self) -> usize {
        match &self.source {
            Source::Stream { buffer, .. } => buffer.bytes.len() + self.chunks(),
            Source::Local { .. } => 0,
        }
    }

    /// Whether parcels are here that come in chunks, between which others may come whole.
    pub fn assembles(&self) -> bool {
        self.chunks() > 0
    }

    fn chunks(&self) -> usize {
        match &self.source {
            Source::Stream {
                decoder: Decoder::Binary(decoder),
                ..
            } => decoder.held(),
            _ => 0,
        }
    }

    /// Takes so many bytes of what has arrived: the length of a [`Plain`].
    pub fn consume(&mut self, length: usize) {
        if let Source::Stream { buffer, .. } = &mut self.source {
            buffer.bytes.advance(length);
            buffer.took(length);
        }
    }

    /// Reads and forgets whatever still comes, until the other side has said its last.
    pub async fn drain(&mut self) {
        match &mut self.source {
            Source::Local { receiver, .. } => while receiver.recv().await.is_some() {},
            Source::Stream { stream, buffer, .. } => {
                stream.forget();
                loop {
                    buffer.bytes.clear();
                    match poll_fn(|context| poll_read(stream, buffer, 0, context)).await {
                        Ok(0) | Err(_) => return,
                        Ok(_) => {}
                    }
                }
            }
        }
    }

    /// The next frame of what has arrived already.
    ///
    /// # Errors
    /// As [`Reader::next`].
    pub fn try_next(&mut self) -> Result<Option<Frame>, NetError> {
        match &mut self.source {
            Source::Local { receiver, arrived } => {
                let next = arrived.take().or_else(|| receiver.try_recv().ok());
                Ok(next.map(local_frame))
            }
            Source::Stream {
                buffer,
                decoder,
                unpacker,
                ..
            } if !buffer.bytes.is_empty() => {
                if let Some(unpacker) = unpacker.as_deref_mut().filter(|unpacker| !unpacker.is_open())
                    && !unpacker.begin(&mut buffer.bytes)?
                {
                    return Ok(None);
                }
                let before = buffer.bytes.len();
                let frame = decoder.decode(&mut buffer.bytes)?;
                if frame.is_some() {
                    buffer.took(before - buffer.bytes.len());
                }
                Ok(frame)
            }
            Source::Stream { .. } => Ok(None),
        }
    }
}

/// The size of the frame that has begun to arrive, where it is known.
fn announced(decoder: &Decoder, bytes: &[u8]) -> usize {
    match decoder {
        Decoder::Binary(decoder) => decoder.announced(bytes),
        Decoder::Xml(_) | Decoder::Json(_) => 0,
    }
}

/// Opens some of what has arrived, and reads where nothing has; gives how many bytes were read, none at the end.
async fn open_some(
    stream: &mut ReadHalf,
    buffer: &mut ReadBuffer,
    unpacker: &mut Unpacker,
    announced: usize,
) -> Result<Option<usize>, NetError> {
    let mut arrived = 0;
    if unpacker.is_tired() {
        tokio::task::yield_now().await;
    }
    if !unpacker.has_more() {
        let read = poll_fn(|context| {
            let read = unpacker.poll_read(stream, context);
            if read.is_pending() {
                buffer.rest();
            }
            read
        });
        arrived = read.await?;
        if arrived == 0 {
            return match buffer.bytes.is_empty() {
                true => Ok(None),
                false => Err(io::Error::from(io::ErrorKind::UnexpectedEof).into()),
            };
        }
    }
    buffer.make_room(announced);
    unpacker.fill(&mut buffer.bytes)?;
    Ok(Some(arrived))
}

/// Reads what has arrived. While nothing has, the connection holds no buffer: thousands of idle ones share a few.
fn poll_read(
    stream: &mut ReadHalf,
    buffer: &mut ReadBuffer,
    announced: usize,
    context: &mut Context<'_>,
) -> Poll<io::Result<usize>> {
    buffer.make_room(announced);
    let mut room = (&mut buffer.bytes).limit(AT_ONCE);
    let read = stream.poll_read(&mut room, context);
    if read.is_pending() {
        buffer.rest();
    }
    read
}

fn local_frame(parcel: Arc<Parcel>) -> Frame {
    match check(&parcel) {
        Ok(()) => Frame::Parcel(Box::new(Arc::unwrap_or_clone(parcel))),
        Err(error) => Frame::Malformed {
            reference: parcel.id,
            error,
        },
    }
}

/// Checks what a codec would have checked.
fn check(parcel: &Parcel) -> Result<(), WireError> {
    check_message_name(&parcel.name)?;
    match &parcel.address {
        Some(address) if address.is_empty() => {
            let text = "the slot address is empty: leave it out to reach all members";
            Err(WireError::new(mom_proto::Code::BAD_SLOT, text).slot("address"))
        }
        _ => Ok(()),
    }
}
