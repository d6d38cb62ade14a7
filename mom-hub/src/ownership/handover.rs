//! Handing over by agreement: offers, requests to the owner, and what is shared instead of owned.

use std::time::Duration;

use mom_managers::Micros;
use mom_proto::event;
use mom_proto::{Code, ContextNumber, Map, Value, Verb, WireError};

use crate::hub::Timer;
use crate::ownership::change::{fence_value, millis};
use crate::token::state::{Asking, Offer};
use crate::{Effect, Hub, PeerId};

/// Peers that may ask one owner at a time.
pub(crate) const ASKING: usize = 16;

/// How soon a peer may be invited to the same place again, µs; and in which time it is asked for or offered the same
/// token by the same one [`TIMES`] times at most.
pub(crate) const AGAIN: Micros = 10_000_000;

/// A person that is told no has a word to say to that, and perhaps another one.
const TIMES: u32 = 4;

/// Offers and requests that a token remembers for that; of more the oldest are forgotten.
const REMEMBERED: usize = 256;

impl Hub {
    /// Checks that a peer has not offered the token to this other one, or asked it for it, again and again: each time
    /// both are told, and nobody may fill somebody else's control lane.
    ///
    /// # Errors
    /// `try-later`, with the time until then.
    pub(crate) fn check_again(
        &self,
        number: ContextNumber,
        (verb, from, to): (Verb, PeerId, PeerId),
    ) -> Result<(), WireError> {
        let until = self
            .token(number)
            .and_then(|token| token.asked.get(&(verb, from, to)));
        match until {
            Some((times, until)) if *times >= TIMES => not_again(self.now, *until, &self.name_of(to)),
            _ => Ok(()),
        }
    }

    /// Notes an offer or a request.
    fn note_asked(&mut self, number: ContextNumber, asked: (Verb, PeerId, PeerId)) {
        let (now, until) = (self.now, self.after(AGAIN));
        let Some(token) = self.token_mut(number) else {
            return;
        };
        token.asked.retain(|_, (_, until)| now < *until);
        if let Some((times, _)) = token.asked.get_mut(&asked) {
            *times += 1;
            return;
        }
        if token.asked.len() >= REMEMBERED {
            let first = token.asked.iter().min_by_key(|(_, (_, until))| *until);
            if let Some(first) = first.map(|(asked, _)| *asked) {
                token.asked.remove(&first);
            }
        }
        token.asked.insert(asked, (1, until));
    }

    /// Who has agreed may be asked again, and so may who could not answer because the token was taken away.
    pub(crate) fn forget_asked(&mut self, number: ContextNumber, asked: (Verb, PeerId, PeerId)) {
        if let Some(token) = self.token_mut(number) {
            token.asked.remove(&asked);
        }
    }

    /// Shows an offer to its receiver and to the owner.
    pub(crate) fn push_offer(&mut self, number: ContextNumber, offer: Offer, out: &mut Vec<Effect>) {
        self.end_offer(number, "withdrawn", out);
        let (owner, to, until) = (offer.by, offer.to, offer.until);
        self.note_asked(number, (Verb::Give, owner, to));
        let mut content = Map::new()
            .with("by", self.name_of(owner))
            .with("to", self.name_of(to))
            .with("within", self.millis_until(until));
        if let Some(owner) = self.peers.get(owner) {
            content.set("level", owner.facts.level);
        }
        if let Some(time) = offer.time {
            content.set("for", millis(time));
        }
        if let Some(commands) = offer.commands {
            content.set("commands", fence_value(commands));
        }
        let Some(path) = self.tree.get(number).map(|context| context.path.clone()) else {
            return;
        };
        if let Some(token) = self.token_mut(number) {
            content.set("fence", fence_value(token.fence));
            token.offer = Some(offer);
        }
        self.timers.insert((until, Timer::Offer(number)));
        self.involve(to, number);
        self.push_event(event::OFFER, &path, vec![owner, to], content, out);
    }

