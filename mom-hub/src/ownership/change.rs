//! The one way in which a token gains, changes or loses its owner (design §6).

use mom_proto::event::Reason;
use mom_proto::{ContextNumber, Verb};

use super::news::{Ended, push_grabbed, push_released};
use super::safe::push_safe_state;
use crate::token::grant::{Former, Grantee};
use crate::token::state::{Change, Token};
use crate::world::World;
use crate::{Effect, PeerId};

impl World {
    /// Ends the ownership of a token, if there is one. A token that was given for a time returns to its giver; any other
    /// goes to the next of the queue.
    pub(crate) fn lose(
        &mut self,
        number: ContextNumber,
        reason: Reason,
        by: Option<PeerId>,
        out: &mut Vec<Effect>,
    ) {
        let Some(token) = self.token(number) else {
            return self.fault("ending the ownership of a token that does not exist");
        };
        let Some(ending) = token.ending(reason, self.now) else {
            return;
        };
        let giver = ending.giver;
        let giver = giver.filter(|giver| !self.refused(*giver, Verb::Renew, number));
        // Where the return has to be stored first, or there is nobody to return to, nobody has the device in hand.
        let at_once = giver.is_some_and(|giver| {
            self.needed_record(number, giver).is_none() && self.lost_until(giver).is_none()
        });
        let agreed = ending.reason == Reason::Returned && by.is_some() && at_once;
        self.change_owner(number, None, ending.reason, by, agreed, out);
        match giver {
            Some(giver) if self.token(number).is_some_and(Token::is_free) => {
                let change = Change {
                    turn: Some(ending.turn),
                    until: ending.until,
                    ..Change::to(giver, Reason::Returned)
                };
                self.begin_grant(number, change, out);
            }
            _ => {
                self.correct_record(number, out);
                self.advance_queue(number, out);
            }
        }
    }

    /// Begins a new lease for the owner, who has shown that it is there.
    pub(crate) fn renew_lease(&mut self, number: ContextNumber) {
        let now = self.now;
        match self.token_mut(number) {
            Some(token) => token.renew(now),
            None => self.fault("renewing the lease of a token that does not exist"),
        }
        self.retime(number);
        // The routes tell refused senders how much of the lease is left.
        self.change_guarded_routes(number);
    }

    /// Ends the ownership of a token whose deadline has come.
    pub(crate) fn end_at_deadline(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        let now = self.now;
        let Some(token) = self.token_mut(number) else {
            return self.fault("a deadline of a token that does not exist");
        };
        token.timer = None;
        let reason = token.reason_at_deadline(now);
        let by = token.waited_for(now).filter(|_| reason == Reason::Expired);
        self.lose(number, reason, by, out);
    }

    /// Makes safe what a token moves whose owner has lost its connection. It stays the owner, but nothing that it has said
    /// so far reaches a device any more.
    pub(crate) fn halt_owned(&mut self, number: ContextNumber, owner: PeerId, out: &mut Vec<Effect>) {
        // It may have been lost, or deleted, since the connection was.
        let ownership = self.token_mut(number).and_then(|token| token.owner.as_mut());
        let Some(ownership) = ownership.filter(|ownership| ownership.peer == owner) else {
            return;
        };
        ownership.halts += 1;
        self.change_guarded_routes(number);
        push_safe_state(self, number, out);
    }

    /// The one place where a token's owner changes. Where that is `agreed`, a token may say that the device stays in hand
    /// until the next owner has it: no safe state.
    pub(crate) fn change_owner(
        &mut self,
        number: ContextNumber,
        to: Option<Grantee>,
        reason: Reason,
        by: Option<PeerId>,
        agreed: bool,
        out: &mut Vec<Effect>,
    ) {
        let (now, floor) = (self.now, self.fence_floor());
        let Some(token) = self.token_mut(number) else {
            return self.fault("changing the owner of a token that does not exist");
        };
        let (new, rule) = match &to {
            Some(grantee) => (Some(grantee.peer), grantee.rule.clone()),
            None => (None, None),
        };
        let former = token.change_owner(to, now, floor);
        if former.is_none() && new.is_none() {
            return;
        }
        self.note_owner(number, former.as_ref(), new);
        self.retime(number);
        self.change_guarded_routes(number);
        if let Some(Former { ownership, fence }) = former {
            // Who has lost its connection has no device in hand.
            let in_hand = agreed && new.is_none_or(|new| self.lost_until(new).is_none());
            if !in_hand || self.token(number).is_some_and(|token| token.safe_on_give) {
                push_safe_state(self, number, out);
            }
            let ended = Ended {
                peer: ownership.peer,
                fence,
                reason,
                by,
            };
            push_released(self, number, &ended, out);
        }
        if let Some(peer) = new {
            self.count_change(peer, number);
            push_grabbed(self, number, peer, reason, rule, out);
        }
        if reason == Reason::Preempted {
            self.forget_offer_count(number);
        }
        self.end_handover(number, new, out);
        self.stir_neighbours(number);
    }

    /// Tells the peers concerned what they own, and what they have lent, from now on.
    fn note_owner(&mut self, number: ContextNumber, former: Option<&Former>, new: Option<PeerId>) {
        let old = former.map(|former| &former.ownership);
        if let Some(old) = old {
            match self.peers.get_mut(old.peer) {
                Some(peer) => {
                    peer.owns.remove(&number);
                }
                None => self.fault("a token's owner does not exist"),
            }
        }
        if let Some(new) = new {
            match self.peers.get_mut(new) {
                Some(peer) => {
                    peer.owns.insert(number);
                }
                None => self.fault("granting a token to a peer that does not exist"),
            }
        }
        let giver = self.token(number).and_then(Token::giver);
        giver.into_iter().for_each(|giver| self.involve(giver, number));
        let lent = old.and_then(|old| old.delegation.as_ref()?.from);
        lent.into_iter().for_each(|giver| self.uninvolve(giver, number));
    }

    /// An owner that lost the token by level could not hear the answer to its offer, so it may offer again.
    fn forget_offer_count(&mut self, number: ContextNumber) {
        let Some(token) = self.token_mut(number) else {
            return self.fault("reporting the grab of a token that does not exist");
        };
        if let Some((by, to)) = token.offer.as_ref().map(|offer| (offer.by, offer.to)) {
            token.forget_asked((Verb::Give, by, to));
        }
    }
}
