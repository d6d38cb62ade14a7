//! Requests that wait for the verdict of a managing peer or a chair (M24, M25).
//!
//! A manager that has to ask defers. The whole request is then carried out again once there is an answer, with the
//! answers at hand: so everything else about it is decided by what holds then, not by what held when it was asked.

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

use mom_managers::{Ask, Defer, GivenAnswer, Micros};
use mom_proto::{Code, Content, ContextNumber, Family, Map, Parcel, Path, Value, Verb, WireError};

use crate::age::Aged;
use crate::hub::Timer;
use crate::{Effect, Hub, PeerId};

/// Questions of one peer that may wait, and of all.
const MOST_OF_ONE: usize = 16;
const MOST: usize = 4096;

/// Beside so many bytes of content that wait of one peer nothing more does.
const MOST_BYTES: usize = 1 << 20;

/// Sends to one channel that wait behind a deferred one of the same peer.
const MOST_SENDS: usize = 16;

/// A deferred send waits no longer than this, µs.
const SEND_TIME: Micros = 2_000_000;

/// Why a request was not carried out.
#[derive(Debug)]
pub(crate) enum Refusal {
    /// For good.
    Error(WireError),
    /// Not before somebody was asked.
    Defer(Box<Deferred>),
}

impl From<WireError> for Refusal {
    fn from(error: WireError) -> Refusal {
        Refusal::Error(error)
    }
}

/// What is to be asked.
#[derive(Debug)]
pub(crate) struct Deferred {
    pub(crate) defer: Defer,
    /// The rule that asks, for people.
    pub(crate) rule: Arc<str>,
    /// Who wants to do it: mostly the peer whose request it is.
    pub(crate) peer: PeerId,
    pub(crate) verb: Verb,
    /// The context whose manager asks.
    pub(crate) managing: ContextNumber,
    /// The context acted on, or the nearest above it.
    pub(crate) at: ContextNumber,
    pub(crate) path: Path,
    pub(crate) message: Option<String>,
    pub(crate) size: usize,
    pub(crate) age: Option<Aged>,
    pub(crate) kind: &'static str,
}

/// A request that waits.
#[derive(Debug)]
pub(crate) struct Pending {
    pub(crate) peer: PeerId,
    pub(crate) parcel: Parcel,
    pub(crate) answers: Vec<Heard>,
    label: Arc<str>,
    pub(crate) asked: BTreeSet<PeerId>,
    whom: Whom,
    pub(crate) until: Micros,
    /// The channel, if it is a send.
    pub(crate) channel: Option<ContextNumber>,
    /// Later sends of the same peer to the same channel.
    pub(crate) behind: VecDeque<Parcel>,
}

/// Who may answer a question, and about what.
#[derive(Clone, Debug)]
struct Whom {
    ask: Ask,
    peer: PeerId,
    verb: Verb,
    managing: ContextNumber,
    at: ContextNumber,
}

/// An answer, and what it is the answer to: managers of one label in other contexts have not been given it.
#[derive(Clone, Debug)]
pub(crate) struct Heard {
    pub(crate) peer: PeerId,
    pub(crate) verb: Verb,
    pub(crate) at: ContextNumber,
    pub(crate) given: GivenAnswer,
}

impl Hub {
    /// Lets a request wait for an answer, or runs it again at once if there is nobody to ask.
    pub(crate) fn postpone(
        &mut self,
        peer: PeerId,
        parcel: Parcel,
        answers: Vec<Heard>,
        deferred: &Deferred,
        out: &mut Vec<Effect>,
    ) {
        let whom = Whom {
            ask: deferred.defer.ask.clone(),
            peer: deferred.peer,
            verb: deferred.verb,
            managing: deferred.managing,
            at: deferred.at,
        };
        let asked = self.whom_to_ask(&whom);
        let label = Arc::clone(&deferred.defer.label);
        if asked.is_empty() {
            let given = unanswered(label, "there is nobody to ask");
            self.resume(peer, parcel, answers, whom.heard(given), out);
            return;
        }
        let (mine, bytes) = self.waiting_of(peer);
        if mine >= MOST_OF_ONE || bytes >= MOST_BYTES || self.pending.len() >= MOST {
            let text = "too many requests wait for somebody's answer";
            let error = WireError::new(Code::TRY_LATER, text).rule(&label);
            self.push_refusal(peer, &parcel, &error, out);
            return;
        }
        let send = parcel.family == Family::Message;
        let within = match send {
            true => deferred.defer.within.min(SEND_TIME),
            false => deferred.defer.within,
        };
        self.last_question += 1;
        let (question, until) = (self.last_question, self.after(within));
        self.push_consult(question, deferred, until, &asked, out);
        self.timers.insert((until, Timer::Answer(question)));
        let channel = send.then_some(deferred.at);
        if let Some(channel) = channel {
            self.hold_sends(channel, peer, true);
        }
        let pending = Pending {
            peer,
            parcel,
            answers,
            label,
            asked,
            whom,
            until,
            channel,
            behind: VecDeque::new(),
        };
        self.pending.insert(question, pending);
    }

