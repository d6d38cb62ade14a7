//! Asking managers, and on their behalf managing peers and chairs (M24, M25).
//!
//! `consult` asks the manager of a context, `explain` makes a refusal of its answer, `questions` keeps the requests of
//! which a manager says that another peer must be asked first.

pub(crate) mod consult;
mod explain;
pub(crate) mod questions;
pub(crate) mod refusal;
pub(crate) mod wish;
