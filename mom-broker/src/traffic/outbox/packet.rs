//! What is delivered: encoded once, shared by all that it waits for.

use std::sync::Arc;

use mom_hub::PeerId;
use mom_net::{DropReason, Item, Lane};
use mom_proto::codec::{Encoded, Form};
use mom_proto::{ContextNumber, Delivery, Micros, Parcel, event};
use mom_system::sync::atomic::{AtomicU64, Ordering};

use crate::traffic::encodings::Encodings;
use crate::traffic::memory::{Account, Charge};

/// Of what is written together, in bytes: more fills a call by itself.
const SMALL: usize = 4096;

/// The priority of what the hub tells a device of others: below all that peers may give, so that nothing waits behind it.
const NEWS: i32 = -500;

/// The fence that lets guarded parcels of a channel pass now; 0 while nobody owns the token.
pub(crate) type Gate = Arc<AtomicU64>;

/// What a waiting parcel counts besides its bytes: the queue's own memory for it.
const PLACE: usize = 64;

/// A parcel, or a run of small ones, with all that a queue has to know of it.
#[derive(Debug)]
pub(crate) struct Packet {
    pub(crate) encodings: Encodings,
    pub(crate) lane: Lane,
    pub(crate) delivery: Delivery,
    /// Whose it is: the same sender and name replace each other where the class is `latest`.
    pub(crate) origin: Origin,
    pub(crate) expires_at: Option<Micros>,
    /// The gate of its channel, and the fence it was admitted with.
    pub(crate) gate: Option<(Gate, u64)>,
    /// How many parcels it has; more than one only in the binary form.
    pub(crate) count: u32,
    /// Whether the two ends of a link count it: all but signs of life.
    pub(crate) counts: bool,
    /// Whether it may go to a receiver that has lost its connection since.
    pub(crate) outlives_loss: bool,
    pub(crate) charged: Charged,
}

/// Where the memory of a packet is charged.
#[derive(Debug, Default)]
pub(crate) enum Charged {
    /// Nowhere: its sender has no account, or tests make it.
    #[default]
    Nowhere,
    /// To an account, once for all queues that it waits in.
    To(Charge),
    /// It shares its memory with this packet.
    With(Arc<Packet>),
}

impl Charged {
    /// What a packet of these encodings takes.
    pub(crate) fn to(account: Option<&Arc<Account>>, encodings: &Encodings) -> Charged {
        match account {
            Some(account) => {
                encodings.charge_to(account);
                Charged::To(account.charge(PLACE + encodings.memory()))
            }
            None => Charged::Nowhere,
        }
    }

    fn account(&self) -> Option<&Arc<Account>> {
        match self {
            Charged::Nowhere => None,
            Charged::To(charge) => Some(charge.account()),
            Charged::With(packet) => packet.charged.account(),
        }
    }
}

/// Where a message comes from.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Origin {
    pub(crate) context: ContextNumber,
    pub(crate) sender: PeerId,
    pub(crate) name: Arc<str>,
}

/// What a receiver did not get: of whom, why, and of which class.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Dropped {
    pub(crate) context: ContextNumber,
    pub(crate) sender: PeerId,
    pub(crate) reason: DropReason,
    pub(crate) class: Delivery,
}

impl Packet {
    /// Whether thinning may leave it out: a message that needed no token and is not a stop. What is guarded is a command, and
    /// each command counts.
    pub(crate) fn may_be_thinned(&self) -> bool {
        matches!(self.lane, Lane::Data(_)) && self.gate.is_none()
    }

    fn is_unstop(&self) -> bool {
        self.lane == Lane::Control && &*self.origin.name == event::UNSTOP
    }

    /// The same for receivers that want the newest only, whatever its class is.
    pub(crate) fn as_latest(self: &Arc<Packet>) -> Packet {
        self.among(self.lane, Delivery::Latest)
    }

