//! `chain`: several managers that all have to allow.

use mom_proto::{Map, Path, Value, WireError};
use serde::Deserialize;

use crate::{Answer, Expiry, Grant, Manager, Question, Setup, Standing, Terms, Verdict};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    /// Names of the configuration, or maps with `kind` and parameters.
    of: Vec<Value>,
}

/// The most managers of one chain: they are built for each context anew, also when a peer names them.
const MOST: usize = 16;

/// Consults each in order; the first denial is the answer, else the first answer that defers or queues.
#[derive(Debug)]
struct Chain {
    links: Vec<Box<dyn Manager>>,
}

pub(crate) fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let params: Params = setup.params()?;
    if params.of.is_empty() {
        // An empty chain would allow everything; only `open` may do that.
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
        let mut deferred: Option<Verdict> = None;
        let mut queued: Option<Verdict> = None;
        for link in &mut self.links {
            let verdict = link.decide(question);
            all.standing = all.standing.and(verdict.standing);
            match &verdict.answer {
                Answer::Allow(grant) => {
                    all.answer = also(&all.answer, grant);
                    all.rule = all.rule.or(verdict.rule);
                }
                // Earlier links may change their answers, so it stands no longer than theirs.
                Answer::Deny(_) => {
                    return Verdict {
                        standing: all.standing.without_rate(),
                        ..verdict
                    };
                }
                // A later link may still deny, and nobody should be asked in vain.
                Answer::Defer(_) => deferred = deferred.or(Some(verdict)),
                Answer::Queue(_) => queued = queued.or(Some(verdict)),
            }
        }
        match deferred.or(queued) {
            Some(verdict) => Verdict {
                standing: Standing::Once,
                ..verdict
            },
            None => all,
        }
    }

    fn terms(&self) -> Terms {
        let mut all = Terms::default();
        for terms in self.links.iter().map(|link| link.terms()) {
            // Terms that belong together come from one link: the first that names the leading one, if any does.
            if all.lease.is_none() && (terms.lease.is_some() || all.expiry == Expiry::Lazy) {
                (all.lease, all.expiry) = (terms.lease, terms.expiry);
            }
            if all.hold.is_none() && (terms.hold.is_some() || all.notice == 0) {
                (all.hold, all.notice, all.by_level) = (terms.hold, terms.notice, terms.by_level);
            }
            all.deadman = all.deadman.or(terms.deadman);
        }
        all
    }

    fn neighbours(&self, token: &Path) -> Vec<Path> {
        self.links
            .iter()
            .flat_map(|link| link.neighbours(token))
            .collect()
    }

    fn facts(&self, context: &Path) -> Map {
        let mut all = Map::new();
        for (key, value) in self.links.iter().flat_map(|link| link.facts(context)) {
            all.set(&key, value);
        }
        all
    }
}

/// The combined grant of two links.
fn also(answer: &Answer, grant: &Grant) -> Answer {
    match answer {
        Answer::Allow(all) => Answer::Allow(Grant {
            displace: all.displace || grant.displace,
            until: [all.until, grant.until].into_iter().flatten().min(),
            priority: [all.priority, grant.priority].into_iter().flatten().min(),
        }),
        other => other.clone(),
    }
}
