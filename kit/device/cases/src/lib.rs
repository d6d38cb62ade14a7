//! Dialogues with a device's server, for tests: who says what, and what the channel hears.
//!
//! [`replay`] plays the dialogues of `tests/cases/device.txt`, which say what every device does alike, over a machine;
//! `tests/cases/README.md` says what their lines mean. A [`Stage`] plays lines of a machine's own.
#![expect(
    clippy::unwrap_used,
    clippy::missing_panics_doc,
    reason = "a library for tests: what does not fit fails the test"
)]

mod line;
mod replay;
mod stage;

pub use replay::{Statements, check, replay};
pub use stage::Stage;
