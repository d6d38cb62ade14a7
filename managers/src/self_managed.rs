//! `self`: the peer that made the context decides (M24).

use std::sync::Arc;

use mom_proto::{Micros, WireError};
use serde::Deserialize;

use crate::params::Verbs;
use crate::{Ask, Manager, Question, Setup, Verdict};

/// ms
const DEFAULT_WITHIN: u64 = 5_000;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    verbs: Option<Vec<String>>,
    /// ms
    #[serde(default = "default_within")]
    within: u64,
}

fn default_within() -> u64 {
    DEFAULT_WITHIN
}

/// Asks the managing peer; its silence is a no.
#[derive(Debug)]
struct SelfManaged {
    label: Arc<str>,
    verbs: Verbs,
    within: Micros,
}

pub(crate) fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let params: Params = setup.params()?;
    let verbs = params
        .verbs
        .map(|words| Verbs::read(setup, "verbs", &words))
        .transpose()?;
    Ok(Box::new(SelfManaged {
        label: setup.label.into(),
        verbs: verbs.unwrap_or(Verbs::All),
        within: setup.within(params.within)?,
    }))
}

impl Manager for SelfManaged {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let verb = question.verb;
        if question.created || verb.gives_up() || !self.verbs.covers(verb) {
            return Verdict::allow_always().by(&self.label);
        }
        let verdict = match question.given(&self.label) {
            None => Verdict::defer(&*self.label, Ask::Creator, self.within),
            Some(given) if given.allows() => given.keep(Verdict::allow()),
            Some(given) => given.refusal(&self.label, question, "the managing peer"),
        };
        verdict.by(&self.label)
    }
}
