//! Requests that wait for the verdict of a managing peer or a chair (M24, M25).
//!
//! A manager that has to ask defers. The whole request is carried out again once there is an answer, with the answers
//! at hand: so everything else about it is decided by what holds then, not by what held when it was asked. Carrying
//! out is the business of the room above, so requests that are due again are returned to it.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use mom_managers::{Ask, GivenAnswer};
use mom_proto::{Code, ContextNumber, Family, Map, Micros, Parcel, Value, Verb, WireError};

use super::refusal::Deferred;
use crate::heard::Heard;
use crate::values::{count, number};
use crate::world::events::peer_map;
use crate::world::{Timer, World};
use crate::{Effect, PeerId};

/// Questions of one peer that may wait, and of all peers of one user. There is no bound on all of them together: it would
/// let a few users, or all guests, which are one user, use up what others need.
const MOST_OF_ONE: usize = 16;
const MOST_OF_USER: usize = 256;

/// Bytes of one peer's requests that may wait, and of one user's; beyond them no further request does.
const MOST_BYTES: usize = 1 << 20;
const MOST_BYTES_OF_USER: usize = 4 << 20;

/// Sends to one channel that wait behind a deferred one of the same peer.
const MOST_SENDS: usize = 16;

/// A deferred send waits no longer than this, µs.
const SEND_TIME: Micros = 2_000_000;

/// A request to be carried out, for the first time or again.
#[derive(Debug)]
pub(crate) struct Due {
    pub(crate) peer: PeerId,
    pub(crate) parcel: Parcel,
    /// What managing peers and chairs have answered about it.
    pub(crate) answers: Vec<Heard>,
    /// If it is a grab that waits in the queue, and a peer has to be asked before it is granted: its token and its ticket.
    pub(crate) waiter: Option<(ContextNumber, u64)>,
}

impl Due {
    /// A request that comes for the first time.
    pub(crate) fn new(peer: PeerId, parcel: Parcel) -> Due {
        Due {
            peer,
            parcel,
            answers: Vec::new(),
            waiter: None,
        }
    }

    /// Refuses it; a grab leaves the queue with that.
    pub(crate) fn refuse(
        &self,
        world: &mut World,
        (error, told): (&WireError, Option<&WireError>),
        out: &mut Vec<Effect>,
    ) {
        if let Some((number, ticket)) = self.waiter
            && world.take_waiter(number, ticket).is_none()
        {
            // It was answered when it left the queue.
            return;
        }
        world.push_refusal_as(self.peer, &self.parcel, (error, told), out);
        if let Some((number, _)) = self.waiter {
            world.tell_queue(number, out);
        }
    }
}

/// The questions that are open, by their numbers.
#[derive(Debug, Default)]
pub(crate) struct Questions {
    pub(crate) pending: BTreeMap<u64, Pending>,
    /// The same by peer.
    of_peer: BTreeMap<PeerId, BTreeSet<u64>>,
    /// What waits of each user.
    of_user: BTreeMap<Arc<str>, Waiting>,
    last: u64,
}

/// How much waits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Waiting {
    questions: usize,
    bytes: usize,
}

/// A request that waits.
#[derive(Debug)]
pub(crate) struct Pending {
    pub(crate) request: Due,
    user: Arc<str>,
    label: Arc<str>,
    pub(crate) asked: BTreeSet<PeerId>,
    whom: Whom,
    pub(crate) until: Micros,
    /// The channel, if it is a send.
    pub(crate) channel: Option<ContextNumber>,
    /// Later sends of the same peer to the same channel.
    pub(crate) behind: VecDeque<Parcel>,
}

/// The subject of a question, by which those who may answer it are found.
#[derive(Clone, Debug)]
struct Whom {
    ask: Ask,
    peer: PeerId,
    verb: Verb,
    managing: ContextNumber,
    at: ContextNumber,
    grants: u64,
}

