//! A connection for hyper.

use std::cell::RefCell;
use std::io::{self, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use bytes::{Buf as _, BufMut as _, BytesMut};
use hyper::rt::{Read, ReadBufCursor, Write};

use crate::Privacy;
use crate::carrier::Carrier;

/// Read at once: as much as TLS decrypts at once, whatever room hyper has for it.
const AT_ONCE: usize = 64 * 1024;

thread_local! {
    static ARRIVED: RefCell<BytesMut> = RefCell::new(BytesMut::with_capacity(AT_ONCE));
}

/// A connection whose first bytes have begun an HTTP request, or on which one will be sent.
#[derive(Debug)]
pub struct HttpStream {
    carrier: Carrier,
    /// Read before it was known that they are HTTP.
    first: BytesMut,
}

impl HttpStream {
    pub(crate) fn new(carrier: Carrier, first: BytesMut) -> HttpStream {
        HttpStream { carrier, first }
    }

    /// Who could have read along.
    pub fn privacy(&self) -> Privacy {
        self.carrier.privacy()
    }

    /// Says this, if anything, and ends the connection so that the other side still gets the last answer.
    pub async fn close(self, last: &[u8]) {
        self.carrier.say_last(last).await;
    }

    /// What is below, and what has been read and not taken.
    pub(crate) fn into_carrier(self) -> (Carrier, BytesMut) {
        (self.carrier, self.first)
    }
}

impl Read for HttpStream {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        mut room: ReadBufCursor<'_>,
    ) -> Poll<io::Result<()>> {
        if !self.first.is_empty() {
            let here = self.first.len().min(room.remaining());
            room.put_slice(&self.first[..here]);
            self.first.advance(here);
            return Poll::Ready(Ok(()));
        }
        // Otherwise it would keep what it was read into.
        self.first = BytesMut::new();
        ARRIVED.with_borrow_mut(|arrived| {
            arrived.clear();
            ready!(self.carrier.poll_read(&mut arrived.limit(AT_ONCE), context))?;
            let here = arrived.len().min(room.remaining());
            room.put_slice(&arrived[..here]);
            self.first.extend_from_slice(&arrived[here..]);
            Poll::Ready(Ok(()))
        })
    }
}

impl Write for HttpStream {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        self.poll_write_vectored(context, &[IoSlice::new(bytes)])
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        pieces: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        loop {
            if let Some(written) = self.carrier.try_write(pieces)? {
                return Poll::Ready(Ok(written));
            }
            ready!(self.carrier.poll_writable(context))?;
        }
    }

    fn is_write_vectored(&self) -> bool {
        true
    }

    fn poll_flush(self: Pin<&mut Self>, _context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.carrier.finish();
        Poll::Ready(Ok(()))
    }
}
