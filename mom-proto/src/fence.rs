//! Fences: the numbers of grants (design §6).

use std::fmt;

use crate::{MAX_ID, Value};

/// The number of a grant of a token: the epoch of the hub in its upper part, the grant within the epoch in its lower.
///
/// A later grant has a higher fence, also over restarts: each start has a higher epoch. Grants beyond an epoch's
/// numbers run into the next epoch, which is why epochs are seconds apart. On the wire a fence is one int, and only
/// compared.
///
/// ```
/// use mom_proto::Fence;
///
/// let fence = Fence::floor(1_763_000_000).next().next();
/// assert_eq!((fence.epoch(), fence.number()), (1_763_000_000, 2));
/// assert!(fence < Fence::floor(1_763_000_001));
/// assert_eq!(Fence::from(u64::from(fence)), fence);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Fence(u64);

/// The bits of the lower part.
const NUMBER_BITS: u32 = 20;

impl Fence {
    /// The highest epoch whose fences an int of the wire holds.
    pub const MAX_EPOCH: u64 = MAX_ID >> NUMBER_BITS;

    /// A grant of an epoch.
    pub const fn new(epoch: u64, number: u64) -> Fence {
        Fence((epoch << NUMBER_BITS) + number)
    }

    /// What lies below all fences of an epoch; no grant has it.
    pub const fn floor(epoch: u64) -> Fence {
        Fence::new(epoch, 0)
    }

    /// The next one.
    #[must_use]
    pub const fn next(self) -> Fence {
        Fence(self.0.saturating_add(1))
    }

    /// The one so many further.
    #[must_use]
    pub const fn after(self, grants: u64) -> Fence {
        Fence(self.0.saturating_add(grants))
    }

    /// The epoch.
    pub const fn epoch(self) -> u64 {
        self.0 >> NUMBER_BITS
    }

    /// The grant within its epoch. It falls at a restart, so nobody is shown it alone.
    pub const fn number(self) -> u64 {
        self.0 & ((1 << NUMBER_BITS) - 1)
    }
}

impl From<u64> for Fence {
    fn from(fence: u64) -> Fence {
        Fence(fence)
    }
}

impl From<Fence> for u64 {
    fn from(fence: Fence) -> u64 {
        fence.0
    }
}

impl From<Fence> for Value {
    fn from(fence: Fence) -> Value {
        Value::Int(i64::try_from(fence.0).unwrap_or(i64::MAX))
    }
}

/// The whole of it, as on the wire.
impl fmt::Display for Fence {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(formatter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fence_is_its_epoch_and_its_number() {
        let fence = Fence::new(1_795_255_200, 7);
        assert_eq!(u64::from(fence), (1_795_255_200 << 20) + 7);
        assert_eq!((fence.epoch(), fence.number()), (1_795_255_200, 7));
        assert_eq!(fence.to_string(), "1882461516595207");
        assert_eq!(Value::from(fence), Value::Int((1_795_255_200_i64 << 20) + 7));
        assert_eq!(Value::from(Fence::from(u64::MAX)), Value::Int(i64::MAX));
    }

    #[test]
    fn fences_rise_over_the_end_of_an_epoch() {
        let last = Fence::new(4, (1 << 20) - 1);
        assert_eq!(last.next(), Fence::floor(5));
        assert_eq!(last.after(8), Fence::new(5, 7));
        assert!(Fence::floor(4) < last && last < Fence::floor(5));
        assert_eq!(Fence::from(u64::MAX).next(), Fence::from(u64::MAX));
    }

    #[test]
    fn the_highest_epoch_fits_the_wire() {
        let last = Fence::new(Fence::MAX_EPOCH, (1 << 20) - 1);
        assert_eq!(u64::from(last), MAX_ID);
    }
}
