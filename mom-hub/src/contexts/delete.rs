//! The end of a context and of all below it.

use std::collections::BTreeSet;

use mom_proto::event::{self, Reason};
use mom_proto::{Code, ContextNumber, Fence, Map, Path, WireError};

use crate::token::state::Granting;
use crate::tree::context::Role;
use crate::world::World;
use crate::world::steps::{Deleter, Deletion, Job, Phase, STEP, TOLD, told};
use crate::{Audit, Effect, PeerId};

impl World {
    /// Deletes a context with all below it. All tokens are lost before: first everything is safe, while the channels
    /// that lead to the devices are still there. Much is deleted in steps, between which others have their turns;
    /// the requester is answered at the end.
    pub(crate) fn delete(
        &mut self,
        number: ContextNumber,
        by: Option<PeerId>,
        answer: Option<(PeerId, Option<u64>)>,
        out: &mut Vec<Effect>,
    ) {
        let Some(mut deletion) = self.begin_deletion(number, by, answer) else {
            return;
        };
        if self.delete_step(&mut deletion, out) {
            return;
        }
        self.doomed.insert(deletion.path.clone());
        self.begin_job(Job::Delete(Box::new(deletion)));
    }

    /// Deletes a context with all below it at once, for a new configuration that has something else there.
    pub(crate) fn delete_at_once(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        if let Some(mut deletion) = self.begin_deletion(number, None, None) {
            while !self.delete_step(&mut deletion, out) {}
        }
    }

    /// Whether a path is being deleted, with what is above it.
    pub(crate) fn is_doomed(&self, path: &Path) -> bool {
        !self.doomed.is_empty() && self.doomed.iter().any(|doomed| path.is_within(doomed))
    }

    fn begin_deletion(
        &self,
        number: ContextNumber,
        by: Option<PeerId>,
        answer: Option<(PeerId, Option<u64>)>,
    ) -> Option<Deletion> {
        let Some(context) = self.tree.get(number) else {
            return self.fault("deleting a context that does not exist");
        };
        // Within something that is being deleted it goes with that.
        let free = !self.is_doomed(&context.path);
        free.then(|| Deletion {
            top: number,
            path: context.path.clone(),
            by: Deleter {
                peer: by,
                fact: by.map_or_else(|| Audit::new("deleted"), |by| self.fact("deleted", by)),
            },
            phase: Phase::Tokens(None),
            answer,
        })
    }

    /// One step; true with the last.
    pub(super) fn delete_step(&mut self, deletion: &mut Deletion, out: &mut Vec<Effect>) -> bool {
        let start = out.len();
        let mut left = STEP;
        if let Phase::Tokens(after) = &deletion.phase {
            let below = self.tree.below(&deletion.path, after.as_ref()).take(left);
            let below: Vec<ContextNumber> = below.collect();
            let mut reached = after.clone();
            for number in &below {
                if told(&out[start..]) >= TOLD {
                    deletion.phase = Phase::Tokens(reached);
                    return false;
                }
                reached = self.tree.get(*number).map(|context| context.path.clone());
                self.end_token(*number, deletion.by.peer, out);
                left -= 1;
            }
            if left == 0 {
                deletion.phase = Phase::Tokens(reached);
                return false;
            }
            self.end_token(deletion.top, deletion.by.peer, out);
            deletion.phase = Phase::Contexts;
        }
        while let Some(last) = self.tree.last_below(&deletion.path) {
            if left == 0 || told(&out[start..]) >= TOLD {
                return false;
            }
            self.delete_one(last, &deletion.by, out);
            left -= 1;
        }
        self.delete_one(deletion.top, &deletion.by, out);
        if let Some((peer, reference)) = deletion.answer {
            self.push_ok(peer, reference, &deletion.path, None, out);
        }
        true
    }

    /// Deletes a context that has nothing below it any more.
    fn delete_one(&mut self, number: ContextNumber, by: &Deleter, out: &mut Vec<Effect>) {
        let Some(context) = self.tree.get(number) else {
            return self.fault("deleting a context that does not exist");
        };
        let (path, parent, kind) = (context.path.clone(), context.parent, context.kind());
        let members: BTreeSet<PeerId> = context.members.keys().copied().collect();
        let mut content = Map::new().with("path", path.as_str()).with("kind", kind.word());
        if let Some(by) = &by.fact.peer {
            content.set("by", &**by);
        }
        let fact = Audit {
            context: Some(path.clone()),
            ..by.fact.clone()
        };
        self.audit(fact, out);
        for peer in &members {
            if let Some(known) = self.peers.get_mut(*peer) {
                known.left(number);
            }
        }
        self.push_last_safe_state(number, out);
        self.unguard(number);
        self.changed.insert(number);
        let above = parent.map(|parent| self.who_may_know(number, parent));
        let told: BTreeSet<PeerId> = members.into_iter().chain(above.unwrap_or_default()).collect();
        self.push_event(event::DELETED, &path, told.into_iter().collect(), content, out);
        let removed = self.tree.remove(number);
        if let Some(token) = removed.as_ref().and_then(|context| context.token()) {
            // So that a token made anew at this path starts above all fences of this one.
            self.deleted_fence = self.deleted_fence.max(token.fence);
            let (fence, guarded) = (token.fence, token.guarded.clone());
            self.changed.extend(&guarded);
            for channel in guarded {
                self.note_lost_fence(channel, fence);
            }
        }
    }

    /// Lets a channel keep the fence of its token, which was deleted.
    fn note_lost_fence(&mut self, channel: ContextNumber, fence: Fence) {
        let role = self.tree.get_mut(channel).map(|context| &mut context.role);
        if let Some(Role::Channel(channel)) = role
            && let Some(guard) = &mut channel.guard
        {
            guard.lost_fence = fence;
        }
    }

    /// Ends all ownership of a token that is about to go, and all waiting for it. Other contexts have none.
    fn end_token(&mut self, number: ContextNumber, by: Option<PeerId>, out: &mut Vec<Effect>) {
        let path = self.tree.get(number).map(|context| context.path.to_string());
        let Some((path, token)) = path.zip(self.tree.token_mut(number)) else {
            return;
        };
        let granting = token.granting.take();
        let held_back = std::mem::take(&mut token.held_back);
        let holders: Vec<PeerId> = token.holders.keys().copied().collect();
        let error = WireError::new(Code::UNKNOWN_PATH, format!("{path} was deleted")).slot("context");
        if let Some(Granting { ticket, change }) = granting {
            ticket.map(|ticket| self.storing.remove(&ticket));
            if let Some(change) = change {
                self.call_off(number, &change, &error, "lost", out);
                self.uninvolve(change.to, number);
            }
        }
        self.withdraw_all(number, &error, out);
        self.stir_neighbours(number);
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

    /// Ends the guard of a channel at its token. The channel may have none, and the token may have been deleted.
    pub(crate) fn unguard(&mut self, channel: ContextNumber) {
        let guard = self
            .tree
            .get(channel)
            .and_then(|context| context.channel()?.guard.as_ref());
        let Some(path) = guard.map(|guard| guard.token.clone()) else {
            return;
        };
        self.tree.remove_guard(&path, channel);
        let token = self.tree.token_at(&path).map(|(number, _)| number);
        if let Some(token) = token.and_then(|token| self.token_mut(token)) {
            token.guarded.remove(&channel);
        }
    }
}
