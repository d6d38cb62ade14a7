//! A grant, from its decision to its effect: it is durable before anybody hears of it (design §4, §6).
//!
//! `hand` begins a change of owner. Where the hub has a store and the record of the token does not name the new
//! owner yet, the change waits for it, and with it all requests on that token; other tokens do not. `settle` carries it out.

use std::sync::Arc;

use mom_managers::Micros;
use mom_proto::event::Reason;
use mom_proto::{Code, ContextNumber, Family, Parcel, Path, Verb, WireError};

use crate::ownership::change::Grantee;
use crate::token::state::{Delegation, Reserved, Token};
use crate::{Effect, Holder, Hub, PeerId, Record, Ticket};

/// What rests after a restart where a token has no lease, µs: as long as a lost peer may go unnoticed.
const REST: Micros = 30_000_000;

/// A change of owner that was decided.
#[derive(Clone, Debug)]
pub(crate) struct Change {
    pub(crate) to: PeerId,
    /// Why the present owner loses the token, if there is one.
    pub(crate) reason: Reason,
    /// Only if this peer is still the owner.
    pub(crate) from: Option<PeerId>,
    /// When the ownership ends, whatever its lease.
    pub(crate) until: Option<Micros>,
    /// For how long and for how many commands it is given.
    pub(crate) given: Option<(Option<Micros>, Option<u64>)>,
    /// The rule that allowed it.
    pub(crate) rule: Option<Arc<str>>,
    /// When the turn began that it continues; none = a new one.
    pub(crate) turn: Option<Micros>,
    /// The requests that it answers.
    pub(crate) answers: Vec<(PeerId, Option<u64>)>,
}

impl Change {
    /// A grant to a peer.
    pub(crate) fn to(to: PeerId, reason: Reason) -> Change {
        Change {
            to,
            reason,
            from: None,
            until: None,
            given: None,
            rule: None,
            turn: None,
            answers: Vec::new(),
        }
    }
}

/// A change that waits until it is durable.
#[derive(Clone, Debug)]
pub(crate) struct Storing {
    pub(crate) ticket: Ticket,
    /// None: it was called off, but the record may become durable all the same.
    pub(crate) change: Option<Change>,
}

impl Hub {
    /// Begins a change of owner.
    pub(crate) fn hand(&mut self, number: ContextNumber, change: Change, out: &mut Vec<Effect>) {
        let Some(record) = self.needed_record(number, change.to) else {
            self.settle(number, change, out);
            return;
        };
        self.last_ticket += 1;
        let ticket = Ticket(self.last_ticket);
        self.involve(change.to, number);
        if let Some(token) = self.token_mut(number) {
            token.record = Some(record.clone());
            let change = Some(change);
            token.storing = Some(Storing { ticket, change });
        }
        self.storing.insert(ticket, number);
        out.push(Effect::Store {
            record,
            ticket: Some(ticket),
        });
    }

    /// What has to be durable before a grant; none if it is.
    pub(crate) fn needed_record(&self, number: ContextNumber, to: PeerId) -> Option<Record> {
        if !self.settings.durable {
            return None;
        }
        let context = self.tree.get(number)?;
        let token = context.token()?;
        let owner = Some(self.holder(to)?);
        let lease = longest_lease(token);
        let known = token.record.as_ref();
        let covered = known.is_some_and(|known| {
            known.owner == owner
                && known.before.is_none()
                && known.lease == lease
                && token.fence.max(self.fence_floor()) + 1 < known.last_fence()
        });
        if covered {
            return None;
        }
        let before = token.owner.as_ref().and_then(|owner| self.holder(owner.peer));
        Some(Record {
            path: context.path.clone(),
            fence: token.fence.max(self.fence_floor()) + 1,
            before: before.filter(|before| Some(before) != owner.as_ref()),
            owner,
            lease,
        })
    }

