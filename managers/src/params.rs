//! Parameters that several kinds share: durations, the terms of tokens, lists of verbs.

use mom_proto::nearest::nearest;
use mom_proto::{Micros, Verb, WireError};

use crate::{Expiry, Setup, Terms};

/// Longer durations make no sense, and sums of them would overflow.
const LONGEST: Micros = 1 << 53;

/// A peer that has not answered by then will not; no request may hang for longer.
const LONGEST_QUESTION: Micros = 3_600_000_000;

/// The least time that an owner keeps the token after another peer has begun to wait, ms.
const NOTICE: u64 = 10_000;

/// The keys that set a token's terms, in ms.
pub(crate) struct TermParams {
    pub(crate) lease: Option<u64>,
    pub(crate) expiry: Expiry,
    pub(crate) deadman: Option<u64>,
    pub(crate) hold: Option<u64>,
    pub(crate) notice: Option<u64>,
}

impl TermParams {
    pub(crate) fn read(self, setup: &Setup<'_>) -> Result<Terms, WireError> {
        let read = |key, millis: Option<u64>| millis.map(|millis| setup.micros(key, millis)).transpose();
        Ok(Terms {
            lease: read("lease", self.lease)?,
            expiry: self.expiry,
            deadman: read("deadman", self.deadman)?,
            hold: read("hold", self.hold)?,
            by_level: false,
            notice: match self.notice.unwrap_or(NOTICE) {
                0 => 0,
                millis => setup.micros("notice", millis)?,
            },
        })
    }
}

impl Setup<'_> {
    /// A duration of the parameter `key`, given in ms, as µs.
    ///
    /// # Errors
    /// `bad-content` with the key as slot: it is 0, or longer than the time that clocks count.
    pub fn micros(&self, key: &str, millis: u64) -> Result<Micros, WireError> {
        let micros = millis.checked_mul(1000);
        micros
            .filter(|micros| (1..LONGEST).contains(micros))
            .ok_or_else(|| {
                let text = format!(
                    "{key} must be a number of ms from 1 to {}; leave it out for the default",
                    LONGEST / 1000
                );
                self.error(key, &text)
            })
    }

    /// The time for an answer, from the parameter `within`.
    pub(crate) fn within(&self, millis: u64) -> Result<Micros, WireError> {
        match self.micros("within", millis)? {
            micros if micros <= LONGEST_QUESTION => Ok(micros),
            _ => {
                let text = format!("within is at most {} ms", LONGEST_QUESTION / 1000);
                Err(self.error("within", &text))
            }
        }
    }
}

/// A list of verbs in a parameter.
#[derive(Clone, Debug)]
pub(crate) enum Verbs {
    All,
    These(Vec<Verb>),
}

impl Verbs {
    /// The verbs at `key`; `*` stands for all.
    pub(crate) fn read(setup: &Setup<'_>, key: &str, words: &[String]) -> Result<Verbs, WireError> {
        if words.is_empty() {
            return Err(setup.error(key, "a list of verbs needs at least one; * stands for all"));
        }
        if words.iter().any(|word| word == "*") {
            return Ok(Verbs::All);
        }
        let verbs: Result<Vec<Verb>, WireError> = words
            .iter()
            .map(|word| {
                Verb::from_word(word).ok_or_else(|| {
                    let near = nearest(word, Verb::ALL.iter().map(|verb| verb.word()));
                    setup
                        .error(key, &format!("there is no verb {word:?}; * stands for all"))
                        .nearest_opt(near)
                })
            })
            .collect();
        verbs.map(Verbs::These)
    }

    /// The verbs of the parameter `verbs`, or these by default.
    pub(crate) fn read_or(
        setup: &Setup<'_>,
        words: Option<Vec<String>>,
        default: &[Verb],
    ) -> Result<Verbs, WireError> {
        match words {
            Some(words) => Verbs::read(setup, "verbs", &words),
            None => Ok(Verbs::These(default.to_vec())),
        }
    }

    pub(crate) fn covers(&self, verb: Verb) -> bool {
        match self {
            Verbs::All => true,
            Verbs::These(verbs) => verbs.contains(&verb),
        }
    }

    /// Whether a narrowing manager covers this verb: never giving up, and `stop` only if it is listed, because a stop
    /// must not wait.
    pub(crate) fn narrow(&self, verb: Verb) -> bool {
        match self {
            Verbs::All => !verb.gives_up() && verb != Verb::Stop,
            Verbs::These(verbs) => !verb.gives_up() && verbs.contains(&verb),
        }
    }
}
