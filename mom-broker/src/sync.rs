//! What threads meet at: locks, atomics, wake-ups and the threads themselves, in one place.
//!
//! They are parking_lot's, std's and tokio's own, and nothing is added to them. Only in the tests that
//! `cargo xtask shuttle` builds they are shuttle's, which runs all threads of a test in turns and tries one order of
//! steps after the other. Whatever the outboxes, the channels, the switchboard and the store share is taken from
//! here; what is taken from elsewhere is one step to those tests.

#[cfg(not(all(test, shuttle)))]
pub(crate) use parking_lot::{Condvar, Mutex, MutexGuard};
#[cfg(not(all(test, shuttle)))]
pub(crate) use std::{sync::atomic, thread};
#[cfg(not(all(test, shuttle)))]
pub(crate) use tokio::sync::Notify;

#[cfg(all(test, shuttle))]
mod shuttled;
#[cfg(all(test, shuttle))]
pub(crate) use shuttle::{sync::atomic, thread};
#[cfg(all(test, shuttle))]
pub(crate) use shuttled::{Condvar, Mutex, MutexGuard, Notify};
