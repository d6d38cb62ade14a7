//! What carries the bytes of a WebSocket or of HTTP: TCP, or TLS on it. Both halves of a connection share it.

use std::future::poll_fn;
use std::io::{self, ErrorKind, IoSlice};
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use bytes::{BufMut, BytesMut};
use socket2::SockRef;
use tokio::net::TcpStream;
use tokio::time::timeout;

use crate::tls::TlsLink;
use crate::{Privacy, TcpState, options};

/// How long a peer that is refused may take to hear so and to close, and how much it may send meanwhile.
const FAREWELL: Duration = Duration::from_secs(1);
const UNREAD: usize = 64 * 1024;

/// A stream of bytes in both directions, without a form.
#[derive(Debug)]
pub(crate) enum Carrier {
    Tcp(TcpStream),
    Tls(Arc<TlsLink>),
}

impl Carrier {
    /// Reads what has arrived; 0 bytes at the end. Stateless, so that it may be begun anew at each poll.
    pub(crate) fn poll_read(
        &self,
        room: &mut impl BufMut,
        context: &mut Context<'_>,
    ) -> Poll<io::Result<usize>> {
        let stream = match self {
            Carrier::Tls(link) => return link.poll_read(room, context),
            Carrier::Tcp(stream) => stream,
        };
        loop {
            ready!(stream.poll_read_ready(context))?;
            match stream.try_read_buf(room) {
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                read => return Poll::Ready(read),
            }
        }
    }

    /// Reads nothing more but the end.
    pub(crate) fn forget(&self) {
        if let Carrier::Tls(link) = self {
            link.forget();
        }
    }

    /// Waits for something to read.
    pub(crate) async fn read(&self, buffer: &mut BytesMut) -> io::Result<usize> {
        poll_fn(|context| self.poll_read(buffer, context)).await
    }

    /// Writes the front of these pieces; gives how much of it, none if the network takes nothing now.
    pub(crate) fn try_write(&self, pieces: &[IoSlice<'_>]) -> io::Result<Option<usize>> {
        let stream = match self {
            Carrier::Tls(link) => return link.try_write(pieces),
            Carrier::Tcp(stream) => stream,
        };
        match stream.try_write_vectored(pieces) {
            Ok(written) => Ok(Some(written)),
            Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Waits until the network takes more.
    pub(crate) fn poll_writable(&self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.stream().poll_write_ready(context)
    }

    /// The same, for one who does not poll.
    pub(crate) async fn writable(&self) -> io::Result<()> {
        self.stream().writable().await
    }

    /// What the kernel knows of the network.
    pub(crate) fn link(&self) -> Option<TcpState> {
        match self {
            Carrier::Tcp(stream) => options::link(stream),
            Carrier::Tls(link) => link.link(),
        }
    }

    /// Says that nothing more comes from this end.
    pub(crate) fn finish(&self) {
        match self {
            // A link that is gone already needs no goodbye.
            Carrier::Tcp(stream) => drop(SockRef::from(stream).shutdown(std::net::Shutdown::Write)),
            Carrier::Tls(link) => link.finish(),
        }
    }

    /// Says these bytes and closes, so that the other side still gets them.
    pub(crate) async fn say_last(&self, bytes: &[u8]) {
        // Best effort: it is closed either way.
        let _ = timeout(FAREWELL, self.end(bytes)).await;
    }

    async fn end(&self, bytes: &[u8]) -> io::Result<()> {
        if !bytes.is_empty() {
            self.writable().await?;
            self.try_write(&[IoSlice::new(bytes)])?;
        }
        self.finish();
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

    /// Sets the options that every connection has.
    pub(crate) fn prepare(&self) -> io::Result<()> {
        options::set(self.stream())
    }

    /// Who could have read along.
    pub(crate) fn privacy(&self) -> Privacy {
        match self {
            Carrier::Tcp(_) => Privacy::Plain,
            Carrier::Tls(link) => Privacy::Tls {
                certificate: link.certificate(),
            },
        }
    }

    fn stream(&self) -> &TcpStream {
        match self {
            Carrier::Tcp(stream) => stream,
            Carrier::Tls(link) => link.stream(),
        }
    }
}
