//! What the hub would answer now, for peers that ask. Nothing of it is an input: the hub is as it was.

use mom_proto::{Code, Map, Micros, Path, Verb, WireError};

use super::judge::{Case, Judgement};
use crate::asking::wish::Wish;
use crate::{Hub, PeerId, User};

/// Stands for a user of whom no peer is here.
const NOBODY: PeerId = PeerId(u64::MAX);

impl Hub {
    /// What the hub would answer if this peer, or this user without one, asked now, as far as who asks for it may know; none
    /// where nothing is that could be asked about. What the case says of owners and invitations does not count: who owns
    /// and is invited does.
    pub fn appraise(
        &mut self,
        now: Micros,
        asks: PeerId,
        peer: Option<PeerId>,
        case: &Case<'_>,
    ) -> Option<Judgement> {
        self.world.peers.get(asks)?;
        self.at(now, |hub| {
            let here = hub.world.seen_at(asks, case.path);
            let above = match case.verb {
                Verb::Create if here.is_none() => hub.world.seen_above(asks, case.path),
                _ => None,
            };
            let at = here.or(above)?;
            let known = peer.filter(|peer| hub.world.peers.get(*peer).is_some());
            let asker = known.unwrap_or_else(|| {
                hub.world.peers.lend(NOBODY, case.user);
                NOBODY
            });
            let mut judgement = hub.judgement(asker, case, at);
            hub.world.peers.take_back(NOBODY);
            if above.is_some() && judgement.verdict.is_allow() {
                judgement.refusal = hub.no_place(asks, case.path);
            }
            Some(judgement)
        })
    }

    /// Why nothing can be made at a path, as far as a peer may know.
    fn no_place(&mut self, asks: PeerId, path: &Path) -> Option<WireError> {
        let above = path.parent()?;
        match self.world.seen_at(asks, &above) {
            Some(_) => self.world.tree.parent_for(path).err(),
            None => {
                let text = format!("there is no context {above}");
                Some(WireError::new(Code::UNKNOWN_PATH, text).slot("context"))
            }
        }
    }

    /// Whether a peer may hear of facts about a path, where something is or was.
    pub fn may_audit(&mut self, now: Micros, peer: PeerId, path: &Path) -> bool {
        let world = &self.world;
        let at = world.tree.find_or_above(path).map(|context| context.number);
        let Some(at) = at.filter(|_| world.peers.get(peer).is_some()) else {
            return false;
        };
        let wish = Wish {
            path: Some(path),
            ..Wish::new(Verb::Audit, at)
        };
        self.at(now, |hub| {
            !hub.world.is_hidden(peer, at) && hub.world.suppose(peer, &wish).is_allow()
        })
    }

    /// The user of a peer, as it is now.
    pub fn user_of(&self, peer: PeerId) -> Option<User> {
        let facts = &self.world.peers.get(peer)?.facts;
        Some(User {
            name: facts.user.to_string(),
            level: facts.level,
            groups: facts.groups.to_vec(),
            details: Map::new(),
        })
    }

    /// Looks at it as it is at a time, before deadlines that have come are acted upon.
    fn at<T>(&mut self, now: Micros, look: impl FnOnce(&mut Hub) -> T) -> T {
        let before = self.world.now;
        self.world.now = before.max(now);
        let seen = look(self);
        self.world.now = before;
        seen
    }
}
