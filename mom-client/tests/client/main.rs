//! The client against a hub that does what each test says.
#![expect(clippy::unwrap_used, reason = "a test that fails panics")]

mod common;
mod concurrency;
mod doors;
mod events;
mod handover;
mod login;
mod managing;
mod reconnect;
mod requests;
mod slow_link;
mod time;
mod tokens;
mod waiting;
