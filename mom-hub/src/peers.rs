//! Who is there, under which name.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use mom_managers::{Micros, PeerFacts};
use mom_proto::{ContextNumber, numbered_name};

use crate::{PeerClock, PeerId, User};

/// A peer that has logged in.
#[derive(Debug)]
pub(crate) struct Peer {
    pub(crate) facts: Arc<PeerFacts>,
    pub(crate) joined: BTreeSet<ContextNumber>,
    pub(crate) owns: BTreeSet<ContextNumber>,
    /// Tokens that it waits for, asks for, is offered, or holds together with others.
    pub(crate) involved: BTreeSet<ContextNumber>,
    /// Its clock, as known at its last request, and when that was.
    pub(crate) clock: Option<(PeerClock, Micros)>,
}

/// All peers by connection and by name.
#[derive(Debug, Default)]
pub(crate) struct Peers {
    by_id: BTreeMap<PeerId, Peer>,
    by_name: BTreeMap<Arc<str>, PeerId>,
    // A name that its peer gave up: until when, and whose it was.
    resting: BTreeMap<Arc<str>, (Micros, Arc<str>)>,
}

impl Peers {
    pub(crate) fn get(&self, peer: PeerId) -> Option<&Peer> {
        self.by_id.get(&peer)
    }

    pub(crate) fn get_mut(&mut self, peer: PeerId) -> Option<&mut Peer> {
        self.by_id.get_mut(&peer)
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (PeerId, &Peer)> {
        self.by_id.iter().map(|(id, peer)| (*id, peer))
    }

    pub(crate) fn id_of(&self, name: &str) -> Option<PeerId> {
        self.by_name.get(name).copied()
    }

    /// Adds a peer under the nickname if it is free, else with `~2`, `~3` …
    pub(crate) fn add(&mut self, peer: PeerId, user: User, nickname: &str, now: Micros) -> Arc<PeerFacts> {
        self.resting.retain(|_, (until, _)| *until > now);
        let name = self.free_name(nickname, &user.name);
        self.resting.remove(&name);
        let facts = Arc::new(PeerFacts {
            name: Arc::clone(&name),
            user: user.name.into(),
            level: user.level,
            groups: user.groups.into(),
        });
        self.by_name.insert(name, peer);
        self.by_id.insert(
            peer,
            Peer {
                facts: Arc::clone(&facts),
                joined: BTreeSet::new(),
                owns: BTreeSet::new(),
                involved: BTreeSet::new(),
                clock: None,
            },
        );
        facts
    }

    /// Gives a peer the facts of a repeated login; its name stays.
    pub(crate) fn update(&mut self, peer: PeerId, user: User) -> Option<Arc<PeerFacts>> {
        let known = self.by_id.get_mut(&peer)?;
        known.facts = Arc::new(PeerFacts {
            name: Arc::clone(&known.facts.name),
            user: user.name.into(),
            level: user.level,
            groups: user.groups.into(),
        });
        Some(Arc::clone(&known.facts))
    }

    /// Removes a peer; its name rests for other users.
    pub(crate) fn remove(&mut self, peer: PeerId, rest_until: Micros) -> Option<Peer> {
        let gone = self.by_id.remove(&peer)?;
        self.by_name.remove(&gone.facts.name);
        self.resting.insert(
            Arc::clone(&gone.facts.name),
            (rest_until, Arc::clone(&gone.facts.user)),
        );
        Some(gone)
    }

    fn free_name(&self, nickname: &str, user: &str) -> Arc<str> {
        // A user's own name is free for that user at once: whoever comes back is the same person.
        let free = |name: &str| {
            !self.by_name.contains_key(name)
                && self.resting.get(name).is_none_or(|(_, whose)| **whose == *user)
        };
        let mut count = 1;
        loop {
            let name = numbered_name(nickname, count);
            if free(&name) {
                return name.into();
            }
            count += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn user(name: &str) -> User {
        User {
            name: name.to_owned(),
            level: 1,
            groups: vec![],
            details: mom_proto::Map::new(),
        }
    }

    #[test]
    fn a_name_rests_before_another_user_has_it() {
        let mut peers = Peers::default();
        let name = |facts: Arc<PeerFacts>| facts.name.to_string();
        assert_eq!(name(peers.add(PeerId(1), user("alice"), "ally", 0)), "ally");
        assert_eq!(name(peers.add(PeerId(2), user("bob"), "ally", 0)), "ally~2");
        assert!(peers.remove(PeerId(1), 60).is_some());
        assert_eq!(name(peers.add(PeerId(3), user("bob"), "ally", 59)), "ally~3");
        assert_eq!(name(peers.add(PeerId(4), user("alice"), "ally", 59)), "ally");
        assert!(peers.remove(PeerId(4), 119).is_some());
        assert_eq!(name(peers.add(PeerId(5), user("bob"), "ally", 119)), "ally");
        assert_eq!(peers.id_of("ally"), Some(PeerId(5)));
    }
}