    /// Keeps the record of a token near the truth. Nobody waits for that: until it is durable, the older record
    /// only refuses more after a restart.
    pub(crate) fn correct_record(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        if !self.settings.durable {
            return;
        }
        let Some(token) = self.token(number) else { return };
        let owner = token.owner.as_ref().and_then(|owner| self.holder(owner.peer));
        let (fence, lease) = (token.fence, longest_lease(token));
        let Some(token) = self.token_mut(number) else {
            return;
        };
        let Some(known) = token.record.as_mut().filter(|_| token.storing.is_none()) else {
            return;
        };
        // A free token's lease says nothing any more.
        let lease = if owner.is_some() { lease } else { Some(0) };
        if known.owner == owner && known.before.is_none() && known.lease == lease {
            return;
        }
        *known = Record {
            path: known.path.clone(),
            fence: known.fence.max(fence),
            owner,
            before: None,
            lease,
        };
        let record = known.clone();
        out.push(Effect::Store { record, ticket: None });
    }

    /// A record is durable, or will never be.
    pub(crate) fn handle_stored(&mut self, ticket: Ticket, ok: bool, out: &mut Vec<Effect>) {
        let Some(number) = self.storing.remove(&ticket) else {
            return;
        };
        let Some(token) = self.token_mut(number) else {
            return;
        };
        let Some(Storing { change, .. }) = token.storing.take() else {
            return;
        };
        if let (Some(record), false) = (&mut token.record, ok) {
            // It may be durable all the same, or not: nothing that is covered by it may go unstored again.
            record.lease = Some(0);
        }
        match change {
            Some(change) => {
                self.uninvolve(change.to, number);
                if ok {
                    self.settle(number, change, out);
                } else {
                    let text = "the change of owner could not be made durable, so nothing was changed";
                    let error = WireError::new(Code::STORAGE_FAILED, text);
                    self.call_off(number, &change, &error, Code::STORAGE_FAILED.word(), out);
                }
            }
            None => self.correct_record(number, out),
        }
        // First who has waited, then who came while this was stored.
        self.advance_queue(number, out);
        self.run_held_back(number, out);
    }

    /// Refuses what a change of owner would have answered, and brings its record back to the truth.
    pub(crate) fn call_off(
        &mut self,
        number: ContextNumber,
        change: &Change,
        error: &WireError,
        reason: &str,
        out: &mut Vec<Effect>,
    ) {
        if let (Some(from), Some(_)) = (change.from, change.given) {
            self.push_lapsed(number, "offer", from, change.to, reason, out);
        }
        self.refuse_all(&change.answers, error, Verb::Grab, number, out);
        self.correct_record(number, out);
    }

    /// Calls off a grant to this peer that is being stored.
    pub(crate) fn call_off_for(
        &mut self,
        number: ContextNumber,
        peer: PeerId,
        error: &WireError,
        reason: &str,
        out: &mut Vec<Effect>,
    ) {
        let storing = self.token_mut(number).and_then(|token| token.storing.as_mut());
        let promised =
            storing.filter(|storing| storing.change.as_ref().is_some_and(|change| change.to == peer));
        if let Some(change) = promised.and_then(|storing| storing.change.take()) {
            self.call_off(number, &change, error, reason, out);
            self.uninvolve(peer, number);
        }
    }

    /// Calls off what an owner has agreed to that is not the owner any more.
    pub(crate) fn call_off_agreed(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        let owner = self.owner_of(number);
        let storing = self.token(number).and_then(|token| token.storing.as_ref());
        let change = storing.and_then(|storing| storing.change.as_ref());
        let over = change.filter(|change| change.from.is_some() && change.from != owner);
        let path = self.tree.get(number).map(|context| &context.path);
        if let (Some(to), Some(path)) = (over.map(|change| change.to), path) {
            let error = lost_meanwhile(path);
            self.call_off_for(number, to, &error, "lost", out);
        }
    }

    /// Carries out what waited for a change of the token to be durable.
    fn run_held_back(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        loop {
            let Some(token) = self.token_mut(number).filter(|token| token.storing.is_none()) else {
                return;
            };
            let Some(held) = token.held_back.pop_front() else {
                return;
            };
            self.uninvolve(held.peer, number);
            self.handle_request(held.peer, held.parcel, held.answers, out);
        }
    }

