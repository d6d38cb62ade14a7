//! `first-come`: the peer that grabs a free token keeps it until it releases it.

use std::sync::Arc;

use mom_proto::{Verb, WireError};
use serde::Deserialize;

use crate::held::{held, lasting_owner, other_owner};
use crate::{Expiry, Manager, Question, Setup, Terms, Verdict};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    /// ms; none = unlimited.
    #[serde(default)]
    lease: Option<u64>,
    #[serde(default)]
    expiry: Expiry,
}

/// Denies a grab while another peer owns the token by an unexpired lease.
#[derive(Debug)]
struct FirstCome {
    label: Arc<str>,
    terms: Terms,
}

pub(crate) fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let params: Params = setup.params()?;
    let lease = params
        .lease
        .map(|lease| setup.micros("lease", lease))
        .transpose()?;
    let terms = Terms {
        lease,
        expiry: params.expiry,
        ..Terms::default()
    };
    Ok(Box::new(FirstCome {
        label: setup.label.into(),
        terms,
    }))
}

impl Manager for FirstCome {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let in_the_way = match question.verb {
            Verb::Grab => lasting_owner(question),
            Verb::Inhibit => other_owner(question),
            _ => return Verdict::allow_always().by(&self.label),
        };
        match in_the_way {
            Some(owner) => held(question, &self.label, &owner),
            None => Verdict::allow().by(&self.label),
        }
    }

    fn terms(&self) -> Terms {
        self.terms
    }
}
