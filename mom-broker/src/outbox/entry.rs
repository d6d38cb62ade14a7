//! One parcel that waits for one peer.

use std::sync::Arc;

use mom_hub::PeerId;
use mom_managers::Micros;
use mom_net::Outgoing;
use mom_proto::{ContextNumber, Delivery};

use crate::sync::atomic::{AtomicU64, Ordering};

/// The fence that lets guarded parcels of a channel pass now; 0 while nobody owns the token.
pub(crate) type Gate = Arc<AtomicU64>;

/// A parcel with all that its queue has to know of it.
#[derive(Clone, Debug)]
pub(crate) struct Entry {
    pub(crate) frame: Outgoing,
    pub(crate) lane: Lane,
    pub(crate) delivery: Delivery,
    /// Whose it is: the same sender and name replace each other where the class is `latest`.
    pub(crate) origin: Origin,
    pub(crate) expires_at: Option<Micros>,
    /// The gate of its channel, and the fence it was admitted with.
    pub(crate) gate: Option<(Gate, u64)>,
    /// The length of the whole frame; what is left of one that the link has begun to take is shorter.
    pub(crate) length: usize,
}

/// Which lane a parcel waits in (design §7).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lane {
    /// `stop`: before all others, in memory of its own.
    Stop,
    /// Replies, events, safe states, heartbeats.
    Control,
    /// Messages, by their priority.
    Data(i32),
}

/// Where a message comes from.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Origin {
    pub(crate) context: ContextNumber,
    pub(crate) sender: PeerId,
    pub(crate) name: Arc<str>,
}

/// Why a parcel was dropped on its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum DropReason {
    /// A newer one took its place.
    Replaced,
    /// The receiver's queue was full.
    Full,
    /// The receiver's connection ended.
    Closed,
    /// Its time was over before the link took it.
    Expired,
    /// The token changed hands before the link took it.
    Fence,
}

impl DropReason {
    pub(crate) fn word(self) -> &'static str {
        match self {
            DropReason::Replaced => "replaced",
            DropReason::Full => "queue-full",
            DropReason::Closed => "receiver-gone",
            DropReason::Expired => "expired",
            DropReason::Fence => "older-fence",
        }
    }
}

impl Entry {
    /// The bytes that count against the bound, with what the queue itself needs for it.
    pub(crate) fn size(&self) -> usize {
        self.frame.len() + 64
    }

    /// Whether the link has taken some of it already.
    pub(crate) fn begun(&self) -> bool {
        self.frame.len() != self.length
    }

    /// Whether it may still leave: its time is not over and its owner still owns.
    pub(crate) fn stale(&self, now: Micros) -> Option<DropReason> {
        if self.expires_at.is_some_and(|end| now >= end) {
            return Some(DropReason::Expired);
        }
        let closed = |(gate, fence): &(Gate, u64)| gate.load(Ordering::Acquire) != *fence;
        self.gate
            .as_ref()
            .is_some_and(closed)
            .then_some(DropReason::Fence)
    }
}

impl AsRef<Outgoing> for Entry {
    fn as_ref(&self) -> &Outgoing {
        &self.frame
    }
}

impl AsMut<Outgoing> for Entry {
    fn as_mut(&mut self) -> &mut Outgoing {
        &mut self.frame
    }
}