    /// Carries out a change of owner, if its peers are still there.
    fn settle(&mut self, number: ContextNumber, change: Change, out: &mut Vec<Effect>) {
        let Some(context) = self.tree.get(number) else {
            return;
        };
        let (path, parent) = (context.path.clone(), context.parent);
        let there = parent.is_some_and(|parent| self.is_member(change.to, parent));
        let token = context.token();
        let owner = token
            .and_then(|token| token.owner.as_ref())
            .map(|owner| owner.peer);
        let inhibited = token.is_some_and(|token| !token.holders.is_empty());
        let moved = change.from.is_some() && change.from != owner;
        if !there || moved || inhibited {
            let error = match moved {
                true => lost_meanwhile(&path),
                false => WireError::new(Code::NOT_MEMBER, format!("{path} was left before it was granted")),
            };
            self.call_off(number, &change, &error, "left", out);
            return;
        }
        let delegation = change
            .given
            .filter(|(time, commands)| time.is_some() || commands.is_some());
        let delegation = delegation.zip(owner).map(|((time, commands), from)| Delegation {
            from: Some(from),
            giver_until: token.and_then(|token| token.owner.as_ref()?.until),
            until: time.map(|time| self.now.saturating_add(time)),
            commands,
            return_at: None,
        });
        let grantee = Grantee {
            peer: change.to,
            until: change.until,
            delegation,
            rule: change.rule,
            turn: match change.reason {
                Reason::Given => token
                    .and_then(|token| token.owner.as_ref())
                    .map(|owner| owner.turn),
                _ => change.turn,
            },
        };
        let agreed = change.reason == Reason::Given;
        self.change_owner(number, Some(grantee), change.reason, Some(change.to), agreed, out);
        self.answer_grant(number, &path, &change.answers, out);
        self.correct_record(number, out);
        self.told_places(number, out);
    }

    fn answer_grant(
        &mut self,
        number: ContextNumber,
        path: &Path,
        answers: &[(PeerId, Option<u64>)],
        out: &mut Vec<Effect>,
    ) {
        for (peer, id) in answers {
            let content = self.granted(number);
            self.push_ok(*peer, *id, path, Some(content), out);
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

    /// A user under a nickname.
    fn holder(&self, peer: PeerId) -> Option<Holder> {
        self.peers.get(peer).map(|peer| Holder {
            user: peer.facts.user.to_string(),
            name: peer.facts.name.to_string(),
        })
    }

    /// Whether a restart keeps this peer from the token.
    pub(crate) fn kept_by_restart(&self, token: &Token, peer: PeerId) -> Option<Micros> {
        let reserved = token
            .reserved
            .as_ref()
            .filter(|reserved| self.now < reserved.until)?;
        let same = reserved.holder.is_some() && reserved.holder == self.holder(peer);
        (!same).then_some(reserved.until)
    }

    /// Frees a token that was kept for its owner of before a restart, also for the next one.
    pub(crate) fn end_reservation(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        if let Some(token) = self.token_mut(number) {
            token.reserved = None;
        }
        self.correct_record(number, out);
        self.advance_queue(number, out);
    }

    /// What a token begins with, by the record of before the start.
    pub(crate) fn restore(&mut self, path: &Path, token: &mut Token) {
        token.fence = self.deleted_fence;
        let Some(record) = self.records.remove(path) else {
            return;
        };
        // Numbers that the record covered may have been given out: epochs are further apart, unless clocks were set back.
        let covered = record.last_fence();
        let highest = if covered > self.fence_floor() {
            covered
        } else {
            record.fence
        };
        token.fence = token.fence.max(highest);
        if record.owner.is_some() || record.before.is_some() {
            token.reserved = Some(Reserved {
                holder: record.owner.clone().filter(|_| record.before.is_none()),
                // Or that of today: a longer one may have been given before it was in the record.
                // From the start on, also for a token that is made later.
                until: longer(record.lease, token.terms.lease).unwrap_or(REST),
            });
        }
        token.record = Some(record);
    }
}

fn lost_meanwhile(path: &Path) -> WireError {
    WireError::new(Code::NO_OFFER, format!("who gave {path} has lost it meanwhile"))
}

/// The longest lease that the owner of a token has, or the next one will have.
fn longest_lease(token: &Token) -> Option<Micros> {
    match &token.owner {
        Some(owner) => longer(owner.lease, token.terms.lease),
        None => token.terms.lease,
    }
}

/// The lease after which more time must have passed; where there is none, that is [`REST`].
fn longer(one: Option<Micros>, other: Option<Micros>) -> Option<Micros> {
    match (one, other) {
        (None, None) => None,
        (one, other) => one.unwrap_or(REST).max(other.unwrap_or(REST)).into(),
    }
}
