//! What carries the bytes of a form: TCP, or TLS on it. In two halves.

use std::io::{self, IoSlice};
use std::pin::pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use bytes::BufMut;
use socket2::SockRef;
use tokio::io::AsyncReadExt as _;
use tokio::net::TcpStream;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};

use crate::tls::TlsLink;
use crate::{TcpState, options};

/// Two halves of a connection.
pub(crate) fn tcp(stream: TcpStream) -> (ReadHalf, WriteHalf) {
    let (read, write) = stream.into_split();
    (ReadHalf::Tcp(read), WriteHalf::Tcp(write))
}

/// The same with TLS.
pub(crate) fn tls(link: Arc<TlsLink>) -> (ReadHalf, WriteHalf) {
    (ReadHalf::Tls(Arc::clone(&link)), WriteHalf::Tls(link))
}

/// Where bytes come from.
#[derive(Debug)]
pub(crate) enum ReadHalf {
    Tcp(OwnedReadHalf),
    Tls(Arc<TlsLink>),
}

impl ReadHalf {
    /// Reads what has arrived; 0 bytes at the end.
    pub(crate) fn poll_read(
        &mut self,
        room: &mut impl BufMut,
        context: &mut Context<'_>,
    ) -> Poll<io::Result<usize>> {
        match self {
            // Stateless, so that it may be begun anew at each poll.
            ReadHalf::Tcp(stream) => pin!(stream.read_buf(room)).poll(context),
            ReadHalf::Tls(link) => link.poll_read(room, context),
        }
    }
}

/// Where bytes go.
#[derive(Debug)]
pub(crate) enum WriteHalf {
    Tcp(OwnedWriteHalf),
    Tls(Arc<TlsLink>),
}

impl WriteHalf {
    /// Writes the front of these pieces; gives how much of it, none if the network takes nothing now.
    pub(crate) fn try_write(&self, pieces: &[IoSlice<'_>]) -> io::Result<Option<usize>> {
        let written = match (self, pieces) {
            (WriteHalf::Tls(link), pieces) => return link.try_write(pieces),
            // One piece needs no vector, and the kernel is a little quicker without.
            (WriteHalf::Tcp(stream), [piece]) => stream.try_write(piece),
            (WriteHalf::Tcp(stream), pieces) => stream.try_write_vectored(pieces),
        };
        match written {
            Ok(written) => Ok(Some(written)),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Waits until the network takes more.
    pub(crate) async fn writable(&self) -> io::Result<()> {
        match self {
            WriteHalf::Tcp(stream) => stream.writable().await,
            WriteHalf::Tls(link) => link.writable().await,
        }
    }

    /// What the kernel knows of the network, none where it cannot be asked.
    pub(crate) fn link(&self) -> Option<TcpState> {
        match self {
            WriteHalf::Tcp(stream) => options::link(stream.as_ref()),
            WriteHalf::Tls(link) => link.link(),
        }
    }

    /// Says that nothing more comes from this end.
    pub(crate) fn finish(&self) {
        match self {
            WriteHalf::Tcp(stream) => {
                // A link that is gone already needs no goodbye.
                let _ = SockRef::from(AsRef::<TcpStream>::as_ref(stream)).shutdown(std::net::Shutdown::Write);
            }
            WriteHalf::Tls(link) => link.finish(),
        }
    }
}
