//! Errors of opening a journal.

use std::path::{Path, PathBuf};

/// A file that the journal cannot write.
#[derive(Debug, thiserror::Error)]
#[error("cannot write the {what} {}: {error}", path.display())]
pub struct WriteError {
    /// Its purpose.
    pub what: &'static str,
    /// The file.
    pub path: PathBuf,
    /// What the system says.
    pub error: std::io::Error,
}

impl WriteError {
    pub(crate) fn of(what: &'static str, path: Option<&Path>) -> impl FnOnce(std::io::Error) -> WriteError {
        let path = path.unwrap_or(Path::new("")).to_owned();
        move |error| WriteError { what, path, error }
    }
}
