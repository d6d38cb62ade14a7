//! Recordings of the hub's inputs and decisions, so that they can be decided again under other rules.
//!
//! The hub is deterministic: the same inputs at the same times give the same effects. So a recording has the inputs
//! with their times, and beside each its decision, for comparison. Messages that pass by a standing verdict never
//! reach the hub and are not recorded.

mod difference;
mod line;
mod log;
mod outcome;
mod recorder;
mod replay;
mod settings;
#[cfg(test)]
mod tests;
mod translations;
mod value;

pub use difference::{Decision, Difference};
pub use log::RecordError;
pub use outcome::Outcome;
pub(crate) use recorder::Recorder;
pub use replay::{Replay, Summary};
pub use settings::RecordConfig;
