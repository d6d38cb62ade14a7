//! The state of a token.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use mom_managers::Terms;
use mom_proto::event::Reason;
use mom_proto::{Content, ContextNumber, Fence, Micros, Parcel, Path, Verb};

use super::record::{Holder, Record, Ticket};
use crate::PeerId;
use crate::heard::Heard;

/// A token.
#[derive(Debug, Default)]
pub(crate) struct Token {
    pub(crate) owner: Option<Ownership>,
    /// Peers that hold it together, and since when; as long as there is one, nobody owns the token.
    pub(crate) holders: BTreeMap<PeerId, Micros>,
    /// Of the latest grant; 0 before the first. Only rises.
    pub(crate) fence: Fence,
    pub(crate) terms: Terms,
    pub(crate) safe: Option<SafeState>,
    /// Whether the safe state is sent also where the owner gave the token away.
    pub(crate) safe_on_give: bool,
    /// Whether a stop of a channel that it guards ends its owner's grant.
    pub(crate) stop_ends_grant: bool,
    /// The channels that it guards.
    pub(crate) guarded: BTreeSet<ContextNumber>,
    /// Waiting grabs in the order in which they are granted.
    pub(crate) queue: Vec<QueuedGrab>,
    /// The owner's offer.
    pub(crate) offer: Option<Offer>,
    /// Requests to the owner that have no answer yet.
    pub(crate) asking: Vec<Asking>,
    /// Recent offers and requests per (verb, from, to): count and expiry.
    pub(crate) asked: BTreeMap<Asked, (u32, Micros)>,
    /// A change of owner that has begun and not finished: it waits for its record.
    pub(crate) granting: Option<Granting>,
    /// Requests that wait for the end of that.
    pub(crate) held_back: VecDeque<HeldBack>,
    /// What was stored last.
    pub(crate) record: Option<Record>,
    /// The only peer that may have it after a restart, for a while.
    pub(crate) reserved: Option<Reserved>,
    /// When the hub's timer for it goes off.
    pub(crate) timer: Option<Micros>,
}

/// An offer or a request: `give` or `request`, by whom, to whom.
pub(crate) type Asked = (Verb, PeerId, PeerId);

/// The requests that a change of owner answers: peer and id.
pub(crate) type Answers = Vec<(PeerId, Option<u64>)>;

/// The owner of a token, with the beginning and the ends of its ownership.
#[derive(Clone, Debug)]
pub(crate) struct Ownership {
    pub(crate) peer: PeerId,
    pub(crate) since: Micros,
    /// When its turn began; giving and returning within a turn do not begin another one.
    pub(crate) turn: Micros,
    /// The lease that the owner was told last; the token's terms may have changed since.
    pub(crate) lease: Option<Micros>,
    pub(crate) lease_end: Option<Micros>,
    /// The end of the deadman time.
    pub(crate) alive_until: Option<Micros>,
    /// The end that the manager set, whatever the lease.
    pub(crate) until: Option<Micros>,
    /// The end of its turn that the owner was told last, and when that was.
    pub(crate) noticed: Option<(Micros, Micros)>,
    pub(crate) delegation: Option<Delegation>,
    /// How often the safe state went out under it, because the owner had lost its connection.
    pub(crate) halts: u64,
}

/// An ownership that returns to the peer that gave it (M41).
#[derive(Clone, Debug)]
pub(crate) struct Delegation {
    /// None if the giver has left since: it returns to nobody.
    pub(crate) from: Option<PeerId>,
    /// When the giver's own ownership would have ended, whatever its lease.
    pub(crate) giver_until: Option<Micros>,
    /// When the time is over.
    pub(crate) until: Option<Micros>,
    /// How many commands are left.
    pub(crate) commands: Option<u64>,
    /// When the token returns after the last command.
    pub(crate) return_at: Option<Micros>,
}

/// A change of owner that was decided.
#[derive(Clone, Debug)]
pub(crate) struct Change {
    pub(crate) to: PeerId,
    /// Why the present owner loses the token, if there is one.
    pub(crate) reason: Reason,
    /// Valid only while this peer is the owner.
    pub(crate) from: Option<PeerId>,
    /// When the ownership ends, whatever its lease.
    pub(crate) until: Option<Micros>,
    /// For how long and for how many commands it is given.
    pub(crate) given: Option<(Option<Micros>, Option<u64>)>,
    /// The rule that allowed it.
    pub(crate) rule: Option<Arc<str>>,
    /// The beginning of the turn that it continues; none = a new one.
    pub(crate) turn: Option<Micros>,
    pub(crate) answers: Answers,
}

