//! Contexts come and go, and peers join and leave them (M23, M24, M30).

mod delete;
pub(crate) mod make;
mod membership;
mod presence;
mod steps;
