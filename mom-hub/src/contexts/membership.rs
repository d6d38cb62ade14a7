//! Joining and leaving, and what follows from it (M23, M30).

use std::collections::BTreeSet;
use std::sync::Arc;

use mom_proto::event::{self, Reason};
use mom_proto::{Code, ContextNumber, Map, Thinning, WireError};

use crate::hub::Timer;
use crate::messages::route::{Guard, GuardOwner, Route};
use crate::ownership::grant::Storing;
use crate::tree::context::Presence;
use crate::world::events::peer_map;
use crate::{Effect, Hub, Member, PeerId};

impl Hub {
    /// Adds a peer to a context and tells its members.
    pub(crate) fn add_member(&mut self, number: ContextNumber, peer: PeerId, out: &mut Vec<Effect>) {
        let Some(known) = self.peers.get_mut(peer) else {
            return;
        };
        known.joined.insert(number);
        let facts = Arc::clone(&known.facts);
        let Some(context) = self.tree.get_mut(number) else {
            return;
        };
        context
            .members
            .insert(peer, Arc::new(Member::new(peer, Arc::clone(&facts))));
        self.grown.insert(number);
        self.push_presence(number, event::JOINED, peer_map(&facts), out);
    }

    /// Spares a member of something else than before; its route says so before anything that comes after.
    pub(crate) fn thin(&mut self, number: ContextNumber, peer: PeerId, thinning: Thinning) {
        let member = self
            .tree
            .get_mut(number)
            .and_then(|context| context.members.get_mut(&peer));
        if let Some(member) = member.filter(|member| member.thinning != thinning) {
            *member = Arc::new(member.thinned(thinning));
            // Who has just joined is told so before it hears anything.
            if !self.grown.contains(&number) {
                self.changed.insert(number);
            }
        }
    }

    /// Takes a peer out of a context and of all below it, deepest first. What it owns there it gives up
    /// before: first everything is safe, and it still hears so itself.
    pub(crate) fn leave(
        &mut self,
        number: ContextNumber,
        peer: PeerId,
        reason: Reason,
        out: &mut Vec<Effect>,
    ) {
        let Some(top) = self.tree.get(number).map(|context| context.path.clone()) else {
            return;
        };
        let Some(known) = self.peers.get(peer) else { return };
        let within = |places: &BTreeSet<ContextNumber>| -> Vec<ContextNumber> {
            let inside = |place: &ContextNumber| {
                let context = self.tree.get(*place);
                context.is_some_and(|context| context.path.is_within(&top))
            };
            // A child's number is higher than its parent's, so this order is deepest first.
            places.iter().rev().copied().filter(inside).collect()
        };
        let (involved, owned) = (within(&known.involved), within(&known.owns));
        let joined = within(&known.joined);
        // What it waits for first, or it would be granted what others lose on its way out.
        for token in involved {
            self.end_involvement(token, peer, reason.word(), out);
        }
        for token in owned {
            self.lose(token, reason, None, out);
        }
        for place in joined {
            self.remove_member(place, peer, out);
        }
    }

    fn remove_member(&mut self, number: ContextNumber, peer: PeerId, out: &mut Vec<Effect>) {
        let Some(context) = self.tree.get_mut(number) else {
            return;
        };
        let Some(member) = context.members.remove(&peer) else {
            return;
        };
        let dissolves = context.transient && !context.permanent && context.members.is_empty();
        if let Some(known) = self.peers.get_mut(peer) {
            known.joined.remove(&number);
        }
        self.changed.insert(number);
        self.push_presence(number, event::LEFT, peer_map(&member.facts), out);
        if dissolves {
            self.delete(number, None, out);
        }
    }

    /// Deletes a context with all below it, deepest first. All tokens are lost before: first everything is
    /// safe, while the channels that lead to the devices are still there.
    pub(crate) fn delete(&mut self, number: ContextNumber, by: Option<PeerId>, out: &mut Vec<Effect>) {
        let all = self.tree.subtree(number);
        all.iter().for_each(|below| self.end_token(*below, by, out));
        for below in all {
            let Some(context) = self.tree.get(below) else {
                continue;
            };
            let (path, parent, kind) = (context.path.clone(), context.parent, context.kind());
            let mut to: BTreeSet<PeerId> = context.members.keys().copied().collect();
            to.extend(parent.map(|parent| self.members_of(parent)).unwrap_or_default());
            let mut content = Map::new().with("path", path.as_str()).with("kind", kind.word());
            self.audit_context("deleted", &path, by, out);
            if let Some(by) = by {
                content.set("by", self.name_of(by));
            }
            for peer in self.members_of(below) {
                if let Some(known) = self.peers.get_mut(peer) {
                    known.joined.remove(&below);
                }
            }
            self.push_last_safe_state(below, out);
            self.unguard(below);
            self.changed.insert(below);
            self.push_event(event::DELETED, &path, to.into_iter().collect(), content, out);
            if let Some(token) = self
                .tree
                .remove(below)
                .as_ref()
                .and_then(|context| context.token())
            {
                // So that a token made anew at this path starts above all fences of this one.
                self.deleted_fence = self.deleted_fence.max(token.fence);
                self.changed.extend(&token.guarded);
                self.change_orphaned_routes();
            }
        }
    }

