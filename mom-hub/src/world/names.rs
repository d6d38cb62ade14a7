//! Peers as tokens and events name them.

use mom_proto::{ContextNumber, Micros, Value};

use super::World;
use crate::token::state::Token;
use crate::{Holder, PeerId};

impl World {
    /// Until when a peer may come back whose connection is lost.
    pub(crate) fn lost_until(&self, peer: PeerId) -> Option<Micros> {
        self.peers.get(peer)?.lost
    }

    /// The name of a peer; empty if it is not there any more.
    pub(crate) fn name_of(&self, peer: PeerId) -> String {
        self.peers
            .get(peer)
            .map(|peer| peer.facts.name.to_string())
            .unwrap_or_default()
    }

    pub(crate) fn level_of(&self, peer: PeerId) -> Option<i32> {
        self.peers.get(peer).map(|peer| peer.facts.level)
    }

    /// The user and the nickname of a peer, by which it is known again after a restart.
    pub(crate) fn holder(&self, peer: PeerId) -> Option<Holder> {
        self.peers.get(peer).map(|peer| Holder {
            user: peer.facts.user.to_string(),
            name: peer.facts.name.to_string(),
        })
    }

    /// The owner of a token.
    pub(crate) fn owner_of(&self, number: ContextNumber) -> Option<PeerId> {
        self.token(number)?.owner_peer()
    }

    /// The level with which the owner of a token defends it: the higher one of its own and the giver's.
    pub(crate) fn owner_level(&self, token: &Token) -> Option<i32> {
        let owner = self.level_of(token.owner_peer()?)?;
        let giver = token.giver().and_then(|giver| self.level_of(giver));
        Some(giver.map_or(owner, |giver| owner.max(giver)))
    }

    /// Until when a restart keeps this peer from the token.
    pub(crate) fn kept_by_restart(&self, token: &Token, peer: PeerId) -> Option<Micros> {
        token.kept_by_restart(self.holder(peer).as_ref(), self.now)
    }

    /// The names of the peers that hold a token together.
    pub(crate) fn holders_value(&self, token: &Token) -> Vec<Value> {
        let holders = token.holders.keys();
        holders.map(|peer| Value::from(self.name_of(*peer))).collect()
    }

    /// Notes that a peer has something to do with a token besides owning it, so that its end is not forgotten.
    pub(crate) fn involve(&mut self, peer: PeerId, number: ContextNumber) {
        match self.peers.get_mut(peer) {
            Some(peer) => {
                peer.involved.insert(number);
            }
            None => self.fault("queuing a peer that does not exist"),
        }
    }

    /// Takes that back, if the peer has nothing to do with the token any more.
    pub(crate) fn uninvolve(&mut self, peer: PeerId, number: ContextNumber) {
        if self.token(number).is_some_and(|token| token.involves(peer)) {
            return;
        }
        match self.peers.get_mut(peer) {
            Some(peer) => {
                peer.involved.remove(&number);
            }
            None => self.fault("ending the wait of a peer that does not exist"),
        }
    }
}
