//! One parcel that waits.

use std::sync::Arc;

use mom_net::Outgoing;
use mom_proto::{Parcel, Path};

use super::{Overruled, Room};

/// Which lane a parcel waits in, the most urgent last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Lane {
    /// Messages, by their priority.
    Data(i32),
    /// Requests, and `unstop`.
    Control,
    /// Pings and pongs.
    Sign,
    /// `stop`.
    Stop,
}

/// A message with the room that it takes.
#[derive(Debug)]
pub(crate) struct Message {
    pub(crate) room: Room,
    /// Its context, if a loss of it is told there; one that is awaited is told by its answer.
    pub(crate) path: Option<Path>,
    pub(crate) outgoing: Outgoing,
}

/// A parcel as it waits.
#[derive(Debug)]
pub(crate) struct Entry {
    pub(super) lane: Lane,
    /// Of messages their number in the order of sending; of control, that of the last message that goes first.
    pub(super) number: u64,
    pub(crate) outgoing: Outgoing,
    id: Option<u64>,
    context: Option<Path>,
    pub(super) address: Option<Vec<Arc<str>>>,
    /// None of what is no message.
    room: Option<Room>,
    path: Option<Path>,
}

impl Entry {
    pub(super) fn control(parcel: &Parcel, lane: Lane, after: u64, outgoing: Outgoing) -> Entry {
        Entry {
            lane,
            number: after,
            outgoing,
            id: parcel.id,
            context: None,
            address: None,
            room: None,
            path: None,
        }
    }

    pub(super) fn message(parcel: &Parcel, lane: Lane, number: u64, message: Message) -> Entry {
        let named = !matches!(lane, Lane::Data(_));
        Entry {
            lane,
            number,
            outgoing: message.outgoing,
            id: parcel.id,
            context: parcel.context.clone().filter(|_| named),
            address: parcel.address.clone().filter(|_| named),
            room: Some(message.room),
            path: message.path,
        }
    }

    /// Whether it is a message, and none of this client's own requests.
    pub(crate) fn is_message(&self) -> bool {
        self.room.is_some()
    }

    /// The room that is free again when it has left.
    pub(crate) fn room(&self) -> Room {
        self.room.unwrap_or_default()
    }

    /// Where its loss is told.
    pub(crate) fn path(&self) -> Option<&Path> {
        self.path.as_ref()
    }

    pub(super) fn is_for_same_as(&self, other: &Entry) -> bool {
        self.context == other.context
    }

    /// Whether somebody waits for its answer.
    pub(super) fn is_awaited(&self) -> bool {
        self.path.is_none()
    }

    pub(super) fn overruled(&self) -> Overruled {
        Overruled {
            id: self.id,
            path: self.path.clone(),
            room: self.room(),
        }
    }

    /// The bytes of its frame; 0 within a process.
    pub(super) fn length(&self) -> usize {
        match &self.outgoing {
            Outgoing::Encoded(encoded) => encoded.len(),
            Outgoing::Parcel(_) => 0,
        }
    }
}
