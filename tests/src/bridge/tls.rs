//! TLS around whatever bytes.

use std::io::{self, Read as _, Write as _};
use std::net::SocketAddr;
use std::sync::Arc;

use rustls::client::WebPkiServerVerifier;
use rustls::crypto::ring;
use rustls::{ClientConfig, ClientConnection, RootCertStore};
use rustls_pki_types::pem::PemObject as _;
use rustls_pki_types::{CertificateDer, ServerName};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

/// A client that trusts the hub of [`crate::tls::of_hub`].
pub(crate) fn client() -> ClientConnection {
    let provider = Arc::new(ring::default_provider());
    let file = crate::tls::of_hub().certificate.expect("a file");
    let mut roots = RootCertStore::empty();
    let certificate = CertificateDer::from_pem_file(file).expect("a certificate");
    roots.add(certificate).expect("one that can be trusted");
    let verifier = WebPkiServerVerifier::builder_with_provider(Arc::new(roots), Arc::clone(&provider));
    let config = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .expect("TLS")
        .with_webpki_verifier(verifier.build().expect("one to trust"))
        .with_no_client_auth();
    let name = ServerName::try_from("localhost").expect("a name");
    ClientConnection::new(Arc::new(config), name).expect("TLS")
}

pub(super) async fn carry(near: TcpStream, hub: SocketAddr) -> io::Result<()> {
    let hub = super::dial(hub).await?;
    let (mut from_near, mut to_near) = near.into_split();
    let (mut from_hub, mut to_hub) = hub.into_split();
    let mut tls = client();
    let (mut up, mut down) = (vec![0; 16 * 1024], vec![0; 16 * 1024]);
    let mut open = true;
    loop {
        let mut out = Vec::new();
        while tls.wants_write() {
            tls.write_tls(&mut out)?;
        }
        to_hub.write_all(&out).await?;
        tokio::select! {
            read = from_near.read(&mut up), if open && !tls.is_handshaking() => match read? {
                0 => {
                    open = false;
                    tls.send_close_notify();
                }
                count => tls.writer().write_all(&up[..count])?,
            },
            read = from_hub.read(&mut down) => {
                let count = read?;
                let mut arrived = &down[..count];
                let mut plain = Vec::new();
                while !arrived.is_empty() {
                    tls.read_tls(&mut arrived)?;
                    let state = tls.process_new_packets().map_err(io::Error::other)?;
                    let mut some = vec![0; state.plaintext_bytes_to_read()];
                    tls.reader().read_exact(&mut some)?;
                    plain.extend(some);
                }
                to_near.write_all(&plain).await?;
                if count == 0 {
                    return to_near.shutdown().await;
                }
            }
        }
    }
}
