//! One parcel that waits.

use std::ops::AddAssign;
use std::sync::Arc;

use mom_net::{Item, Lane, Outgoing};
use mom_proto::codec::{Encoded, Form};
use mom_proto::{Delivery, Parcel, Path};

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
    /// Its context, if a loss of it is told there; one that is awaited is told by its answer.
    pub(crate) path: Option<Path>,
    /// It needs a token.
    pub(crate) guarded: bool,
    pub(crate) outgoing: Outgoing,
}

/// Where a message goes and under which name: a newer one of class `latest` replaces an older one that goes there too.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Destination {
    context: Option<Path>,
    name: Arc<str>,
    address: Option<Vec<Arc<str>>>,
}

/// A parcel as it waits.
#[derive(Debug)]
pub(crate) struct Entry {
    lane: Lane,
    delivery: Delivery,
    outgoing: Outgoing,
    pub(crate) id: Option<u64>,
    /// Kept of what may replace or overrule another message.
    destination: Option<Box<Destination>>,
    /// When its time is over, in µs of the wall clock.
    pub(super) expires_at: Option<u64>,
    /// None of what is no message.
    capacity: Option<Capacity>,
    path: Option<Path>,
    /// It needs a token.
    pub(super) guarded: bool,
}

impl Entry {
    /// A request or a sign of life.
    pub(super) fn control(parcel: &Parcel, lane: Lane, outgoing: Outgoing) -> Entry {
        Entry {
            lane,
            delivery: Delivery::Reliable,
            outgoing,
            id: parcel.id,
            destination: None,
            expires_at: None,
            capacity: None,
            path: None,
            guarded: false,
        }
    }

    pub(super) fn message(parcel: &Parcel, lane: Lane, message: Message) -> Entry {
        // What its channel makes of a message without a class is known to the hub alone.
        let delivery = parcel.delivery.unwrap_or(Delivery::Reliable);
        let named = !matches!(lane, Lane::Data(_)) || delivery == Delivery::Latest;
        let destination = || {
            Box::new(Destination {
                context: parcel.context.clone(),
                name: Arc::clone(&parcel.name),
                address: parcel.address.clone(),
            })
        };
        Entry {
            lane,
            delivery,
            outgoing: message.outgoing,
            id: parcel.id,
            destination: named.then(destination),
            // A device must halt also if its operator's clock is wrong.
            expires_at: expires_at(parcel).filter(|_| lane != Lane::Stop),
            capacity: Some(message.capacity),
            path: message.path,
            guarded: message.guarded,
        }
    }

    /// The same once it has left: its capacity was given back then.
    pub(super) fn without_capacity(&self) -> Entry {
        Entry {
            lane: self.lane,
            delivery: self.delivery,
            outgoing: self.outgoing.clone(),
            id: self.id,
            destination: self.destination.clone(),
            expires_at: self.expires_at,
            capacity: Some(Capacity::default()),
            path: self.path.clone(),
            guarded: self.guarded,
        }
    }

    /// Whether it is a message, and none of this client's own requests.
    pub(crate) fn is_message(&self) -> bool {
        self.capacity.is_some()
    }

    /// The capacity that is free again when it has left.
    pub(crate) fn capacity(&self) -> Capacity {
        self.capacity.unwrap_or_default()
    }

    /// Where its loss is told; none if somebody waits for its answer.
    pub(crate) fn path(&self) -> Option<&Path> {
        self.path.as_ref()
    }

    fn context(&self) -> Option<&Path> {
        self.destination.as_ref()?.context.as_ref()
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

    // Signs of life do not count.
    fn counts(&self) -> bool {
        self.lane != Lane::Sign
    }

    fn charge(&self, _: Option<Form>) -> usize {
        self.outgoing.len()
    }

    // A second stop of a context says nothing that the first does not, unless somebody waits for its answer.
    fn repeats(&self, older: &Entry) -> bool {
        // Not one whose answer somebody waits for: it would not come.
        self.lane == Lane::Stop && older.path.is_some() && self.destination == older.destination
    }

    fn overrules(&self, waiting: &Entry) -> bool {
        self.lane == Lane::Stop && waiting.is_message() && self.context() == waiting.context()
    }
}

/// When a message is over: `expires` counts from its creation.
fn expires_at(parcel: &Parcel) -> Option<u64> {
    let created = u64::try_from(parcel.timestamp?.micros()).ok()?;
    Some(created.saturating_add(parcel.expires?.saturating_mul(1000)))
}