impl Questions {
    /// Lets a request wait for an answer. It is returned at once if there is no peer to ask.
    pub(crate) fn postpone(
        &mut self,
        world: &mut World,
        request: Due,
        deferred: &Deferred,
        out: &mut Vec<Effect>,
    ) -> Option<Due> {
        let whom = Whom {
            ask: deferred.defer.ask.clone(),
            peer: deferred.peer,
            verb: deferred.verb,
            managing: deferred.managing,
            at: deferred.at,
            grants: world.grants_at(deferred.at),
        };
        let asked = whom.find(world);
        let label = Arc::clone(&deferred.defer.label);
        if asked.is_empty() {
            let given = unanswered(label, "there is no peer to ask");
            return resume(world, request, whom.heard(given), out);
        }
        let peer = request.peer;
        let Some(user) = world.peers.get(peer).map(|peer| Arc::clone(&peer.facts.user)) else {
            return world.fault("deferring the request of a peer that does not exist");
        };
        if let Err(error) = self.check_waiting(peer, &user) {
            request.refuse(world, (&error.rule(&label), None), out);
            return None;
        }
        let send = request.parcel.family == Family::Message;
        let within = match send {
            true => deferred.defer.within.min(SEND_TIME),
            false => deferred.defer.within,
        };
        self.last += 1;
        let (question, until) = (self.last, world.after(within));
        push_consult(world, question, deferred, until, &asked, out);
        world.timers.insert((until, Timer::Answer(question)));
        let channel = send.then_some(deferred.at);
        if let Some(channel) = channel {
            hold_sends(world, channel, peer, true);
        }
        let waiting = self.of_user.entry(Arc::clone(&user)).or_default();
        waiting.questions += 1;
        waiting.bytes += size(&request.parcel);
        self.of_peer.entry(peer).or_default().insert(question);
        let pending = Pending {
            request,
            user,
            label,
            asked,
            whom,
            until,
            channel,
            behind: VecDeque::new(),
        };
        self.pending.insert(question, pending);
        None
    }

    /// Checks that one request more of a peer may wait.
    fn check_waiting(&self, peer: PeerId, user: &Arc<str>) -> Result<(), WireError> {
        let own = self.waiting_of(peer);
        let all = self.of_user.get(user).copied().unwrap_or_default();
        let text = if own.questions >= MOST_OF_ONE || own.bytes >= MOST_BYTES {
            "too many requests of this peer are waiting for an answer".to_owned()
        } else if all.questions >= MOST_OF_USER || all.bytes >= MOST_BYTES_OF_USER {
            format!("too many requests of {user}'s peers are waiting for an answer")
        } else {
            return Ok(());
        };
        Err(WireError::new(Code::TRY_LATER, text))
    }

    /// How much of a peer waits.
    fn waiting_of(&self, peer: PeerId) -> Waiting {
        let own = self.own(peer);
        own.fold(Waiting::default(), |waiting, (_, pending)| Waiting {
            questions: waiting.questions + 1,
            bytes: waiting.bytes + pending.bytes(),
        })
    }

    /// The questions of a peer: a few.
    fn own(&self, peer: PeerId) -> impl Iterator<Item = (u64, &Pending)> {
        let own = self.of_peer.get(&peer).into_iter().flatten();
        own.filter_map(|question| Some((*question, self.pending.get(question)?)))
    }

    /// The one of a peer that is a send to this channel.
    fn send_of(&self, peer: PeerId, channel: ContextNumber) -> Option<u64> {
        let mut own = self.own(peer);
        own.find_map(|(question, pending)| (pending.channel == Some(channel)).then_some(question))
    }

    /// Asserts that what waits is counted right.
    pub(crate) fn check(&self) {
        let mut of_user: BTreeMap<Arc<str>, Waiting> = BTreeMap::new();
        for (question, pending) in &self.pending {
            let own = self.of_peer.get(&pending.request.peer);
            assert!(own.is_some_and(|own| own.contains(question)), "found by its peer");
            let waiting = of_user.entry(Arc::clone(&pending.user)).or_default();
            waiting.questions += 1;
            waiting.bytes += pending.bytes();
        }
        assert_eq!(of_user, self.of_user, "what waits of each user");
        let own = self.of_peer.values().map(BTreeSet::len);
        assert_eq!(own.sum::<usize>(), self.pending.len(), "no more by peer");
    }

    /// Takes the answer of a peer to a question, and returns the requests that are due with it; none if the peer was
    /// not asked, or is not any more.
    pub(crate) fn answer(
        &mut self,
        world: &mut World,
        question: u64,
        (given, by): (GivenAnswer, PeerId),
        out: &mut Vec<Effect>,
    ) -> Option<Vec<Due>> {
        let asked = self.pending.get(&question)?;
        // A chair may have left the room since it was asked, or been put out of it.
        if !asked.asked.contains(&by) || !asked.whom.find(world).contains(&by) {
            return None;
        }
        let pending = self.take(world, question)?;
        let label = Arc::clone(&pending.label);
        Some(finish(world, pending, GivenAnswer { label, ..given }, out))
    }

