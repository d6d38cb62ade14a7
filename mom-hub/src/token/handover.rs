//! Handing over by agreement: offers and requests to the owner, and how often they may be repeated.

use std::time::Duration;

use mom_proto::{Code, Micros, WireError};

use super::state::{Asked, Asking, HeldBack, Token};
use crate::PeerId;

/// Peers that may ask one owner at a time.
pub(crate) const ASKING: usize = 16;

/// How long an offer or a request counts against the next one of the same kind, µs.
pub(crate) const AGAIN: Micros = 10_000_000;

/// Offers or requests of the same kind in that time. A person that is told no has a word to say to that, and perhaps
/// another one.
const TIMES: u32 = 4;

/// Recent offers and requests that a token remembers; the oldest is forgotten for another one.
const REMEMBERED: usize = 256;

impl Token {
    /// Checks that the same peer was not offered the token, or asked for it, by the same one too often: each time both
    /// are told, and nobody may fill another's control lane.
    ///
    /// # Errors
    /// `try-later`, with the time until then.
    pub(crate) fn check_again(&self, asked: Asked, name: &str, now: Micros) -> Result<(), WireError> {
        match self.asked.get(&asked) {
            Some((times, until)) if *times >= TIMES => not_again(now, *until, name),
            _ => Ok(()),
        }
    }

    /// Counts an offer or a request.
    pub(crate) fn note_asked(&mut self, asked: Asked, now: Micros) {
        self.asked.retain(|_, (_, until)| now < *until);
        if let Some((times, _)) = self.asked.get_mut(&asked) {
            *times += 1;
            return;
        }
        if self.asked.len() >= REMEMBERED {
            let first = self.asked.iter().min_by_key(|(_, (_, until))| *until);
            if let Some(first) = first.map(|(asked, _)| *asked) {
                self.asked.remove(&first);
            }
        }
        self.asked.insert(asked, (1, now.saturating_add(AGAIN)));
    }

    /// Forgets the count: a peer that has agreed may be asked again, and so may one that could not answer because the
    /// token was taken away.
    pub(crate) fn forget_asked(&mut self, asked: Asked) {
        self.asked.remove(&asked);
    }

    pub(crate) fn asks(&self, peer: PeerId) -> bool {
        self.asking.iter().any(|asking| asking.peer == peer)
    }

    pub(crate) fn take_asking(&mut self, peer: PeerId) -> Option<Asking> {
        let place = self.asking.iter().position(|asking| asking.peer == peer)?;
        Some(self.asking.remove(place))
    }

    /// Takes away the requests of a peer that wait for the end of a change of owner.
    pub(crate) fn take_held_back_of(&mut self, peer: PeerId) -> Vec<HeldBack> {
        let (left, kept): (Vec<_>, Vec<_>) = self.held_back.drain(..).partition(|held| held.peer == peer);
        self.held_back = kept.into();
        left
    }
}

/// Refuses what the same peer was asked a short while ago.
///
/// # Errors
/// `try-later`, with the time until then.
pub(crate) fn not_again(now: Micros, until: Micros, name: &str) -> Result<(), WireError> {
    if now >= until {
        return Ok(());
    }
    let text = format!("{name} was asked the same a short while ago");
    Err(WireError::new(Code::TRY_LATER, text)
        .rule("not again and again")
        .retry_after(Duration::from_micros(until - now)))
}
