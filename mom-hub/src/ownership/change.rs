//! The one way in which a token gains, changes or loses its owner (design §6).
//!
//! The order is always: routes of all guarded channels, safe state, `released`, `grabbed`; the reply is the
//! caller's and comes last.

use std::collections::BTreeSet;
use std::sync::Arc;

use mom_managers::{Expiry, Micros};
use mom_proto::event::{self, Reason};
use mom_proto::{Content, ContextNumber, Family, Map, Path, Value, Verb};

use crate::hub::Timer;
use crate::ownership::grant::Change;
use crate::token::state::{Delegation, Ownership, Token};
use crate::{Effect, Hub, PeerId};

/// Numbers of one epoch; grants beyond run into the next, which is why epochs are seconds apart.
const EPOCH_BITS: u32 = 20;

/// A new owner, and what its ownership depends on.
#[derive(Clone, Debug)]
pub(crate) struct Grantee {
    pub(crate) peer: PeerId,
    /// When it ends, whatever the lease.
    pub(crate) until: Option<Micros>,
    pub(crate) delegation: Option<Delegation>,
    /// The rule that allowed it.
    pub(crate) rule: Option<Arc<str>>,
    /// When the turn began that it continues.
    pub(crate) turn: Option<Micros>,
}

impl Hub {
    /// Ends the ownership of a token, if there is one. What was given for a time returns to its giver; else the
    /// next of the queue has it.
    pub(crate) fn lose(
        &mut self,
        number: ContextNumber,
        reason: Reason,
        by: Option<PeerId>,
        out: &mut Vec<Effect>,
    ) {
        let owner = self.token(number).and_then(|token| token.owner.as_ref());
        let Some(owner) = owner else { return };
        let turn = Some(owner.turn);
        let until = owner.delegation.as_ref().and_then(|lent| lent.giver_until);
        let giver = self.token(number).and_then(Token::giver);
        let returns = !matches!(reason, Reason::Deleted | Reason::Broken | Reason::Preempted);
        // A delegate that gives the token back does what was agreed.
        let reason = match reason {
            Reason::Released if giver.is_some() => Reason::Returned,
            reason => reason,
        };
        // The giver's own right may have ended meanwhile.
        let over = until.is_some_and(|until| self.now >= until);
        let giver = giver.filter(|_| returns && !over);
        let giver = giver.filter(|giver| !self.refused(*giver, Verb::Renew, number));
        // Where the return has to be stored first, or there is nobody to return to, nobody has the device in hand.
        let at_once = giver.is_some_and(|giver| self.needed_record(number, giver).is_none());
        let agreed = reason == Reason::Returned && by.is_some() && at_once;
        self.change_owner(number, None, reason, by, agreed, out);
        match giver {
            Some(giver) if self.token(number).is_some_and(Token::is_free) => {
                let change = Change {
                    turn,
                    until,
                    ..Change::to(giver, Reason::Returned)
                };
                self.hand(number, change, out);
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
        if let Some(token) = self.token_mut(number) {
            let (lease, end) = (token.terms.lease, token.lease_from(now));
            let deadman = token.terms.deadman;
            if let Some(owner) = &mut token.owner {
                owner.lease = lease;
                owner.lease_end = end;
                owner.alive_until = deadman.map(|deadman| now.saturating_add(deadman));
            }
        }
        self.retime(number);
        // The routes tell refused senders how much of the lease is left.
        self.change_guarded_routes(number);
    }

    /// The one place where a token's owner changes. Where that is `agreed`, who has the device in hand keeps it
    /// there until the next one has it: no safe state.
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
        let Some(context) = self.tree.get_mut(number) else {
            return;
        };
        let path = context.path.clone();
        let Some(token) = context.token_mut() else { return };
        let old = token.owner.take();
        let old_fence = token.fence;
        if old.is_none() && to.is_none() {
            return;
        }
        let (new, rule) = match to {
            Some(grantee) => {
                token.fence = (token.fence + 1).max(floor + 1);
                token.reserved = None;
                token.owner = Some(Ownership {
                    peer: grantee.peer,
                    since: now,
                    turn: grantee.turn.unwrap_or(now),
                    lease: token.terms.lease,
                    lease_end: token.lease_from(now),
                    alive_until: token.terms.deadman.map(|deadman| now.saturating_add(deadman)),
                    until: grantee.until,
                    noticed: None,
                    delegation: grantee.delegation,
                });
                (Some(grantee.peer), grantee.rule)
            }
            None => (None, None),
        };
        self.note_owner(number, old.as_ref(), new);
        let giver = self.token(number).and_then(Token::giver);
        giver.into_iter().for_each(|giver| self.involve(giver, number));
        let lent = old.as_ref().and_then(|old| old.delegation.as_ref()?.from);
        lent.into_iter().for_each(|giver| self.uninvolve(giver, number));
        self.retime(number);
        self.change_guarded_routes(number);
        if let Some(old) = old {
            if !agreed || self.token(number).is_some_and(|token| token.safe_on_give) {
                self.push_safe_state(number, out);
            }
            let ended = Ended {
                path: &path,
                peer: old.peer,
                fence: old_fence,
                reason,
                by,
            };
            self.push_released(number, &ended, out);
            self.audit_lost(&ended, out);
        }
        if let Some(peer) = new {
            self.push_grabbed(number, &path, peer, reason == Reason::Returned, out);
            self.audit_granted(number, &path, peer, reason, rule, out);
        }
        let taken = reason == Reason::Preempted;
        let offer = self.token(number).and_then(|token| token.offer.as_ref());
        if let Some((by, to)) = offer.filter(|_| taken).map(|offer| (offer.by, offer.to)) {
            self.forget_asked(number, (Verb::Give, by, to));
        }
        self.end_handover(number, new, out);
    }

    /// The deadline of a token has come.
    pub(crate) fn handle_deadline(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        let now = self.now;
        let Some(token) = self.token_mut(number) else {
            return;
        };
        token.timer = None;
        let over = |at: Option<Micros>| at.is_some_and(|at| now >= at);
        let delegation = token.owner.as_ref().and_then(|owner| owner.delegation.as_ref());
        let returned =
            delegation.is_some_and(|delegation| over(delegation.until) || over(delegation.return_at));
        let reason = match returned {
            true => Reason::Returned,
            false => Reason::Expired,
        };
        self.lose(number, reason, None, out);
    }

    fn note_owner(&mut self, number: ContextNumber, old: Option<&Ownership>, new: Option<PeerId>) {
        if let Some(peer) = old.and_then(|old| self.peers.get_mut(old.peer)) {
            peer.owns.remove(&number);
        }
        if let Some(peer) = new.and_then(|new| self.peers.get_mut(new)) {
            peer.owns.insert(number);
        }
    }

    pub(crate) fn fence_floor(&self) -> u64 {
        (self.settings.epoch << EPOCH_BITS).max(self.deleted_fence)
    }

    fn push_safe_state(&self, number: ContextNumber, out: &mut Vec<Effect>) {
        let guarded = self.token(number).map(|token| token.guarded.clone());
        self.push_safe_state_of(number, &guarded.unwrap_or_default(), out);
    }

    /// Sends the safe state of a channel that is about to go although its token has an owner: no command will reach
    /// its devices any more, not even one to stop what they do.
    pub(crate) fn push_last_safe_state(&self, channel: ContextNumber, out: &mut Vec<Effect>) {
        let guard = self
            .tree
            .get(channel)
            .and_then(|context| context.channel()?.guard.as_ref());
        let token = guard.and_then(|guard| self.tree.find(&guard.token));
        let owned = token.filter(|token| token.token().is_some_and(|token| token.owner.is_some()));
        if let Some(token) = owned {
            self.push_safe_state_of(token.number, &BTreeSet::from([channel]), out);
        }
    }

    /// Sends the safe state of a token for these of its channels.
    fn push_safe_state_of(
        &self,
        number: ContextNumber,
        channels: &BTreeSet<ContextNumber>,
        out: &mut Vec<Effect>,
    ) {
        let Some(token) = self.token(number) else { return };
        let halt = |channel: &ContextNumber| Some((self.tree.get(*channel)?.path.clone(), event::HALT, None));
        let messages: Vec<(Path, &str, Option<Content>)> = match &token.safe {
            Some(safe) => vec![(safe.channel.clone(), &safe.name, safe.content.clone())],
            None => channels.iter().filter_map(halt).collect(),
        };
        for (path, name, content) in messages {
            // Only where the token guards: a safe state speaks in the hub's name, which nobody may borrow to talk
            // to other devices.
            let channel = self
                .tree
                .find(&path)
                .filter(|channel| token.guarded.contains(&channel.number));
            let Some(channel) = channel else { continue };
            let to = self.members_of(channel.number);
            if to.is_empty() {
                continue;
            }
            let mut parcel = self.hub_parcel(Family::Message, name, &path);
            parcel.received = parcel.timestamp;
            parcel.content = content;
            out.push(Effect::Deliver {
                to,
                parcel: Arc::new(parcel),
            });
        }
    }

    fn push_released(&self, number: ContextNumber, ended: &Ended<'_>, out: &mut Vec<Effect>) {
        let mut content = Map::new()
            .with("owner", self.name_of(ended.peer))
            .with("reason", ended.reason.word());
        if let Some(by) = ended.by {
            content.set("by", self.name_of(by));
        }
        content.set("fence", fence_value(ended.fence));
        let mut to = self.concerned(number);
        // Always the old owner; one that is gone already cannot be told.
        if self.peers.get(ended.peer).is_some() {
            to.insert(ended.peer);
        }
        self.push_event(
            event::RELEASED,
            ended.path,
            to.into_iter().collect(),
            content,
            out,
        );
    }

    fn push_grabbed(
        &self,
        number: ContextNumber,
        path: &Path,
        new: PeerId,
        returned: bool,
        out: &mut Vec<Effect>,
    ) {
        let Some(token) = self.token(number) else { return };
        let mut content = Map::new().with("owner", self.name_of(new));
        content.set("level", self.owner_level(token).unwrap_or_default());
        for (key, value) in self.granted(number) {
            content.set(&key, value);
        }
        let mut to = self.concerned(number);
        // What returns by itself nobody has asked for, so no reply says it.
        if returned {
            to.insert(new);
        }
        self.push_event(event::GRABBED, path, to.into_iter().collect(), content, out);
    }

    /// The members of a token and of the channels that it guards.
    pub(crate) fn concerned(&self, number: ContextNumber) -> BTreeSet<PeerId> {
        let mut peers: BTreeSet<PeerId> = self.members_of(number).into_iter().collect();
        for channel in self.token(number).into_iter().flat_map(|token| &token.guarded) {
            peers.extend(self.members_of(*channel));
        }
        peers
    }

    /// What an owner is told: fence, lease, deadman time, and from whom it has the token for how long.
    pub(crate) fn granted(&self, number: ContextNumber) -> Map {
        let Some(token) = self.token(number) else {
            return Map::new();
        };
        let mut map = Map::new()
            .with("fence", fence_value(token.fence))
            .with("lease", self.lease_value(token));
        if let Some(deadman) = token.terms.deadman {
            map.set("deadman", millis(deadman));
        }
        let delegation = token.owner.as_ref().and_then(|owner| owner.delegation.as_ref());
        if let Some(delegation) = delegation {
            if let Some(from) = delegation.from {
                map.set("from", self.name_of(from));
            }
            if let Some(until) = delegation.until {
                map.set("for", self.millis_until(until));
            }
            if let Some(commands) = delegation.commands {
                map.set("commands", fence_value(commands));
            }
        }
        map
    }

    /// The level with which the owner of a token defends it: that of the giver too, if it was given.
    pub(crate) fn owner_level(&self, token: &Token) -> Option<i32> {
        let owner = token.owner.as_ref()?;
        let level = |peer: PeerId| self.peers.get(peer).map(|peer| peer.facts.level);
        let giver = token.giver().and_then(level);
        level(owner.peer).map(|own| giver.map_or(own, |giver| own.max(giver)))
    }

    /// The whole lease in ms, null without end.
    pub(crate) fn lease_value(&self, token: &Token) -> Value {
        token.terms.lease.map_or(Value::Null, millis)
    }

    pub(crate) fn name_of(&self, peer: PeerId) -> String {
        self.peers
            .get(peer)
            .map(|peer| peer.facts.name.to_string())
            .unwrap_or_default()
    }

    /// Sets the token's timer to its deadline as it is now.
    pub(crate) fn retime(&mut self, number: ContextNumber) {
        let Some(token) = self.tree.get_mut(number).and_then(|context| context.token_mut()) else {
            return;
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
}

/// An ownership that has ended.
pub(crate) struct Ended<'a> {
    pub(crate) path: &'a Path,
    pub(crate) peer: PeerId,
    pub(crate) fence: u64,
    pub(crate) reason: Reason,
    pub(crate) by: Option<PeerId>,
}

/// The word for what happens at a lease's end.
pub(crate) fn expiry_word(expiry: Expiry) -> &'static str {
    match expiry {
        Expiry::Lazy => "lazy",
        Expiry::Eager => "eager",
    }
}

/// A fence as a value.
pub(crate) fn fence_value(fence: u64) -> i64 {
    i64::try_from(fence).unwrap_or(i64::MAX)
}

/// A duration in whole ms.
pub(crate) fn millis(duration: Micros) -> Value {
    Value::Int(i64::try_from(duration / 1000).unwrap_or(i64::MAX))
}
