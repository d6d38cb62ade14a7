//! Shared holds: as long as there is one, nobody owns the token.

use mom_proto::event;
use mom_proto::{ContextNumber, Map};

use super::news::concerned;
use crate::world::World;
use crate::{Effect, PeerId};

impl World {
    /// Begins a peer's part in a shared hold.
    pub(crate) fn inhibit(&mut self, number: ContextNumber, peer: PeerId, out: &mut Vec<Effect>) {
        let now = self.now;
        let Some(token) = self.token_mut(number) else {
            return self.fault("inhibiting a token that does not exist");
        };
        if token.holders.insert(peer, now).is_some() {
            return;
        }
        self.involve(peer, number);
        self.push_shared(number, event::INHIBITED, peer, None, out);
    }

    /// Ends a peer's part in a shared hold, if it has one; after the last one the next of the queue has the token.
    pub(crate) fn uninhibit(
        &mut self,
        number: ContextNumber,
        peer: PeerId,
        reason: &str,
        out: &mut Vec<Effect>,
    ) -> bool {
        let ended = self.end_hold(number, peer, reason, out);
        if ended {
            self.advance_queue(number, out);
        }
        ended
    }

    /// Ends a peer's part in a shared hold, and leaves to the caller who is next.
    pub(crate) fn end_hold(
        &mut self,
        number: ContextNumber,
        peer: PeerId,
        reason: &str,
        out: &mut Vec<Effect>,
    ) -> bool {
        let removed = self
            .token_mut(number)
            .and_then(|token| token.holders.remove(&peer));
        if removed.is_none() {
            return false;
        }
        self.uninvolve(peer, number);
        self.push_shared(number, event::UNINHIBITED, peer, Some(reason), out);
        true
    }

    fn push_shared(
        &self,
        number: ContextNumber,
        name: &'static str,
        peer: PeerId,
        reason: Option<&str>,
        out: &mut Vec<Effect>,
    ) {
        let context = self.tree.get(number);
        let Some((context, token)) = context.and_then(|context| Some((context, context.token()?))) else {
            return self.fault("sharing a token that does not exist");
        };
        let mut content = Map::new()
            .with("peer", self.name_of(peer))
            .with("holders", self.holders_value(token));
        if let Some(reason) = reason {
            content.set("reason", reason);
        }
        let mut to = concerned(self, number);
        to.insert(peer);
        self.push_event(name, &context.path, to.into_iter().collect(), content, out);
        self.audit_shared(name, &context.path, peer, out);
    }
}
