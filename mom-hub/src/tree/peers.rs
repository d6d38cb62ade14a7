//! The peers that have logged in, and their names.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use mom_managers::PeerFacts;
use mom_proto::{ContextNumber, Map, Micros, numbered_name};

use super::clock::PeerClock;
use crate::PeerId;

/// A user as the login found it (M13).
#[derive(Clone, Debug, PartialEq)]
pub struct User {
    /// The name.
    pub name: String,
    /// The authority level; higher is more.
    pub level: i32,
    /// The groups.
    pub groups: Vec<String>,
    /// Preferences and personal information, for the login reply.
    pub details: Map,
}

/// A peer that has logged in.
#[derive(Debug)]
pub(crate) struct Peer {
    pub(crate) facts: Arc<PeerFacts>,
    pub(crate) joined: BTreeSet<ContextNumber>,
    pub(crate) owns: BTreeSet<ContextNumber>,
    /// Tokens that it waits for, asks for, is offered, has lent, or holds together with others.
    pub(crate) involved: BTreeSet<ContextNumber>,
    /// Its clock, as known at its last request, and when that was.
    pub(crate) clock: Option<(PeerClock, Micros)>,
}

/// All peers by connection and by name.
#[derive(Debug, Default)]
pub(crate) struct Peers {
    by_id: BTreeMap<PeerId, Peer>,
    by_name: BTreeMap<Arc<str>, PeerId>,
    // Names that their peers gave up: until when they rest, and for which user.
    resting: BTreeMap<Arc<str>, (Micros, Arc<str>)>,
    /// The same by time, so that each login looks only at rests that are over.
    rest_ends: BTreeSet<(Micros, Arc<str>)>,
    /// The lowest number that may be free, for nicknames with many peers.
    crowded: BTreeMap<Arc<str>, u32>,
}

/// Peers of one nickname from which on that number is remembered.
const CROWD: u32 = 16;

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
        self.end_rests(now);
        let name = self.free_name(nickname, &user.name);
        self.end_rest(&name);
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
        let name = &gone.facts.name;
        self.end_rest(name);
        self.rest_ends.insert((rest_until, Arc::clone(name)));
        let rest = (rest_until, Arc::clone(&gone.facts.user));
        self.resting.insert(Arc::clone(name), rest);
        let (nickname, count) = split_name(name);
        if let Some(taken) = self.crowded.get_mut(nickname) {
            *taken = count.min(*taken);
            if *taken < CROWD {
                self.crowded.remove(nickname);
            }
        }
        Some(gone)
    }

    fn free_name(&mut self, nickname: &str, user: &str) -> Arc<str> {
        let known = self.crowded.get(nickname).copied();
        let mut taken = known.unwrap_or(1);
        while self.by_name.contains_key(&*numbered_name(nickname, taken)) {
            taken += 1;
        }
        if taken >= CROWD && known != Some(taken) {
            self.crowded.insert(nickname.into(), taken);
        }
        // A user's own name is free for that user at once: whoever comes back is the same person.
        let free = |name: &str| {
            !self.by_name.contains_key(name)
                && self.resting.get(name).is_none_or(|(_, whose)| **whose == *user)
        };
        let names = (taken..).map(|count| numbered_name(nickname, count));
        let mut free = names.filter(|name| free(name));
        free.next().map_or_else(|| nickname.into(), Into::into)
    }

    /// Ends the rests that are over.
    fn end_rests(&mut self, now: Micros) {
        while self.rest_ends.first().is_some_and(|(until, _)| *until <= now) {
            if let Some((_, name)) = self.rest_ends.pop_first() {
                self.resting.remove(&name);
            }
        }
    }

    fn end_rest(&mut self, name: &Arc<str>) {
        if let Some((until, _)) = self.resting.remove(name) {
            self.rest_ends.remove(&(until, Arc::clone(name)));
        }
    }
}

/// The nickname and the number of a name.
fn split_name(name: &str) -> (&str, u32) {
    let numbered = name.rsplit_once('~');
    let numbered = numbered.and_then(|(nickname, count)| Some((nickname, count.parse().ok()?)));
    numbered.unwrap_or((name, 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn user(name: &str) -> User {
        User {
            name: name.to_owned(),
            level: 1,
            groups: vec![],
            details: Map::new(),
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

    #[test]
    fn the_lowest_number_is_given_however_many_have_a_nickname() {
        let mut peers = Peers::default();
        let add = |peers: &mut Peers, id, by: &str, now| {
            let facts = peers.add(PeerId(id), user(by), "ally", now);
            facts.name.to_string()
        };
        for id in 1..=100 {
            let name = add(&mut peers, id, "bob", 0);
            assert_eq!(name, numbered_name("ally", u32::try_from(id).unwrap()));
        }
        for id in [90, 40, 7] {
            peers.remove(PeerId(id), 60);
        }
        assert_eq!(add(&mut peers, 101, "carol", 59), "ally~101", "they rest");
        assert_eq!(add(&mut peers, 102, "bob", 59), "ally~7", "its own");
        assert_eq!(add(&mut peers, 103, "carol", 60), "ally~40");
        assert_eq!(add(&mut peers, 104, "carol", 60), "ally~90");
        assert_eq!(add(&mut peers, 105, "carol", 60), "ally~102");
        for id in 1..=105 {
            peers.remove(PeerId(id), 120);
        }
        assert!(peers.crowded.is_empty(), "{:?}", peers.crowded);
        assert_eq!(add(&mut peers, 106, "carol", 120), "ally");
        assert!(peers.resting.is_empty() && peers.rest_ends.is_empty());
    }
}
