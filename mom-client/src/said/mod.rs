//! What the hub says, typed.

pub(crate) mod events;
pub(crate) mod info;
pub(crate) mod stats;
pub(crate) mod token_info;