    /// Takes an offer away; who had it, if there was one.
    pub(crate) fn take_offer(&mut self, number: ContextNumber) -> Option<Offer> {
        let offer = self.token_mut(number)?.offer.take()?;
        self.timers.remove(&(offer.until, Timer::Offer(number)));
        self.uninvolve(offer.to, number);
        Some(offer)
    }

    /// Ends an offer that was not accepted, and says so to both.
    pub(crate) fn end_offer(&mut self, number: ContextNumber, reason: &str, out: &mut Vec<Effect>) {
        let Some(offer) = self.take_offer(number) else {
            return;
        };
        // Not the owner of now: that may be another one already.
        self.push_lapsed(number, "offer", offer.by, offer.to, reason, out);
    }

    /// Tells both sides that an offer or a request is over.
    pub(crate) fn push_lapsed(
        &self,
        number: ContextNumber,
        what: &str,
        by: PeerId,
        to: PeerId,
        reason: &str,
        out: &mut Vec<Effect>,
    ) {
        let Some(path) = self.tree.get(number).map(|context| context.path.clone()) else {
            return;
        };
        let content = Map::new()
            .with("what", what)
            .with("by", self.name_of(by))
            .with("to", self.name_of(to))
            .with("reason", reason);
        let told = [by, to].into_iter();
        let told = told.filter(|peer| self.peers.get(*peer).is_some()).collect();
        self.push_event(event::LAPSED, &path, told, content, out);
    }

    /// Shows a request to the owner and to who asks.
    pub(crate) fn push_requested(
        &mut self,
        number: ContextNumber,
        asking: Asking,
        text: Option<&str>,
        out: &mut Vec<Effect>,
    ) {
        let (peer, owner) = (asking.peer, asking.owner);
        let (ticket, until) = (asking.ticket, asking.until);
        let Some(path) = self.tree.get(number).map(|context| context.path.clone()) else {
            return;
        };
        let mut content = match self.peers.get(peer) {
            Some(known) => crate::world::events::peer_map(&known.facts),
            None => return,
        };
        content.set("within", self.millis_until(until));
        if let Some(text) = text {
            content.set("text", text);
        }
        if let Some(token) = self.token_mut(number) {
            token.asking.push(asking);
        }
        self.timers.insert((until, Timer::Request(number, ticket)));
        self.note_asked(number, (Verb::Request, peer, owner));
        self.involve(peer, number);
        self.push_event(event::REQUESTED, &path, vec![owner, peer], content, out);
    }

    /// Takes a request to the owner away.
    pub(crate) fn take_asking(&mut self, number: ContextNumber, peer: PeerId) -> Option<Asking> {
        let token = self.token_mut(number)?;
        let place = token.asking.iter().position(|asking| asking.peer == peer)?;
        let asking = token.asking.remove(place);
        self.timers
            .remove(&(asking.until, Timer::Request(number, asking.ticket)));
        self.uninvolve(asking.peer, number);
        Some(asking)
    }

    /// Refuses a request to the owner; `reason` goes to both sides, if it is not the owner's own word.
    pub(crate) fn end_asking(
        &mut self,
        number: ContextNumber,
        peer: PeerId,
        error: &WireError,
        reason: Option<&str>,
        out: &mut Vec<Effect>,
    ) {
        let Some(asking) = self.take_asking(number, peer) else {
            return;
        };
        if let Some(reason) = reason {
            self.push_lapsed(number, "request", peer, asking.owner, reason, out);
        }
        self.refuse_all(&[(asking.peer, asking.id)], error, Verb::Request, number, out);
    }

