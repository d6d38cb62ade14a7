//! The clock of a peer.

use mom_managers::Micros;
use mom_proto::ClockOffset;

/// What a link knows of the clock by which its peer stamps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PeerClock {
    /// The peer's clock minus the hub's.
    pub offset: ClockOffset,
    /// How far beyond the offset's error a stamp may lie in the future, µs.
    pub future: Micros,
}
