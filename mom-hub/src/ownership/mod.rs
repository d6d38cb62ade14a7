//! Tokens in the tree: who hears of a step of theirs, which routes change with it, and who is next.
//!
//! `change` is the only place where a token gains, changes or loses its owner. Its order never differs: routes of the
//! guarded channels, safe state, `released`, `grabbed`; the reply is the caller's and comes last.

mod change;
mod describe;
mod grant;
mod handover;
mod news;
mod safe;
mod shared;
mod waiting;

pub(crate) use describe::{describe_owner, describe_waiting, granted, lease_value};
