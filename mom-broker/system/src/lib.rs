//! System services for the broker: the clock, locks and threads, private files.
//!
//! Each of them can be replaced for tests: the clock by a manual one, locks and threads by those of
//! shuttle (feature `shuttle`).

mod clock;
mod machine;
mod own_file;
pub mod sync;
mod workers;

pub use clock::{Clock, Expiry};
pub use machine::machine_memory;
pub use own_file::{DiskSpace, disk_space, numbered, open_own};
pub use workers::{Workers, give_way};
