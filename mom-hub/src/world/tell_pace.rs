//! How often one user may have others told of the same thing, so that they, and the devices among them, hear something else, too.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use mom_proto::{Code, ContextNumber, Gcra, Micros, Pace, Wait, WireError};

use super::World;
use crate::PeerId;
use crate::tree::peers::Peer;

/// The most times at once.
const AT_ONCE: u64 = 100;

/// The fewest times at once that a slow device leaves: who takes it, gives it up and takes it again is not an attacker.
const LEAST_AT_ONCE: u64 = 4;

/// Entries from which on it is looked for those that are paid back.
const MANY: usize = 64;

/// What others are told of; each is counted apart, so that who uses up one, as all guests may together, has the others still.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum What {
    /// Who comes to a context, leaves it, or is put out of it.
    Presence,
    /// Whose a token is.
    Owner,
    /// That stops of a channel, or of all below a session, are lifted.
    Unstop,
    /// A request to this peer: its token, that it takes one, that it comes.
    Wish,
}

impl What {
    /// The time after which one more is told, µs.
    fn each(self) -> Micros {
        match self {
            // Links of one user's robots that are lost and come back are told by it, too.
            What::Owner | What::Presence => 50_000,
            What::Unstop => 250_000,
            // What people or agents answer.
            What::Wish => 1_000_000,
        }
    }

    /// About how many bytes a device gets of one before all commands: a change of owner is `halt`, `released` and `grabbed`. None of what
    /// the broker lets wait behind commands.
    fn bytes(self) -> Option<u64> {
        match self {
            What::Owner => Some(800),
            What::Unstop => Some(200),
            What::Presence | What::Wish => None,
        }
    }

    /// How often one user may have it told where devices read so many bytes in a second: an eighth of that in the long
    /// run, half a second's at once.
    fn terms(self, reads: Option<u32>) -> Terms {
        let usual = Terms {
            at_once: AT_ONCE,
            each: self.each(),
        };
        let Some((reads, bytes)) = reads.map(u64::from).zip(self.bytes()) else {
            return usual;
        };
        Terms {
            at_once: (reads / 2 / bytes).clamp(LEAST_AT_ONCE, usual.at_once),
            each: (bytes * 8_000_000 / reads.max(1)).max(usual.each),
        }
    }
}

/// Where it is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum At {
    In(ContextNumber),
    /// To a peer: who is asked, or the slowest device that hears of it, wherever it does.
    To(PeerId),
}

/// What is told, where, and to a device that reads how much.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Told {
    what: What,
    place: At,
    reads: Option<u32>,
}

impl Told {
    fn new(what: What, place: At) -> Told {
        Told {
            what,
            place,
            reads: None,
        }
    }

    /// The same, where a device hears of it of which it is known how fast it reads.
    fn to(self, slowest: Option<Slowest>) -> Told {
        match slowest {
            Some(Slowest { reads, peer }) => Told {
                place: At::To(peer),
                reads: Some(reads),
                ..self
            },
            None => self,
        }
    }

    fn terms(self) -> Terms {
        self.what.terms(self.reads)
    }
}

/// The slowest of the devices of which it is known how fast they read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Slowest {
    /// Bytes in a second.
    reads: u32,
    peer: PeerId,
}

/// So many at once, and one each so many µs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Terms {
    at_once: u64,
    each: Micros,
}

impl Terms {
    fn pace(self) -> Pace {
        Pace::every(self.each, self.at_once)
    }
}

/// What users have had others told of lately.
#[derive(Debug, Default)]
pub(crate) struct TellPace {
    /// When each is paid back.
    of: BTreeMap<(What, At, Arc<str>), Micros>,
    /// Entries that were left when it was last looked through.
    left: usize,
}

impl TellPace {
    /// Counts one.
    ///
    /// # Errors
    /// It was one too many, and is not counted.
    fn take(&mut self, told: Told, user: &Arc<str>, now: Micros) -> Result<(), TooOften> {
        if self.of.len() >= MANY.max(2 * self.left) {
            self.of.retain(|_, paid_at| *paid_at > now);
            self.left = self.of.len();
        }
        let terms = told.terms();
        let key = (told.what, told.place, Arc::clone(user));
        let paid_at = self.of.entry(key).or_default();
        let mut used = Gcra::paid_at(*paid_at);
        used.take(&terms.pace(), 1, now)
            .map_err(|wait| TooOften::new(terms, wait))?;
        *paid_at = used.next(&terms.pace());
        Ok(())
    }