    /// The owner did not answer in time.
    pub(crate) fn handle_asked(&mut self, number: ContextNumber, ticket: u64, out: &mut Vec<Effect>) {
        let asking = self
            .token(number)
            .and_then(|token| token.asking.iter().find(|asking| asking.ticket == ticket));
        let Some(peer) = asking.map(|asking| asking.peer) else {
            return;
        };
        let mut error = self.held(peer, number);
        error.code = Code::TIMED_OUT;
        error.text = format!("the owner did not answer in time; {}", error.text);
        self.end_asking(number, peer, &error, Some("timed-out"), out);
    }

    /// Ends what was about an ownership that is over: offers, requests, and the waiting of who owns now.
    pub(crate) fn end_handover(&mut self, number: ContextNumber, new: Option<PeerId>, out: &mut Vec<Effect>) {
        self.end_offer(number, "lost", out);
        self.call_off_agreed(number, out);
        let path = self.tree.get(number).map(|context| context.path.to_string());
        let asking: Vec<PeerId> = self
            .token(number)
            .map(|token| token.asking.iter().map(|asking| asking.peer).collect())
            .unwrap_or_default();
        for peer in asking {
            if Some(peer) == new {
                if let Some(asking) = self.take_asking(number, peer) {
                    self.answer_owner(number, peer, asking.id, out);
                }
                continue;
            }
            let text = format!(
                "the owner whom this peer asked has lost {}; grab it, or ask again",
                path.as_deref().unwrap_or_default()
            );
            let error = WireError::new(Code::WITHDRAWN, text);
            self.end_asking(number, peer, &error, Some("lost"), out);
        }
        // Who has it waits no more.
        let waiting = self.token(number).and_then(|token| {
            let waiter = token.queue.iter().find(|waiter| Some(waiter.peer) == new)?;
            Some(waiter.ticket)
        });
        if let Some(waiter) = waiting.and_then(|ticket| self.take_waiter(number, ticket)) {
            self.answer_owner(number, waiter.peer, waiter.id, out);
            self.told_places(number, out);
        }
    }

    fn answer_owner(&mut self, number: ContextNumber, peer: PeerId, id: Option<u64>, out: &mut Vec<Effect>) {
        if let Some(path) = self.tree.get(number).map(|context| context.path.clone()) {
            let content = self.granted(number);
            self.push_ok(peer, id, &path, Some(content), out);
        }
    }

    /// Begins a shared hold.
    pub(crate) fn inhibit(&mut self, number: ContextNumber, peer: PeerId, out: &mut Vec<Effect>) {
        let now = self.now;
        let Some(token) = self.token_mut(number) else {
            return;
        };
        if token.holders.insert(peer, now).is_some() {
            return;
        }
        self.involve(peer, number);
        self.push_shared(number, event::INHIBITED, peer, None, out);
    }

    /// Ends a shared hold; with the last one the next of the queue has the token.
    pub(crate) fn uninhibit(
        &mut self,
        number: ContextNumber,
        peer: PeerId,
        reason: &str,
        out: &mut Vec<Effect>,
    ) -> bool {
        let ended = self.end_hold(number, peer, reason, out);
        if ended {
            self.advance_queue(number, out);
        }
        ended
    }

    /// Ends a shared hold, and leaves to the caller who is next.
    pub(crate) fn end_hold(
        &mut self,
        number: ContextNumber,
        peer: PeerId,
        reason: &str,
        out: &mut Vec<Effect>,
    ) -> bool {
        let removed = self
            .token_mut(number)
            .and_then(|token| token.holders.remove(&peer));
        if removed.is_none() {
            return false;
        }
        self.uninvolve(peer, number);
        self.push_shared(number, event::UNINHIBITED, peer, Some(reason), out);
        true
    }

