//! What this peer is at the hub, behind one lock: what it waits for, where it is, who listens, and what it holds.

mod answers;
pub(crate) mod guards;
pub(crate) mod handover;
pub(crate) mod holds;
pub(crate) mod joins;
pub(crate) mod link_state;
pub(crate) mod losses;
pub(crate) mod pending;
pub(crate) mod shared;
pub(crate) mod state;
pub(crate) mod subscribers;
mod waits;
pub(crate) mod wanted;
