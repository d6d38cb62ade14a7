//! Destinations of audit lines.

use std::io;

/// A destination of lines.
pub(super) trait LineSink: Send {
    /// Appends whole lines; gives how many were written, and why the others were not.
    fn append(&mut self, lines: &[Vec<u8>]) -> (usize, io::Result<()>);

    /// Makes durable what was appended.
    ///
    /// # Errors
    /// What the system says.
    fn sync(&mut self) -> io::Result<()>;
}

/// The ordinary log, used if no file is configured.
#[derive(Debug)]
pub(super) struct TracingSink;

impl LineSink for TracingSink {
    fn append(&mut self, lines: &[Vec<u8>]) -> (usize, io::Result<()>) {
        for line in lines {
            tracing::info!(target: "audit", "{}", String::from_utf8_lossy(line).trim_end());
        }
        (lines.len(), Ok(()))
    }

    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}
