//! Offers and requests to the owner, from their beginning to their end.

use mom_proto::event;
use mom_proto::{Code, ContextNumber, Map, Verb, WireError};

use super::describe::set_given;
use crate::token::state::{Asked, Asking, Offer};
use crate::world::events::peer_map;
use crate::world::{Timer, World};
use crate::{Effect, PeerId};

impl World {
    /// Checks that the same peer was not offered the token, or asked for it, by the same one too often.
    ///
    /// # Errors
    /// `try-later`, with the time until then.
    pub(crate) fn check_again(&self, number: ContextNumber, asked: Asked) -> Result<(), WireError> {
        let (_, _, to) = asked;
        match self.token(number) {
            Some(token) => token.check_again(asked, &self.name_of(to), self.now),
            None => Err(self.faulted("handing over a token that does not exist")),
        }
    }

    pub(crate) fn forget_asked(&mut self, number: ContextNumber, asked: Asked) {
        match self.token_mut(number) {
            Some(token) => token.forget_asked(asked),
            None => self.fault("reporting the hand-over of a token that does not exist"),
        }
    }

    /// Shows an offer to its receiver and to the owner.
    pub(crate) fn push_offer(&mut self, number: ContextNumber, offer: Offer, out: &mut Vec<Effect>) {
        self.end_offer(number, "withdrawn", out);
        let (owner, to, until) = (offer.by, offer.to, offer.until);
        let mut content = Map::new()
            .with("by", self.name_of(owner))
            .with("to", self.name_of(to))
            .with("within", self.millis_until(until));
        if let Some(level) = self.level_of(owner) {
            content.set("level", level);
        }
        set_given(&mut content, &offer);
        let now = self.now;
        let Some(context) = self.tree.get_mut(number) else {
            return self.fault("offering a token that does not exist");
        };
        let path = context.path.clone();
        let Some(token) = context.token_mut() else {
            return self.fault("offering a context that is not a token");
        };
        token.note_asked((Verb::Give, owner, to), now);
        content.set("fence", token.fence);
        token.offer = Some(offer);
        self.timers.insert((until, Timer::Offer(number)));
        self.involve(to, number);
        self.push_event(event::OFFER, &path, vec![owner, to], content, out);
    }

    /// Takes an offer away, if there is one.
    pub(crate) fn take_offer(&mut self, number: ContextNumber) -> Option<Offer> {
        let offer = self.token_mut(number)?.offer.take()?;
        self.timers.remove(&(offer.until, Timer::Offer(number)));
        self.uninvolve(offer.to, number);
        Some(offer)
    }

    /// Ends an offer that was not accepted, if there is one, and tells both sides.
    pub(crate) fn end_offer(&mut self, number: ContextNumber, reason: &str, out: &mut Vec<Effect>) {
        if let Some(offer) = self.take_offer(number) {
            // Not the owner of now: that may be another one already.
            self.push_lapsed(number, "offer", (offer.by, offer.to), reason, out);
        }
    }

    /// Tells both sides that an offer or a request is over.
    pub(super) fn push_lapsed(
        &self,
        number: ContextNumber,
        what: &str,
        (by, to): (PeerId, PeerId),
        reason: &str,
        out: &mut Vec<Effect>,
    ) {
        let Some(context) = self.tree.get(number) else {
            return self.fault("a lapse of an offer or request of a token that does not exist");
        };
        let content = Map::new()
            .with("what", what)
            .with("by", self.name_of(by))
            .with("to", self.name_of(to))
            .with("reason", reason);
        let told = [by, to].into_iter();
        let told = told.filter(|peer| self.peers.get(*peer).is_some()).collect();
        self.push_event(event::LAPSED, &context.path, told, content, out);
    }

    /// Shows a request to the owner and to the peer that asks.
    pub(crate) fn push_requested(
        &mut self,
        number: ContextNumber,
        asking: Asking,
        text: Option<&str>,
        out: &mut Vec<Effect>,
    ) {
        let (peer, owner) = (asking.peer, asking.owner);
        let (ticket, until) = (asking.ticket, asking.until);
        let now = self.now;
        let mut content = match self.peers.get(peer) {
            Some(known) => peer_map(&known.facts),
            None => return self.fault("a request for a token by a peer that does not exist"),
        };
        content.set("within", self.millis_until(until));
        if let Some(text) = text {
            content.set("text", text);
        }
        let Some(context) = self.tree.get_mut(number) else {
            return self.fault("requesting a token that does not exist");
        };
        let path = context.path.clone();
        let Some(token) = context.token_mut() else {
            return self.fault("requesting a context that is not a token");
        };
        token.asking.push(asking);
        token.note_asked((Verb::Request, peer, owner), now);
        self.timers.insert((until, Timer::Request(number, ticket)));
        self.involve(peer, number);
        self.push_event(event::REQUESTED, &path, vec![owner, peer], content, out);
    }

