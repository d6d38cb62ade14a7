//! The table `[record]` of the configuration.

use std::path::{Path, PathBuf};

use serde::Deserialize;

/// Where the hub's inputs are recorded.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct RecordConfig {
    /// The file, relative to the configuration file; none = nothing is recorded. Each start begins it anew.
    pub path: Option<PathBuf>,
    /// Bytes after which recording stops.
    pub size: u64,
    /// Earlier recordings that are kept beside the present one: `control.jsonl.1` is the youngest.
    pub keep: u32,
    /// Bytes that are left free on their disk, a tenth of it at most: where less is free the oldest recordings go, then
    /// recording stops.
    pub reserve: u64,
}

impl Default for RecordConfig {
    fn default() -> RecordConfig {
        RecordConfig {
            path: None,
            size: 256 * 1024 * 1024,
            keep: 1,
            reserve: crate::RESERVE,
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
