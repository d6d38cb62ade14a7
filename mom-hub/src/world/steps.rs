//! What is done in steps: much is deleted, or left.

use mom_proto::event::Reason;
use mom_proto::{ContextNumber, Map, Micros, Path, WireError};

use super::stops::Order;
use super::{Timer, World};
use crate::{Audit, Effect, PeerId};

/// Contexts that one step ends, removes, leaves or stops, and peers that it tells.
pub(crate) const STEP: usize = 32;
pub(crate) const TOLD: usize = 256;

/// The time between two steps, in which others have their turns.
pub(crate) const PAUSE: Micros = 1_000;

impl World {
    /// Lets a job go on with its next step a little later.
    pub(crate) fn begin_job(&mut self, job: Job) {
        if self.jobs.is_empty() {
            self.timers.insert((self.after(PAUSE), Timer::Step));
        }
        self.queue_job(job);
    }

    /// Lets a job wait for its next step. A stop goes before all others: nobody's deletions hold it up.
    pub(crate) fn queue_job(&mut self, job: Job) {
        match job {
            Job::Stop(_) => self.jobs.push_front(job),
            _ => self.jobs.push_back(job),
        }
    }
}

/// What one step may still do.
#[derive(Debug)]
pub(crate) struct Budget {
    pub(crate) places: usize,
    /// Whose routes are made anew.
    pub(crate) members: usize,
    /// Effects before it.
    start: usize,
}

impl Budget {
    /// That of a step that begins after these effects.
    pub(crate) fn new(out: &[Effect]) -> Budget {
        Budget {
            places: STEP,
            members: 0,
            start: out.len(),
        }
    }

    /// Whether another step is to leave more; `costs` = that takes a new route.
    pub(crate) fn is_spent(&self, costs: bool, out: &[Effect]) -> bool {
        let members = if costs { self.members } else { 0 };
        self.places == 0 || members + told(&out[self.start..]) >= TOLD
    }
}

/// How many are told by effects.
pub(crate) fn told(effects: &[Effect]) -> usize {
    let one = |effect: &Effect| match effect {
        Effect::Deliver { to, .. } => to.len(),
        Effect::Send { route, .. } => route.members.len(),
        _ => 0,
    };
    effects.iter().map(one).sum()
}

/// What goes on between other inputs.
#[derive(Debug)]
pub(crate) enum Job {
    Delete(Box<Deletion>),
    Leave(Leaving),
    Link(LinkNews),
    Stop(Box<Sweep>),
}

impl Job {
    /// Whether it takes out a peer whose connection has ended.
    pub(crate) fn is_departure(&self) -> bool {
        matches!(self, Job::Leave(leaving) if matches!(leaving.then, Then::Forget))
    }
}

/// A stop or unstop of all channels below a session.
#[derive(Debug)]
pub(crate) struct Sweep {
    pub(crate) order: Order,
    pub(crate) top: Path,
    /// The last one that was told, in the order of paths.
    pub(crate) after: Option<Path>,
    /// The newest context at the beginning: what was made since is looked at in the end.
    pub(crate) newest: ContextNumber,
    /// The last one of those that was looked at.
    pub(crate) again: Option<ContextNumber>,
    /// Channels that had devices and are not there, which come last.
    pub(crate) away: Option<Vec<Path>>,
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
