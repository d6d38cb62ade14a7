//! How often one user may have others told of the same thing, so that they, and the devices among them, hear something else, too.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use mom_proto::{Code, ContextNumber, Gcra, Micros, Pace, Wait, WireError};

use super::World;
use crate::PeerId;
use crate::tree::context::Context;

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
    /// Who asks for a token.
    Asked(ContextNumber),
    /// That somebody invites this peer.
    Invited(PeerId),
}

impl Told {
    /// The time after which one more is told, µs.
    fn each(self) -> Micros {
        match self {
            Told::Owner(_) => 50_000,
            Told::Presence(_) => 250_000,
            // What people or agents answer.
            Told::Asked(_) | Told::Invited(_) => 1_000_000,
        }
    }

    /// About how many bytes a device gets of one: a change of owner is `halt`, `released` and `grabbed`.
    fn bytes(self) -> u64 {
        match self {
            Told::Owner(_) => 800,
            Told::Presence(_) => 200,
            Told::Asked(_) | Told::Invited(_) => 400,
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

impl World {
    /// Checks that a user does not have a device told of its token all the time: each change is told before all commands. What changes nothing
    /// is not counted.
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
        let Some(user) = user.filter(|_| self.moves_devices(token)) else {
            return Ok(());
        };
        let reads = self.slowest_guarded(token);
        self.tell_pace.check(Told::Owner(token), &user, reads, self.now)
    }

    /// Counts that a token is a peer's from now on.
    pub(crate) fn count_change(&mut self, peer: PeerId, token: ContextNumber) {
        if let Some(user) = self.user_of(peer) {
            let reads = self.slowest_guarded(token);
            // One that is not refused any more is too many for the next.
            let _ = self.tell_pace.take(Told::Owner(token), &user, reads, self.now);
        }
    }

    /// Whether it is told by name that a user comes to a context, or leaves it.
    pub(crate) fn count_presence(&mut self, number: ContextNumber, user: &Arc<str>) -> Result<(), TooOften> {
        let reads = self.tree.get(number).and_then(|context| context.pace);
        self.tell_pace.take(Told::Presence(number), user, reads, self.now)
    }

    /// Counts that a user wants something, of which others are told.
    ///
    /// # Errors
    /// It was one too many.
    pub(crate) fn count_wish(&mut self, peer: PeerId, told: Told, what: &str) -> Result<(), WireError> {
        let Some(user) = self.user_of(peer) else {
            return Ok(());
        };
        let taken = self.tell_pace.take(told, &user, None, self.now);
        taken.map_err(|too_often| too_often.refusal(&user, what))
    }

    fn user_of(&self, peer: PeerId) -> Option<Arc<str>> {
        let known = self.peers.get(peer)?;
        Some(Arc::clone(&known.facts.user))
    }

    /// Whether a device is where a token guards.
    fn moves_devices(&self, token: ContextNumber) -> bool {
        let mut channels = self.guarded(token);
        channels.any(|channel| channel.members.values().any(|member| member.device))
    }

    /// Bytes that the slowest of the devices that a token moves reads in a second, as far as known.
    fn slowest_guarded(&self, token: ContextNumber) -> Option<u32> {
        self.guarded(token).filter_map(|channel| channel.pace).min()
    }

    fn guarded(&self, token: ContextNumber) -> impl Iterator<Item = &Context> {
        let channels = self.token(token).into_iter().flat_map(|token| &token.guarded);
        channels.filter_map(|channel| self.tree.get(*channel))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_user_has_his_own_and_nothing_is_kept_of_who_rests() {
        let mut pace = TellPace::default();
        let (here, there) = (Told::Owner(ContextNumber(1)), Told::Asked(ContextNumber(1)));
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
        assert_eq!(presence.terms(None), terms(100, 250_000));
        assert_eq!(owner.terms(Some(60_000)), terms(37, 106_666));
        assert_eq!(presence.terms(Some(60_000)), terms(100, 250_000));
        assert_eq!(owner.terms(Some(6000)), terms(4, 1_066_666));
        assert_eq!(presence.terms(Some(6000)), terms(15, 266_666));
        assert_eq!(owner.terms(Some(u32::MAX)), owner.terms(None));
    }
}
