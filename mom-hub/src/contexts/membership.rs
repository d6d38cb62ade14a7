//! Joining and leaving (M23).

use std::collections::BTreeSet;
use std::sync::Arc;

use mom_proto::event;
use mom_proto::{Card, Code, ContextNumber, Path, Thinning, Value, WireError};

use crate::tree::context::Context;
use crate::tree::installation::Installation;
use crate::tree::peers::Peer;
use crate::world::World;
use crate::world::steps::{Budget, Job, Leaving, PAUSE, STEP, Then};
use crate::{Effect, Member, PeerId};

/// Contexts that are told to forget their creator in place of one that is left: it is that much cheaper.
const FORGOTTEN: usize = 16;

/// The most bytes of all cards of one peer: those of 128 full ones, or of some thousand robots of a gateway.
const MOST_CARDS: usize = 8 << 20;

/// What a peer has in a place that it leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stake {
    Involved,
    Owned,
    Joined,
}

impl World {
    /// Adds a peer to a context and tells its members.
    pub(crate) fn add_member(&mut self, number: ContextNumber, peer: PeerId, out: &mut Vec<Effect>) {
        let (Some(known), Some(context)) = (self.peers.get_mut(peer), self.tree.get_mut(number)) else {
            return self.fault("joining a peer or context that does not exist");
        };
        known.joined.insert(number);
        let facts = Arc::clone(&known.facts);
        context
            .members
            .insert(peer, Arc::new(Member::new(peer, Arc::clone(&facts))));
        self.grown.insert(number);
        self.push_presence(number, event::JOINED, &facts, out);
    }

    /// Changes what a member is to be spared, and whether it is a device; its route says so before anything that comes after.
    pub(crate) fn set_terms(
        &mut self,
        number: ContextNumber,
        peer: PeerId,
        thinning: Thinning,
        device: bool,
    ) {
        let context = self.tree.get_mut(number);
        let Some(member) = context.and_then(|context| context.members.get_mut(&peer)) else {
            return self.fault("thinning for a peer that is not a member");
        };
        if member.thinning != thinning || member.device != device {
            *member = Arc::new(member.on_terms(thinning, device));
            if let Some(known) = self.peers.get_mut(peer) {
                match device {
                    true => known.moves_in.insert(number),
                    false => known.moves_in.remove(&number),
                };
            }
            // A peer that has just joined is told so before it hears anything.
            if !self.grown.contains(&number) {
                self.changed.insert(number);
            }
        }
    }

    /// Notes which installation a device is, and what it can do; only the hub looks at that, so no route changes.
    pub(crate) fn set_device(
        &mut self,
        number: ContextNumber,
        peer: PeerId,
        (installation, card): (Option<Installation>, Option<Arc<Value>>),
    ) {
        let context = self.tree.get_mut(number);
        let Some(member) = context.and_then(|context| context.members.get_mut(&peer)) else {
            return self.fault("what a peer says as a device that is not a member");
        };
        let installation = installation.map(Box::new);
        if member.installation == installation && member.card == card {
            return;
        }
        let size = |card: &Option<Arc<Value>>| card.as_deref().map_or(0, Card::size);
        let (before, after) = (size(&member.card), size(&card));
        let member = Arc::make_mut(member);
        (member.installation, member.card) = (installation, card);
        if let Some(known) = self.peers.get_mut(peer) {
            known.card_bytes = known.card_bytes.saturating_sub(before) + after;
        }
    }

    /// Whether there is room for a card of a peer in a channel.
    ///
    /// # Errors
    /// `full`.
    pub(crate) fn check_card(
        &self,
        number: ContextNumber,
        peer: PeerId,
        card: Option<&Value>,
    ) -> Result<(), WireError> {
        let member = self
            .tree
            .get(number)
            .and_then(|context| context.members.get(&peer));
        let before = member
            .and_then(|member| member.card.as_deref())
            .map_or(0, Card::size);
        let known = self.peers.get(peer).map_or(0, |known| known.card_bytes);
        let bytes = known.saturating_sub(before) + card.map_or(0, Card::size);
        match card.is_some() && bytes > MOST_CARDS {
            true => {
                let text = format!(
                    "the cards of one peer have {MOST_CARDS} bytes at most, these would have {bytes}"
                );
                Err(WireError::new(Code::FULL, text).slot("content/device/card"))
            }
            false => Ok(()),
        }
    }

