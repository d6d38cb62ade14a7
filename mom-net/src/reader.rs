//! The half that gives frames.

use std::io;
use std::sync::Arc;

use bytes::BytesMut;
use mom_proto::Limits;
use mom_proto::Parcel;
use mom_proto::codec::{Decoder, Form, Frame};
use tokio::net::TcpStream;
use tokio::sync::mpsc;

use crate::{NetError, local};

/// Read at once from a socket; also the most that small parcels wait for each other in one turn.
const CHUNK: usize = 64 * 1024;

/// Room below which a buffer is replaced; above it what is left is used up first, so that a peer of small
/// parcels does not cost a buffer for each.
const LEAST: usize = 4 * 1024;

/// Gives the frames of a connection.
#[derive(Debug)]
pub struct Reader {
    source: Source,
}

#[derive(Debug)]
pub(crate) enum Source {
    Stream {
        stream: Arc<TcpStream>,
        buffer: BytesMut,
        decoder: Decoder,
        form: Form,
    },
    Local(mpsc::Receiver<Arc<Parcel>>),
}

impl Reader {
    pub(crate) fn new(source: Source) -> Reader {
        Reader { source }
    }

    /// The wire form, none inside a process.
    pub fn form(&self) -> Option<Form> {
        match &self.source {
            Source::Stream { form, .. } => Some(*form),
            Source::Local(_) => None,
        }
    }

    /// Changes the limits, as after login.
    pub fn set_limits(&mut self, limits: &Limits) {
        if let Source::Stream { decoder, .. } = &mut self.source {
            decoder.set_limits(limits);
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
            match &mut self.source {
                Source::Local(receiver) => return Ok(receiver.recv().await.map(local_frame)),
                Source::Stream { stream, buffer, .. } => {
                    stream.readable().await?;
                    if buffer.capacity() - buffer.len() < LEAST {
                        buffer.reserve(CHUNK);
                    }
                    match stream.try_read_buf(buffer) {
                        Ok(0) if buffer.is_empty() => return Ok(None),
                        Ok(0) => return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into()),
                        Ok(_) => {}
                        Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                        Err(error) => return Err(error.into()),
                    }
                }
            }
        }
    }

    /// Reads and forgets whatever still comes, until the other side has said its last.
    pub async fn drain(&mut self) {
        match &mut self.source {
            Source::Local(receiver) => while receiver.recv().await.is_some() {},
            Source::Stream { stream, buffer, .. } => loop {
                buffer.clear();
                buffer.reserve(LEAST);
                let read = match stream.readable().await {
                    Ok(()) => stream.try_read_buf(buffer),
                    Err(_) => return,
                };
                match read {
                    Ok(0) => return,
                    Err(error) if error.kind() != io::ErrorKind::WouldBlock => return,
                    _ => {}
                }
            },
        }
    }

    /// The next frame of what has arrived already.
    ///
    /// # Errors
    /// As [`Reader::next`].
    pub fn try_next(&mut self) -> Result<Option<Frame>, NetError> {
        match &mut self.source {
            Source::Local(receiver) => Ok(receiver.try_recv().ok().map(local_frame)),
            Source::Stream { buffer, decoder, .. } if !buffer.is_empty() => Ok(decoder.decode(buffer)?),
            Source::Stream { .. } => Ok(None),
        }
    }
}

fn local_frame(parcel: Arc<Parcel>) -> Frame {
    match local::check(&parcel) {
        Ok(()) => Frame::Parcel(local::unshare(parcel)),
        Err(error) => Frame::Malformed {
            reference: parcel.id,
            error,
        },
    }
}
