//! One parcel that waits.

use std::ops::AddAssign;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use mom_net::{Item, Lane, Outgoing};
use mom_proto::codec::{Encoded, Form};
use mom_proto::{Delivery, Family, Parcel, Path, answers_request, event, outlives_loss};

/// Capacity for messages, in units of 1 KiB.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Capacity {
    /// For messages of no or low priority.
    pub(crate) usual: usize,
    /// For urgent ones: who waits for the usual capacity is not waited for.
    pub(crate) urgent: usize,
}

impl AddAssign for Capacity {
    fn add_assign(&mut self, other: Capacity) {
        self.usual += other.usual;
        self.urgent += other.urgent;
    }
}

/// A message with the capacity that it takes.
#[derive(Debug)]
pub(crate) struct Message {
    pub(crate) capacity: Capacity,
    /// A caller waits for its answer; the loss of any other is told in its context.
    pub(crate) awaited: bool,
    /// The token that it needs.
    pub(crate) guard: Option<Path>,
    pub(crate) outgoing: Outgoing,
}

/// Behind which messages that were said before it a request or an `unstop` waits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Follows {
    /// Behind none: it overtakes them.
    Nothing,
    /// Those of its context.
    Context,
    /// Those of its context and of all below it.
    Within,
    /// Those that need the token that it is about.
    Token,
    /// All.
    All,
}

/// Where a message goes and under which name: a newer one of class `latest` replaces an older one that goes there too.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Destination {
    context: Option<Path>,
    name: Arc<str>,
    /// In order, each once; none = all members.
    address: Option<Vec<Arc<str>>>,
}

/// A parcel as it waits.
#[derive(Debug)]
pub(crate) struct Entry {
    lane: Lane,
    delivery: Delivery,
    outgoing: Outgoing,
    pub(crate) id: Option<u64>,
    /// [`Parcel::checksum_word`] of it.
    checksum_word: u32,
    context: Option<Path>,
    /// Kept of what may replace or withdraw another message.
    destination: Option<Box<Destination>>,
    /// When its time is over, in µs of the wall clock.
    pub(super) expires_at: Option<u64>,
    /// None of what is not a message.
    capacity: Option<Capacity>,
    /// Whether its capacity was given back.
    given: AtomicBool,
    awaited: bool,
    /// The token that it needs.
    guard: Option<Path>,
    follows: Follows,
    family: Family,
    /// An owner's sign of life, which what waits behind messages must not keep until its time is over.
    renews: bool,
    /// Whether both ends of a link count it.
    counts: bool,
    outlives_loss: bool,
}

impl Follows {
    pub(crate) fn of(parcel: &Parcel) -> Follows {
        match (parcel.family, parcel.name()) {
            // Nothing that was said to a device at rest may reach it when it moves again.
            (Family::Message, event::UNSTOP) => Follows::Context,
            // Who gives up a context or a token has said all that before.
            (Family::Context, "leave" | "delete" | event::UNSTOP) => Follows::Within,
            (Family::Token, "release" | "give" | "inhibit") => Follows::Token,
            // An owner's answer to who asked; that to an offer gives nothing up.
            (Family::Token, "accept") if answers_request(parcel) => Follows::Token,
            (Family::Login, "logout") => Follows::All,
            _ => Follows::Nothing,
        }
    }
}

impl Destination {
    fn of(parcel: &Parcel) -> Destination {
        let sorted = |mut names: Vec<Arc<str>>| {
            names.sort_unstable();
            names.dedup();
            names
        };
        Destination {
            context: parcel.context.clone(),
            name: Arc::clone(&parcel.name),
            address: parcel.address.clone().map(sorted),
        }
    }

    /// Whether both go to some peer.
    fn overlaps(&self, other: &Destination) -> bool {
        let shared = |(own, others): (&Vec<Arc<str>>, &Vec<_>)| own.iter().any(|name| others.contains(name));
        self.context == other.context
            && self
                .address
                .as_ref()
                .zip(other.address.as_ref())
                .is_none_or(shared)
    }
}

impl Entry {
    /// A request or a sign of life, behind these messages.
    pub(super) fn control(parcel: &Parcel, outgoing: Outgoing, follows: Follows) -> Entry {
        let counts = parcel.family != Family::Time;
        let lane = match (parcel.family, parcel.name()) {
            (Family::Time, _) => Lane::Sign,
            // A stop of a whole session is as urgent as one of a channel.
            (Family::Context, event::STOP) => Lane::Stop,
            _ => Lane::Control,
        };
        Entry {
            lane,
            delivery: Delivery::Reliable,
            outgoing,
            id: parcel.id,
            checksum_word: parcel.checksum_word(),
            context: parcel.context.clone(),
            destination: None,
            expires_at: None,
            capacity: None,
            given: AtomicBool::new(false),
            awaited: false,
            guard: None,
            follows,
            family: parcel.family,
            renews: parcel.is(Family::Token, "renew"),
            counts,
            outlives_loss: outlives_loss(parcel, false),
        }
    }