    fn push_shared(
        &self,
        number: ContextNumber,
        name: &'static str,
        peer: PeerId,
        reason: Option<&str>,
        out: &mut Vec<Effect>,
    ) {
        let Some(path) = self.tree.get(number).map(|context| context.path.clone()) else {
            return;
        };
        let mut content = Map::new()
            .with("peer", self.name_of(peer))
            .with("holders", self.holders_value(number));
        if let Some(reason) = reason {
            content.set("reason", reason);
        }
        let mut to = self.concerned(number);
        if self.peers.get(peer).is_some() {
            to.insert(peer);
        }
        self.push_event(name, &path, to.into_iter().collect(), content, out);
        self.audit_shared(name, &path, peer, out);
    }

    /// The names of those who hold a token together.
    pub(crate) fn holders_value(&self, number: ContextNumber) -> Vec<Value> {
        let holders = self
            .token(number)
            .into_iter()
            .flat_map(|token| token.holders.keys());
        holders.map(|peer| Value::from(self.name_of(*peer))).collect()
    }

    /// Ends all that a peer has to do with a token besides owning it.
    pub(crate) fn end_involvement(
        &mut self,
        number: ContextNumber,
        peer: PeerId,
        reason: &str,
        out: &mut Vec<Effect>,
    ) {
        let path = self.tree.get(number).map(|context| context.path.to_string());
        let text = format!("this peer has left where {} is", path.unwrap_or_default());
        let error = WireError::new(Code::NOT_MEMBER, text);
        self.withdraw(number, peer, &error, out);
        self.end_asking(number, peer, &error, Some("left"), out);
        let offered = self.token(number).and_then(|token| token.offer.as_ref());
        if offered.is_some_and(|offer| offer.to == peer) {
            self.end_offer(number, "left", out);
        }
        self.uninhibit(number, peer, reason, out);
        self.forget_giver(number, peer);
        self.call_off_for(number, peer, &error, "left", out);
        let Some(token) = self.token_mut(number) else {
            return;
        };
        let (left, kept): (Vec<_>, Vec<_>) = token.held_back.drain(..).partition(|held| held.peer == peer);
        token.held_back = kept.into();
        for held in left {
            self.push_refusal(peer, &held.parcel, &error, out);
        }
        self.uninvolve(peer, number);
    }

    /// What was lent is not returned to who is not there any more, nor to another user on its connection.
    fn forget_giver(&mut self, number: ContextNumber, peer: PeerId) {
        let owner = self.token_mut(number).and_then(|token| token.owner.as_mut());
        let lent = owner.and_then(|owner| owner.delegation.as_mut());
        if let Some(delegation) = lent.filter(|delegation| delegation.from == Some(peer)) {
            delegation.from = None;
            // They show the level with which the token is defended.
            self.change_guarded_routes(number);
        }
    }

    /// Who owns a token.
    pub(crate) fn owner_of(&self, number: ContextNumber) -> Option<PeerId> {
        self.token(number)?.owner.as_ref().map(|owner| owner.peer)
    }

    /// Notes that a peer has something to do with a token, so that its end is not forgotten.
    pub(crate) fn involve(&mut self, peer: PeerId, number: ContextNumber) {
        if let Some(peer) = self.peers.get_mut(peer) {
            peer.involved.insert(number);
        }
    }

    pub(crate) fn uninvolve(&mut self, peer: PeerId, number: ContextNumber) {
        if self.token(number).is_some_and(|token| token.involves(peer)) {
            return;
        }
        if let Some(peer) = self.peers.get_mut(peer) {
            peer.involved.remove(&number);
        }
    }

    /// The end of a time that begins now.
    pub(crate) fn after(&self, time: Micros) -> Micros {
        self.now.saturating_add(time)
    }
}

/// Refuses what was asked of the same peer a short while ago.
///
/// # Errors
/// `try-later`, with the time until then.
pub(crate) fn not_again(now: Micros, until: Micros, name: &str) -> Result<(), WireError> {
    if now >= until {
        return Ok(());
    }
    let text = format!("{name} was asked the same before, a short while ago");
    Err(WireError::new(Code::TRY_LATER, text)
        .rule("not again and again")
        .retry_after(Duration::from_micros(until - now)))
}
