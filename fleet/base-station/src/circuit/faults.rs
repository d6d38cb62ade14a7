//! What was wrong with what a robot said.

/// What was wrong with what a robot said, since the circuit was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// Frames of unknown codes.
    pub unknown: u64,
    /// Bytes that belong to no frame, those of unknown frames among them.
    pub bytes: u64,
    /// How often silence cut a frame.
    pub cut: u64,
    /// Values that were out of range.
    pub clamped: u64,
    /// Replies to commands that were never sent.
    pub unasked: u64,
}

impl Faults {
    pub(super) fn plus(self, more: mom_brs::Faults) -> Faults {
        Faults {
            unknown: self.unknown + u64::from(more.unknown),
            bytes: self.bytes + u64::from(more.unknown_bytes) + u64::from(more.skipped),
            cut: self.cut + u64::from(more.cut),
            clamped: self.clamped + u64::from(more.clamped),
            unasked: self.unasked,
        }
    }
}
