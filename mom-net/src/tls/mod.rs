//! TLS below any form: what its reader and its writers share is one link.

mod client;
mod server;

use std::cell::RefCell;
use std::io::{self, BufRead as _, ErrorKind, IoSlice, Read, Write};
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use bytes::BufMut;
use mom_proto::Fingerprint;
use parking_lot::Mutex;
use rustls::client::danger::HandshakeSignatureValid;
use rustls::crypto::{CryptoProvider, verify_tls12_signature, verify_tls13_signature};
use rustls::{Connection, DigitallySignedStruct, SignatureScheme};
use rustls_pki_types::CertificateDer;
use sha2::{Digest as _, Sha256};
use tokio::net::TcpStream;

use crate::turn::next_turn;
use crate::{TcpState, options};

pub use client::{ClientTls, Identity, Trust};
pub use server::{SelfSigned, ServerTls, TlsError};

/// The first byte of a TLS handshake; no form begins so.
pub(crate) const HANDSHAKE: u8 = 0x16;

/// Read at once from the network.
const AT_ONCE: usize = 64 * 1024;

/// Plaintext that is encrypted before the network has taken what was encrypted before: little, because nothing urgent
/// can overtake it.
const AHEAD: usize = 64 * 1024;

thread_local! {
    /// What has arrived and is not decrypted: used within a turn only, so that idle connections need no memory for it.
    static ARRIVED: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

/// Named at each use, so that it does not matter what else in the process installs one.
fn provider() -> Arc<CryptoProvider> {
    Arc::new(rustls::crypto::ring::default_provider())
}

/// What a certificate in DER is known by.
fn fingerprint(certificate: &[u8]) -> Fingerprint {
    Fingerprint::new(Sha256::digest(certificate).into())
}

/// Whether who shows a certificate has its key: asked where whose it is is decided otherwise.
#[derive(Debug)]
struct Signatures(Arc<CryptoProvider>);

impl Signatures {
    fn tls12(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls12_signature(
            message,
            certificate,
            signed,
            &self.0.signature_verification_algorithms,
        )
    }

    fn tls13(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls13_signature(
            message,
            certificate,
            signed,
            &self.0.signature_verification_algorithms,
        )
    }

    fn schemes(&self) -> Vec<SignatureScheme> {
        self.0.signature_verification_algorithms.supported_schemes()
    }
}

fn invalid(error: rustls::Error) -> io::Error {
    match error {
        // In our own words, which its Display would introduce as unexpected.
        rustls::Error::General(text) => io::Error::new(ErrorKind::InvalidData, text),
        error => io::Error::new(ErrorKind::InvalidData, error),
    }
}

/// One TCP connection with TLS on it.
#[derive(Debug)]
pub(crate) struct TlsLink {
    stream: TcpStream,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    tls: Connection,
    /// The last byte that was taken is not told yet: the network has not taken all that was made of it. A caller that
    /// writes comes back for that byte, and so the rest is sent.
    owed: bool,
    /// Bytes given to the network, and bytes taken to be encrypted.
    sent: u64,
    taken: u64,
    /// How many more were given than taken when all was sent the last time: handshake and records.
    overhead: u64,
    /// What still comes is thrown away.
    forgets: bool,
}

impl TlsLink {
    /// Shakes hands, from the bytes that have come already on. Whatever fails is told to the other side.
    pub(crate) async fn handshake(
        stream: TcpStream,
        mut tls: Connection,
        mut arrived: &[u8],
    ) -> io::Result<Arc<TlsLink>> {
        tls.set_buffer_limit(Some(AHEAD));
        let mut sent = 0;
        loop {
            while tls.wants_write() {
                match tls.write_tls(&mut Socket(&stream)) {
                    Ok(bytes) => sent += bytes as u64,
                    Err(error) if error.kind() == ErrorKind::WouldBlock => stream.writable().await?,
                    Err(error) => return Err(error),
                }
            }
            if !tls.is_handshaking() && arrived.is_empty() {
                let state = State {
                    tls,
                    owed: false,
                    sent,
                    taken: 0,
                    overhead: sent,
                    forgets: false,
                };
                let state = Mutex::new(state);
                return Ok(Arc::new(TlsLink { stream, state }));
            }
            let read = match arrived.is_empty() {
                false => tls.read_tls(&mut arrived),
                true => {
                    stream.readable().await?;
                    tls.read_tls(&mut Socket(&stream))
                }
            };
            match read {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => continue,
                Err(error) => return Err(error),
            }
            if let Err(error) = tls.process_new_packets() {
                // The alert says why; best effort, as the connection ends anyway.
                let _ = tls.write_tls(&mut Socket(&stream));
                return Err(invalid(error));
            }
        }
    }

    /// The connection below.
    pub(crate) fn stream(&self) -> &TcpStream {
        &self.stream
    }

    /// The certificate that the other side has shown and proved to have the key of.
    pub(crate) fn certificate(&self) -> Option<Fingerprint> {
        let state = self.state.lock();
        let certificates = state.tls.peer_certificates()?;
        certificates.first().map(|first| fingerprint(first))
    }

    /// Reads what has arrived; 0 bytes at the end. Stateless, so that it may be begun anew at each poll.
    pub(crate) fn poll_read(
        &self,
        room: &mut impl BufMut,
        context: &mut Context<'_>,
    ) -> Poll<io::Result<usize>> {
        // What came with the end of the handshake.
        if let Some(read) = self.state.lock().read(room)? {
            return Poll::Ready(Ok(read));
        }
        loop {
            ready!(self.stream.poll_read_ready(context))?;
            match self.receive(room) {
                Ok(None) => return next_turn(context),
                Ok(Some(read)) => return Poll::Ready(Ok(read)),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => return Poll::Ready(Err(error)),
            }
        }
    }

    /// Reads from the network and decrypts; none if that is nothing for the reader yet.
    fn receive(&self, room: &mut impl BufMut) -> io::Result<Option<usize>> {
        // Much at once, though rustls takes it by 4 KiB.
        ARRIVED.with_borrow_mut(|arrived| {
            arrived.resize(AT_ONCE, 0);
            let count = self.stream.try_read(arrived)?;
            let mut state = self.state.lock();
            match count {
                0 => Ok(Some(0)),
                _ if state.forgets => Ok(None),
                count => state.decrypt(&arrived[..count], room, &self.stream),
            }
        })
    }

    /// Writes the front of these pieces; gives how much of it, none if the network takes nothing now.
    pub(crate) fn try_write(&self, pieces: &[IoSlice<'_>]) -> io::Result<Option<usize>> {
        let mut state = self.state.lock();
        if !state.send(&self.stream)? {
            return Ok(None);
        }
        let begun = std::mem::take(&mut state.owed);
        let taken = state.take(pieces, begun)?;
        state.owed = !state.send(&self.stream)?;
        match usize::from(begun) + taken - usize::from(state.owed) {
            0 => Ok(None),
            told => Ok(Some(told)),
        }
    }

    pub(crate) async fn writable(&self) -> io::Result<()> {
        self.stream.writable().await
    }

    /// The state of the network, as if it knew the bytes that were taken only.
    pub(crate) fn link(&self) -> Option<TcpState> {
        let mut link = options::link(&self.stream)?;
        link.acknowledged = link.acknowledged.saturating_sub(self.state.lock().overhead);
        Some(link)
    }

    /// Decrypts nothing more: what still comes is thrown away, and a broken record is not worth an alert after the end
    /// of what this side says.
    pub(crate) fn forget(&self) {
        self.state.lock().forgets = true;
    }

    /// Says that nothing more comes from this end.
    pub(crate) fn finish(&self) {
        let mut state = self.state.lock();
        state.tls.send_close_notify();
        // A link that is gone or full needs no goodbye.
        let _ = state.send(&self.stream);
        let _ = socket2::SockRef::from(&self.stream).shutdown(std::net::Shutdown::Write);
    }
}

impl State {
    /// Plaintext that is here already, none if something has to arrive first.
    fn read(&mut self, room: &mut impl BufMut) -> io::Result<Option<usize>> {
        let mut reader = self.tls.reader();
        let chunk = match reader.fill_buf() {
            Ok(chunk) => chunk,
            Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(None),
            // Frames tell their own ends: one that is cut short is found there.
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(Some(0)),
            Err(error) => return Err(error),
        };
        let read = chunk.len().min(room.remaining_mut());
        room.put_slice(&chunk[..read]);
        reader.consume(read);
        Ok(Some(read))
    }

    /// Decrypts what has arrived; none if that is nothing for the reader.
    fn decrypt(
        &mut self,
        mut arrived: &[u8],
        room: &mut impl BufMut,
        stream: &TcpStream,
    ) -> io::Result<Option<usize>> {
        let mut read = 0;
        let mut ended = false;
        while !arrived.is_empty() && !ended {
            self.tls.read_tls(&mut arrived)?;
            let processed = self.tls.process_new_packets();
            // An alert, or the answer to a change of keys.
            if self.tls.wants_write() {
                self.send(stream)?;
            }
            ended = processed.map_err(invalid)?.peer_has_closed();
            while let Some(more @ 1..) = self.read(room)? {
                read += more;
            }
        }
        Ok(Some(read).filter(|read| *read > 0 || ended))
    }

    /// Encrypts the front of these pieces, all in as few records as hold it; gives how much of it. `begun` = the first
    /// byte is encrypted already.
    fn take(&mut self, pieces: &[IoSlice<'_>], begun: bool) -> io::Result<usize> {
        let mut pieces = pieces.to_vec();
        let mut rest = &mut pieces[..];
        IoSlice::advance_slices(&mut rest, usize::from(begun));
        let taken = self.tls.writer().write_vectored(rest)?;
        self.taken += taken as u64;
        Ok(taken)
    }

    /// Gives the network what is encrypted; false if it does not take all.
    fn send(&mut self, stream: &TcpStream) -> io::Result<bool> {
        while self.tls.wants_write() {
            match self.tls.write_tls(&mut Socket(stream)) {
                Ok(bytes) => self.sent += bytes as u64,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(false),
                Err(error) => return Err(error),
            }
        }
        self.overhead = self.sent.saturating_sub(self.taken);
        Ok(true)
    }
}

/// The network as rustls wants it, which never waits.
struct Socket<'a>(&'a TcpStream);

impl Read for Socket<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.0.try_read(buffer)
    }
}

impl Write for Socket<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.try_write(bytes)
    }

    fn write_vectored(&mut self, pieces: &[IoSlice<'_>]) -> io::Result<usize> {
        self.0.try_write_vectored(pieces)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
