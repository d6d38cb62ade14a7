//! `first-come`: whoever grabs a free token keeps it until giving it back.

use mom_proto::{Code, Verb, WireError};
use serde::Deserialize;

use crate::level_or_lease::{held_text, micros};
use crate::{Expiry, Manager, Question, Setup, Terms, Verdict};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    /// ms; none = without end.
    #[serde(default)]
    lease: Option<u64>,
    #[serde(default)]
    expiry: Expiry,
}

/// Denies a grab while somebody else owns the token and its lease lasts.
#[derive(Debug)]
struct FirstCome {
    label: String,
    terms: Terms,
}

pub(crate) fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let params: Params = setup.params()?;
    let lease = params.lease.map(|lease| micros(lease, "lease")).transpose()?;
    let terms = Terms {
        lease,
        expiry: params.expiry,
        ..Terms::default()
    };
    Ok(Box::new(FirstCome {
        label: setup.label.to_owned(),
        terms,
    }))
}

impl Manager for FirstCome {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        if question.verb != Verb::Grab {
            return Verdict::allow_always();
        }
        let token = question.token.unwrap_or_default();
        match token.owner {
            Some(owner) if !owner.asks && token.lease_end.is_none_or(|end| question.now < end) => {
                Verdict::deny(Code::HELD, &self.label, held_text(question, owner.name))
                    .earliest(token.lease_end)
            }
            _ => Verdict::allow(),
        }
    }

    fn terms(&self) -> Terms {
        self.terms
    }
}
