//! `queue`: one after the other, in the order of asking.

use std::sync::Arc;

use mom_proto::{Verb, WireError};
use serde::Deserialize;

use crate::held::{done_by, held, lasting_owner, other_owner};
use crate::params::TermParams;
use crate::{Expiry, Manager, Question, Setup, Terms, Verdict};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    /// ms; none = unlimited.
    lease: Option<u64>,
    #[serde(default)]
    expiry: Expiry,
    /// ms
    deadman: Option<u64>,
    /// ms
    hold: Option<u64>,
    /// ms
    notice: Option<u64>,
}

/// Grants a free token, and queues grabs while it has an owner.
///
/// The hub keeps the queue: it grants a token that becomes free to the first in it before any newcomer, and asks here
/// again before each grant.
#[derive(Debug)]
struct Queue {
    label: Arc<str>,
    terms: Terms,
}

pub(crate) fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let params: Params = setup.params()?;
    let terms = TermParams {
        lease: params.lease,
        expiry: params.expiry,
        deadman: params.deadman,
        hold: params.hold,
        notice: params.notice,
    };
    Ok(Box::new(Queue {
        label: setup.label.into(),
        terms: terms.read(setup)?,
    }))
}

impl Manager for Queue {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let verdict = match question.verb {
            Verb::Grab => match lasting_owner(question) {
                Some(owner) => held(question, &self.label, &owner).or_wait(done_by(question, &self.terms)),
                None => Verdict::allow(),
            },
            Verb::Inhibit => match other_owner(question) {
                Some(owner) => held(question, &self.label, &owner),
                None => Verdict::allow(),
            },
            _ => Verdict::allow_always(),
        };
        verdict.by(&self.label)
    }

    fn terms(&self) -> Terms {
        self.terms
    }
}
