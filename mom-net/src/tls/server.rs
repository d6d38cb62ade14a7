//! The hub's side of TLS: its certificate, and those that peers show.

use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mom_proto::Fingerprint;
use rustls::client::danger::HandshakeSignatureValid;
use rustls::server::danger::{ClientCertVerified, ClientCertVerifier};
use rustls::{DigitallySignedStruct, DistinguishedName, ServerConfig, ServerConnection, SignatureScheme};
use rustls_pki_types::pem::PemObject as _;
use rustls_pki_types::{CertificateDer, PrivateKeyDer, UnixTime};

use super::{Signatures, fingerprint, provider};

/// Why a certificate or a key cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{}: {why}", file.display())]
pub struct TlsError {
    /// The file that is wrong, or cannot be read or written.
    pub file: PathBuf,
    /// What is wrong.
    pub why: String,
}

impl TlsError {
    pub(super) fn new(file: &Path, why: &impl ToString) -> TlsError {
        TlsError {
            file: file.to_owned(),
            why: why.to_string(),
        }
    }
}

/// A certificate with its key, as the hub shows it. Peers may show one, too.
#[derive(Clone, Debug)]
pub struct ServerTls {
    config: Arc<ServerConfig>,
    fingerprint: Fingerprint,
}

impl ServerTls {
    /// Reads a certificate, with those that signed it behind it, and its key, both in PEM.
    ///
    /// # Errors
    /// Files that cannot be read, that hold no certificate or no key, or that do not belong together.
    pub fn from_files(certificate: &Path, key: &Path) -> Result<ServerTls, TlsError> {
        let chain = certificates(certificate)?;
        let first = chain
            .first()
            .ok_or_else(|| TlsError::new(certificate, &"it holds no certificate in PEM"))?;
        let shown = fingerprint(first);
        let private = private_key(key)?;
        let provider = provider();
        let config = ServerConfig::builder_with_provider(Arc::clone(&provider))
            .with_safe_default_protocol_versions()
            .map_err(|error| TlsError::new(certificate, &error))?
            .with_client_cert_verifier(Arc::new(AnyCertificate(Signatures(provider))))
            .with_single_cert(chain, private)
            .map_err(|error| {
                TlsError::new(
                    key,
                    &format!("it is not a key of {}: {error}", certificate.display()),
                )
            })?;
        Ok(ServerTls {
            config: Arc::new(config),
            fingerprint: shown,
        })
    }

    /// What clients may know it by.
    pub fn fingerprint(&self) -> Fingerprint {
        self.fingerprint
    }

    pub(crate) fn connection(&self) -> io::Result<ServerConnection> {
        ServerConnection::new(Arc::clone(&self.config)).map_err(io::Error::other)
    }
}

/// A certificate that nobody has signed, for those who know its fingerprint.
#[derive(Clone, Debug)]
pub struct SelfSigned {
    /// Where it is kept.
    pub certificate: PathBuf,
    /// Where its key is kept.
    pub key: PathBuf,
}

impl SelfSigned {
    /// Makes certificate and key for hosts of these names, unless both files are there already.
    ///
    /// # Errors
    /// Files that cannot be written, or one without the other, which is not overwritten.
    pub fn make(&self, hosts: Vec<String>) -> Result<(), TlsError> {
        let missing =
            "it is missing, but its counterpart exists: restore it, or remove both to generate new ones";
        match (self.certificate.exists(), self.key.exists()) {
            (true, true) => return Ok(()),
            (false, false) => {}
            (false, true) => return Err(TlsError::new(&self.certificate, &missing)),
            (true, false) => return Err(TlsError::new(&self.key, &missing)),
        }
        let made = rcgen::generate_simple_self_signed(hosts);
        let made = made.map_err(|error| TlsError::new(&self.certificate, &error))?;
        write(&self.key, &made.signing_key.serialize_pem())?;
        write(&self.certificate, &made.cert.pem())
    }
}

/// Writes a file that nobody else may read.
fn write(path: &Path, text: &str) -> Result<(), TlsError> {
    let mut options = fs::OpenOptions::new();
    options.write(true).create(true).truncate(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let written = options.open(path).and_then(|mut file| {
        file.write_all(text.as_bytes())?;
        file.sync_all()
    });
    written.map_err(|error| TlsError::new(path, &format!("it cannot be written: {error}")))
}

pub(super) fn certificates(file: &Path) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let text = fs::read(file).map_err(|error| TlsError::new(file, &format!("it cannot be read: {error}")))?;
    let read: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&text).collect();
    read.map_err(|error| TlsError::new(file, &format!("it is not a certificate in PEM: {error}")))
}

pub(super) fn private_key(file: &Path) -> Result<PrivateKeyDer<'static>, TlsError> {
    let text = fs::read(file).map_err(|error| TlsError::new(file, &format!("it cannot be read: {error}")))?;
    PrivateKeyDer::from_pem_slice(&text)
        .map_err(|error| TlsError::new(file, &format!("it holds no private key in PEM: {error}")))
}

/// Takes whatever certificate a peer shows and has the key of: whose it is, the users file says by its fingerprint.
#[derive(Debug)]
struct AnyCertificate(Signatures);

impl ClientCertVerifier for AnyCertificate {
    fn client_auth_mandatory(&self) -> bool {
        false
    }

    fn root_hint_subjects(&self) -> &[DistinguishedName] {
        &[]
    }

    fn verify_client_cert(
        &self,
        _end_entity: &CertificateDer<'_>,
        _intermediates: &[CertificateDer<'_>],
        _now: UnixTime,
    ) -> Result<ClientCertVerified, rustls::Error> {
        Ok(ClientCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        self.0.tls12(message, certificate, signed)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        self.0.tls13(message, certificate, signed)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.0.schemes()
    }
}
