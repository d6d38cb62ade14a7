//! What can wait in a queue, and what its user decides about it.

use std::fmt::Debug;
use std::hash::Hash;
use std::sync::Arc;

use mom_proto::codec::{Encoded, Form};
use mom_proto::{Delivery, Parcel};

/// Which lane a parcel waits in, the most urgent last (design §7).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Lane {
    /// Messages, by their priority.
    Data(i32),
    /// Requests, replies, events, safe states, `unstop`.
    Control,
    /// Pings and pongs of a client, which nothing is ordered by and whose delay is what they measure.
    Sign,
    /// `stop`: before all others, in memory of its own.
    Stop,
}

impl Lane {
    /// Whether something in this lane is urgent: it overtakes messages of the default priority, and never waits for
    /// others to be written with.
    pub fn is_urgent(self) -> bool {
        self > Lane::Data(0)
    }
}

/// A parcel, or several that travel together, as a queue has to know it. Shared by all queues that it waits in.
pub trait Item: Debug {
    /// Items of class [`Delivery::Latest`] with the same key replace each other.
    type Key: Clone + Debug + Eq + Hash;

    /// The lane that it waits in.
    fn lane(&self) -> Lane;

    /// Its class.
    fn delivery(&self) -> Delivery;

    /// Its key.
    fn key(&self) -> Self::Key;

    /// Its frames in this form; none for a peer in the same process.
    fn frames(&self, form: Option<Form>) -> Option<&Encoded>;

    /// Whether it can leave in this form; what is more urgent goes before it meanwhile, and nothing else.
    fn is_ready(&self, _form: Option<Form>) -> bool {
        true
    }

    /// Why it cannot leave in this form at all.
    fn fault(&self, _form: Option<Form>) -> Option<DropReason> {
        None
    }

    /// What a peer in the same process gets.
    fn parcel(&self) -> Option<&Arc<Parcel>>;

    /// The bytes that it counts while it waits for a link of this form.
    fn charge(&self, form: Option<Form>) -> usize;

    /// How many parcels it has; those of several can be written one by one.
    fn count(&self) -> u32 {
        1
    }

    /// What stands for it in the checksum of a link: [`Parcel::checksum_word`]. Not asked of those of several parcels.
    fn checksum_word(&self) -> u32;

    /// Whether its sender waits for the answer: its loss is told by itself, whatever its class.
    fn is_awaited(&self) -> bool {
        false
    }

    /// Whether the two ends of a link count it.
    fn counts(&self) -> bool {
        true
    }

    /// Whether an item of control may go before this earlier one, which waits behind data.
    fn overtakes(&self, _earlier: &Self) -> bool {
        false
    }

    /// Whether it takes the place of this older one, which waits in the same lane: a stop that of a stop, an `unstop` that of
    /// an `unstop`.
    fn repeats(&self, _older: &Self) -> bool {
        false
    }

    /// Whether, as a stop, it withdraws this waiting item of the control lane.
    fn withdraws(&self, _waiting: &Self) -> bool {
        false
    }

    /// Whether, in the control lane, it waits behind some of the data that was put in before it, and what is put in after it
    /// leaves after it. It waits for no room.
    fn waits_behind_data(&self) -> bool {
        false
    }

    /// Whether, as one that waits behind data, it waits behind this.
    fn follows(&self, _earlier: &Self) -> bool {
        false
    }

    /// Whether it may leave over another connection than the one that it was put in for
    /// ([`outlives_loss`](mom_proto::outlives_loss)).
    fn outlives_loss(&self) -> bool {
        true
    }
}

/// What the user of a queue decides about its items.
pub trait DropPolicy<I: ?Sized> {
    /// Why an item may not leave any more, looked at before each piece of it.
    fn stale(&self, item: &I, now: u64) -> Option<DropReason>;

    /// Hears of an item, of which so many parcels had not left, that it was dropped.
    fn dropped(&mut self, item: &Arc<I>, parcels: u64, reason: DropReason);
}

/// Why a parcel was dropped on its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum DropReason {
    /// A newer one took its place.
    Replaced,
    /// The queue was full.
    Full,
    /// The connection ended.
    Closed,
    /// Its time was over before the link took it.
    Expired,
    /// The token changed hands before the link took it.
    Fence,
    /// The receiver wants fewer, and a newer one came before its time.
    Rate,
    /// It has no form that the receiver could read.
    BadContent,
    /// The hub had no memory for it.
    Memory,
    /// A stop came after this `unstop`, before it had left.
    Withdrawn,
    /// The connection was lost before it had left, or is lost: what comes so late would move a device.
    Lost,
    /// The connection was lost after it had left, and nobody can say whether it was read.
    Unknown,
}

impl DropReason {
    /// The word for it on the wire.
    pub fn word(self) -> &'static str {
        match self {
            DropReason::Replaced => "replaced",
            DropReason::Withdrawn => "withdrawn",
            DropReason::Full => "queue-full",
            DropReason::Closed => "receiver-gone",
            DropReason::Expired => "expired",
            DropReason::Fence => "older-fence",
            DropReason::Rate => "rate",
            DropReason::BadContent => "bad-content",
            DropReason::Memory => "memory",
            DropReason::Lost => "lost",
            DropReason::Unknown => "unknown",
        }
    }
}
