//! The journal's view of a configuration.

use std::path::Path;

use mom_journal::{ConfigFile, RecordError, Replay};
use sha2::{Digest, Sha256};

use crate::Config;

impl Config {
    /// Its file, as named in the journal.
    pub fn file(&self) -> ConfigFile {
        let source = self.source.as_ref();
        let name = source.and_then(|source| Path::new(&source.name).file_name());
        let sha256 = |text: &str| {
            Sha256::digest(text)
                .iter()
                .map(|byte| format!("{byte:02x}"))
                .collect()
        };
        ConfigFile {
            name: name.map(|name| name.to_string_lossy().into_owned()),
            sha256: source.map(|source| sha256(&source.text)),
        }
    }

    /// The name under which its stops are kept in a directory that several brokers may share.
    pub fn stops_name(&self) -> String {
        let path = self.source.as_ref().map(|source| Path::new(&source.name));
        let path = path.map(|path| path.canonicalize().unwrap_or_else(|_| path.to_owned()));
        let Some(path) = path.filter(|_| self.store.path.is_none()) else {
            return "stops".to_owned();
        };
        let sum = Sha256::digest(path.as_os_str().as_encoded_bytes());
        let sum: String = sum.iter().take(4).map(|byte| format!("{byte:02x}")).collect();
        format!("stops-{sum}")
    }

    /// Opens a recording, to decide it again by this configuration.
    ///
    /// # Errors
    /// A file that is not a recording, or a configuration that is wrong.
    pub fn replay(&self, log: &Path) -> Result<Replay, RecordError> {
        let users = self.users.iter().map(|user| user.to_user()).collect();
        Replay::open(log, self.limits.clone(), users, |settings| {
            self.make_hub(settings)
        })
    }
}
