//! The end of a context and of all below it.

use std::collections::BTreeSet;

use mom_proto::event::{self, Reason};
use mom_proto::{Code, ContextNumber, Map, WireError};

use crate::token::state::Granting;
use crate::world::World;
use crate::{Effect, PeerId};

impl World {
    /// Deletes a context with all below it, deepest first. All tokens are lost before: first everything is
    /// safe, while the channels that lead to the devices are still there.
    pub(crate) fn delete(&mut self, number: ContextNumber, by: Option<PeerId>, out: &mut Vec<Effect>) {
        let all = self.tree.subtree(number);
        all.iter().for_each(|below| self.end_token(*below, by, out));
        for below in all {
            self.delete_one(below, by, out);
        }
    }

    /// Deletes a context that has nothing below it any more.
    fn delete_one(&mut self, number: ContextNumber, by: Option<PeerId>, out: &mut Vec<Effect>) {
        let Some(context) = self.tree.get(number) else {
            return self.fault("a context is deleted that is not there");
        };
        let (path, parent, kind) = (context.path.clone(), context.parent, context.kind());
        let members: BTreeSet<PeerId> = context.members.keys().copied().collect();
        let mut content = Map::new().with("path", path.as_str()).with("kind", kind.word());
        if let Some(by) = by {
            content.set("by", self.name_of(by));
        }
        self.audit_context("deleted", &path, by, out);
        for peer in &members {
            if let Some(known) = self.peers.get_mut(*peer) {
                known.joined.remove(&number);
            }
        }
        self.push_last_safe_state(number, out);
        self.unguard(number);
        self.changed.insert(number);
        let above = parent.map(|parent| self.tree.members_of(parent));
        let told: BTreeSet<PeerId> = members.into_iter().chain(above.unwrap_or_default()).collect();
        self.push_event(event::DELETED, &path, told.into_iter().collect(), content, out);
        let removed = self.tree.remove(number);
        if let Some(token) = removed.as_ref().and_then(|context| context.token()) {
            // So that a token made anew at this path starts above all fences of this one.
            self.deleted_fence = self.deleted_fence.max(token.fence);
            self.changed.extend(&token.guarded);
            self.change_orphaned_routes();
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
        let token = guard.and_then(|guard| self.tree.token_at(&guard.token));
        if let Some(token) = token
            .map(|(number, _)| number)
            .and_then(|token| self.token_mut(token))
        {
            token.guarded.remove(&channel);
        }
    }
}
