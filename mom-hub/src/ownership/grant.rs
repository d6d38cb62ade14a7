//! A grant, from its decision to its effect: it is durable before anybody hears of it (design §4, §6).
//!
//! Every grant begins in `begin_grant` and ends in `finish_grant`. Where a record has to be stored first, the end comes
//! with it, and requests on that token wait in between; other tokens do not.

use mom_proto::event::Reason;
use mom_proto::{Code, ContextNumber, Family, Parcel, Path, Verb, WireError};

use super::describe::granted;
use crate::token::grant::Overtaken;
use crate::token::state::{Change, Granting};
use crate::world::World;
use crate::{Effect, PeerId, Record, Ticket};

impl World {
    /// Begins a change of owner.
    pub(crate) fn begin_grant(&mut self, number: ContextNumber, change: Change, out: &mut Vec<Effect>) {
        let record = self.needed_record(number, change.to);
        let ticket = record.as_ref().map(|_| {
            self.last_ticket += 1;
            Ticket(self.last_ticket)
        });
        let Some(token) = self.tree.token_mut(number) else {
            return self.fault("beginning a grant of a token that does not exist");
        };
        debug_assert!(token.granting.is_none(), "one grant at a time");
        let to = change.to;
        token.granting = Some(Granting {
            ticket,
            change: Some(change),
        });
        match record {
            None => self.finish_grant(number, true, out),
            Some(record) => {
                token.record = Some(record.clone());
                self.involve(to, number);
                self.storing.extend(ticket.map(|ticket| (ticket, number)));
                out.push(Effect::Store { record, ticket });
            }
        }
    }

    /// Ends a change of owner: carries it out if what had to be stored is durable and its peers are still there, else
    /// calls it off.
    fn finish_grant(&mut self, number: ContextNumber, durable: bool, out: &mut Vec<Effect>) {
        let Some(token) = self.tree.token_mut(number) else {
            return self.fault("ending a grant of a token that does not exist");
        };
        let Some(Granting { ticket, change }) = token.granting.take() else {
            return self.fault("ending a grant that was not begun");
        };
        if !durable {
            token.doubt_record();
        }
        let Some(change) = change else {
            return self.correct_record(number, out);
        };
        if ticket.is_some() {
            self.uninvolve(change.to, number);
        }
        if !durable {
            let text = "the change of owner could not be stored, so nothing was changed";
            let error = WireError::new(Code::STORAGE_FAILED, text);
            return self.call_off(number, &change, &error, Code::STORAGE_FAILED.word(), out);
        }
        if let Some(error) = self.obstacle(number, &change) {
            return self.call_off(number, &change, &error, "left", out);
        }
        self.carry_out(number, change, out);
    }

    /// Why a change cannot be carried out any more.
    fn obstacle(&self, number: ContextNumber, change: &Change) -> Option<WireError> {
        let context = self.tree.get(number)?;
        let overtaken = context.token()?.overtaken(change);
        let there = context
            .parent
            .is_some_and(|parent| self.tree.is_member(change.to, parent));
        match overtaken {
            Some(Overtaken::Moved) => Some(lost_meanwhile(&context.path)),
            None if there => None,
            _ => {
                let text = format!("{} was left before it was granted", context.path);
                Some(WireError::new(Code::NOT_MEMBER, text))
            }
        }
    }

    fn carry_out(&mut self, number: ContextNumber, change: Change, out: &mut Vec<Effect>) {
        let Some(token) = self.token(number) else {
            return self.fault("completing a grant of a token that does not exist");
        };
        let grantee = token.grantee(&change, self.now);
        let agreed = change.reason == Reason::Given;
        self.change_owner(number, Some(grantee), change.reason, Some(change.to), agreed, out);
        for (peer, id) in change.answers {
            self.answer_granted(number, peer, id, out);
        }
        self.correct_record(number, out);
        self.tell_queue(number, out);
    }

    /// Answers a request that has led to ownership.
    pub(super) fn answer_granted(
        &self,
        number: ContextNumber,
        peer: PeerId,
        id: Option<u64>,
        out: &mut Vec<Effect>,
    ) {
        match self.tree.get(number) {
            Some(context) => self.push_ok(peer, id, &context.path, Some(granted(self, number)), out),
            None => self.fault("answering a grant of a token that does not exist"),
        }
    }

