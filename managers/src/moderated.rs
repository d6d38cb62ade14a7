//! `moderated`: a chair has to approve.

use std::sync::Arc;

use mom_proto::{Micros, Verb, WireError};
use serde::Deserialize;

use crate::held::{held, lasting_owner, other_owner};
use crate::params::Verbs;
use crate::who::{Who, WhoParams};
use crate::{Manager, Question, Scope, Setup, Verdict};

/// ms
const DEFAULT_WITHIN: u64 = 30_000;

/// The verbs that give control of a token.
const DEFAULT_VERBS: [Verb; 3] = [Verb::Grab, Verb::Accept, Verb::Inhibit];

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    chairs: WhoParams,
    verbs: Option<Vec<String>>,
    /// The names of sent messages; empty = all.
    #[serde(default)]
    messages: Vec<String>,
    /// ms
    #[serde(default = "default_within")]
    within: u64,
    /// Whether an approved grab takes the token from its owner.
    #[serde(default)]
    displace: bool,
}

fn default_within() -> u64 {
    DEFAULT_WITHIN
}

/// Asks the chairs about moderated requests, and allows all others.
#[derive(Debug)]
struct Moderated {
    label: Arc<str>,
    chairs: Who,
    verbs: Verbs,
    messages: Vec<String>,
    within: Micros,
    displace: bool,
}

pub(crate) fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let params: Params = setup.params()?;
    let chairs = Who::read(setup, "chairs", params.chairs)?;
    if chairs.is_anybody() {
        return Err(setup.error("chairs", "chairs are named by users, groups or min-level"));
    }
    Ok(Box::new(Moderated {
        label: setup.label.into(),
        chairs,
        verbs: Verbs::read_or(setup, params.verbs, &DEFAULT_VERBS)?,
        messages: params.messages,
        within: setup.within(params.within)?,
        displace: params.displace,
    }))
}

impl Manager for Moderated {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        if !self.verbs.narrow(question.verb) {
            return Verdict::allow_always().by(&self.label);
        }
        if !self.moderates(question) {
            return Verdict::allow().stands(Scope::ThisName).by(&self.label);
        }
        // Chairs are not asked about a token that cannot be granted now.
        if let Some(verdict) = self.in_the_way(question) {
            return verdict;
        }
        let chair = self.chairs.fits(question.peer);
        let verdict = match question.given(&self.label) {
            _ if chair => self.granted(question).stands(Scope::AnyName),
            None => return Verdict::defer(&*self.label, self.chairs.chairs(), self.within).by(&self.label),
            Some(given) if given.allows() => given.keep(self.granted(question)),
            Some(given) => given.refusal(&self.label, question, "a chair"),
        };
        verdict.by(&self.label)
    }
}

impl Moderated {
    fn moderates(&self, question: &Question<'_>) -> bool {
        let listed = |name: &str| self.messages.iter().any(|listed| listed == name);
        question.verb != Verb::Send || self.messages.is_empty() || question.message.is_some_and(listed)
    }

    fn in_the_way(&self, question: &Question<'_>) -> Option<Verdict> {
        let verdict = match question.verb {
            Verb::Grab if !self.displace => {
                let expected = question.token.and_then(|token| token.lease_end);
                held(question, &self.label, &lasting_owner(question)?).or_wait(expected)
            }
            Verb::Inhibit => held(question, &self.label, &other_owner(question)?),
            _ => return None,
        };
        Some(verdict.by(&self.label))
    }

    fn granted(&self, question: &Question<'_>) -> Verdict {
        match question.verb {
            Verb::Grab if self.displace => Verdict::displace(),
            _ => Verdict::allow(),
        }
    }
}
