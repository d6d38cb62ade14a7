use std::sync::Arc;

use mom_managers::{Manager, Question, Registry, Setup, Verdict};
use mom_proto::{Code, Verb, WireError};
use serde::Deserialize;

/// Lets messages through up to a size, and all else.
#[derive(Debug)]
struct SmallOnly {
    label: Arc<str>,
    most: usize,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    most: usize,
}

fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let Params { most } = setup.params()?;
    if most == 0 {
        return Err(setup.error("most", "most is a number of bytes from 1 on"));
    }
    Ok(Box::new(SmallOnly {
        label: setup.label.into(),
        most,
    }))
}

impl Manager for SmallOnly {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let verdict = match question.verb {
            // Each size is another question, so neither answer stands.
            Verb::Send if question.size > self.most => {
                let text = format!(
                    "{} takes messages of at most {} bytes",
                    question.context, self.most
                );
                Verdict::deny(Code::DENIED, &*self.label, text)
            }
            _ => Verdict::allow(),
        };
        verdict.by(&self.label)
    }
}

/// The built-in kinds and this one.
pub(crate) fn registry() -> Registry {
    let mut registry = Registry::builtin();
    registry.add_kind("small-only", make);
    registry
}
