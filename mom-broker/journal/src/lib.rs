//! The audit log for people, recordings for `mom-broker what-if`, and the tap between broker and hub that feeds both; and the way
//! of log lines.

mod audit;
mod config_file;
mod error;
mod fold;
mod kept_files;
mod log_writer;
mod record;
mod tap;

pub use audit::{AuditConfig, AuditLog, AuditQuery, AuditScan, Fact};
pub use config_file::ConfigFile;
pub use error::WriteError;
pub use fold::FoldedLines;
pub use log_writer::LogWriter;
pub use record::{Decision, Difference, Outcome, RecordConfig, RecordError, Replay, Summary};
pub use tap::Tap;

/// What logs leave free on their disk if nothing else is said: enough for a store to go on for long.
const RESERVE: u64 = 64 * 1024 * 1024;
