//! Brings plain connections through a door of a hub, so that drivers that know bytes only are measured behind TLS and WebSocket, all
//! hubs alike. It runs in a process of its own: what it costs is nobody's processor time but its own.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, copy, split};
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::TlsConnector;

/// Read at once.
const CHUNK: usize = 64 * 1024;

/// A door of a hub.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Passage {
    /// The connection itself.
    Tcp,
    /// TLS.
    Tls,
    /// A WebSocket.
    Ws,
    /// A WebSocket inside TLS.
    Wss,
}

impl Passage {
    /// All of them.
    pub const ALL: [Passage; 4] = [Passage::Tcp, Passage::Tls, Passage::Ws, Passage::Wss];

    /// Its name in tables and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Passage::Tcp => "tcp",
            Passage::Tls => "tls",
            Passage::Ws => "ws",
            Passage::Wss => "wss",
        }
    }

    /// Whether it is encrypted.
    pub fn has_tls(self) -> bool {
        matches!(self, Passage::Tls | Passage::Wss)
    }

    /// Whether it is a WebSocket.
    pub fn is_websocket(self) -> bool {
        matches!(self, Passage::Ws | Passage::Wss)
    }
}

/// Where to, and how.
#[derive(Clone)]
pub struct Gateway {
    /// The hub.
    pub to: SocketAddr,
    /// Its door.
    pub passage: Passage,
    /// The path and the subprotocol of its WebSocket.
    pub websocket: (String, String),
    /// Trusts the hub's certificate.
    pub tls: Option<TlsConnector>,
}

trait Duplex: AsyncRead + AsyncWrite + Unpin + Send {}

impl<T: AsyncRead + AsyncWrite + Unpin + Send> Duplex for T {}

/// What trusts this certificate only.
///
/// # Errors
/// No certificate.
pub fn trusting(certificate: &Path) -> Result<TlsConnector> {
    let mut roots = rustls::RootCertStore::empty();
    roots.add(CertificateDer::from_pem_file(certificate)?)?;
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = rustls::ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()?
        .with_root_certificates(roots)
        .with_no_client_auth();
    Ok(TlsConnector::from(Arc::new(config)))
}

impl Gateway {
    /// Serves until it is ended.
    ///
    /// # Errors
    /// A listener that fails.
    pub async fn serve(self, listener: TcpListener) -> Result<()> {
        loop {
            let (near, _) = listener.accept().await?;
            let gateway = self.clone();
            // A refused client sees its connection end.
            tokio::spawn(async move { gateway.pass(near).await });
        }
    }

    async fn pass(self, near: TcpStream) -> Result<()> {
        near.set_nodelay(true)?;
        let far = TcpStream::connect(self.to).await?;
        far.set_nodelay(true)?;
        let mut far: Box<dyn Duplex> = match &self.tls {
            Some(tls) if self.passage.has_tls() => {
                Box::new(tls.connect(ServerName::try_from("localhost")?, far).await?)
            }
            _ => Box::new(far),
        };
        let (mut near_in, mut near_out) = near.into_split();
        if !self.passage.is_websocket() {
            let (mut far_in, mut far_out) = split(far);
            let down = tokio::spawn(async move { copy(&mut far_in, &mut near_out).await });
            copy(&mut near_in, &mut far_out).await?;
            far_out.shutdown().await?;
            down.await??;
            return Ok(());
        }
        self.upgrade(&mut far).await?;
        let (mut far_in, mut far_out) = split(far);
        let down = tokio::spawn(async move { unframe(&mut far_in, &mut near_out).await });
        let mut bytes = vec![0; HEAD + CHUNK];
        loop {
            let length = near_in.read(&mut bytes[HEAD..]).await?;
            if length == 0 {
                break;
            }
            let from = frame(&mut bytes, length);
            far_out.write_all(&bytes[from..HEAD + length]).await?;
            far_out.flush().await?;
        }
        far_out.shutdown().await?;
        down.await?
    }

    async fn upgrade(&self, far: &mut Box<dyn Duplex>) -> Result<()> {
        let (path, protocol) = &self.websocket;
        let mut request = format!(
            "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        );
        if !protocol.is_empty() {
            request += &format!("Sec-WebSocket-Protocol: {protocol}\r\n");
        }
        far.write_all((request + "\r\n").as_bytes()).await?;
        far.flush().await?;
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            head.push(far.read_u8().await.context("an answer to the upgrade")?);
        }
        if !head.starts_with(b"HTTP/1.1 101") {
            bail!("no WebSocket: {}", head.escape_ascii());
        }
        Ok(())
    }
}

/// The longest head of a frame with its mask.
const HEAD: usize = 14;

/// Puts a head before bytes that begin at [`HEAD`], and gives where it begins. The mask is 0, so that the bytes stay as they are.
fn frame(bytes: &mut [u8], length: usize) -> usize {
    let head: Vec<u8> = match u16::try_from(length) {
        Ok(short @ 0..126) => vec![0x82, 0x80 | short.to_be_bytes()[1]],
        Ok(short) => [&[0x82, 0x80 | 126][..], &short.to_be_bytes()].concat(),
        Err(_) => [&[0x82, 0x80 | 127][..], &(length as u64).to_be_bytes()].concat(),
    };
    let from = HEAD - 4 - head.len();
    bytes[from..HEAD - 4].copy_from_slice(&head);
    bytes[HEAD - 4..HEAD].fill(0);
    from
}

/// Passes on what is in binary frames.
async fn unframe(far: &mut (impl AsyncRead + Unpin), near: &mut (impl AsyncWrite + Unpin)) -> Result<()> {
    let mut bytes = vec![0; CHUNK];
    let (mut filled, mut payload) = (0, 0);
    loop {
        let length = far.read(&mut bytes[filled..]).await?;
        if length == 0 {
            near.shutdown().await?;
            return Ok(());
        }
        filled += length;
        let (mut at, mut kept) = (0, 0);
        // Payloads move together, so that one write takes them all.
        while at < filled {
            if payload > 0 {
                let part = payload.min(filled - at);
                bytes.copy_within(at..at + part, kept);
                (at, kept, payload) = (at + part, kept + part, payload - part);
                continue;
            }
            let Some((head, length)) = head(&bytes[at..filled]) else {
                break;
            };
            (at, payload) = (at + head, length);
        }
        near.write_all(&bytes[..kept]).await?;
        bytes.copy_within(at..filled, 0);
        filled -= at;
    }
}

/// How long the head of a frame and its payload are, if it is there.
fn head(bytes: &[u8]) -> Option<(usize, usize)> {
    match *bytes.get(1)? & 0x7F {
        126 => Some((
            4,
            usize::from(u16::from_be_bytes(bytes.get(2..4)?.try_into().ok()?)),
        )),
        127 => {
            let length = u64::from_be_bytes(bytes.get(2..10)?.try_into().ok()?);
            Some((10, usize::try_from(length).ok()?))
        }
        short => Some((2, usize::from(short))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_come_back() {
        for length in [0, 1, 125, 126, 65_535, 65_536] {
            let mut bytes = vec![7; HEAD + length];
            let from = frame(&mut bytes, length);
            let mut unmasked = bytes[from..].to_vec();
            unmasked[1] &= 0x7F;
            let (head, found) = head(&unmasked).unwrap();
            // The mask follows the head of a client's frame.
            assert_eq!((head + 4, found), (HEAD - from, length));
        }
    }
}