    /// Ends a question that nobody has answered in time, and returns the requests that are due with that.
    pub(crate) fn unanswered(&mut self, world: &mut World, question: u64, out: &mut Vec<Effect>) -> Vec<Due> {
        // Another request may have ended it meanwhile.
        let Some(pending) = self.take(world, question) else {
            return Vec::new();
        };
        let given = unanswered(Arc::clone(&pending.label), "");
        finish(world, pending, given, out)
    }

    fn take(&mut self, world: &mut World, question: u64) -> Option<Pending> {
        let pending = self.pending.remove(&question)?;
        world.timers.remove(&(pending.until, Timer::Answer(question)));
        let peer = pending.request.peer;
        if let Some(own) = self.of_peer.get_mut(&peer) {
            own.remove(&question);
            if own.is_empty() {
                self.of_peer.remove(&peer);
            }
        }
        if let Some(waiting) = self.of_user.get_mut(&pending.user) {
            waiting.questions = waiting.questions.saturating_sub(1);
            waiting.bytes = waiting.bytes.saturating_sub(pending.bytes());
            if waiting.questions == 0 {
                self.of_user.remove(&pending.user);
            }
        }
        Some(pending)
    }

    /// Whether an earlier send of this peer to this channel waits for an answer.
    pub(crate) fn waits_behind(&self, peer: PeerId, channel: ContextNumber) -> bool {
        self.send_of(peer, channel).is_some()
    }

    /// Lets a send wait behind that one.
    ///
    /// # Errors
    /// `try-later` if too many wait there already.
    pub(crate) fn wait_behind(
        &mut self,
        world: &World,
        (peer, channel): (PeerId, ContextNumber),
        parcel: &mut Parcel,
    ) -> Result<(), WireError> {
        let bytes = self.waiting_of(peer).bytes;
        let first = self.send_of(peer, channel);
        let Some(pending) = first.and_then(|question| self.pending.get_mut(&question)) else {
            return Err(world.faulted("queuing a send behind one that is not waiting"));
        };
        let user = self.of_user.entry(Arc::clone(&pending.user)).or_default();
        if pending.behind.len() >= MOST_SENDS || bytes >= MOST_BYTES || user.bytes >= MOST_BYTES_OF_USER {
            let text = "an earlier message to this channel is still waiting for its manager";
            return Err(WireError::new(Code::TRY_LATER, text));
        }
        user.bytes += size(parcel);
        pending.behind.push_back(take_parcel(parcel));
        Ok(())
    }

    /// The questions about messages of a peer.
    pub(crate) fn sends_of(&self, peer: PeerId) -> Vec<u64> {
        let sends = self.own(peer).filter(|(_, pending)| pending.channel.is_some());
        sends.map(|(question, _)| question).collect()
    }

    /// Takes back the question about a message; gives it and those behind it.
    pub(crate) fn withdraw_send(&mut self, world: &mut World, question: u64) -> Vec<Due> {
        let Some(pending) = self.take(world, question) else {
            return Vec::new();
        };
        let peer = pending.request.peer;
        if let Some(channel) = pending.channel {
            hold_sends(world, channel, peer, false);
        }
        let behind = pending.behind.into_iter().map(|parcel| Due::new(peer, parcel));
        std::iter::once(pending.request).chain(behind).collect()
    }

    /// Refuses the waiting requests of a peer that goes: its connection may be another user's next.
    pub(crate) fn refuse_all_of(&mut self, world: &mut World, peer: PeerId, out: &mut Vec<Effect>) {
        let own = self.of_peer.get(&peer).into_iter().flatten();
        let own: Vec<u64> = own.copied().collect();
        let error = WireError::new(Code::WITHDRAWN, "the requester left before it was answered");
        for question in own {
            let Some(pending) = self.take(world, question) else {
                continue;
            };
            pending.request.refuse(world, (&error, None), out);
            for parcel in &pending.behind {
                world.push_refusal(peer, parcel, &error, out);
            }
        }
    }

    /// Takes a peer that is gone out of all questions, and returns those that nobody is left to answer.
    pub(crate) fn left_by(&mut self, peer: PeerId) -> Vec<u64> {
        let mut alone = Vec::new();
        for (question, pending) in &mut self.pending {
            if pending.asked.remove(&peer) && pending.asked.is_empty() {
                alone.push(*question);
            }
        }
        alone
    }
}

impl Pending {
    fn bytes(&self) -> usize {
        let behind: usize = self.behind.iter().map(size).sum();
        size(&self.request.parcel) + behind
    }
}