    /// Checks that one more would not be too many.
    fn check(&self, told: Told, user: &Arc<str>, now: Micros) -> Result<(), TooOften> {
        let terms = told.terms();
        let paid_at = self.of.get(&(told.what, told.place, Arc::clone(user)));
        let used = Gcra::paid_at(paid_at.copied().unwrap_or_default());
        used.peek(&terms.pace(), 1, now)
            .map_err(|wait| TooOften::new(terms, wait))
    }
}

/// A user has had others told of it too often.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TooOften {
    terms: Terms,
    /// The time after which it would not be, µs.
    pub(crate) wait: Micros,
}

impl TooOften {
    fn new(terms: Terms, wait: Wait) -> TooOften {
        let wait = match wait {
            Wait::For(time) => time,
            Wait::Never => terms.each,
        };
        TooOften { terms, wait }
    }

    /// What who has done this is told.
    fn refusal(self, user: &str, what: &str) -> WireError {
        let Terms { at_once, each } = self.terms;
        let text = format!(
            "{user} {what} more than {at_once} times at once and once each {} ms; others are told each time",
            each / 1000
        );
        WireError::new(Code::TRY_LATER, text).retry_after(Duration::from_micros(self.wait))
    }
}

impl World {
    /// Checks that a user does not have devices and owners told of a token all the time: each change is told before all commands. What
    /// changes nothing is not counted.
    pub(crate) fn check_tell_pace(&self, peer: PeerId, token: ContextNumber) -> Result<(), WireError> {
        let Some(user) = self.user_of(peer) else {
            return Ok(());
        };
        let checked = self.check_turn(peer, token);
        checked.map_err(|too_often| too_often.refusal(&user, "takes this"))
    }

    /// The same, for a grab that waits for its turn anyway.
    pub(crate) fn check_turn(&self, peer: PeerId, token: ContextNumber) -> Result<(), TooOften> {
        let user = self.user_of(peer).filter(|_| self.owner_of(token) != Some(peer));
        // Nobody has had anybody told of anything lately.
        let Some(user) = user.filter(|_| !self.tell_pace.of.is_empty()) else {
            return Ok(());
        };
        match self.hearers(token, &user) {
            Some(told) => self.tell_pace.check(told, &user, self.now),
            None => Ok(()),
        }
    }

    /// Counts that a token is a peer's from now on.
    pub(crate) fn count_change(&mut self, peer: PeerId, token: ContextNumber) {
        if let Some(user) = self.user_of(peer) {
            let told = self.hearers(token, &user);
            let told = told.unwrap_or(Told::new(What::Owner, At::In(token)));
            // One that is not refused any more is too many for the next.
            let _ = self.tell_pace.take(told, &user, self.now);
        }
    }

    /// Whether it is told by name that a user comes to a context, or leaves it.
    pub(crate) fn count_presence(&mut self, number: ContextNumber, user: &Arc<str>) -> Result<(), TooOften> {
        let told = Told::new(What::Presence, At::In(number));
        self.tell_pace.take(told, user, self.now)
    }

    /// Whether it is told by name that a peer puts another one out of a context.
    pub(crate) fn count_expulsion(&mut self, number: ContextNumber, by: PeerId) -> Result<(), TooOften> {
        match self.user_of(by) {
            Some(user) => self.count_presence(number, &user),
            None => Ok(()),
        }
    }

    /// Counts that a user lifts stops of a channel, or of all below a session.
    ///
    /// # Errors
    /// It was one too many.
    pub(crate) fn count_unstop(&mut self, peer: PeerId, number: ContextNumber) -> Result<(), WireError> {
        let told = Told::new(What::Unstop, At::In(number)).to(self.slowest_of(self.members(number)));
        self.count(peer, told, "lifts stops here")
    }

    /// Counts that a user wants something of a peer.
    ///
    /// # Errors
    /// It was one too many.
    pub(crate) fn count_wish(&mut self, peer: PeerId, to: PeerId) -> Result<(), WireError> {
        self.count(peer, Told::new(What::Wish, At::To(to)), "asks this peer")
    }

