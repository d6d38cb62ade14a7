//! A client's side of TLS: which hub it trusts, and what it shows of itself.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mom_proto::Fingerprint;
use rustls::client::WebPkiServerVerifier;
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::{ClientConfig, ClientConnection, DigitallySignedStruct, RootCertStore, SignatureScheme};
use rustls_pki_types::{CertificateDer, ServerName, UnixTime};

use super::server::{TlsError, certificates, private_key};
use super::{Signatures, fingerprint, provider};

/// Which hub is the right one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Trust {
    /// One whose certificate was signed by whom this system trusts.
    #[default]
    System,
    /// One whose certificate was signed by one in this file, in PEM.
    Authorities(PathBuf),
    /// The one with this certificate, whatever its name.
    Pinned(Fingerprint),
}

/// A certificate to log in with, and its key, both in PEM.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// The file of the certificate.
    pub certificate: PathBuf,
    /// The file of its key.
    pub key: PathBuf,
}

/// How a client speaks TLS.
#[derive(Clone, Debug)]
pub struct ClientTls(Arc<ClientConfig>);

impl ClientTls {
    /// Reads the files that are named.
    ///
    /// # Errors
    /// Files that cannot be read or used; a system that trusts nobody.
    pub fn new(trust: &Trust, identity: Option<&Identity>) -> Result<ClientTls, TlsError> {
        let provider = provider();
        let named = match trust {
            Trust::Authorities(file) => file.clone(),
            Trust::System | Trust::Pinned(_) => PathBuf::from("the system's certificates"),
        };
        let failed = |why: String| TlsError::new(&named, &why);
        let verifier: Arc<dyn ServerCertVerifier> = match trust {
            Trust::Pinned(pin) => Arc::new(Pinned(*pin, Signatures(Arc::clone(&provider)))),
            Trust::System | Trust::Authorities(_) => {
                let roots = Arc::new(roots(trust, &named)?);
                WebPkiServerVerifier::builder_with_provider(roots, Arc::clone(&provider))
                    .build()
                    .map_err(|error| failed(error.to_string()))?
            }
        };
        let builder = ClientConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .map_err(|error| failed(error.to_string()))?
            .dangerous()
            .with_custom_certificate_verifier(verifier);
        let config = match identity {
            None => builder.with_no_client_auth(),
            Some(Identity { certificate, key }) => builder
                .with_client_auth_cert(certificates(certificate)?, private_key(key)?)
                .map_err(|error| TlsError::new(key, &error))?,
        };
        Ok(ClientTls(Arc::new(config)))
    }

    pub(crate) fn connection(&self, host: &str) -> io::Result<ClientConnection> {
        let name = ServerName::try_from(host.to_owned()).map_err(io::Error::other)?;
        ClientConnection::new(Arc::clone(&self.0), name).map_err(io::Error::other)
    }
}

fn roots(trust: &Trust, named: &Path) -> Result<RootCertStore, TlsError> {
    let found = match trust {
        Trust::Authorities(file) => certificates(file)?,
        // What cannot be read of the system's is left out; what remains is trusted.
        _ => rustls_native_certs::load_native_certs().certs,
    };
    let mut roots = RootCertStore::empty();
    roots.add_parsable_certificates(found);
    match roots.is_empty() {
        true => Err(TlsError::new(named, &"there is no certificate to trust")),
        false => Ok(roots),
    }
}

/// Trusts one certificate. Its name and its dates do not matter: the user who named its fingerprint has checked it.
#[derive(Debug)]
struct Pinned(Fingerprint, Signatures);

impl ServerCertVerifier for Pinned {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        _intermediates: &[CertificateDer<'_>],
        _name: &ServerName<'_>,
        _ocsp: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, rustls::Error> {
        let shown = fingerprint(end_entity);
        match shown == self.0 {
            true => Ok(ServerCertVerified::assertion()),
            false => Err(rustls::Error::General(format!(
                "the hub shows another certificate, {shown}, than the pinned one, {}",
                self.0
            ))),
        }
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        self.1.tls12(message, certificate, signed)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        self.1.tls13(message, certificate, signed)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.1.schemes()
    }
}
