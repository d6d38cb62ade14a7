//! Asking managers, peers and chairs.

pub(crate) mod consult;
pub(crate) mod questions;