    pub(super) fn message(parcel: &Parcel, lane: Lane, message: Message) -> Entry {
        // What its channel makes of a message without a class is known to the hub alone.
        let class = parcel.delivery.filter(|_| matches!(lane, Lane::Data(_)));
        let delivery = class.unwrap_or(Delivery::Reliable);
        let named = !matches!(lane, Lane::Data(_)) || delivery == Delivery::Latest;
        Entry {
            lane,
            delivery,
            outgoing: message.outgoing,
            id: parcel.id,
            checksum_word: parcel.checksum_word(),
            context: parcel.context.clone(),
            destination: named.then(|| Box::new(Destination::of(parcel))),
            // A device must halt also if its operator's clock is wrong.
            expires_at: expires_at(parcel).filter(|_| lane != Lane::Stop),
            capacity: Some(message.capacity),
            given: AtomicBool::new(false),
            awaited: message.awaited,
            outlives_loss: outlives_loss(parcel, message.guard.is_some()),
            guard: message.guard,
            follows: Follows::of(parcel),
            family: parcel.family,
            renews: false,
            counts: true,
        }
    }

    /// Whether it is a message, and none of this client's own requests.
    pub(crate) fn is_message(&self) -> bool {
        self.capacity.is_some()
    }

    /// The capacity that is free now that it has left or is lost: given once, also of what is sent again.
    pub(crate) fn take_capacity(&self) -> Capacity {
        match self.given.swap(true, Ordering::Relaxed) {
            true => Capacity::default(),
            false => self.capacity.unwrap_or_default(),
        }
    }

    /// Where its loss is told; none of a request, and if a caller waits for its answer.
    pub(crate) fn path(&self) -> Option<&Path> {
        let told = self.is_message() && !self.awaited;
        self.context.as_ref().filter(|_| told)
    }
}

impl Item for Entry {
    type Key = Option<Box<Destination>>;

    fn lane(&self) -> Lane {
        self.lane
    }

    fn delivery(&self) -> Delivery {
        self.delivery
    }

    fn key(&self) -> Self::Key {
        self.destination.clone()
    }

    fn frames(&self, _: Option<Form>) -> Option<&Encoded> {
        match &self.outgoing {
            Outgoing::Encoded(encoded) => Some(encoded),
            Outgoing::Parcel(_) => None,
        }
    }

    fn parcel(&self) -> Option<&Arc<Parcel>> {
        match &self.outgoing {
            Outgoing::Parcel(parcel) => Some(parcel),
            Outgoing::Encoded(_) => None,
        }
    }

    fn is_awaited(&self) -> bool {
        self.awaited
    }

    fn checksum_word(&self) -> u32 {
        self.checksum_word
    }

    fn counts(&self) -> bool {
        self.counts
    }

    fn charge(&self, _: Option<Form>) -> usize {
        self.outgoing.len()
    }

    // A second stop of a context says nothing that the first does not. One whose answer a caller waits for stays: it would not
    // come.
    fn repeats(&self, older: &Entry) -> bool {
        let answered = older.lane == Lane::Stop && older.awaited;
        self.destination.is_some() && self.destination == older.destination && !answered
    }

    fn withdraws(&self, waiting: &Entry) -> bool {
        let both = self.destination.as_ref().zip(waiting.destination.as_ref());
        self.lane == Lane::Stop && both.is_some_and(|(stop, unstop)| stop.overlaps(unstop))
    }

    fn overtakes(&self, earlier: &Entry) -> bool {
        let same = self.context == earlier.context && earlier.family == Family::Token;
        self.renews && !same && earlier.family != Family::Login
    }

    fn waits_behind_data(&self) -> bool {
        self.follows != Follows::Nothing
    }

    fn follows(&self, earlier: &Entry) -> bool {
        let (here, there) = (self.context.as_ref(), earlier.context.as_ref());
        match self.follows {
            Follows::Nothing => false,
            Follows::Context => here == there,
            Follows::Within => here.zip(there).is_some_and(|(here, there)| there.is_within(here)),
            Follows::Token => here.is_some() && here == earlier.guard.as_ref(),
            Follows::All => true,
        }
    }

    fn outlives_loss(&self) -> bool {
        self.outlives_loss
    }
}

/// When a message is over: `expires` counts from its creation.
fn expires_at(parcel: &Parcel) -> Option<u64> {
    let created = u64::try_from(parcel.timestamp?.micros()).ok()?;
    Some(created.saturating_add(parcel.expires?.saturating_mul(1000)))
}
