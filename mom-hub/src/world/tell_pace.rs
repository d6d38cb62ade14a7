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

/// The fewest times at once that a slow device leaves: who takes it, gives it up and takes it again is no attacker.
const LEAST_AT_ONCE: u64 = 4;

/// Entries from which on it is looked for those that are paid back.
const MANY: usize = 64;

/// What others are told of; each is counted apart, so that who uses up one, as all guests may together, has the others still.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Told {
    /// Who comes to a context, or leaves it.
    Presence(ContextNumber),
    /// Whose a token is.
    Owner(ContextNumber),
    /// That stops of a channel, or of all below a session, are lifted.
    Unstop(ContextNumber),
    /// That somebody wants something of this peer: its token, that it takes one, that it comes.
    Wish(PeerId),
}

impl Told {
    /// The time after which one more is told, µs.
    fn each(self) -> Micros {
        match self {
            // Links of one user's robots that are lost and come back are told by it, too.
            Told::Owner(_) | Told::Presence(_) => 50_000,
            Told::Unstop(_) => 250_000,
            // What people or agents answer.
            Told::Wish(_) => 1_000_000,
        }
    }

    /// About how many bytes a device gets of one: a change of owner is `halt`, `released` and `grabbed`, and what nobody answers lapses.
    fn bytes(self) -> u64 {
        match self {
            Told::Owner(_) => 800,
            Told::Presence(_) => 200,
            Told::Unstop(_) | Told::Wish(_) => 400,
        }
    }

    /// How often one user may have it told where devices read so many bytes in a second: an eighth of that in the long run, half a second's at once.
    fn terms(self, reads: Option<u32>) -> Terms {
        let usual = Terms {
            at_once: AT_ONCE,
            each: self.each(),
        };
        let Some(reads) = reads.map(u64::from) else {
            return usual;
        };
        Terms {
            at_once: (reads / 2 / self.bytes()).clamp(LEAST_AT_ONCE, usual.at_once),
            each: (self.bytes() * 8_000_000 / reads.max(1)).max(usual.each),
        }
    }
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
    of: BTreeMap<(Told, Arc<str>), Micros>,
    /// Entries that were left when it was last looked through.
    left: usize,
}

impl TellPace {
    /// Counts one; `reads` = bytes that the devices that are told read in a second, as far as known.
    ///
    /// # Errors
    /// It was one too many, and is not counted.
    pub(crate) fn take(
        &mut self,
        told: Told,
        user: &Arc<str>,
        reads: Option<u32>,
        now: Micros,
    ) -> Result<(), TooOften> {
        if self.of.len() >= MANY.max(2 * self.left) {
            self.of.retain(|_, paid_at| *paid_at > now);
            self.left = self.of.len();
        }
        let terms = told.terms(reads);
        let paid_at = self.of.entry((told, Arc::clone(user))).or_default();
        let mut used = Gcra::paid_at(*paid_at);
        used.take(&terms.pace(), 1, now)
            .map_err(|wait| TooOften::new(terms, wait))?;
        *paid_at = used.next(&terms.pace());
        Ok(())
    }

    /// Whether a user has had it told lately.
    fn owes(&self, told: Told, user: &Arc<str>, now: Micros) -> bool {
        let paid_at = self.of.get(&(told, Arc::clone(user)));
        paid_at.is_some_and(|paid_at| *paid_at > now)
    }

    /// Checks that one more would not be too many.
    fn check(&self, told: Told, user: &Arc<str>, reads: Option<u32>, now: Micros) -> Result<(), TooOften> {
        let terms = told.terms(reads);
        let paid_at = self.of.get(&(told, Arc::clone(user)));
        let used = Gcra::paid_at(paid_at.copied().unwrap_or_default());
        used.peek(&terms.pace(), 1, now)
            .map_err(|wait| TooOften::new(terms, wait))
    }
}

/// Somebody has had others told of it too often.
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
            "{user} {what} more than {at_once} times at once and once each {} ms, and others hear of each time",
            each / 1000
        );
        WireError::new(Code::TRY_LATER, text).retry_after(Duration::from_micros(self.wait))
    }
}

