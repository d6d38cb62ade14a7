//! The state of a token (M28, M29, design §6). Only `ownership.rs` changes its owner.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use mom_managers::{Expiry, Micros, Terms};
use mom_proto::{Content, ContextNumber, Parcel, Path, Verb};

use crate::asking::questions::Heard;
use crate::ownership::grant::Storing;
use crate::{Holder, PeerId, Record};

/// A token.
#[derive(Debug, Default)]
pub(crate) struct Token {
    pub(crate) owner: Option<Ownership>,
    /// Who holds it together with others, and since when; while somebody does, nobody owns it.
    pub(crate) holders: BTreeMap<PeerId, Micros>,
    /// Of the latest grant; 0 before the first. Only rises.
    pub(crate) fence: u64,
    pub(crate) terms: Terms,
    pub(crate) safe: Option<SafeState>,
    /// Whether the safe state is sent also where the owner gave the token away.
    pub(crate) safe_on_give: bool,
    /// The channels that it guards.
    pub(crate) guarded: BTreeSet<ContextNumber>,
    /// Who waits for it, in the order in which they will have it.
    pub(crate) queue: Vec<Waiter>,
    /// What the owner offers.
    pub(crate) offer: Option<Offer>,
    /// Who has asked the owner to hand over.
    pub(crate) asking: Vec<Asking>,
    /// Who has offered it to, or asked for it, whom, how often, and until when that counts.
    pub(crate) asked: BTreeMap<(Verb, PeerId, PeerId), (u32, Micros)>,
    /// A change of owner that waits until it is durable.
    pub(crate) storing: Option<Storing>,
    /// Requests that wait for the end of that.
    pub(crate) held_back: VecDeque<HeldBack>,
    /// What was stored last.
    pub(crate) record: Option<Record>,
    /// Who alone may have it, since a restart.
    pub(crate) reserved: Option<Reserved>,
    /// When the hub's timer for it goes off.
    pub(crate) timer: Option<Micros>,
}

/// Who owns a token, since when, until when.
#[derive(Clone, Debug)]
pub(crate) struct Ownership {
    pub(crate) peer: PeerId,
    pub(crate) since: Micros,
    /// When its turn began: who gives and returns within a turn gains no time by that.
    pub(crate) turn: Micros,
    /// The lease that it was told last; that of the token may be another one since.
    pub(crate) lease: Option<Micros>,
    pub(crate) lease_end: Option<Micros>,
    /// The end of the deadman time.
    pub(crate) alive_until: Option<Micros>,
    /// The end that the manager set, whatever the lease.
    pub(crate) until: Option<Micros>,
    /// The end of its turn that it was told last.
    pub(crate) noticed: Option<Micros>,
    pub(crate) delegation: Option<Delegation>,
}

/// An ownership that returns to who gave it (M41).
#[derive(Clone, Debug)]
pub(crate) struct Delegation {
    /// None: it has left since, so that nobody has it back.
    pub(crate) from: Option<PeerId>,
    /// When the ownership ends that the giver had, whatever its lease.
    pub(crate) giver_until: Option<Micros>,
    /// When the time is over.
    pub(crate) until: Option<Micros>,
    /// How many commands are left.
    pub(crate) commands: Option<u64>,
    /// When the token returns, once they are used up.
    pub(crate) return_at: Option<Micros>,
}

/// A grab that waits.
#[derive(Clone, Debug)]
pub(crate) struct Waiter {
    pub(crate) peer: PeerId,
    /// Tells it from all others that ever waited.
    pub(crate) ticket: u64,
    /// The id of its request.
    pub(crate) id: Option<u64>,
    pub(crate) level: i32,
    pub(crate) since: Micros,
    /// When it gives up.
    pub(crate) until: Option<Micros>,
    /// What chairs and managing peers said of it.
    pub(crate) answers: Vec<Heard>,
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

/// A peer that has asked the owner to hand over.
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
    /// What chairs and managing peers said of it.
    pub(crate) answers: Vec<Heard>,
}

/// After a restart: who may have the token before a lease of then could have ended.
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
    /// The end of a lease that begins now.
    pub(crate) fn lease_from(&self, now: Micros) -> Option<Micros> {
        self.terms.lease.map(|lease| now.saturating_add(lease))
    }

    /// Whether the owner's lease is over, so that the next grab takes the token.
    pub(crate) fn lapsed(&self, now: Micros) -> bool {
        self.owner
            .as_ref()
            .and_then(|owner| owner.lease_end)
            .is_some_and(|end| now >= end)
    }

    /// When the hub has to end the ownership by itself.
    pub(crate) fn deadline(&self) -> Option<Micros> {
        let owner = self.owner.as_ref()?;
        let lease = owner
            .lease_end
            .filter(|_| self.terms.expiry == Expiry::Eager || !self.queue.is_empty());
        let delegated = owner.delegation.as_ref();
        let ends = [
            lease,
            owner.alive_until,
            owner.until,
            self.hold_end(),
            delegated.and_then(|delegation| delegation.until),
            delegated.and_then(|delegation| delegation.return_at),
        ];
        ends.into_iter().flatten().min()
    }

    /// When the owner has had its turn, because others wait.
    pub(crate) fn hold_end(&self) -> Option<Micros> {
        let owner = self.owner.as_ref()?;
        let hold = self.terms.hold?;
        let first = self.queue.iter().map(|waiter| waiter.since).min()?;
        let noticed = first.saturating_add(self.terms.notice);
        Some(owner.turn.saturating_add(hold).max(noticed))
    }

    /// Whether nobody has it in any way, and no change is under way.
    pub(crate) fn is_free(&self) -> bool {
        self.owner.is_none() && self.holders.is_empty() && self.storing.is_none()
    }

    /// The place in the queue at which a waiter of this level would come, from 0.
    pub(crate) fn place_for(&self, level: i32) -> usize {
        if !self.terms.by_level {
            return self.queue.len();
        }
        let before = |waiter: &&Waiter| waiter.level >= level;
        self.queue.iter().take_while(before).count()
    }

    /// Whether a peer has something to do with it besides owning it.
    pub(crate) fn involves(&self, peer: PeerId) -> bool {
        self.holders.contains_key(&peer)
            || self.queue.iter().any(|waiter| waiter.peer == peer)
            || self.asking.iter().any(|asking| asking.peer == peer)
            || self.offer.as_ref().is_some_and(|offer| offer.to == peer)
            || self.held_back.iter().any(|held| held.peer == peer)
            || self.promised() == Some(peer)
            || self.giver() == Some(peer)
    }

    /// To whom it is being granted, once that is durable.
    pub(crate) fn promised(&self) -> Option<PeerId> {
        Some(self.storing.as_ref()?.change.as_ref()?.to)
    }

    /// Who has lent it to its owner, and will have it back.
    pub(crate) fn giver(&self) -> Option<PeerId> {
        self.owner.as_ref()?.delegation.as_ref()?.from
    }
}

impl SafeState {
    /// A safe state of the configuration or of a request; its content goes as it came.
    pub(crate) fn new(channel: Path, name: String, content: Option<Content>) -> SafeState {
        SafeState {
            channel,
            name,
            content,
        }
    }
}