    /// Takes a peer out of a context and of all below it, deepest first. It gives up its tokens there before: first
    /// everything is safe, and it still hears so itself. Much is left in steps, between which others have their turns;
    /// if that was all, the caller sees to what follows.
    pub(crate) fn leave(&mut self, leaving: Leaving, out: &mut Vec<Effect>) -> Option<Leaving> {
        if !self.goes_with_others(&leaving) {
            let mut budget = Budget::new(out);
            let is_out = self.leave_step(&leaving, &mut budget, out);
            // Where many are, many may follow: each new route costs as much as there are members.
            if matches!(leaving.then, Then::Forget) && budget.members > STEP {
                self.crowd_until = self.after(PAUSE);
            }
            if is_out {
                return Some(leaving);
            }
        }
        let tops = self.leaving.entry(leaving.peer).or_default();
        tops.push(leaving.top.clone());
        self.begin_job(Job::Leave(leaving));
        None
    }

    /// Whether a peer that is gone waits for others that go in the same moment from where many are, so that all of them
    /// cost one new route. Who has a token, or wants one, does not wait.
    fn goes_with_others(&self, leaving: &Leaving) -> bool {
        let has_nothing = |peer: &Peer| peer.owns.is_empty() && peer.involved.is_empty();
        matches!(leaving.then, Then::Forget)
            && (self.now < self.crowd_until || self.jobs.iter().any(Job::is_departure))
            && self.peers.get(leaving.peer).is_some_and(has_nothing)
    }

    /// One step; true with the last.
    pub(super) fn leave_step(
        &mut self,
        leaving: &Leaving,
        budget: &mut Budget,
        out: &mut Vec<Effect>,
    ) -> bool {
        let Leaving {
            peer, top, reason, ..
        } = leaving;
        let mut before = None;
        // Others may have offered it something since the last step.
        while let Some(next) = self.places_to_leave(*peer, top, budget.places) {
            if before.as_ref() == Some(&next) {
                self.fault::<()>("a peer is still in a context that it was removed from");
                return true;
            }
            let (places, how) = &next;
            for place in places.iter().copied() {
                // Of a channel they have a new route, even where they are not told, and one for all that leave it in this step.
                let is_channel = |place: &Context| place.channel().is_some();
                let costs = !self.changed.contains(&place) && self.tree.get(place).is_some_and(is_channel);
                if budget.is_spent(costs, out) {
                    return false;
                }
                budget.places -= 1;
                match how {
                    // Its waiting ends first, or it would be granted what others lose on its way out.
                    Stake::Involved => self.end_involvement(place, *peer, reason.word(), out),
                    Stake::Owned => self.lose(place, *reason, None, out),
                    Stake::Joined => {
                        if costs {
                            budget.members += self.tree.get(place).map_or(0, |place| place.members.len());
                        }
                        self.remove_member(place, *peer, out);
                    }
                }
            }
            before = Some(next);
        }
        // Who is out of the root is forgotten next.
        !top.is_root() || self.tree.forget(*peer, budget.places * FORGOTTEN)
    }

    /// What a peer has to leave next, so many places at most.
    fn places_to_leave(&self, peer: PeerId, top: &Path, most: usize) -> Option<(Vec<ContextNumber>, Stake)> {
        // It may have gone since the last step.
        let known = self.peers.get(peer)?;
        let within = |places: &BTreeSet<ContextNumber>| -> Vec<ContextNumber> {
            let inside = |place: &ContextNumber| {
                let context = self.tree.get(*place);
                context.is_some_and(|context| context.path.is_within(top))
            };
            // A child's number is higher than its parent's, so this order is deepest first.
            let inside = places.iter().rev().copied().filter(inside);
            inside.take(most.max(1)).collect()
        };
        let ways = [
            (&known.involved, Stake::Involved),
            (&known.owns, Stake::Owned),
            (&known.joined, Stake::Joined),
        ];
        let mut ways = ways.into_iter().map(|(places, how)| (within(places), how));
        ways.find(|(places, _)| !places.is_empty())
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
            known.left(number);
            known.card_bytes = known
                .card_bytes
                .saturating_sub(member.card.as_deref().map_or(0, Card::size));
        }
        self.changed.insert(number);
        self.push_presence(number, event::LEFT, &member.facts, out);
        if dissolves {
            self.delete(number, None, None, out);
        }
    }
}
