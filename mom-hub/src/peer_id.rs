//! The number of a peer's connection.

/// A peer's connection; the broker gives each a number and never the same twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PeerId(pub u64);