    /// Takes a request to the owner away, if the peer has made one.
    pub(crate) fn take_asking(&mut self, number: ContextNumber, peer: PeerId) -> Option<Asking> {
        let asking = self.token_mut(number)?.take_asking(peer)?;
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
        if let Some(asking) = self.take_asking(number, peer) {
            if let Some(reason) = reason {
                self.push_lapsed(number, "request", (peer, asking.owner), reason, out);
            }
            self.refuse_all(&[(asking.peer, asking.id)], error, Verb::Request, number, out);
        }
    }

    /// Ends a request that the owner did not answer in time.
    pub(crate) fn end_asked(&mut self, number: ContextNumber, ticket: u64, out: &mut Vec<Effect>) {
        let asking = self
            .token(number)
            .and_then(|token| token.asking.iter().find(|asking| asking.ticket == ticket));
        let Some(peer) = asking.map(|asking| asking.peer) else {
            return self.fault("ending a request that was not made");
        };
        let mut error = self.held(peer, number);
        error.code = Code::TIMED_OUT;
        error.text = format!("the owner did not answer in time; {}", error.text);
        self.end_asking(number, peer, &error, Some("timed-out"), out);
    }

    /// Ends the offers and requests of an ownership that is over, and the waiting of the new owner.
    pub(crate) fn end_handover(&mut self, number: ContextNumber, new: Option<PeerId>, out: &mut Vec<Effect>) {
        self.end_offer(number, "lost", out);
        self.call_off_agreed(number, out);
        let Some(context) = self.tree.get(number) else {
            return self.fault("a token that does not exist has lost its owner");
        };
        let text = format!(
            "the owner that this peer asked has lost {}; grab it, or ask again",
            context.path
        );
        let error = WireError::new(Code::WITHDRAWN, text);
        let asking = context.token().into_iter().flat_map(|token| &token.asking);
        let asking: Vec<PeerId> = asking.map(|asking| asking.peer).collect();
        for peer in asking {
            if Some(peer) == new {
                if let Some(asking) = self.take_asking(number, peer) {
                    self.answer_granted(number, peer, asking.id, out);
                }
                continue;
            }
            self.end_asking(number, peer, &error, Some("lost"), out);
        }
        // The owner waits no more.
        let waiting = self.token(number).zip(new);
        let waiting = waiting.and_then(|(token, new)| token.ticket_of(new));
        if let Some(waiter) = waiting.and_then(|ticket| self.take_waiter(number, ticket)) {
            self.answer_granted(number, waiter.peer, waiter.id, out);
            self.tell_queue(number, out);
        }
    }

    /// Ends all that a peer has to do with a token besides owning it.
    pub(crate) fn end_involvement(
        &mut self,
        number: ContextNumber,
        peer: PeerId,
        reason: &str,
        out: &mut Vec<Effect>,
    ) {
        let Some(context) = self.tree.get(number) else {
            return self.fault("queuing a peer for a token that does not exist");
        };
        let text = format!("this peer has left where {} is", context.path);
        let error = WireError::new(Code::NOT_MEMBER, text);
        self.withdraw(number, peer, &error, out);
        self.end_asking(number, peer, &error, Some("left"), out);
        let offered = self.token(number).and_then(|token| token.offer.as_ref());
        if offered.is_some_and(|offer| offer.to == peer) {
            self.end_offer(number, "left", out);
        }
        self.uninhibit(number, peer, reason, out);
        // What was lent is not returned to a peer that has left, nor to another user on its connection.
        if self
            .token_mut(number)
            .is_some_and(|token| token.forget_giver(peer))
        {
            // They show the level with which the token is defended.
            self.change_guarded_routes(number);
        }
        self.call_off_for(number, peer, &error, "left", out);
        let left = self.token_mut(number).map(|token| token.take_held_back_of(peer));
        for held in left.unwrap_or_default() {
            self.push_refusal(peer, &held.parcel, &error, out);
        }
        self.uninvolve(peer, number);
    }
}