    /// How many requests of a peer wait, and with how many bytes.
    fn waiting_of(&self, peer: PeerId) -> (usize, usize) {
        let size = |parcel: &Parcel| parcel.content.as_ref().map_or(0, Content::size);
        let own = self.pending.values().filter(|pending| pending.peer == peer);
        own.fold((0, 0), |(count, bytes), pending| {
            let behind: usize = pending.behind.iter().map(size).sum();
            (count + 1, bytes + size(&pending.parcel) + behind)
        })
    }

    fn whom_to_ask(&self, whom: &Whom) -> BTreeSet<PeerId> {
        match &whom.ask {
            Ask::Creator => {
                let creator = self.tree.get(whom.managing).and_then(|context| context.creator);
                creator
                    .into_iter()
                    .filter(|creator| self.peers.get(*creator).is_some())
                    .collect()
            }
            ask @ Ask::Chairs { .. } => {
                let Some(at) = self.tree.get(whom.at) else {
                    return BTreeSet::new();
                };
                let parent = at.parent.and_then(|parent| self.tree.get(parent));
                let members = at
                    .members
                    .values()
                    .chain(parent.into_iter().flat_map(|parent| parent.members.values()));
                let chairs = members.filter(|member| member.peer != whom.peer && ask.is_chair(&member.facts));
                chairs.map(|member| member.peer).collect()
            }
        }
    }

    fn push_consult(
        &self,
        question: u64,
        deferred: &Deferred,
        until: Micros,
        asked: &BTreeSet<PeerId>,
        out: &mut Vec<Effect>,
    ) {
        let Some(facts) = self.peers.get(deferred.peer).map(|peer| &peer.facts) else {
            return;
        };
        let mut content = Map::new().with("verb", deferred.verb.word());
        for (key, value) in crate::events::peer_map(facts) {
            content.set(&key, value);
        }
        let groups: Vec<Value> = facts
            .groups
            .iter()
            .map(|group| Value::from(group.as_str()))
            .collect();
        content.set("groups", groups);
        if let Some(message) = &deferred.message {
            content.set("message", message.as_str());
            content.set("size", i64::try_from(deferred.size).unwrap_or(i64::MAX));
            if let Some((age, error)) = deferred.age {
                content.set("age", age);
                content.set("age-error", i64::try_from(error).unwrap_or(i64::MAX));
            }
        }
        content.set("kind", deferred.kind);
        content.set("within", self.millis_until(until));
        content.set("rule", &*deferred.rule);
        let mut parcel = self.hub_parcel(Family::Manager, "consult", &deferred.path);
        parcel.id = Some(question);
        out.push(Effect::Deliver {
            to: asked.iter().copied().collect(),
            parcel: Arc::new(parcel.content(content)),
        });
    }

    /// Takes the answer of a peer to a question; false if it was not asked, or not any more.
    pub(crate) fn answer(
        &mut self,
        question: u64,
        given: GivenAnswer,
        by: PeerId,
        out: &mut Vec<Effect>,
    ) -> bool {
        let asked = self.pending.get(&question);
        // Who was a chair when it was asked may have left the room meanwhile, or been put out of it.
        let may =
            |pending: &Pending| pending.asked.contains(&by) && self.whom_to_ask(&pending.whom).contains(&by);
        if !asked.is_some_and(may) {
            return false;
        }
        if let Some(pending) = self.take_pending(question) {
            let label = Arc::clone(&pending.label);
            self.finish(pending, GivenAnswer { label, ..given }, out);
        }
        true
    }

    /// Nobody has answered in time.
    pub(crate) fn handle_unanswered(&mut self, question: u64, out: &mut Vec<Effect>) {
        let Some(pending) = self.take_pending(question) else {
            return;
        };
        let given = unanswered(Arc::clone(&pending.label), "");
        self.finish(pending, given, out);
    }