    /// Notes that the routes of all channels have changed whose token is no more: they show the fence of today.
    fn change_orphaned_routes(&mut self) {
        let orphaned = self.tree.iter().filter(|context| {
            let guard = context.channel().and_then(|channel| channel.guard.as_ref());
            guard.is_some_and(|guard| self.tree.find(&guard.token).is_none())
        });
        let orphaned: Vec<ContextNumber> = orphaned.map(|context| context.number).collect();
        self.changed.extend(orphaned);
    }

    /// Ends all ownership of a token that is about to go, and all waiting for it.
    fn end_token(&mut self, number: ContextNumber, by: Option<PeerId>, out: &mut Vec<Effect>) {
        let Some(token) = self.token_mut(number) else {
            return;
        };
        let storing = token.storing.take();
        let held_back = std::mem::take(&mut token.held_back);
        let holders: Vec<PeerId> = token.holders.keys().copied().collect();
        let path = self.tree.get(number).map(|context| context.path.to_string());
        let text = format!("{} was deleted", path.unwrap_or_default());
        let error = WireError::new(Code::UNKNOWN_PATH, text).slot("context");
        if let Some(Storing { ticket, change }) = storing {
            self.storing.remove(&ticket);
            if let Some(change) = change {
                self.call_off(number, &change, &error, "lost", out);
                self.uninvolve(change.to, number);
            }
        }
        self.withdraw_all(number, &error, out);
        for held in held_back {
            self.push_refusal(held.peer, &held.parcel, &error, out);
            self.uninvolve(held.peer, number);
        }
        for peer in holders {
            self.uninhibit(number, peer, Reason::Deleted.word(), out);
        }
        self.end_handover(number, None, out);
        self.lose(number, Reason::Deleted, by, out);
        self.correct_record(number, out);
    }

    pub(crate) fn unguard(&mut self, channel: ContextNumber) {
        let token = self
            .tree
            .get(channel)
            .and_then(|context| context.channel()?.guard.as_ref());
        let token = token
            .and_then(|guard| self.tree.find(&guard.token))
            .map(|token| token.number);
        if let Some(token) = token.and_then(|token| self.tree.get_mut(token)?.token_mut()) {
            token.guarded.remove(&channel);
        }
    }

    /// Notes that the routes of all channels which a token guards have changed.
    pub(crate) fn change_guarded_routes(&mut self, number: ContextNumber) {
        if let Some(token) = self.tree.get(number).and_then(|context| context.token()) {
            self.changed.extend(&token.guarded);
        }
    }

    /// The route of a channel as the tree stands.
    pub(crate) fn route(&self, number: ContextNumber) -> Option<Route> {
        let context = self.tree.get(number)?;
        let channel = context.channel()?;
        let guard = channel.guard.as_ref().map(|spec| {
            // A guard whose token is gone has no owner: it lets nobody pass.
            let token = self.tree.find(&spec.token).and_then(|context| context.token());
            let owner = token.and_then(|token| token.owner.as_ref());
            Guard {
                token: spec.token.clone(),
                names: Arc::clone(&spec.names),
                owner: owner.and_then(|owner| {
                    let facts = &self.peers.get(owner.peer)?.facts;
                    let name = Arc::clone(&facts.name);
                    Some(GuardOwner {
                        peer: owner.peer,
                        name,
                        level: token
                            .and_then(|token| self.owner_level(token))
                            .unwrap_or(facts.level),
                        lease_end: owner.lease_end,
                        lost_at: token.and_then(|token| token.deadline()),
                        commands: owner.delegation.as_ref().and_then(|given| given.commands),
                    })
                }),
                fence: token.map_or(self.deleted_fence, |token| token.fence),
            }
        });
        Some(Route {
            number,
            path: context.path.clone(),
            members: context.members.values().cloned().collect(),
            guard,
            delivery: channel.delivery,
            overflow: channel.overflow,
            keep: channel.keep,
        })
    }

    fn push_presence(&mut self, number: ContextNumber, name: &str, who: Map, out: &mut Vec<Effect>) {
        let (now, above, every) = (self.now, self.settings.counts_above, self.settings.counts_every);
        let Some(context) = self.tree.get_mut(number) else {
            return;
        };
        let count = context.members.len();
        let counted = match context.presence {
            Presence::None => return,
            Presence::All => false,
            Presence::Counts => count > above,
        };
        if counted && now < context.next_count {
            if !context.count_due {
                context.count_due = true;
                self.timers.insert((context.next_count, Timer::Count(number)));
            }
            return;
        }
        let path = context.path.clone();
        let content = if counted {
            context.next_count = now + every;
            count_map(count)
        } else {
            who
        };
        self.push_event(name, &path, self.members_of(number), content, out);
    }

    /// Sends the count that was held back, also if so many have left that each is told of by name again.
    pub(crate) fn push_count(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        let next = self.now + self.settings.counts_every;
        let Some(context) = self.tree.get_mut(number) else {
            return;
        };
        context.count_due = false;
        context.next_count = next;
        let (path, content) = (context.path.clone(), count_map(context.members.len()));
        self.push_event(event::JOINED, &path, self.members_of(number), content, out);
    }
}

fn count_map(members: usize) -> Map {
    Map::new().with("count", i64::try_from(members).unwrap_or(i64::MAX))
}
