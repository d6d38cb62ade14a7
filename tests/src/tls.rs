//! Certificates for tests, made once for each process.

use std::path::Path;
use std::sync::OnceLock;

use mom_broker::TlsConfig;
use mom_net::{Identity, SelfSigned};
use tempfile::TempDir;

/// The `[tls]` of a hub that has made its own certificate, for `localhost` and 127.0.0.1.
///
/// # Panics
/// If there is no folder for it.
pub fn of_hub() -> TlsConfig {
    let folder = folder();
    let config = TlsConfig {
        certificate: Some(folder.join("hub.crt")),
        key: Some(folder.join("hub.key")),
        ..TlsConfig::default()
    };
    static MADE: OnceLock<()> = OnceLock::new();
    MADE.get_or_init(|| {
        make(folder, "hub");
    });
    config
}

/// Makes `NAME.crt` and `NAME.key` in a folder.
///
/// # Panics
/// If they cannot be written.
pub fn make(folder: &Path, name: &str) -> Identity {
    let files = SelfSigned {
        certificate: folder.join(format!("{name}.crt")),
        key: folder.join(format!("{name}.key")),
    };
    let hosts = vec!["localhost".to_owned(), "127.0.0.1".to_owned()];
    files.make(hosts).expect("a folder that can be written to");
    Identity {
        certificate: files.certificate,
        key: files.key,
    }
}

/// The fingerprint of a certificate.
pub fn fingerprint(files: &Identity) -> Option<String> {
    let made = mom_net::ServerTls::from_files(&files.certificate, &files.key).ok()?;
    Some(made.fingerprint().to_string())
}

fn folder() -> &'static Path {
    static FOLDER: OnceLock<TempDir> = OnceLock::new();
    FOLDER
        .get_or_init(|| tempfile::tempdir().expect("a temporary folder"))
        .path()
}
