//! What the broker takes from the system: the clock, locks and threads, files of its own.
//!
//! Each of them can be replaced for tests: the clock by one that is moved by hand, locks and threads by those of
//! shuttle (feature `shuttle`).

mod clock;
mod own_file;
pub mod sync;

pub use clock::Clock;
pub use own_file::{numbered, open_own};
