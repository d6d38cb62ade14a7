//! How often one user may have others told of the same thing, so that they, and the devices among them, hear something else, too.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use mom_proto::{Code, ContextNumber, Gcra, Micros, Pace, WireError};

use super::World;
use crate::PeerId;

/// Times that one user comes to one context, leaves it, has it or asks for it, or invites one peer: so many at once, and one each so many µs.
const AT_ONCE: u64 = 100;
const EACH: Micros = 50_000;

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

/// What users have had others told of lately.
#[derive(Debug, Default)]
pub(crate) struct TellPace {
    /// When each is paid back.
    of: BTreeMap<(Told, Arc<str>), Micros>,
    /// Entries that were left when it was last looked through.
    left: usize,
}

impl TellPace {
    /// Counts one.
    ///
    /// # Errors
    /// It was one too many, and is not counted.
    pub(crate) fn take(&mut self, told: Told, user: &Arc<str>, now: Micros) -> Result<(), TooOften> {
        if self.of.len() >= MANY.max(2 * self.left) {
            self.of.retain(|_, paid_at| *paid_at > now);
            self.left = self.of.len();
        }
        let pace = Pace::every(EACH, AT_ONCE);
        let paid_at = self.of.entry((told, Arc::clone(user))).or_default();
        let mut used = Gcra::paid_at(*paid_at);
        used.take(&pace, 1, now).map_err(|_| TooOften)?;
        *paid_at = used.next(&pace);
        Ok(())
    }

    /// Whether one more would be one too many.
    fn is_used_up(&self, told: Told, user: &Arc<str>, now: Micros) -> bool {
        let paid_at = self
            .of
            .get(&(told, Arc::clone(user)))
            .copied()
            .unwrap_or_default();
        let used = Gcra::paid_at(paid_at);
        used.peek(&Pace::every(EACH, AT_ONCE), 1, now).is_err()
    }
}

/// Somebody has had others told of it too often.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TooOften;

impl TooOften {
    /// What who has done this is told.
    fn refusal(self, user: &str, what: &str) -> WireError {
        let text = format!(
            "{user} {what} more than {AT_ONCE} times at once and {} times a second, and others hear of each time",
            1_000_000 / EACH
        );
        WireError::new(Code::TRY_LATER, text).retry_after(Duration::from_micros(EACH))
    }
}

impl World {
    /// Checks that a user does not have a device told of its token all the time: each change is told before all commands. What changes nothing
    /// is not counted.
    pub(crate) fn check_tell_pace(&self, peer: PeerId, token: ContextNumber) -> Result<(), WireError> {
        let Some(user) = self.user_of(peer).filter(|_| self.owner_of(token) != Some(peer)) else {
            return Ok(());
        };
        match self.tell_pace.is_used_up(Told::Owner(token), &user, self.now) && self.moves_devices(token) {
            true => Err(TooOften.refusal(&user, "takes this")),
            false => Ok(()),
        }
    }

    /// Counts that a token is a peer's from now on.
    pub(crate) fn count_change(&mut self, peer: PeerId, token: ContextNumber) {
        if let Some(user) = self.user_of(peer) {
            // One that is not refused any more is too many for the next.
            let _ = self.tell_pace.take(Told::Owner(token), &user, self.now);
        }
    }

    /// Counts that a user wants something, of which others are told.
    ///
    /// # Errors
    /// It was one too many.
    pub(crate) fn count_wish(&mut self, peer: PeerId, told: Told, what: &str) -> Result<(), WireError> {
        let Some(user) = self.user_of(peer) else {
            return Ok(());
        };
        let taken = self.tell_pace.take(told, &user, self.now);
        taken.map_err(|too_often| too_often.refusal(&user, what))
    }

    fn user_of(&self, peer: PeerId) -> Option<Arc<str>> {
        let known = self.peers.get(peer)?;
        Some(Arc::clone(&known.facts.user))
    }

    /// Whether a device is where a token guards.
    fn moves_devices(&self, token: ContextNumber) -> bool {
        let channels = self.token(token).into_iter().flat_map(|token| &token.guarded);
        let mut channels = channels.filter_map(|channel| self.tree.get(*channel));
        channels.any(|channel| channel.members.values().any(|member| member.device))
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
        let mut taken =
            |context, user, now| (0..200).filter(|_| pace.take(context, user, now).is_ok()).count();
        assert_eq!(taken(here, &alice, 1), 100);
        assert_eq!(taken(here, &bob, 1), 100);
        assert_eq!(taken(there, &alice, 1), 100);
        assert_eq!(taken(here, &alice, 1_000_001), 20);
        for user in 0..1000_u32 {
            let now = 60_000_000 + u64::from(user) * EACH;
            assert_eq!(pace.take(here, &user.to_string().into(), now), Ok(()));
        }
        assert!(pace.of.len() <= MANY, "{}", pace.of.len());
    }
}