impl Change {
    /// A grant to a peer.
    pub(crate) fn to(to: PeerId, reason: Reason) -> Change {
        Change {
            to,
            reason,
            from: None,
            until: None,
            given: None,
            rule: None,
            turn: None,
            answers: Vec::new(),
        }
    }
}

/// A change of owner between its beginning and its end.
#[derive(Clone, Debug)]
pub(crate) struct Granting {
    /// The store that it waits for; none where nothing has to be stored.
    pub(crate) ticket: Option<Ticket>,
    /// None if it was called off: the record may become durable all the same.
    pub(crate) change: Option<Change>,
}

/// A grab that waits.
#[derive(Clone, Debug)]
pub(crate) struct QueuedGrab {
    pub(crate) peer: PeerId,
    /// Unique over all waiters of the hub.
    pub(crate) ticket: u64,
    /// The id of its request.
    pub(crate) id: Option<u64>,
    pub(crate) level: i32,
    pub(crate) since: Micros,
    /// When it gives up.
    pub(crate) until: Option<Micros>,
    /// Answers of chairs and managing peers to this grab.
    pub(crate) answers: Vec<Heard>,
    /// Whether a peer is being asked about it, because its turn has come.
    pub(crate) asking: bool,
    /// The place that it was told last.
    pub(crate) told: usize,
}

/// An offer of the owner to one peer.
#[derive(Clone, Debug)]
pub(crate) struct Offer {
    pub(crate) by: PeerId,
    pub(crate) to: PeerId,
    pub(crate) until: Micros,
    /// For how long, once accepted; none = for good.
    pub(crate) time: Option<Micros>,
    /// For how many commands.
    pub(crate) commands: Option<u64>,
}

/// A request to the owner to hand over.
#[derive(Clone, Debug)]
pub(crate) struct Asking {
    pub(crate) peer: PeerId,
    /// The owner that was asked.
    pub(crate) owner: PeerId,
    pub(crate) ticket: u64,
    pub(crate) id: Option<u64>,
    pub(crate) until: Micros,
}

/// A request that waits for the end of a change of owner.
#[derive(Clone, Debug)]
pub(crate) struct HeldBack {
    pub(crate) peer: PeerId,
    pub(crate) parcel: Parcel,
    /// Answers of chairs and managing peers to this request.
    pub(crate) answers: Vec<Heard>,
}

/// After a restart: the peer that may have the token before a lease from before the restart could have ended.
#[derive(Clone, Debug)]
pub(crate) struct Reserved {
    /// None: a change was under way, so nobody may.
    pub(crate) holder: Option<Holder>,
    pub(crate) until: Micros,
}

/// What is sent when ownership ends; without one, `halt` to every guarded channel.
#[derive(Clone, Debug)]
pub(crate) struct SafeState {
    pub(crate) channel: Path,
    pub(crate) name: String,
    pub(crate) content: Option<Content>,
}

impl Token {
    pub(crate) fn owner_peer(&self) -> Option<PeerId> {
        self.owner.as_ref().map(|owner| owner.peer)
    }

    /// The peer that has lent the token to its owner and gets it back.
    pub(crate) fn giver(&self) -> Option<PeerId> {
        self.owner.as_ref()?.delegation.as_ref()?.from
    }

    /// The change of owner that waits for its record.
    pub(crate) fn promise(&self) -> Option<&Change> {
        self.granting.as_ref()?.change.as_ref()
    }

    /// The peer that owns the token once its record is durable.
    pub(crate) fn promised(&self) -> Option<PeerId> {
        self.promise().map(|change| change.to)
    }

    /// Whether nobody owns it or holds it with others, and no change is under way.
    pub(crate) fn is_free(&self) -> bool {
        self.owner.is_none() && self.holders.is_empty() && self.granting.is_none()
    }

    /// Whether a peer waits for it, asks for it, is offered it, holds it with others or has lent it.
    pub(crate) fn involves(&self, peer: PeerId) -> bool {
        self.holders.contains_key(&peer)
            || self.queue.iter().any(|waiter| waiter.peer == peer)
            || self.asking.iter().any(|asking| asking.peer == peer)
            || self.offer.as_ref().is_some_and(|offer| offer.to == peer)
            || self.held_back.iter().any(|held| held.peer == peer)
            || self.promised() == Some(peer)
            || self.giver() == Some(peer)
    }
}
