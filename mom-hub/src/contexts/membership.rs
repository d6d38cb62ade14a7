//! Joining and leaving (M23).

use std::collections::BTreeSet;
use std::sync::Arc;

use mom_proto::event::{self, Reason};
use mom_proto::{ContextNumber, Thinning};

use crate::world::World;
use crate::world::events::peer_map;
use crate::{Effect, Member, PeerId};

impl World {
    /// Adds a peer to a context and tells its members.
    pub(crate) fn add_member(&mut self, number: ContextNumber, peer: PeerId, out: &mut Vec<Effect>) {
        let (Some(known), Some(context)) = (self.peers.get_mut(peer), self.tree.get_mut(number)) else {
            return self.fault("a peer or a context is not there that is to be joined");
        };
        known.joined.insert(number);
        let facts = Arc::clone(&known.facts);
        context
            .members
            .insert(peer, Arc::new(Member::new(peer, Arc::clone(&facts))));
        self.grown.insert(number);
        self.push_presence(number, event::JOINED, peer_map(&facts), out);
    }

    /// Changes what a member is to be spared; its route says so before anything that comes after.
    pub(crate) fn thin(&mut self, number: ContextNumber, peer: PeerId, thinning: Thinning) {
        let context = self.tree.get_mut(number);
        let Some(member) = context.and_then(|context| context.members.get_mut(&peer)) else {
            return self.fault("a peer is to be spared of something where it is no member");
        };
        if member.thinning != thinning {
            *member = Arc::new(member.thinned(thinning));
            // A peer that has just joined is told so before it hears anything.
            if !self.grown.contains(&number) {
                self.changed.insert(number);
            }
        }
    }

    /// Takes a peer out of a context and of all below it, deepest first. It gives up its tokens there before: first
    /// everything is safe, and it still hears so itself.
    pub(crate) fn leave(
        &mut self,
        number: ContextNumber,
        peer: PeerId,
        reason: Reason,
        out: &mut Vec<Effect>,
    ) {
        let (Some(context), Some(known)) = (self.tree.get(number), self.peers.get(peer)) else {
            return self.fault("a peer or a context is not there that is to be left");
        };
        let top = &context.path;
        let within = |places: &BTreeSet<ContextNumber>| -> Vec<ContextNumber> {
            let inside = |place: &ContextNumber| {
                let context = self.tree.get(*place);
                context.is_some_and(|context| context.path.is_within(top))
            };
            // A child's number is higher than its parent's, so this order is deepest first.
            places.iter().rev().copied().filter(inside).collect()
        };
        let (involved, owned) = (within(&known.involved), within(&known.owns));
        let joined = within(&known.joined);
        // Its waiting ends first, or it would be granted what others lose on its way out.
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
        // A transient context may have been deleted with a member that left before.
        let Some(context) = self.tree.get_mut(number) else {
            return;
        };
        let Some(member) = context.members.remove(&peer) else {
            return self.fault("a peer leaves a context that it has not joined");
        };
        let dissolves = context.transient && !context.permanent && context.members.is_empty();
        if let Some(known) = self.peers.get_mut(peer) {
            known.joined.remove(&number);
        }
        self.changed.insert(number);
        self.push_presence(number, event::LEFT, peer_map(&member.facts), out);
        if dissolves {
            self.delete(number, None, None, out);
        }
    }
}
