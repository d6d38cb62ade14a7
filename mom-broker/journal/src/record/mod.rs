//! What the hub was told and what it decided, written down so that it can be decided again under other rules.
//!
//! The hub is deterministic: the same inputs at the same times give the same effects. So a recording holds the inputs
//! alone, with their times, and beside each what was decided, to compare. Messages that pass by a standing verdict
//! never come to the hub; they are not in it.

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
