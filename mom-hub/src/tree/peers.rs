//! The peers that have logged in, and their names.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use mom_managers::PeerFacts;
use mom_proto::{ContextNumber, Map, Micros, folds_of, numbered_name};

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
    /// Channels of these in which it is a device.
    pub(crate) moves_in: BTreeSet<ContextNumber>,
    /// Bytes of its cards there.
    pub(crate) card_bytes: usize,
    pub(crate) owns: BTreeSet<ContextNumber>,
    /// Tokens that it waits for, asks for, is offered, has lent, or holds together with others.
    pub(crate) involved: BTreeSet<ContextNumber>,
    /// Its clock, as known at its last request, and when that was.
    pub(crate) clock: Option<(PeerClock, Micros)>,
    /// Until when it may come back, if its connection is lost.
    pub(crate) lost: Option<Micros>,
}

impl Peer {
    /// One that is nowhere yet.
    fn new(facts: Arc<PeerFacts>) -> Peer {
        Peer {
            facts,
            joined: BTreeSet::new(),
            moves_in: BTreeSet::new(),
            card_bytes: 0,
            owns: BTreeSet::new(),
            involved: BTreeSet::new(),
            clock: None,
            lost: None,
        }
    }

    /// Notes that it is in a context no more.
    pub(crate) fn left(&mut self, number: ContextNumber) {
        self.joined.remove(&number);
        self.moves_in.remove(&number);
    }
}

/// All peers by connection and by name.
#[derive(Debug, Default)]
pub(crate) struct Peers {
    /// Boxed: peers come in the order of their numbers, which leaves each node of the tree half empty.
    by_id: BTreeMap<PeerId, Box<Peer>>,
    by_name: BTreeMap<Arc<str>, PeerId>,
    /// Names that their peers gave up.
    resting: BTreeMap<Arc<str>, Rest>,
    /// The same by time, so that each login looks only at rests that are over.
    rest_ends: BTreeSet<(Micros, Arc<str>)>,
    /// The same by user, the longest at rest first.
    rests_of: BTreeMap<Arc<str>, BTreeSet<(Micros, Arc<str>)>>,
    /// All these names, present and at rest, by each form in which one could be taken for another.
    by_fold: BTreeMap<Arc<str>, Arc<str>>,
    /// The lowest number that may be free, for nicknames with many peers, by their first form.
    crowded: BTreeMap<String, u32>,
}

/// A name at rest.
#[derive(Debug)]
struct Rest {
    until: Micros,
    /// The user who may have it at once.
    user: Arc<str>,
}

/// Peers of one nickname from which on that number is remembered.
const CROWD: u32 = 16;

/// Names of one user that rest at a time; of more, the first may be had by others before its time. So a user that comes and
/// goes under ever new names fills nobody's memory, and loses but its own.
const RESTING: usize = 256;

impl Peers {
    pub(crate) fn get(&self, peer: PeerId) -> Option<&Peer> {
        self.by_id.get(&peer).map(Box::as_ref)
    }

