//! What the hub knows, and what it wants done.

pub(crate) mod audit;
pub(crate) mod effect;
pub(crate) mod events;
mod facts;
pub(crate) mod settings;