    fn count(&mut self, peer: PeerId, told: Told, words: &str) -> Result<(), WireError> {
        let Some(user) = self.user_of(peer) else {
            return Ok(());
        };
        let taken = self.tell_pace.take(told, &user, self.now);
        taken.map_err(|too_often| too_often.refusal(&user, words))
    }

    fn user_of(&self, peer: PeerId) -> Option<Arc<str>> {
        let known = self.peers.get(peer)?;
        Some(Arc::clone(&known.facts.user))
    }

    /// That devices, or owners of other users, are told whose a token is; none if there are none of these.
    fn hearers(&self, token: ContextNumber, user: &Arc<str>) -> Option<Told> {
        let guarded = self.token(token).into_iter().flat_map(|token| &token.guarded);
        let places = guarded.copied().chain([token]);
        let peers = places.flat_map(|place| self.members(place));
        let matters = |peer: &PeerId| {
            self.peers.get(*peer).is_some_and(|peer| {
                !peer.moves_in.is_empty() || (!peer.owns.is_empty() && peer.facts.user != *user)
            })
        };
        let matter: Vec<PeerId> = peers.filter(matters).collect();
        let slowest = self.slowest_of(matter.iter().copied());
        (!matter.is_empty()).then(|| Told::new(What::Owner, At::In(token)).to(slowest))
    }

    fn members(&self, number: ContextNumber) -> impl Iterator<Item = PeerId> {
        let place = self.tree.get(number);
        place.into_iter().flat_map(|place| place.members.keys().copied())
    }

    fn slowest_of(&self, peers: impl IntoIterator<Item = PeerId>) -> Option<Slowest> {
        let one = |peer| {
            let reads = self.reads_of(self.peers.get(peer)?)?;
            Some(Slowest { reads, peer })
        };
        peers.into_iter().filter_map(one).min()
    }

    /// Bytes that a peer reads in a second, by the channels in which it is a device.
    fn reads_of(&self, peer: &Peer) -> Option<u32> {
        let channels = peer.moves_in.iter().filter_map(|channel| self.tree.get(*channel));
        channels.filter_map(|channel| channel.pace).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(what: What, reads: Option<u32>) -> Told {
        Told {
            reads,
            ..Told::new(what, At::In(ContextNumber(1)))
        }
    }

    #[test]
    fn each_user_has_his_own_and_nothing_is_kept_of_who_rests() {
        let mut pace = TellPace::default();
        let (here, there) = (told(What::Owner, None), told(What::Presence, None));
        let [alice, bob]: [Arc<str>; 2] = ["alice".into(), "bob".into()];
        let mut taken = |told, user, now| (0..200).filter(|_| pace.take(told, user, now).is_ok()).count();
        assert_eq!(taken(here, &alice, 1), 100);
        assert_eq!(taken(here, &bob, 1), 100);
        assert_eq!(taken(there, &alice, 1), 100);
        assert_eq!(taken(here, &alice, 1_000_001), 20);
        for user in 0..1000_u32 {
            let now = 60_000_000 + u64::from(user) * here.what.each();
            assert_eq!(pace.take(here, &user.to_string().into(), now), Ok(()));
        }
        assert!(pace.of.len() <= MANY, "{}", pace.of.len());
    }

    /// An eighth of what a device reads, and half a second's worth at once.
    #[test]
    fn a_slow_device_hears_less_of_others() {
        let terms = |at_once, each| Terms { at_once, each };
        assert_eq!(What::Owner.terms(None), terms(100, 50_000));
        assert_eq!(What::Presence.terms(None), terms(100, 50_000));
        assert_eq!(What::Owner.terms(Some(60_000)), terms(37, 106_666));
        assert_eq!(What::Owner.terms(Some(6000)), terms(4, 1_066_666));
        assert_eq!(What::Unstop.terms(Some(6000)), terms(15, 266_666));
        assert_eq!(What::Presence.terms(Some(6000)), terms(100, 50_000));
        assert_eq!(What::Owner.terms(Some(u32::MAX)), What::Owner.terms(None));
    }
}
