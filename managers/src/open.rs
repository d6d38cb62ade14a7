//! `open`: everybody may do everything.

use std::sync::Arc;

use mom_proto::WireError;
use serde::Deserialize;

use crate::{Manager, Question, Setup, Verdict};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {}

/// Allows all; a token's owner is still safe from others.
#[derive(Debug)]
struct Open {
    label: Arc<str>,
}

pub(crate) fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let Params {} = setup.params()?;
    Ok(Box::new(Open {
        label: setup.label.into(),
    }))
}

impl Manager for Open {
    fn decide(&mut self, _question: &Question<'_>) -> Verdict {
        Verdict::allow_always().by(&self.label)
    }
}
