//! Contexts come and go, and peers join and leave them (M23, M24, M30).

mod delete;
mod link;
pub(crate) mod make;
mod membership;
mod occupancy;
mod presence;
mod steps;
