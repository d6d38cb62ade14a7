//! The table `[audit]` of the configuration.

use std::path::{Path, PathBuf};

use serde::Deserialize;

/// Where the audit log goes, and how much of it is kept.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct AuditConfig {
    /// The file, relative to the configuration file; none = the log, at level info under the target `audit`.
    pub path: Option<PathBuf>,
    /// Bytes after which a new file is begun.
    pub size: u64,
    /// Files that are kept beside the present one: `audit.jsonl.1` is the youngest.
    pub keep: u32,
    /// Bytes that are left free on their disk, a tenth of it at most: where less is free the oldest files go, then lines.
    pub reserve: u64,
}

impl Default for AuditConfig {
    fn default() -> AuditConfig {
        AuditConfig {
            path: None,
            size: 16 * 1024 * 1024,
            keep: 8,
            reserve: crate::RESERVE,
        }
    }
}

impl AuditConfig {
    /// The least size of a file: one line always has room.
    pub const LEAST: u64 = 4096;

    /// Takes the path as relative to this folder.
    pub fn resolve(&mut self, folder: &Path) {
        if let Some(path) = &mut self.path {
            *path = folder.join(&*path);
        }
    }
}
