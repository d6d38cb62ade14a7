//! Tokens: asking for one, holding it, and giving it to another peer.

pub(crate) mod ask_owner;
pub(crate) mod give;
pub(crate) mod grab;
pub(crate) mod guard;
pub(crate) mod holding;
pub(crate) mod inhibit;
mod owning;
pub(crate) mod token;