    /// The same for a device that it reaches behind all messages.
    pub(crate) fn as_news(self: &Arc<Packet>, delivery: Delivery) -> Packet {
        self.among(Lane::Data(NEWS), delivery)
    }

    /// Whether it is what others do, as the hub tells it to a device.
    pub(crate) fn is_news(&self) -> bool {
        self.lane == Lane::Data(NEWS)
    }

    fn among(self: &Arc<Packet>, lane: Lane, delivery: Delivery) -> Packet {
        Packet {
            encodings: self.encodings.clone(),
            lane,
            delivery,
            origin: self.origin.clone(),
            expires_at: self.expires_at,
            gate: self.gate.clone(),
            count: self.count,
            counts: self.counts,
            outlives_loss: self.outlives_loss,
            charged: Charged::With(Arc::clone(self)),
        }
    }

    /// What is left of a run after so many bytes of its frames.
    pub(crate) fn rest(self: &Arc<Packet>, sent: usize) -> Packet {
        let (encodings, count) = self.encodings.rest_of_run(sent);
        Packet {
            encodings,
            lane: self.lane,
            delivery: self.delivery,
            origin: self.origin.clone(),
            expires_at: self.expires_at,
            gate: self.gate.clone(),
            count,
            counts: self.counts,
            outlives_loss: self.outlives_loss,
            charged: Charged::With(Arc::clone(self)),
        }
    }

    /// Whether its memory is charged to this account.
    pub(crate) fn is_of(&self, account: &Arc<Account>) -> bool {
        self.account().is_some_and(|own| Arc::ptr_eq(own, account))
    }

    /// Where its memory is charged.
    pub(crate) fn account(&self) -> Option<&Arc<Account>> {
        self.charged.account()
    }

    /// Whether it may no longer leave: its time is over, or its owner owns no more.
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

    /// Whether it may leave a moment later if that saves work: small, and no more urgent than usual.
    pub(crate) fn can_wait(&self) -> bool {
        let small = |form| self.encodings.charge(form) <= SMALL;
        !self.lane.is_urgent() && Form::ALL.map(Some).into_iter().chain([None]).all(small)
    }
}

impl Item for Packet {
    type Key = Origin;

    fn lane(&self) -> Lane {
        self.lane
    }

    fn delivery(&self) -> Delivery {
        self.delivery
    }

    fn key(&self) -> Origin {
        self.origin.clone()
    }

    fn frames(&self, form: Option<Form>) -> Option<&Encoded> {
        self.encodings.frames(form)
    }

    fn parcel(&self) -> Option<&Arc<Parcel>> {
        self.encodings.local()
    }

    fn is_ready(&self, form: Option<Form>) -> bool {
        self.encodings.unready(form).is_none()
    }

    fn fault(&self, form: Option<Form>) -> Option<DropReason> {
        self.encodings.is_bad(form).then_some(DropReason::BadContent)
    }

    fn charge(&self, form: Option<Form>) -> usize {
        self.encodings.charge(form) + PLACE
    }

    fn count(&self) -> u32 {
        self.count
    }

    fn checksum_word(&self) -> u32 {
        self.encodings.checksum_word()
    }

    fn counts(&self) -> bool {
        self.counts
    }

    // One pending per context: a second stop says nothing that the first does not, nor does a second unstop.
    fn repeats(&self, older: &Packet) -> bool {
        let latched = self.lane == Lane::Stop || self.is_unstop();
        latched && self.origin.context == older.origin.context && self.origin.name == older.origin.name
    }

    fn withdraws(&self, waiting: &Packet) -> bool {
        waiting.is_unstop() && self.origin.context == waiting.origin.context
    }

    // Nothing that was said to a device at rest may reach it when it moves again.
    fn waits_behind_data(&self) -> bool {
        self.is_unstop()
    }

    fn follows(&self, earlier: &Packet) -> bool {
        self.origin.context == earlier.origin.context && !earlier.is_news()
    }

    fn outlives_loss(&self) -> bool {
        self.outlives_loss
    }
}
