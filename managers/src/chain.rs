//! `chain`: several managers that all have to allow.

use mom_proto::{Value, WireError};
use serde::Deserialize;

use crate::{Answer, Grant, Manager, Question, Setup, Terms, Verdict};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    /// Names of the configuration, or maps with `kind` and parameters.
    of: Vec<Value>,
}

/// Managers of one chain: they are built for each context anew, also where a peer names them.
const MOST: usize = 16;

/// Asks each in turn; the first denial is the answer.
#[derive(Debug)]
struct Chain {
    links: Vec<Box<dyn Manager>>,
}

pub(crate) fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let params: Params = setup.params()?;
    if params.of.is_empty() {
        // No manager would deny, so an empty chain would be open; only the word may open a context.
        return Err(setup.error(
            "of",
            "a chain needs at least one manager; to allow all, name the manager open",
        ));
    }
    if params.of.len() > MOST {
        return Err(setup.error("of", &format!("a chain has at most {MOST} managers")));
    }
    let links: Result<_, WireError> = params
        .of
        .iter()
        .enumerate()
        .map(|(index, spec)| setup.inner(&format!("of/{index}"), spec))
        .collect();
    Ok(Box::new(Chain { links: links? }))
}

impl Manager for Chain {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let mut all = Verdict::allow_always();
        for link in &mut self.links {
            let verdict = link.decide(question);
            let Answer::Allow(grant) = verdict.answer else {
                // The links before allowed; the answer stands no longer than they do.
                return Verdict {
                    standing: all.standing.and(verdict.standing),
                    ..verdict
                };
            };
            if let Answer::Allow(Grant { displace, until }) = &mut all.answer {
                *displace |= grant.displace;
                *until = [*until, grant.until].into_iter().flatten().min();
            }
            all.standing = all.standing.and(verdict.standing);
            all.rule = all.rule.or(verdict.rule);
        }
        all
    }

    fn terms(&self) -> Terms {
        let named = self
            .links
            .iter()
            .map(|link| link.terms())
            .find(|terms| terms.lease.is_some());
        named.unwrap_or_default()
    }
}
