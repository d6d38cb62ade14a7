//! Which file a configuration is, for logs and recordings.

use sha2::{Digest, Sha256};

use super::Config;

impl Config {
    /// The name of its file, without folders; none for one that was made in a program.
    pub(crate) fn file_name(&self) -> Option<String> {
        let path = std::path::Path::new(&self.source.as_ref()?.name);
        path.file_name().map(|name| name.to_string_lossy().into_owned())
    }

    /// The SHA-256 of its file's text, as `sha256sum` writes it.
    pub(crate) fn text_hash(&self) -> Option<String> {
        let hash = Sha256::digest(&self.source.as_ref()?.text);
        Some(hash.iter().map(|byte| format!("{byte:02x}")).collect())
    }
}
