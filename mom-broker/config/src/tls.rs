//! The certificate that the hub shows.

use std::path::{Path, PathBuf};

use serde::Deserialize;

/// The `[tls]` of the configuration.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct TlsConfig {
    /// The file of the certificate, with those that signed it behind it; none = no TLS.
    pub certificate: Option<PathBuf>,
    /// The file of its key.
    pub key: Option<PathBuf>,
    /// Both files are made where they are not there, and nobody signs them.
    pub self_signed: bool,
    /// The names of this hub, for the certificate that is made.
    pub hosts: Vec<String>,
}

impl Default for TlsConfig {
    fn default() -> TlsConfig {
        TlsConfig {
            certificate: None,
            key: None,
            self_signed: false,
            hosts: vec!["localhost".to_owned()],
        }
    }
}

impl TlsConfig {
    /// Takes the files relative to this folder.
    pub(crate) fn resolve(&mut self, folder: &Path) {
        for file in [&mut self.certificate, &mut self.key].into_iter().flatten() {
            *file = folder.join(&*file);
        }
    }
}
