//! How a token gains, changes and loses its owner.

pub(crate) mod change;
mod describe;
pub(crate) mod grant;
pub(crate) mod handover;
pub(crate) mod queue;
