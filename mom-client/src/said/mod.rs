//! What the hub says, typed.

pub(crate) mod events;
pub(crate) mod info;
pub(crate) mod ownership;
pub(crate) mod stats;
pub(crate) mod stop_state;
pub(crate) mod token_info;
