//! The store: rows, lanes, damage, crashes.

mod crash;
mod files;
#[cfg(feature = "shuttle")]
mod interleaved;
mod queue;
mod random;
mod row;
mod stops;
mod threads;

use mom_hub::{Holder, Record};
use mom_proto::{Path, Time};

fn path(text: &str) -> Path {
    Path::parse(text).expect("a path")
}

fn holder(user: &str) -> Holder {
    Holder {
        user: user.to_owned(),
        name: format!("{user}~2"),
    }
}

/// A record of an owned token.
fn owned(token: &str, fence: u64) -> Record {
    Record {
        path: path(token),
        fence,
        owner: Some(holder("alice")),
        before: None,
        lease: Some(180_000_000),
    }
}

/// A record of a token that is free.
fn free(token: &str, fence: u64) -> Record {
    Record {
        owner: None,
        lease: None,
        ..owned(token, fence)
    }
}

fn at(seconds: i64) -> Time {
    Time::from_micros(seconds * 1_000_000).expect("a time")
}
