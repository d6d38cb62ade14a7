//! A peer in a context.

use std::sync::Arc;

use mom_managers::{Answer, PeerFacts, Rate};
use mom_proto::{Map, Micros, Thinning, Value, event};

use super::installation::Installation;
use crate::PeerId;

/// Messages whose verdicts are remembered one by one; a sender of more names is asked about each time.
const NAMES: usize = 64;

/// A peer in a context, with the verdicts that stand for its messages there.
#[derive(Clone, Debug, PartialEq)]
pub struct Member {
    /// Its connection.
    pub peer: PeerId,
    /// Name, user, level and groups.
    pub facts: Arc<PeerFacts>,
    /// The messages of the others that it is spared.
    pub thinning: Thinning,
    /// Whether it is a device: one that obeys `stop` here, and says so.
    pub device: bool,
    /// Which one, if it says so; boxed, for most members are no devices.
    pub(crate) installation: Option<Box<Installation>>,
    /// What it can do, if it says so.
    pub(crate) card: Option<Arc<Value>>,
    standing: Vec<StandingVerdict>,
    // An earlier message waits for a verdict, so later ones have to come to the hub too and wait behind it.
    held: bool,
}

/// An answer that holds for later messages.
#[derive(Clone, Debug, PartialEq)]
pub struct StandingVerdict {
    /// For messages of this name; none = of any name but `stop` and `unstop`, which have rights of their
    /// own.
    pub name: Option<Arc<str>>,
    /// Whether the hub alone carries such messages out (`stop`, `unstop`): it knows their order.
    pub by_hub: bool,
    /// Up to, but not at, this time.
    pub until: Option<Micros>,
    /// How much of them; none = without limit.
    pub rate: Option<Rate>,
    /// For messages that are surely not older, µs; none = of any age.
    pub max_age: Option<Micros>,
    /// The answer.
    pub answer: Answer,
}

/// Whether a message is a verb of its own (`stop`, `unstop`), for which verdicts about other messages do not stand.
pub(crate) fn has_own_right(name: &str) -> bool {
    matches!(name, event::STOP | event::UNSTOP)
}

impl Member {
    /// A member for whose messages no verdict stands.
    pub fn new(peer: PeerId, facts: Arc<PeerFacts>) -> Member {
        Member {
            peer,
            facts,
            thinning: Thinning::default(),
            device: false,
            installation: None,
            card: None,
            standing: Vec::new(),
            held: false,
        }
    }

    /// This member with new facts and without standing verdicts.
    pub(crate) fn unjudged(&self, facts: Arc<PeerFacts>) -> Member {
        Member {
            thinning: self.thinning,
            device: self.device,
            installation: self.installation.clone(),
            card: self.card.clone(),
            held: self.held,
            ..Member::new(self.peer, facts)
        }
    }

    /// This member without the verdicts that stand only up to some time; none if there are no such.
    pub(crate) fn timeless(&self) -> Option<Member> {
        let timeless = |verdict: &&StandingVerdict| verdict.until.is_none();
        let standing: Vec<_> = self.standing.iter().filter(timeless).cloned().collect();
        (standing.len() < self.standing.len()).then(|| Member {
            standing,
            ..self.clone()
        })
    }

    /// This member with another thinning, as a device or not.
    pub(crate) fn on_terms(&self, thinning: Thinning, device: bool) -> Member {
        Member {
            thinning,
            device,
            installation: self.installation.clone().filter(|_| device),
            ..self.clone()
        }
    }

    /// What it asked for when it joined.
    pub(crate) fn describe_terms(&self, map: &mut Map) {
        self.thinning.describe(map);
        if self.device {
            map.set("device", true);
        }
    }

    /// This member with its messages sent to the hub one by one, or not any more.
    pub(crate) fn holding(&self, held: bool) -> Member {
        Member { held, ..self.clone() }
    }

    /// The verdict that stands for a message of this name.
    pub fn standing(&self, name: &str, now: Micros) -> Option<&StandingVerdict> {
        if self.held {
            return None;
        }
        self.standing
            .iter()
            .find(|verdict| match verdict.name.as_deref() {
                Some(known) => known == name,
                None => !has_own_right(name),
            })
            .filter(|verdict| verdict.until.is_none_or(|until| now < until))
    }

    /// This member with one standing verdict more; `None` if there is no room for it.
    pub(crate) fn with(&self, verdict: StandingVerdict) -> Option<Member> {
        let mut standing: Vec<_> = match verdict.name {
            // A verdict for all names takes the place of those for some.
            None => self
                .standing
                .iter()
                .filter(|known| known.name.as_deref().is_some_and(has_own_right))
                .cloned()
                .collect(),
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
            thinning: self.thinning,
            device: self.device,
            installation: self.installation.clone(),
            card: self.card.clone(),
            standing,
            held: self.held,
        })
    }
}
