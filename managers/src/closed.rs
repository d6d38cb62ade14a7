//! `closed`: nobody may do anything; the default where nothing is configured (M25).

use std::sync::Arc;

use mom_proto::{Code, WireError};
use serde::Deserialize;

use crate::{Manager, Question, Scope, Setup, Verdict};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {}

/// Denies everything except giving up.
#[derive(Debug)]
struct Closed {
    label: Arc<str>,
}

pub(crate) fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let Params {} = setup.params()?;
    Ok(Box::new(Closed {
        label: setup.label.into(),
    }))
}

impl Manager for Closed {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        if question.verb.gives_up() {
            return Verdict::allow().by(&self.label);
        }
        let text = format!(
            "{} is closed: its configuration allows nobody to {}",
            question.context, question.verb
        );
        Verdict::deny(Code::DENIED, &*self.label, text).stands(Scope::AnyName)
    }
}
