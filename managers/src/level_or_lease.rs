//! `level-or-lease`: the rule of the papers' robot token (M29).

use std::sync::Arc;

use mom_proto::{Verb, WireError};
use serde::Deserialize;

use crate::held::{done_by, held, lasting_owner, other_owner};
use crate::params::TermParams;
use crate::{Expiry, Manager, Owner, Question, Setup, Terms, Verdict};

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
    /// Whether an equal level takes the token, too.
    #[serde(default)]
    equal: bool,
    /// Whether a refused grab may be queued; by default if `hold` bounds the wait.
    queue: Option<bool>,
    /// ms
    deadman: Option<u64>,
    /// ms
    hold: Option<u64>,
    /// ms
    notice: Option<u64>,
}

fn default_lease() -> u64 {
    DEFAULT_LEASE
}

/// A free token is granted, a strictly higher level takes it. Otherwise only after the lease, which only renewals
/// prolong.
#[derive(Debug)]
struct LevelOrLease {
    label: Arc<str>,
    equal: bool,
    queue: bool,
    terms: Terms,
}

pub(crate) fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let params: Params = setup.params()?;
    let queue = params.queue.unwrap_or(params.hold.is_some());
    let equal = params.equal;
    let terms = TermParams {
        lease: Some(params.lease),
        expiry: params.expiry,
        deadman: params.deadman,
        hold: params.hold,
        notice: params.notice,
    };
    Ok(Box::new(LevelOrLease {
        label: setup.label.into(),
        equal,
        queue,
        terms: Terms {
            by_level: true,
            ..terms.read(setup)?
        },
    }))
}

impl Manager for LevelOrLease {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let verdict = match (question.verb, other_owner(question)) {
            (Verb::Grab, Some(owner)) => self.grab(question, &owner),
            (Verb::Inhibit, Some(owner)) => held(question, &self.label, &owner),
            (Verb::Grab | Verb::Inhibit, None) => Verdict::allow(),
            _ => Verdict::allow_always(),
        };
        verdict.by(&self.label)
    }

    fn terms(&self) -> Terms {
        self.terms
    }
}

impl LevelOrLease {
    fn grab(&self, question: &Question<'_>, owner: &Owner<'_>) -> Verdict {
        let level = question.peer.level;
        let outranks = level > owner.level || self.equal && level == owner.level;
        if outranks || lasting_owner(question).is_none() {
            return Verdict::displace();
        }
        let denied = held(question, &self.label, owner);
        match self.queue {
            true => denied.or_wait(done_by(question, &self.terms)),
            false => denied,
        }
    }
}
