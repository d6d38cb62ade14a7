//! A connection, with TLS or without, that never waits for more than it is asked for.

use std::io::{self, Read as _, Write as _};
use std::net::{IpAddr, SocketAddr};

use bytes::BytesMut;
use rustls::ClientConnection;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpSocket, TcpStream};

/// The most that is read or written at once.
const PIECE: usize = 16 * 1024;

/// Where a connection comes from and goes to.
#[derive(Clone, Copy, Debug)]
pub(super) struct Route {
    pub(super) hub: SocketAddr,
    /// All of 127.0.0.0/8 is this machine, so each peer has an address of its own.
    pub(super) from: IpAddr,
    pub(super) tls: bool,
    /// A small receive buffer in the kernel: a peer that reads nothing is soon full.
    pub(super) small: bool,
}

#[derive(Debug)]
pub(super) struct Pipe {
    socket: TcpStream,
    tls: Option<Box<ClientConnection>>,
}

/// What was answered to a request of HTTP.
#[derive(Debug)]
pub(super) struct Answer {
    pub(super) status: u16,
    head: String,
    pub(super) body: BytesMut,
}

impl Answer {
    pub(super) fn header(&self, name: &str) -> Option<&str> {
        let mut lines = self.head.lines().filter_map(|line| line.split_once(':'));
        let (_, value) = lines.find(|(key, _)| key.eq_ignore_ascii_case(name))?;
        Some(value.trim())
    }
}

impl Pipe {
    pub(super) async fn open(route: Route) -> io::Result<Pipe> {
        let socket = TcpSocket::new_v4()?;
        if route.small {
            socket.set_recv_buffer_size(4096)?;
        }
        socket.bind(SocketAddr::new(route.from, 0))?;
        let socket = socket.connect(route.hub).await?;
        socket.set_nodelay(true)?;
        let tls = route.tls.then(|| Box::new(crate::bridge::tls::client()));
        Ok(Pipe { socket, tls })
    }

    pub(super) async fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        let Some(tls) = &mut self.tls else {
            return self.socket.write_all(bytes).await;
        };
        while tls.is_handshaking() {
            flush(tls, &mut self.socket).await?;
            if tls.is_handshaking() {
                hear(tls, &mut self.socket, PIECE).await?;
            }
        }
        for piece in bytes.chunks(PIECE) {
            tls.writer().write_all(piece)?;
            flush(tls, &mut self.socket).await?;
        }
        flush(tls, &mut self.socket).await
    }

    /// Bytes without TLS, wherever that is.
    pub(super) async fn write_below(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.socket.write_all(bytes).await
    }

    /// Reads at most so many bytes; the end of the connection is an error.
    pub(super) async fn read(&mut self, into: &mut BytesMut, most: usize) -> io::Result<()> {
        let most = most.min(PIECE);
        let Some(tls) = &mut self.tls else {
            let mut bytes = vec![0; most];
            let count = self.socket.read(&mut bytes).await?;
            into.extend_from_slice(&bytes[..count]);
            return end(count);
        };
        let count = hear(tls, &mut self.socket, most).await?;
        let mut plain = Vec::new();
        match tls.reader().read_to_end(&mut plain) {
            Err(error) if error.kind() != io::ErrorKind::WouldBlock => return Err(error),
            _ => into.extend_from_slice(&plain),
        }
        end(count)
    }

    /// Sends a request of HTTP and waits for its answer.
    pub(super) async fn ask(&mut self, first: &str, lines: &[&str], body: &[u8]) -> io::Result<Answer> {
        self.write(&crate::asking::request(first, lines, body)).await?;
        let mut arrived = BytesMut::new();
        let end = loop {
            match arrived.windows(4).position(|four| four == b"\r\n\r\n") {
                Some(end) => break end + 4,
                None => self.read(&mut arrived, PIECE).await?,
            }
        };
        let head = String::from_utf8_lossy(&arrived.split_to(end)).into_owned();
        let status = head.split(' ').nth(1).and_then(|status| status.parse().ok());
        let mut answer = Answer {
            status: status.ok_or_else(|| io::Error::other(format!("no status: {head}")))?,
            head,
            body: arrived,
        };
        let length = answer
            .header("content-length")
            .and_then(|length| length.parse().ok());
        let length: usize = length.unwrap_or_default();
        while answer.body.len() < length {
            self.read(&mut answer.body, PIECE).await?;
        }
        Ok(answer)
    }

    /// Nothing more is said, and all is heard.
    pub(super) async fn half_close(&mut self) -> io::Result<()> {
        self.socket.shutdown().await
    }

    /// Ends it so that the hub sees a reset.
    pub(super) fn reset(self) {
        // One that has ended needs none.
        let _ = self.socket.set_zero_linger();
    }
}

fn end(count: usize) -> io::Result<()> {
    match count {
        0 => Err(io::ErrorKind::UnexpectedEof.into()),
        _ => Ok(()),
    }
}

async fn flush(tls: &mut ClientConnection, socket: &mut TcpStream) -> io::Result<()> {
    let mut out = Vec::new();
    while tls.wants_write() {
        tls.write_tls(&mut out)?;
    }
    socket.write_all(&out).await
}

async fn hear(tls: &mut ClientConnection, socket: &mut TcpStream, most: usize) -> io::Result<usize> {
    let mut bytes = vec![0; most];
    let count = socket.read(&mut bytes).await?;
    let mut arrived = &bytes[..count];
    while !arrived.is_empty() {
        tls.read_tls(&mut arrived)?;
        tls.process_new_packets().map_err(io::Error::other)?;
    }
    match count {
        0 if tls.is_handshaking() => Err(io::ErrorKind::UnexpectedEof.into()),
        count => Ok(count),
    }
}
