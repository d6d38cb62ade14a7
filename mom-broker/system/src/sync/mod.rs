//! Locks, atomics, wake-ups and threads, in one place.
//!
//! They are parking_lot's, std's and tokio's own, and nothing is added to them. Only with the feature `shuttle`,
//! which `cargo xtask shuttle` sets, are they shuttle's: it runs the threads of a test one at a time and tries one
//! interleaving after the other. Everything that the broker's threads share must come from here; primitives from
//! elsewhere are a single step to those tests.

#[cfg(not(feature = "shuttle"))]
pub use parking_lot::{Condvar, Mutex, MutexGuard};
#[cfg(not(feature = "shuttle"))]
pub use std::{sync::atomic, thread};
#[cfg(not(feature = "shuttle"))]
pub use tokio::sync::Notify;

#[cfg(feature = "shuttle")]
mod explore;
#[cfg(feature = "shuttle")]
mod shuttled;
#[cfg(feature = "shuttle")]
pub use explore::explore;
#[cfg(feature = "shuttle")]
pub use shuttle::{sync::atomic, thread};
#[cfg(feature = "shuttle")]
pub use shuttled::{Condvar, Mutex, MutexGuard, Notify};