    /// The record that has to be durable before a grant; none if nothing has to be stored.
    pub(super) fn needed_record(&self, number: ContextNumber, to: PeerId) -> Option<Record> {
        if !self.settings.durable {
            return None;
        }
        let context = self.tree.get(number)?;
        let token = context.token()?;
        let before = token.owner_peer().and_then(|owner| self.holder(owner));
        // A peer that is gone is not granted anything, so nothing needs to be stored.
        token.needed_record(&context.path, self.holder(to)?, before, self.fence_floor())
    }

    /// Keeps the record of a token near the truth.
    pub(crate) fn correct_record(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        if !self.settings.durable {
            return;
        }
        let owner = self.owner_of(number).and_then(|owner| self.holder(owner));
        let Some(token) = self.token_mut(number) else {
            return self.fault("correcting the record of a token that does not exist");
        };
        if let Some(record) = token.correct_record(owner) {
            out.push(Effect::Store { record, ticket: None });
        }
    }

    /// Ends the grant whose record is durable, or will never be; returns its token.
    pub(crate) fn take_stored(
        &mut self,
        ticket: Ticket,
        durable: bool,
        out: &mut Vec<Effect>,
    ) -> Option<ContextNumber> {
        // None where the token was deleted meanwhile.
        let number = self.storing.remove(&ticket)?;
        self.finish_grant(number, durable, out);
        self.advance_queue(number, out);
        Some(number)
    }

    /// Refuses the requests that a change of owner would have answered, and brings its record back to the truth.
    pub(crate) fn call_off(
        &mut self,
        number: ContextNumber,
        change: &Change,
        error: &WireError,
        reason: &str,
        out: &mut Vec<Effect>,
    ) {
        if let (Some(from), Some(_)) = (change.from, change.given) {
            self.push_lapsed(number, "offer", (from, change.to), reason, out);
        }
        self.refuse_all(&change.answers, error, Verb::Grab, number, out);
        self.correct_record(number, out);
        // Others were refused for it as long as it was being stored.
        self.stir_neighbours(number);
    }

    /// Calls off a grant to this peer that has begun.
    pub(crate) fn call_off_for(
        &mut self,
        number: ContextNumber,
        peer: PeerId,
        error: &WireError,
        reason: &str,
        out: &mut Vec<Effect>,
    ) {
        let token = self.token_mut(number);
        if let Some(change) = token.and_then(|token| token.call_off_for(peer)) {
            self.call_off(number, &change, error, reason, out);
            self.uninvolve(peer, number);
        }
    }

    /// Calls off a grant whose agreeing owner is not the owner any more.
    pub(super) fn call_off_agreed(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        let Some(context) = self.tree.get(number) else {
            return self.fault("cancelling a grant of a token that does not exist");
        };
        let token = context.token();
        let promise = token.and_then(|token| Some((token, token.promise()?)));
        let over = promise.filter(|(token, change)| token.overtaken(change) == Some(Overtaken::Moved));
        if let Some(to) = over.map(|(_, change)| change.to) {
            let error = lost_meanwhile(&context.path);
            self.call_off_for(number, to, &error, "lost", out);
        }
    }

    /// Refuses requests that waited, as far as their peers are still there.
    pub(crate) fn refuse_all(
        &mut self,
        answers: &[(PeerId, Option<u64>)],
        error: &WireError,
        verb: Verb,
        number: ContextNumber,
        out: &mut Vec<Effect>,
    ) {
        let path = self.tree.get(number).map(|context| context.path.clone());
        for (peer, id) in answers.iter().filter(|(peer, _)| self.peers.get(*peer).is_some()) {
            let mut parcel = Parcel::new(Family::Token, verb.word());
            parcel.context.clone_from(&path);
            parcel.id = *id;
            self.push_refusal(*peer, &parcel, error, out);
        }
    }

    /// Ends the time for which only the owner of before a restart may have a token.
    pub(crate) fn end_reservation(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        // Its timer stays behind where the token is deleted before.
        let Some(token) = self.token_mut(number) else {
            return;
        };
        token.reserved = None;
        self.correct_record(number, out);
        self.advance_queue(number, out);
    }

    /// Takes over fence and reservation of before the start into a new token.
    pub(crate) fn restore(&mut self, path: &Path, token: &mut crate::token::state::Token) {
        token.fence = self.deleted_fence;
        let floor = self.fence_floor();
        if let Some(record) = self.records.remove(path) {
            token.restore(record, floor);
        }
    }
}

fn lost_meanwhile(path: &Path) -> WireError {
    WireError::new(
        Code::NO_OFFER,
        format!("the peer that gave {path} has lost it meanwhile"),
    )
}
