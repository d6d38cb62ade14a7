//! What the hub knows at one moment, and how it says what it wants done.
//!
//! The rooms above work on a `&mut World`: they look things up, change them, and append [`Effect`]s.

pub(crate) mod audit;
pub(crate) mod effect;
pub(crate) mod events;
mod facts;
pub(crate) mod inquiry;
mod names;
mod routes;
pub(crate) mod settings;
pub(crate) mod steps;
pub(crate) mod stops;
pub(crate) mod tell_pace;

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

use mom_managers::Registry;
use mom_proto::{Code, ContextNumber, Fence, Micros, Path, Time, WireError};

use crate::token::state::Token;
use crate::tree::Tree;
use crate::tree::peers::Peers;
use crate::{Audit, Effect, PeerId, Record, Settings, Ticket};
use steps::Job;
use stops::Stops;
use tell_pace::TellPace;

/// All that the hub knows, but for the questions that it has asked.
#[derive(Debug)]
pub(crate) struct World {
    pub(crate) settings: Settings,
    pub(crate) registry: Registry,
    pub(crate) tree: Tree,
    pub(crate) peers: Peers,
    pub(crate) timers: BTreeSet<(Micros, Timer)>,
    pub(crate) now: Micros,
    /// By how much the wall clock is ahead of [`World::wall`], µs.
    pub(crate) ahead: i64,
    /// The highest fence of all tokens that were deleted.
    pub(crate) deleted_fence: Fence,
    /// Channels from whose routes the present input has taken something, or whose guard it has changed.
    pub(crate) changed: BTreeSet<ContextNumber>,
    /// Channels to whose routes it has only added.
    pub(crate) grown: BTreeSet<ContextNumber>,
    /// What is done in steps, the next one first.
    pub(crate) jobs: VecDeque<Job>,
    /// Up to when those wait for each other who go from where many are.
    pub(crate) crowd_until: Micros,
    /// The paths of what is being deleted.
    pub(crate) doomed: BTreeSet<Path>,
    /// What peers are leaving.
    pub(crate) leaving: BTreeMap<PeerId, Vec<Path>>,
    /// Changes of owner that wait for their record, by the ticket of the store.
    pub(crate) storing: BTreeMap<Ticket, ContextNumber>,
    pub(crate) last_ticket: u64,
    /// Records of before the start, by path, until a token is made there.
    pub(crate) records: BTreeMap<Path, Record>,
    pub(crate) last_waiter: u64,
    /// Tokens whose queues are to be looked at, because something else than their own release may let a waiter have them.
    pub(crate) stirred: BTreeSet<ContextNumber>,
    /// Waiting grabs whose turn it is, and about which a peer has to be asked: token and ticket.
    pub(crate) to_ask: Vec<(ContextNumber, u64)>,
    /// Which devices are stopped.
    pub(crate) stops: Stops,
    /// What users have had others told of lately.
    pub(crate) tell_pace: TellPace,
    // In a cell, because lookups find faults too.
    faults: RefCell<Vec<&'static str>>,
}

/// What the hub does by itself at some time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Timer {
    /// Ends the ownership of a token.
    Lease(ContextNumber),
    /// Sends a count of members that was held back.
    Count(ContextNumber),
    /// Ends the waiting of a grab.
    Wait(ContextNumber, u64),
    /// Looks again at a queue in which grabs of who had the token too often wait.
    Turn(ContextNumber),
    /// Ends an offer.
    Offer(ContextNumber),
    /// Ends a request to an owner.
    Request(ContextNumber, u64),
    /// Ends the waiting for a verdict.
    Answer(u64),
    /// Ends the waiting for the word of devices.
    Call(u64),
    /// Goes on with what is done in steps.
    Step,
    /// Ends the time for which only the owner of before a restart may have a token.
    Reserved(ContextNumber),
    /// Ends the time in which a peer may come back that has lost its connection.
    Grace(PeerId),
}

impl World {
    /// A world without any context.
    pub(crate) fn new(mut settings: Settings, registry: Registry) -> World {
        let records = std::mem::take(&mut settings.records);
        let stopped = std::mem::take(&mut settings.stops);
        let stops = Stops::new(stopped, settings.stops_unread, settings.epoch, settings.anchor);
        World {
            settings,
            registry,
            tree: Tree::default(),
            peers: Peers::default(),
            timers: BTreeSet::new(),
            now: 0,
            ahead: 0,
            deleted_fence: Fence::default(),
            changed: BTreeSet::new(),
            grown: BTreeSet::new(),
            jobs: VecDeque::new(),
            doomed: BTreeSet::new(),
            leaving: BTreeMap::new(),
            storing: BTreeMap::new(),
            last_ticket: 0,
            records: records
                .into_iter()
                .map(|record| (record.path.clone(), record))
                .collect(),
            last_waiter: 0,
            stirred: BTreeSet::new(),
            to_ask: Vec::new(),
            stops,
            tell_pace: TellPace::default(),
            crowd_until: 0,
            faults: RefCell::default(),
        }
    }

