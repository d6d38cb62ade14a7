//! The clock of a peer.

use mom_proto::{ClockOffset, Micros};

/// The clock of a peer, as its link has measured it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PeerClock {
    /// The peer's clock minus the hub's.
    pub offset: ClockOffset,
    /// How far beyond the offset's error a stamp may lie in the future, µs.
    pub future: Micros,
}
