//! What is said over one connection: the queue of what leaves, proofs and the reply to them, stamps of time, and spans of it.

pub(crate) mod clock;
pub(crate) mod ids;
pub(crate) mod key;
pub(crate) mod link_secret;
pub(crate) mod outbox;
pub(crate) mod proof;
pub(crate) mod trace;
pub(crate) mod welcome;
