//! What is delivered: encoded once, shared by all that it waits for.

use std::io::IoSlice;
use std::sync::Arc;

use mom_hub::PeerId;
use mom_managers::Micros;
use mom_net::Part;
use mom_proto::binary;
use mom_proto::codec::{Encoded, Form};
use mom_proto::{ContextNumber, Delivery, Parcel};
use mom_system::sync::atomic::{AtomicU64, Ordering};

use crate::traffic::encodings::Encodings;
use crate::traffic::gather;

/// The fence that lets guarded parcels of a channel pass now; 0 while nobody owns the token.
pub(crate) type Gate = Arc<AtomicU64>;

/// What a waiting parcel counts besides its bytes: the queue's own memory for it.
const PLACE: usize = 64;

/// A parcel, or a run of small ones, with all that a queue has to know of it.
#[derive(Clone, Debug)]
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
}

/// Which lane a parcel waits in (design §7).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Lane {
    /// Messages, by their priority.
    Data(i32),
    /// Replies, events, safe states, heartbeats.
    Control,
    /// `stop`: before all others, in memory of its own.
    Stop,
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
    /// The receiver wants fewer, and a newer one came before its turn.
    Rate,
}

/// What a receiver did not get: of whom, why, and of which class.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Dropped {
    pub(crate) context: ContextNumber,
    pub(crate) sender: PeerId,
    pub(crate) reason: DropReason,
    pub(crate) class: Delivery,
}

impl DropReason {
    pub(crate) fn word(self) -> &'static str {
        match self {
            DropReason::Replaced => "replaced",
            DropReason::Full => "queue-full",
            DropReason::Closed => "receiver-gone",
            DropReason::Expired => "expired",
            DropReason::Fence => "older-fence",
            DropReason::Rate => "rate",
        }
    }
}

impl Packet {
    /// Whether a receiver may be spared of it: a message that needed no token and is no stop. What is guarded is a
    /// command, of which each counts.
    pub(crate) fn may_be_thinned(&self) -> bool {
        matches!(self.lane, Lane::Data(_)) && self.gate.is_none()
    }

    /// The same for receivers that want the newest only, whatever its class is.
    pub(crate) fn as_latest(&self) -> Packet {
        Packet {
            delivery: Delivery::Latest,
            ..self.clone()
        }
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
        let small = |form| self.length(form) <= gather::SMALL;
        matches!(self.lane, Lane::Data(..=0))
            && [Some(Form::Binary), Some(Form::Xml), None].into_iter().all(small)
    }

    /// The frames for a receiver of this form, none inside this process.
    pub(super) fn frames(&self, form: Option<Form>) -> Option<&Encoded> {
        self.encodings.frames(form)
    }

    /// The bytes on the wire; inside this process a fixed charge that keeps the bound a bound.
    pub(super) fn length(&self, form: Option<Form>) -> usize {
        match self.frames(form) {
            Some(frames) => frames.len(),
            None => self.encodings.local_size(),
        }
    }
}

impl Packet {
    /// The bytes that it counts for a receiver of this form while it waits.
    pub(crate) fn charge(&self, form: Option<Form>) -> usize {
        self.length(form) + PLACE
    }
}

/// A packet as it waits for one peer.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    pub(super) packet: Arc<Packet>,
    pub(super) progress: Progress,
}

/// How much of a packet was given to the link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Progress {
    /// Bytes of its frames, or, once it goes in chunks, of what the chunks carry.
    pub(super) sent: usize,
    /// The stream of chunks that it goes in.
    pub(super) stream: Option<u64>,
}

impl Entry {
    pub(super) fn new(packet: Arc<Packet>) -> Entry {
        Entry {
            packet,
            progress: Progress::default(),
        }
    }

    pub(super) fn begun(&self) -> bool {
        self.progress != Progress::default()
    }

    /// How many parcels have not left yet.
    pub(super) fn remaining(&self, form: Option<Form>) -> u64 {
        match self.packet.frames(form) {
            Some(frames) if self.packet.count > 1 => {
                let rest = frames.head.get(self.progress.sent..).unwrap_or_default();
                u64::from(binary::cut(rest, rest.len()).1)
            }
            _ => u64::from(self.packet.count),
        }
    }
}

/// What is given to the link at once: a whole packet or a part of one that others may follow.
#[derive(Debug)]
pub(crate) struct Piece {
    pub(super) packet: Arc<Packet>,
    /// Of the packet's frames.
    pub(super) part: Part,
    /// How far the packet was before.
    pub(super) before: Progress,
    /// Nothing of the packet comes after it.
    pub(super) last: bool,
}

impl Piece {
    /// Gives up a packet of which chunks have left.
    pub(super) fn abort(packet: Arc<Packet>, stream: u64) -> Piece {
        Piece {
            packet,
            part: Part::abort(stream),
            before: Progress {
                sent: 0,
                stream: Some(stream),
            },
            last: true,
        }
    }

    /// The bytes that are not written yet.
    pub(super) fn length(&self) -> usize {
        self.part.left()
    }

    /// What is to be written of it.
    pub(super) fn append_to<'a>(&'a self, form: Option<Form>, slices: &mut Vec<IoSlice<'a>>) {
        self.part.append_to(self.packet.frames(form), slices);
    }

    /// The parcel, for a peer in this process.
    pub(super) fn parcel(&self) -> Option<&Arc<Parcel>> {
        self.packet.encodings.local()
    }
}
