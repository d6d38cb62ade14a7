//! The state of the link to the hub.

use mom_proto::WireError;

/// The state of the link to the hub.
#[derive(Clone, Debug, PartialEq)]
pub enum LinkState {
    /// Logged in.
    Connected,
    /// Logged in, but the hub has not been heard of for one and a half heartbeats.
    Stale {
        /// When it was heard last.
        since: std::time::Instant,
    },
    /// The connection is lost; another one is to go on with the same link, and nothing is lost so far.
    Resuming {
        /// When it was lost.
        since: std::time::Instant,
        /// Attempts that failed since then.
        attempt: u32,
    },
    /// Lost, and its tokens with it; connecting anew.
    Trying {
        /// When it was lost.
        since: std::time::Instant,
        /// Attempts that failed since then.
        attempt: u32,
    },
    /// Closed for good, with the hub's error if there was one.
    Closed(Option<WireError>),
}
