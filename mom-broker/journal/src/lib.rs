//! The audit log for people, recordings for `mom-broker what-if`, and the tap between broker and hub that feeds both.

mod audit;
mod config_file;
mod error;
mod record;
mod tap;

pub use audit::{AuditConfig, AuditLog, Fact};
pub use config_file::ConfigFile;
pub use error::WriteError;
pub use record::{Decision, Difference, Outcome, RecordConfig, RecordError, Replay, Summary};
pub use tap::Tap;
