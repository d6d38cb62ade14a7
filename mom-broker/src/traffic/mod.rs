//! From a sender to its receivers: who gets a message, what it waits for, and what becomes of it.

mod batch;
pub(crate) mod capacity;
pub(crate) mod channel;
pub(crate) mod encodings;
mod history;
pub(crate) mod inquiries;
#[cfg(all(test, feature = "shuttle"))]
#[path = "../../tests/interleaved/mod.rs"]
mod interleaved;
mod later_frame;
pub(crate) mod memory;
pub(crate) mod outbox;
mod replay;
mod statistics;
pub(crate) mod switchboard;
mod trace;
