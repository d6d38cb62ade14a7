//! The client and its proxies for contexts.

pub(crate) mod builder;
pub(crate) mod channel;
pub(crate) mod client;
pub(crate) mod consults;
pub(crate) mod events;
pub(crate) mod membership;
pub(crate) mod message;
pub(crate) mod session;
pub(crate) mod stops;
