//! The one way in which a token gains, changes or loses its owner (design §6).
//!
//! The order is always: routes of all guarded channels, safe state, `released`, `grabbed`; the reply is the
//! caller's and comes last.

use std::collections::BTreeSet;
use std::sync::Arc;

use mom_managers::{Expiry, Micros};
use mom_proto::event::{self, Reason};
use mom_proto::{Content, ContextNumber, Family, Map, Path, Value};

use crate::hub::Timer;
use crate::token::{Ownership, Token};
use crate::{Effect, Hub, PeerId};

/// Numbers of one epoch; grants beyond run into the next, which is why epochs are seconds apart.
const EPOCH_BITS: u32 = 20;

impl Hub {
    /// Gives a token to a peer, taking it from its owner if it has one.
    pub(crate) fn grant(&mut self, number: ContextNumber, to: PeerId, reason: Reason, out: &mut Vec<Effect>) {
        self.change_owner(number, Some(to), reason, Some(to), out);
    }

    /// Ends the ownership of a token, if there is one.
    pub(crate) fn lose(
        &mut self,
        number: ContextNumber,
        reason: Reason,
        by: Option<PeerId>,
        out: &mut Vec<Effect>,
    ) {
        self.change_owner(number, None, reason, by, out);
    }

    /// Begins a new lease for the owner.
    pub(crate) fn renew_lease(&mut self, number: ContextNumber) {
        self.drop_timer(number);
        let now = self.now;
        if let Some(token) = self.tree.get_mut(number).and_then(|context| context.token_mut()) {
            let end = token.lease_from(now);
            if let Some(owner) = &mut token.owner {
                owner.lease_end = end;
            }
        }
        self.set_timer(number);
        // The routes tell refused senders how much of the lease is left.
        self.change_guarded_routes(number);
    }

    fn change_owner(
        &mut self,
        number: ContextNumber,
        to: Option<PeerId>,
        reason: Reason,
        by: Option<PeerId>,
        out: &mut Vec<Effect>,
    ) {
        self.drop_timer(number);
        let (now, floor) = (self.now, self.fence_floor());
        let Some(context) = self.tree.get_mut(number) else {
            return;
        };
        let path = context.path.clone();
        let Some(token) = context.token_mut() else { return };
        let old = token.owner.take();
        let old_fence = token.fence;
        if let Some(peer) = to {
            token.fence = (token.fence + 1).max(floor + 1);
            token.owner = Some(Ownership {
                peer,
                since: now,
                lease_end: token.lease_from(now),
            });
        }
        if old.is_none() && to.is_none() {
            return;
        }
        self.note_owner(number, old.as_ref(), to);
        self.set_timer(number);
        self.change_guarded_routes(number);
        if let Some(old) = old {
            self.push_safe_state(number, out);
            self.push_released(number, &path, old.peer, old_fence, reason, by, out);
        }
        if let Some(peer) = to {
            self.push_grabbed(number, &path, peer, out);
        }
    }

    fn note_owner(&mut self, number: ContextNumber, old: Option<&Ownership>, new: Option<PeerId>) {
        if let Some(peer) = old.and_then(|old| self.peers.get_mut(old.peer)) {
            peer.owns.remove(&number);
        }
        if let Some(peer) = new.and_then(|new| self.peers.get_mut(new)) {
            peer.owns.insert(number);
        }
    }

    fn fence_floor(&self) -> u64 {
        (self.settings.epoch << EPOCH_BITS).max(self.deleted_fence)
    }

    fn push_safe_state(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        let Some(token) = self.token(number) else { return };
        let halt = |channel: &ContextNumber| Some((self.tree.get(*channel)?.path.clone(), event::HALT, None));
        let messages: Vec<(Path, &str, Option<Content>)> = match &token.safe {
            Some(safe) => vec![(safe.channel.clone(), &safe.name, safe.content.clone())],
            None => token.guarded.iter().filter_map(halt).collect(),
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

    #[expect(clippy::too_many_arguments, reason = "all of them are what the event says")]
    fn push_released(
        &self,
        number: ContextNumber,
        path: &Path,
        old: PeerId,
        fence: u64,
        reason: Reason,
        by: Option<PeerId>,
        out: &mut Vec<Effect>,
    ) {
        let mut content = Map::new()
            .with("owner", self.name_of(old))
            .with("reason", reason.word());
        if let Some(by) = by {
            content.set("by", self.name_of(by));
        }
        content.set("fence", fence_value(fence));
        let mut to = self.concerned(number);
        // Always the old owner; one that is gone already cannot be told.
        if self.peers.get(old).is_some() {
            to.insert(old);
        }
        self.push_event(event::RELEASED, path, to.into_iter().collect(), content, out);
    }

    fn push_grabbed(&self, number: ContextNumber, path: &Path, new: PeerId, out: &mut Vec<Effect>) {
        let Some(token) = self.token(number) else { return };
        let mut content = Map::new().with("owner", self.name_of(new));
        if let Some(peer) = self.peers.get(new) {
            content.set("level", peer.facts.level);
        }
        content.set("fence", fence_value(token.fence));
        content.set("lease", self.lease_value(token));
        self.push_event(
            event::GRABBED,
            path,
            self.concerned(number).into_iter().collect(),
            content,
            out,
        );
    }

    /// The members of a token and of the channels that it guards.
    fn concerned(&self, number: ContextNumber) -> BTreeSet<PeerId> {
        let mut peers: BTreeSet<PeerId> = self.members_of(number).into_iter().collect();
        for channel in self.token(number).into_iter().flat_map(|token| &token.guarded) {
            peers.extend(self.members_of(*channel));
        }
        peers
    }

    /// What is known of a token's owner, for replies: fence, and with an owner who, since when, lease left.
    pub(crate) fn token_map(&self, token: &Token) -> Map {
        let mut map = Map::new();
        if let Some(owner) = &token.owner {
            map.set("owner", self.name_of(owner.peer));
            if let Some(peer) = self.peers.get(owner.peer) {
                map.set("owner-level", peer.facts.level);
            }
            let held = i64::try_from((self.now - owner.since) / 1000).unwrap_or(i64::MAX);
            map.set("held", held);
            map.set(
                "lease-left",
                owner.lease_end.map_or(Value::Null, |end| self.millis_until(end)),
            );
        }
        map.set("fence", fence_value(token.fence));
        map
    }

    /// The whole lease in ms, null without end.
    pub(crate) fn lease_value(&self, token: &Token) -> Value {
        let millis = |lease: Micros| Value::Int(i64::try_from(lease / 1000).unwrap_or(i64::MAX));
        token.terms.lease.map_or(Value::Null, millis)
    }

    pub(crate) fn name_of(&self, peer: PeerId) -> String {
        self.peers
            .get(peer)
            .map(|peer| peer.facts.name.to_string())
            .unwrap_or_default()
    }

    fn set_timer(&mut self, number: ContextNumber) {
        if let Some(deadline) = self.token(number).and_then(Token::deadline) {
            self.timers.insert((deadline, Timer::Lease(number)));
        }
    }

    fn drop_timer(&mut self, number: ContextNumber) {
        if let Some(deadline) = self.token(number).and_then(Token::deadline) {
            self.timers.remove(&(deadline, Timer::Lease(number)));
        }
    }
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
