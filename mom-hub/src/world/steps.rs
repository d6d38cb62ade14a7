//! What is done in steps: much is deleted, or left.

use mom_proto::event::Reason;
use mom_proto::{ContextNumber, Map, Path, WireError};

use crate::{Audit, PeerId};

/// What goes on between other inputs.
#[derive(Debug)]
pub(crate) enum Job {
    Delete(Box<Deletion>),
    Leave(Leaving),
    Link(LinkNews),
}

/// A peer has lost its connection, or has come back.
#[derive(Debug)]
pub(crate) struct LinkNews {
    pub(crate) peer: PeerId,
    pub(crate) lost: bool,
    /// Tokens whose devices have to be made safe.
    pub(crate) halts: Vec<ContextNumber>,
    /// Where members have to be told.
    pub(crate) told: Vec<ContextNumber>,
}

/// A deletion that goes on. What it concerns is closed to all requests.
#[derive(Debug)]
pub(crate) struct Deletion {
    pub(crate) top: ContextNumber,
    pub(crate) path: Path,
    pub(crate) by: Deleter,
    pub(crate) phase: Phase,
    /// Who waits for it, and the id of its request.
    pub(crate) answer: Option<(PeerId, Option<u64>)>,
}

/// Who deletes; its name outlives it.
#[derive(Clone, Debug)]
pub(crate) struct Deleter {
    pub(crate) peer: Option<PeerId>,
    pub(crate) fact: Audit,
}

/// How far a deletion has come.
#[derive(Clone, Debug)]
pub(crate) enum Phase {
    /// Tokens are lost, those after this path next.
    Tokens(Option<Path>),
    /// Contexts are removed, the last one next.
    Contexts,
}

/// A peer on its way out of a context and all below it. What it asks for there is refused.
#[derive(Debug)]
pub(crate) struct Leaving {
    pub(crate) peer: PeerId,
    pub(crate) top: Path,
    pub(crate) reason: Reason,
    pub(crate) then: Then,
}

/// What follows when a peer is out.
#[derive(Debug)]
pub(crate) enum Then {
    /// Its request of this id is answered.
    Answer(Option<u64>),
    Expelled(Box<Expulsion>),
    /// The hub forgets it.
    Forget,
    /// The same, and its request of this id is answered.
    LogOut(Option<u64>),
}

/// What is said of a peer that was put out.
#[derive(Debug)]
pub(crate) struct Expulsion {
    /// Who were members, the peer among them.
    pub(crate) told: Vec<PeerId>,
    pub(crate) content: Map,
    /// Why its connection ends, if it was put out of the hub.
    pub(crate) close: Option<WireError>,
    /// Who has asked for it, and the id of the request.
    pub(crate) answer: Option<(PeerId, Option<u64>)>,
}