/// What a request that waits takes, without the bytes that every parcel takes.
fn size(parcel: &Parcel) -> usize {
    parcel.size() + parcel.context.as_ref().map_or(0, |path| path.as_str().len())
}

/// The requests that are due once a question has its answer: its own, then the sends behind it in their order.
fn finish(world: &mut World, pending: Pending, given: GivenAnswer, out: &mut Vec<Effect>) -> Vec<Due> {
    let Pending {
        request,
        channel,
        behind,
        whom,
        ..
    } = pending;
    let peer = request.peer;
    if let Some(channel) = channel {
        hold_sends(world, channel, peer, false);
    }
    let first = if channel.is_some() && given.by.is_none() && !given.allow {
        let text = "this channel's manager did not answer in time";
        let error = WireError::new(Code::TRY_LATER, text).rule(&given.label);
        world.push_refusal(peer, &request.parcel, &error, out);
        None
    } else {
        resume(world, request, whom.heard(given), out)
    };
    let behind = behind.into_iter().map(|parcel| Due::new(peer, parcel));
    first.into_iter().chain(behind).collect()
}

/// A request with one answer more; refused if the manager defers again and again although it has its answers.
fn resume(world: &mut World, mut request: Due, heard: Heard, out: &mut Vec<Effect>) -> Option<Due> {
    // Those about a token that was granted since hold no more.
    request
        .answers
        .retain(|known| known.grants == world.grants_at(known.at));
    if request.answers.len() >= MOST_OF_ONE {
        let error = WireError::new(Code::DENIED, "the manager keeps asking and does not decide")
            .rule(&heard.given.label);
        request.refuse(world, (&error, None), out);
        return None;
    }
    request.answers.push(heard);
    Some(request)
}

fn push_consult(
    world: &World,
    question: u64,
    deferred: &Deferred,
    until: Micros,
    asked: &BTreeSet<PeerId>,
    out: &mut Vec<Effect>,
) {
    let Some(facts) = world.peers.get(deferred.peer).map(|peer| &peer.facts) else {
        return world.fault("asking a manager about a peer that does not exist");
    };
    let mut content = Map::new().with("verb", deferred.verb.word());
    for (key, value) in peer_map(facts) {
        content.set(&key, value);
    }
    let groups = facts.groups.iter().map(|group| Value::from(group.as_str()));
    content.set("groups", groups.collect::<Vec<_>>());
    if let Some(message) = &deferred.message {
        content.set("message", message.as_str());
        content.set("size", count(deferred.size));
        if let Some((age, error)) = deferred.age {
            content.set("age", age);
            content.set("age-error", number(error));
        }
    }
    content.set("kind", deferred.kind);
    content.set("within", world.millis_until(until));
    content.set("rule", &*deferred.rule);
    let mut parcel = world.hub_parcel(Family::Manager, "consult", &deferred.path);
    parcel.id = Some(question);
    out.push(Effect::Deliver {
        to: asked.iter().copied().collect(),
        parcel: Arc::new(parcel.content(content)),
    });
}

/// Lets all sends of a peer to a channel come to the hub, or not any more.
fn hold_sends(world: &mut World, channel: ContextNumber, peer: PeerId, held: bool) {
    let context = world.tree.get_mut(channel);
    let member = context.and_then(|context| context.members.get_mut(&peer));
    // It may have left the channel, or the channel may have been deleted, before the answer came.
    if let Some(member) = member {
        *member = Arc::new(member.holding(held));
        world.changed.insert(channel);
    }
}

impl Whom {
    /// The peers that may answer now.
    fn find(&self, world: &World) -> BTreeSet<PeerId> {
        match &self.ask {
            Ask::Creator => {
                let creator = world.tree.get(self.managing).and_then(|context| context.creator);
                creator
                    .into_iter()
                    .filter(|creator| world.peers.get(*creator).is_some())
                    .collect()
            }
            ask @ Ask::Chairs { .. } => {
                // The context may have been deleted since.
                let Some(at) = world.tree.get(self.at) else {
                    return BTreeSet::new();
                };
                let parent = at.parent.and_then(|parent| world.tree.get(parent));
                let members = at
                    .members
                    .values()
                    .chain(parent.into_iter().flat_map(|parent| parent.members.values()));
                let chairs = members.filter(|member| member.peer != self.peer && ask.is_chair(&member.facts));
                chairs.map(|member| member.peer).collect()
            }
        }
    }

    fn heard(&self, given: GivenAnswer) -> Heard {
        Heard {
            peer: self.peer,
            verb: self.verb,
            at: self.at,
            grants: self.grants,
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
