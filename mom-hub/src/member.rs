//! A peer in a context.

use std::sync::Arc;

use mom_managers::{Answer, Micros, PeerFacts};

/// A peer's connection; the broker gives each a number and never the same twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PeerId(pub u64);

/// Messages whose verdicts are remembered one by one; a sender of more names is asked about each time.
const NAMES: usize = 64;

/// A peer in a context, with the verdicts that stand for its messages there.
#[derive(Clone, Debug, PartialEq)]
pub struct Member {
    /// Its connection.
    pub peer: PeerId,
    /// What the hub knows of it.
    pub facts: Arc<PeerFacts>,
    standing: Vec<StandingVerdict>,
}

/// An answer that holds for later messages.
#[derive(Clone, Debug, PartialEq)]
pub struct StandingVerdict {
    /// For messages of this name; none = of any name.
    pub name: Option<Arc<str>>,
    /// Up to, but not at, this time.
    pub until: Option<Micros>,
    /// The answer.
    pub answer: Answer,
}

impl Member {
    /// A member for whose messages no verdict stands.
    pub fn new(peer: PeerId, facts: Arc<PeerFacts>) -> Member {
        Member {
            peer,
            facts,
            standing: Vec::new(),
        }
    }

    /// The answer that stands for a message of this name.
    pub fn standing(&self, name: &str, now: Micros) -> Option<&Answer> {
        self.standing
            .iter()
            .find(|verdict| verdict.name.as_deref().is_none_or(|known| known == name))
            .filter(|verdict| verdict.until.is_none_or(|until| now < until))
            .map(|verdict| &verdict.answer)
    }

    /// This member with one standing verdict more; `None` if there is no room for it.
    pub(crate) fn with(&self, verdict: StandingVerdict) -> Option<Member> {
        let mut standing: Vec<_> = match verdict.name {
            // A verdict for all names takes the place of those for some.
            None => Vec::new(),
            Some(_) => self
                .standing
                .iter()
                .filter(|known| known.name != verdict.name)
                .cloned()
                .collect(),
        };
        if standing.len() >= NAMES {
            return None;
        }
        standing.push(verdict);
        Some(Member {
            peer: self.peer,
            facts: Arc::clone(&self.facts),
            standing,
        })
    }
}
