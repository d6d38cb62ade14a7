//! Records, which outlive the hub (design §6).

use mom_proto::{Fence, Micros, Path};

/// The number of an awaited store; never given twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticket(pub u64);

/// A user under a nickname, by which an owner is known again after a restart.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// The user.
    pub user: String,
    /// The peer's name.
    pub name: String,
}

/// The stored part of a token: no fence falls over a restart, and nobody is granted it during another's lease.
///
/// The latest record of a path holds, also when the token is deleted. One that nobody owns may be forgotten: the next start
/// has a higher epoch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// The token.
    pub path: Path,
    /// The highest fence given out, or about to be.
    pub fence: u64,
    /// The owner, or the peer that is about to be.
    pub owner: Option<Holder>,
    /// The owner of before, as long as the change may not have happened.
    pub before: Option<Holder>,
    /// The longest lease that either of them may have, µs; none = without end.
    pub lease: Option<Micros>,
}

/// Numbers that the record of one grant covers, so that its owner may grab again without another.
const BLOCK: u64 = 1 << 19;

impl Record {
    /// The highest fence that may have been given out under this record; the next epoch begins above it.
    pub fn last_fence(&self) -> u64 {
        Fence::from(self.fence).after(BLOCK).into()
    }
}