    fn finish(&mut self, pending: Pending, given: GivenAnswer, out: &mut Vec<Effect>) {
        let Pending {
            peer,
            parcel,
            answers,
            channel,
            behind,
            whom,
            ..
        } = pending;
        if let Some(channel) = channel {
            self.hold_sends(channel, peer, false);
        }
        if channel.is_some() && given.by.is_none() && !given.allow {
            let text = "who manages this channel did not answer in time";
            let error = WireError::new(Code::TRY_LATER, text).rule(&given.label);
            self.push_refusal(peer, &parcel, &error, out);
        } else {
            self.resume(peer, parcel, answers, whom.heard(given), out);
        }
        // They come in their order; what has to be asked for again holds back those after it.
        for parcel in behind {
            self.handle_request(peer, parcel, Vec::new(), out);
        }
    }

    fn resume(
        &mut self,
        peer: PeerId,
        parcel: Parcel,
        mut answers: Vec<Heard>,
        heard: Heard,
        out: &mut Vec<Effect>,
    ) {
        // A manager that defers again although it has its answer would do so forever.
        if answers.len() >= MOST_OF_ONE {
            let error = WireError::new(Code::DENIED, "the manager asks without end").rule(&heard.given.label);
            self.push_refusal(peer, &parcel, &error, out);
            return;
        }
        answers.push(heard);
        self.handle_request(peer, parcel, answers, out);
    }

    fn take_pending(&mut self, question: u64) -> Option<Pending> {
        let pending = self.pending.remove(&question)?;
        self.timers.remove(&(pending.until, Timer::Answer(question)));
        Some(pending)
    }

    /// Whether an earlier send of this peer to this channel waits for an answer.
    pub(crate) fn waits_behind(&self, peer: PeerId, channel: ContextNumber) -> bool {
        let mut waiting = self.pending.values();
        waiting.any(|pending| pending.peer == peer && pending.channel == Some(channel))
    }

    /// Lets a send wait behind that one.
    ///
    /// # Errors
    /// `try-later` if too many wait there already.
    pub(crate) fn wait_behind(
        &mut self,
        peer: PeerId,
        channel: ContextNumber,
        parcel: &mut Parcel,
    ) -> Result<(), WireError> {
        let (_, bytes) = self.waiting_of(peer);
        let mut waiting = self.pending.values_mut();
        let Some(pending) = waiting.find(|pending| pending.peer == peer && pending.channel == Some(channel))
        else {
            return Ok(());
        };
        if pending.behind.len() >= MOST_SENDS || bytes >= MOST_BYTES {
            let text = "an earlier message to this channel still waits for who manages it";
            return Err(WireError::new(Code::TRY_LATER, text));
        }
        pending.behind.push_back(take_parcel(parcel));
        Ok(())
    }

    /// Refuses what waits of a peer that goes: its connection may be somebody else's next.
    pub(crate) fn end_pending(&mut self, peer: PeerId, out: &mut Vec<Effect>) {
        let own: Vec<u64> = self
            .pending
            .iter()
            .filter(|(_, pending)| pending.peer == peer)
            .map(|(question, _)| *question)
            .collect();
        let error = WireError::new(Code::WITHDRAWN, "who asked is gone before it was answered");
        for question in own {
            let Some(pending) = self.take_pending(question) else {
                continue;
            };
            for parcel in std::iter::once(&pending.parcel).chain(&pending.behind) {
                self.push_refusal(peer, parcel, &error, out);
            }
        }
    }

    /// Answers for a peer that is gone what it was asked, where it was the last who could.
    pub(crate) fn end_questions(&mut self, peer: PeerId, out: &mut Vec<Effect>) {
        let mut alone = Vec::new();
        for (question, pending) in &mut self.pending {
            if pending.asked.remove(&peer) && pending.asked.is_empty() {
                alone.push(*question);
            }
        }
        for question in alone {
            self.handle_unanswered(question, out);
        }
    }

    /// Lets all sends of a peer to a channel come to the hub, or not any more.
    fn hold_sends(&mut self, channel: ContextNumber, peer: PeerId, held: bool) {
        let Some(context) = self.tree.get_mut(channel) else {
            return;
        };
        let Some(member) = context.members.get(&peer) else {
            return;
        };
        let member = member.holding(held);
        context.members.insert(peer, Arc::new(member));
        self.changed.insert(channel);
    }
}

impl Whom {
    fn heard(&self, given: GivenAnswer) -> Heard {
        Heard {
            peer: self.peer,
            verb: self.verb,
            at: self.at,
            given,
        }
    }
}

/// The parcel of a request that needs it no more.
pub(crate) fn take_parcel(parcel: &mut Parcel) -> Parcel {
    std::mem::replace(parcel, Parcel::new(Family::Message, ""))
}

fn unanswered(label: Arc<str>, why: &str) -> GivenAnswer {
    GivenAnswer {
        label,
        by: None,
        allow: false,
        stands: false,
        text: why.to_owned(),
    }
}
