//! `level-or-lease`: the rule of the papers' robot token (M29).

use mom_proto::{Code, Verb, WireError};
use serde::Deserialize;

use crate::{Expiry, Manager, Micros, Question, Setup, Terms, Verdict};

/// 3 minutes, as in M29; in ms.
const DEFAULT_LEASE: u64 = 180_000;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    /// ms
    #[serde(default = "default_lease")]
    lease: u64,
    #[serde(default)]
    expiry: Expiry,
}

fn default_lease() -> u64 {
    DEFAULT_LEASE
}

/// Free: granted. Strictly higher level: taken. Otherwise only after the lease, which only renewals prolong.
#[derive(Debug)]
struct LevelOrLease {
    label: String,
    terms: Terms,
}

pub(crate) fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let params: Params = setup.params()?;
    let terms = Terms {
        lease: Some(micros(params.lease, "lease")?),
        expiry: params.expiry,
        by_level: true,
        ..Terms::default()
    };
    Ok(Box::new(LevelOrLease {
        label: setup.label.to_owned(),
        terms,
    }))
}

impl Manager for LevelOrLease {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        if question.verb != Verb::Grab {
            return Verdict::allow_always();
        }
        let token = question.token.unwrap_or_default();
        let Some(owner) = token.owner else {
            return Verdict::allow();
        };
        let lapsed = token.lease_end.is_some_and(|end| question.now >= end);
        if owner.asks || lapsed || question.peer.level > owner.level {
            return Verdict::displace();
        }
        Verdict::deny(Code::HELD, &self.label, held_text(question, owner.name)).earliest(token.lease_end)
    }

    fn terms(&self) -> Terms {
        self.terms
    }
}

/// A duration of the configuration in µs.
pub(crate) fn micros(millis: u64, key: &str) -> Result<Micros, WireError> {
    match millis
        .checked_mul(1000)
        .filter(|micros| *micros > 0 && *micros < 1 << 53)
    {
        Some(micros) => Ok(micros),
        None => {
            let text = format!(
                "{key} is a number of ms from 1 to {}; leave it out for the default",
                (1_u64 << 53) / 1000
            );
            Err(WireError::new(Code::BAD_CONTENT, text).slot(key))
        }
    }
}

/// The words of a refusal because somebody else owns the token.
pub(crate) fn held_text(question: &Question<'_>, owner: &str) -> String {
    format!("{} is held by {owner}", question.context)
}
