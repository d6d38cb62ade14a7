//! Contexts come and go, and who is in them.

pub(crate) mod make;
mod membership;