    /// The hub's time for stamps: wall time at the start, and monotonic from then on.
    pub(crate) fn wall(&self) -> Time {
        let micros = i64::try_from(self.now).unwrap_or(i64::MAX);
        Time::from_micros(self.settings.anchor.micros().saturating_add(micros)).unwrap_or(Time::MAX)
    }

    /// The time of day by the wall clock, which may be set at any time.
    pub(crate) fn civil(&self) -> Time {
        let civil = self.wall().micros().saturating_add(self.ahead);
        Time::from_micros(civil).unwrap_or(if civil < 0 { Time::default() } else { Time::MAX })
    }

    /// The end of a time that begins now.
    pub(crate) fn after(&self, time: Micros) -> Micros {
        self.now.saturating_add(time)
    }

    pub(crate) fn token(&self, number: ContextNumber) -> Option<&Token> {
        self.tree.token(number)
    }

    pub(crate) fn token_mut(&mut self, number: ContextNumber) -> Option<&mut Token> {
        self.tree.token_mut(number)
    }

    /// The fence above which the next grant of any token is.
    pub(crate) fn fence_floor(&self) -> Fence {
        Fence::floor(self.settings.epoch).max(self.deleted_fence)
    }

    /// Sets the token's timer to its deadline as it is now.
    pub(crate) fn retime(&mut self, number: ContextNumber) {
        let Some(token) = self.tree.token_mut(number) else {
            return self.fault("setting a timer for a token that does not exist");
        };
        let (old, new) = (token.timer, token.deadline());
        token.timer = new;
        if old == new {
            return;
        }
        if let Some(old) = old {
            self.timers.remove(&(old, Timer::Lease(number)));
        }
        if let Some(new) = new {
            self.timers.insert((new, Timer::Lease(number)));
        }
    }

    /// Notes something that [`Hub::check`](crate::Hub::check) calls impossible, in words for those who look for the
    /// cause. A debug build stops here; a release goes on without what was missing and writes the words into the audit
    /// log.
    #[track_caller]
    pub(crate) fn fault<T: Default>(&self, words: &'static str) -> T {
        debug_assert!(false, "{words}");
        self.faults.borrow_mut().push(words);
        T::default()
    }

    /// The same where a request has to be refused for it.
    #[track_caller]
    pub(crate) fn faulted(&self, words: &'static str) -> WireError {
        self.fault::<()>(words);
        WireError::new(Code::DENIED, "internal error in the hub; see its audit log").rule("fault")
    }

    /// Gives out the faults of one input.
    pub(crate) fn push_faults(&mut self, out: &mut Vec<Effect>) {
        for words in self.faults.take() {
            let fact = Audit {
                text: Some(words.to_owned()),
                ..Audit::new("fault")
            };
            self.audit(fact, out);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn world() -> World {
        World::new(Settings::default(), Registry::builtin())
    }

    #[test]
    fn a_fault_is_a_fact_with_its_words() {
        let mut world = world();
        world.faults.borrow_mut().push("the sky has fallen");
        let mut out = Vec::new();
        world.push_faults(&mut out);
        let [Effect::Audit(fact)] = &out[..] else {
            panic!("{out:?}")
        };
        assert_eq!(
            (fact.what, fact.text.as_deref()),
            ("fault", Some("the sky has fallen"))
        );
    }

    #[test]
    #[cfg_attr(debug_assertions, should_panic(expected = "the sky has fallen"))]
    fn a_fault_stops_a_debug_build_and_is_told_by_a_release() {
        let mut world = world();
        assert_eq!(world.fault::<Option<u64>>("the sky has fallen"), None);
        assert_eq!(world.faulted("twice").code, Code::DENIED);
        let mut out = Vec::new();
        world.push_faults(&mut out);
        let words = out.iter().map(|effect| match effect {
            Effect::Audit(fact) => (fact.what, fact.text.as_deref()),
            other => panic!("{other:?}"),
        });
        let words: Vec<_> = words.collect();
        assert_eq!(
            words,
            [("fault", Some("the sky has fallen")), ("fault", Some("twice"))]
        );
        out.clear();
        world.push_faults(&mut out);
        assert_eq!(out, [], "each is told once");
    }
}
