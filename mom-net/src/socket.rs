//! What carries the bytes of a form, in two halves: TCP, TLS on it, a WebSocket on either, or a tunnel.

use std::io::{self, IoSlice};
use std::pin::pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use bytes::BufMut;
use socket2::SockRef;
use tokio::io::AsyncReadExt as _;
use tokio::net::TcpStream;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};

use crate::carrier::Carrier;
use crate::tls::TlsLink;
use crate::tunnel::Pipe;
use crate::websocket::WebSocket;
use crate::{Door, TcpState, options};

/// Two halves of a connection.
pub(crate) fn plain(carrier: Carrier) -> (ReadHalf, WriteHalf) {
    match carrier {
        Carrier::Tcp(stream) => {
            let (read, write) = stream.into_split();
            (ReadHalf::Tcp(read), WriteHalf::Tcp(write))
        }
        Carrier::Tls(link) => (ReadHalf::Tls(Arc::clone(&link)), WriteHalf::Tls(link)),
    }
}

/// The same of a WebSocket.
pub(crate) fn websocket(link: WebSocket) -> (ReadHalf, WriteHalf) {
    let link = Arc::new(link);
    (ReadHalf::WebSocket(Arc::clone(&link)), WriteHalf::WebSocket(link))
}

/// The same of a tunnel.
pub(crate) fn tunnel(pipe: Arc<Pipe>) -> (ReadHalf, WriteHalf) {
    (
        ReadHalf::Tunnel(Arc::clone(&pipe)),
        WriteHalf::Tunnel(Ending(pipe)),
    )
}

/// The writer's end of a tunnel: no socket is closed when it is gone, so it says so.
#[derive(Debug)]
pub(crate) struct Ending(Arc<Pipe>);

impl Drop for Ending {
    fn drop(&mut self) {
        self.0.finish();
    }
}

/// Where bytes come from.
#[derive(Debug)]
pub(crate) enum ReadHalf {
    Tcp(OwnedReadHalf),
    Tls(Arc<TlsLink>),
    WebSocket(Arc<WebSocket>),
    Tunnel(Arc<Pipe>),
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
            ReadHalf::WebSocket(link) => link.poll_read(room, context),
            ReadHalf::Tunnel(pipe) => pipe.poll_read(room, context),
        }
    }
}

impl ReadHalf {
    /// What still comes is read for its end only.
    pub(crate) fn forget(&self) {
        match self {
            ReadHalf::Tls(link) => link.forget(),
            ReadHalf::WebSocket(link) => link.forget(),
            ReadHalf::Tcp(_) | ReadHalf::Tunnel(_) => {}
        }
    }

    /// What is compressed is not text: a WebSocket of text takes binary messages, too.
    pub(crate) fn take_binary(&self) {
        if let ReadHalf::WebSocket(link) = self {
            link.take_binary();
        }
    }

    /// Notes that the peer has logged in.
    pub(crate) fn trust(&self) {
        if let ReadHalf::Tunnel(pipe) = self {
            pipe.trust();
        }
    }
}

/// Where bytes go.
#[derive(Debug)]
pub(crate) enum WriteHalf {
    Tcp(OwnedWriteHalf),
    Tls(Arc<TlsLink>),
    WebSocket(Arc<WebSocket>),
    Tunnel(Ending),
}

impl WriteHalf {
    /// Writes the front of these pieces; gives how much of it, none if the network takes nothing now.
    pub(crate) fn try_write(&self, pieces: &[IoSlice<'_>]) -> io::Result<Option<usize>> {
        // Nothing leaves at once, whatever the network takes: to some doors none taken means that it is full.
        if pieces.iter().all(|piece| piece.is_empty()) {
            return Ok(Some(0));
        }
        let written = match (self, pieces) {
            (WriteHalf::Tls(link), pieces) => return link.try_write(pieces),
            (WriteHalf::WebSocket(link), pieces) => return link.try_write(pieces),
            (WriteHalf::Tunnel(end), pieces) => return end.0.try_write(pieces),
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

    /// What it is, whether TLS is below or not. A tunnel's end does not know how its answers are fetched.
    pub(crate) fn door(&self) -> Door {
        match self {
            WriteHalf::Tcp(_) | WriteHalf::Tls(_) => Door::Stream,
            WriteHalf::WebSocket(_) => Door::WebSocket,
            WriteHalf::Tunnel(_) => Door::Tunnel { polled: false },
        }
    }

    /// Waits until the network takes more.
    pub(crate) async fn writable(&self) -> io::Result<()> {
        match self {
            WriteHalf::Tcp(stream) => stream.writable().await,
            WriteHalf::Tls(link) => link.writable().await,
            WriteHalf::WebSocket(link) => link.writable().await,
            WriteHalf::Tunnel(end) => {
                end.0.writable().await;
                Ok(())
            }
        }
    }

    /// What follows is not text: a WebSocket of text sends it in binary messages.
    pub(crate) fn begin_binary(&self) {
        if let WriteHalf::WebSocket(link) = self {
            link.begin_binary();
        }
    }

    /// What the kernel knows of the network, none where it cannot be asked.
    pub(crate) fn link(&self) -> Option<TcpState> {
        match self {
            WriteHalf::Tcp(stream) => options::link(stream.as_ref()),
            WriteHalf::Tls(link) => link.link(),
            WriteHalf::WebSocket(link) => link.link(),
            // Proxies are between, of whose queues no kernel knows: what is under way is bounded by the tunnel.
            WriteHalf::Tunnel(_) => None,
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
            WriteHalf::WebSocket(link) => link.finish(),
            WriteHalf::Tunnel(end) => end.0.finish(),
        }
    }
}
