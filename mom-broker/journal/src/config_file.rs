//! The configuration file of a hub.

/// A configuration file, as the audit log and recordings name it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ConfigFile {
    /// Its name without folders; none for a configuration that was made in a program.
    pub name: Option<String>,
    /// The SHA-256 of its text in hexadecimal digits, as `sha256sum` writes it.
    pub sha256: Option<String>,
}