/// Those for whom it matters that they hear other things, too, among who is told of a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Hearers {
    /// Bytes that the slowest of the devices among them reads in a second, as far as known.
    reads: Option<u32>,
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
        let told = Told::Owner(token);
        let Some(user) = user.filter(|user| self.tell_pace.owes(told, user, self.now)) else {
            return Ok(());
        };
        match self.hearers(token, &user) {
            Some(Hearers { reads }) => self.tell_pace.check(told, &user, reads, self.now),
            None => Ok(()),
        }
    }

    /// Counts that a token is a peer's from now on.
    pub(crate) fn count_change(&mut self, peer: PeerId, token: ContextNumber) {
        if let Some(user) = self.user_of(peer) {
            let hearers = self.hearers(token, &user);
            let reads = hearers.and_then(|hearers| hearers.reads);
            // One that is not refused any more is too many for the next.
            let _ = self.tell_pace.take(Told::Owner(token), &user, reads, self.now);
        }
    }

    /// Whether it is told by name that a user comes to a context, or leaves it.
    pub(crate) fn count_presence(&mut self, number: ContextNumber, user: &Arc<str>) -> Result<(), TooOften> {
        let told = Told::Presence(number);
        let owes = self.tell_pace.owes(told, user, self.now);
        let reads = if owes { self.slowest_in(number) } else { None };
        self.tell_pace.take(told, user, reads, self.now)
    }

    /// Counts that a user wants something, of which others are told.
    ///
    /// # Errors
    /// It was one too many.
    pub(crate) fn count_wish(&mut self, peer: PeerId, told: Told, what: &str) -> Result<(), WireError> {
        let Some(user) = self.user_of(peer) else {
            return Ok(());
        };
        let reads = match told {
            Told::Wish(to) => self.reads(to),
            Told::Presence(number) | Told::Owner(number) | Told::Unstop(number) => self.slowest_in(number),
        };
        let taken = self.tell_pace.take(told, &user, reads, self.now);
        taken.map_err(|too_often| too_often.refusal(&user, what))
    }

    fn user_of(&self, peer: PeerId) -> Option<Arc<str>> {
        let known = self.peers.get(peer)?;
        Some(Arc::clone(&known.facts.user))
    }

    /// The devices and owners of other users that are told whose a token is; none if there are none.
    fn hearers(&self, token: ContextNumber, user: &Arc<str>) -> Option<Hearers> {
        let guarded = self.token(token).into_iter().flat_map(|token| &token.guarded);
        let places = guarded.copied().chain([token]);
        let members = places.filter_map(|place| self.tree.get(place));
        let peers = members
            .flat_map(|place| place.members.keys())
            .filter_map(|peer| self.peers.get(*peer));
        let matter = peers
            .filter(|peer| !peer.moves_in.is_empty() || (!peer.owns.is_empty() && peer.facts.user != *user));
        let slowest = matter.map(|peer| self.reads_of(peer));
        let slowest = slowest.reduce(|one, other| one.into_iter().chain(other).min());
        slowest.map(|reads| Hearers { reads })
    }

    /// Bytes that the slowest device of a context's members reads in a second, as far as known.
    fn slowest_in(&self, number: ContextNumber) -> Option<u32> {
        let members = self
            .tree
            .get(number)
            .into_iter()
            .flat_map(|place| place.members.keys());
        members.filter_map(|peer| self.reads(*peer)).min()
    }

    fn reads(&self, peer: PeerId) -> Option<u32> {
        self.reads_of(self.peers.get(peer)?)
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

    #[test]
    fn each_user_has_his_own_and_nothing_is_kept_of_who_rests() {
        let mut pace = TellPace::default();
        let (here, there) = (Told::Owner(ContextNumber(1)), Told::Unstop(ContextNumber(1)));
        let [alice, bob]: [Arc<str>; 2] = ["alice".into(), "bob".into()];
        let mut taken = |context, user, now| {
            (0..200)
                .filter(|_| pace.take(context, user, None, now).is_ok())
                .count()
        };
        assert_eq!(taken(here, &alice, 1), 100);
        assert_eq!(taken(here, &bob, 1), 100);
        assert_eq!(taken(there, &alice, 1), 100);
        assert_eq!(taken(here, &alice, 1_000_001), 20);
        for user in 0..1000_u32 {
            let now = 60_000_000 + u64::from(user) * here.each();
            assert_eq!(pace.take(here, &user.to_string().into(), None, now), Ok(()));
        }
        assert!(pace.of.len() <= MANY, "{}", pace.of.len());
    }

    /// An eighth of what a device reads, and half a second's worth at once.
    #[test]
    fn a_slow_device_hears_less_of_others() {
        let (owner, presence) = (Told::Owner(ContextNumber(1)), Told::Presence(ContextNumber(1)));
        let terms = |at_once, each| Terms { at_once, each };
        assert_eq!(owner.terms(None), terms(100, 50_000));
        assert_eq!(presence.terms(None), terms(100, 50_000));
        assert_eq!(owner.terms(Some(60_000)), terms(37, 106_666));
        assert_eq!(presence.terms(Some(60_000)), terms(100, 50_000));
        assert_eq!(owner.terms(Some(6000)), terms(4, 1_066_666));
        assert_eq!(presence.terms(Some(6000)), terms(15, 266_666));
        assert_eq!(owner.terms(Some(u32::MAX)), owner.terms(None));
    }
}
