//! The table `[record]` of the configuration.

use std::path::{Path, PathBuf};

use serde::Deserialize;

/// Where the hub's inputs are recorded.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct RecordConfig {
    /// The file, relative to the configuration file; none = nothing is recorded. Each start begins it anew; the one
    /// before is kept with `.1` behind its name.
    pub path: Option<PathBuf>,
    /// Bytes after which recording stops.
    pub size: u64,
}

impl Default for RecordConfig {
    fn default() -> RecordConfig {
        RecordConfig {
            path: None,
            size: 256 * 1024 * 1024,
        }
    }
}

impl RecordConfig {
    /// The least size of a file.
    pub const LEAST: u64 = 4096;

    /// Takes the path as relative to this folder.
    pub fn resolve(&mut self, folder: &Path) {
        if let Some(path) = &mut self.path {
            *path = folder.join(&*path);
        }
    }
}