    pub(crate) fn get_mut(&mut self, peer: PeerId) -> Option<&mut Peer> {
        self.by_id.get_mut(&peer).map(Box::as_mut)
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (PeerId, &Peer)> {
        self.by_id.iter().map(|(id, peer)| (*id, &**peer))
    }

    pub(crate) fn id_of(&self, name: &str) -> Option<PeerId> {
        self.by_name.get(name).copied()
    }

    /// Adds a peer under the nickname if it is free, else with `~2`, `~3` …
    pub(crate) fn add(&mut self, peer: PeerId, user: User, nickname: &str, now: Micros) -> Arc<PeerFacts> {
        self.end_rests(now);
        let (name, folds) = self.free_name(nickname, &user.name);
        for fold in folds {
            // What rests in this form was the same user's, or it would not be free.
            if let Some(rested) = self.by_fold.get(fold.as_str()).map(Arc::clone) {
                self.end_rest(&rested);
            }
            // Most names are their own first form.
            let fold = match *fold == *name {
                true => Arc::clone(&name),
                false => fold.into(),
            };
            self.by_fold.insert(fold, Arc::clone(&name));
        }
        let facts = Arc::new(PeerFacts {
            name: Arc::clone(&name),
            user: user.name.into(),
            level: user.level,
            groups: user.groups.into(),
        });
        self.by_name.insert(name, peer);
        self.by_id.insert(peer, Box::new(Peer::new(Arc::clone(&facts))));
        facts
    }

    /// Adds a peer for the length of one question, under a name that nobody hears of; [`Peers::take_back`] removes it again.
    pub(crate) fn lend(&mut self, peer: PeerId, user: &User) {
        let facts = PeerFacts {
            name: user.name.as_str().into(),
            user: user.name.as_str().into(),
            level: user.level,
            groups: user.groups.clone().into(),
        };
        self.by_id.insert(peer, Box::new(Peer::new(Arc::new(facts))));
    }

    /// Removes what was lent.
    pub(crate) fn take_back(&mut self, peer: PeerId) {
        self.by_id.remove(&peer);
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
    pub(crate) fn remove(&mut self, peer: PeerId, rest_until: Micros) -> Option<Box<Peer>> {
        let gone = self.by_id.remove(&peer)?;
        let (name, user) = (&gone.facts.name, &gone.facts.user);
        self.by_name.remove(name);
        let rest = Rest {
            until: rest_until,
            user: Arc::clone(user),
        };
        self.resting.insert(Arc::clone(name), rest);
        self.rest_ends.insert((rest_until, Arc::clone(name)));
        let rests = self.rests_of.entry(Arc::clone(user)).or_default();
        rests.insert((rest_until, Arc::clone(name)));
        if rests.len() > RESTING
            && let Some((_, first)) = rests.first().cloned()
        {
            self.end_rest(&first);
        }
        let (nickname, count) = split_name(name);
        for fold in folds_of(nickname) {
            if let Some(taken) = self.crowded.get_mut(&fold) {
                *taken = count.min(*taken);
                if *taken < CROWD {
                    self.crowded.remove(&fold);
                }
            }
        }
        Some(gone)
    }

    /// The first name of a nickname that could be taken for nobody else's, and its forms.
    fn free_name(&mut self, nickname: &str, user: &str) -> (Arc<str>, Vec<String>) {
        let folds = folds_of(nickname);
        let known = self.crowded.get(&folds[0]).copied();
        let mut taken = known.unwrap_or(1);
        while self.is_present(&folds, taken) {
            taken += 1;
        }
        if taken >= CROWD && known != Some(taken) {
            self.crowded.insert(folds[0].clone(), taken);
        }
        while !self.is_free(&folds, taken, user) {
            taken += 1;
        }
        let folds = folds.iter().map(|fold| numbered_name(fold, taken)).collect();
        (numbered_name(nickname, taken).into(), folds)
    }

    /// Whether a peer that is here has such a name.
    fn is_present(&self, folds: &[String], count: u32) -> bool {
        let name = |fold: &String| self.by_fold.get(numbered_name(fold, count).as_str());
        let mut names = folds.iter().filter_map(name);
        names.any(|name| self.by_name.contains_key(name))
    }

    /// Whether a user may have such a name. One that rests is free for the same user at once: a peer that comes back is the
    /// same person.
    fn is_free(&self, folds: &[String], count: u32, user: &str) -> bool {
        let name = |fold: &String| self.by_fold.get(numbered_name(fold, count).as_str());
        let mut names = folds.iter().filter_map(name);
        names.all(|name| self.resting.get(name).is_some_and(|rest| *rest.user == *user))
    }

    /// Ends the rests that are over.
    fn end_rests(&mut self, now: Micros) {
        while let Some((until, name)) = self.rest_ends.first()
            && *until <= now
        {
            let name = Arc::clone(name);
            self.end_rest(&name);
        }
    }

    fn end_rest(&mut self, name: &Arc<str>) {
        let Some(rest) = self.resting.remove(name) else {
            return;
        };
        let end = (rest.until, Arc::clone(name));
        self.rest_ends.remove(&end);
        if let Some(rests) = self.rests_of.get_mut(&rest.user) {
            rests.remove(&end);
            if rests.is_empty() {
                self.rests_of.remove(&rest.user);
            }
        }
        let (nickname, count) = split_name(name);
        for fold in folds_of(nickname) {
            let fold = numbered_name(&fold, count);
            if self.by_fold.get(fold.as_str()) == Some(name) {
                self.by_fold.remove(fold.as_str());
            }
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
        assert!(peers.resting.is_empty() && peers.rest_ends.is_empty() && peers.rests_of.is_empty());
        assert_eq!(peers.by_fold.len(), 1);
    }

    #[test]
    fn a_name_is_nobody_elses_in_any_form() {
        let mut peers = Peers::default();
        let name = |facts: Arc<PeerFacts>| facts.name.to_string();
        assert_eq!(name(peers.add(PeerId(1), user("guest"), "anna", 0)), "anna");
        assert_eq!(name(peers.add(PeerId(2), user("guest"), "Anna", 0)), "Anna~2");
        assert_eq!(
            name(peers.add(PeerId(3), user("bob"), "\u{430}nn\u{430}", 0)),
            "\u{430}nn\u{430}~3"
        );
        assert!(peers.remove(PeerId(1), 60).is_some());
        assert_eq!(name(peers.add(PeerId(4), user("bob"), "ANNA", 59)), "ANNA~4");
        assert_eq!(
            name(peers.add(PeerId(5), user("guest"), "ANNA", 59)),
            "ANNA",
            "its own"
        );
        assert_eq!(name(peers.add(PeerId(6), user("guest"), "anna", 59)), "anna~5");
        for id in 2..=6 {
            assert!(peers.remove(PeerId(id), 120).is_some());
        }
        assert_eq!(name(peers.add(PeerId(7), user("bob"), "anna", 120)), "anna");
        assert_eq!(peers.by_fold.len(), 1, "{:?}", peers.by_fold);
    }

    /// Part of threat 42: who comes and goes under ever new names has so many of them at rest, and takes no other's.
    #[test]
    fn so_many_names_of_one_user_rest() {
        let mut peers = Peers::default();
        peers.add(PeerId(1), user("alice"), "ally", 0);
        peers.remove(PeerId(1), 60);
        for id in 2..1000 {
            peers.add(PeerId(id), user("guest"), &format!("name-{id}"), 1);
            peers.remove(PeerId(id), 61 + id);
        }
        assert_eq!(peers.resting.len(), RESTING + 1);
        assert!(
            peers.by_fold.len() <= 3 * (RESTING + 1),
            "{}",
            peers.by_fold.len()
        );
        let name = |facts: Arc<PeerFacts>| facts.name.to_string();
        assert_eq!(name(peers.add(PeerId(1000), user("guest"), "ally", 59)), "ally~2");
        assert_eq!(name(peers.add(PeerId(1001), user("bob"), "name-2", 59)), "name-2");
        assert_eq!(
            name(peers.add(PeerId(1002), user("bob"), "name-999", 59)),
            "name-999~2"
        );
    }
}
