//! `zones`: boxes in space with a token each, of which no two that overlap have different owners (M40).

use std::sync::Arc;

use mom_proto::{Code, Map, Path, Value, Verb, WireError};
use serde::Deserialize;

use crate::{Manager, Question, Setup, Verdict};

/// The most zones of one manager: each grab looks at all of them.
const MOST: usize = 256;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    zones: Vec<ZoneParams>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ZoneParams {
    token: String,
    from: [f64; 3],
    to: [f64; 3],
}

/// Denies the grab of a zone, and its return, that overlaps one which another peer owns, or is being granted. It narrows what others allow:
/// who may have a zone at all, and what happens when two want the same one, the other managers of its chain say.
#[derive(Debug)]
struct Zones {
    label: Arc<str>,
    zones: Vec<Zone>,
}

/// A box along the axes.
#[derive(Debug)]
struct Zone {
    token: Path,
    from: [f64; 3],
    to: [f64; 3],
}

pub(crate) fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let Params { zones } = setup.params()?;
    if zones.is_empty() || zones.len() > MOST {
        return Err(setup.error("zones", &format!("zones are 1 to {MOST} boxes")));
    }
    let mut all: Vec<Zone> = Vec::with_capacity(zones.len());
    for (index, zone) in zones.into_iter().enumerate() {
        let zone = make_zone(setup, index, &zone)?;
        if all.iter().any(|other| other.token == zone.token) {
            let text = format!("{} has a box already; a zone is one box", zone.token);
            return Err(setup.error(&format!("zones/{index}/token"), &text));
        }
        all.push(zone);
    }
    Ok(Box::new(Zones {
        label: setup.label.into(),
        zones: all,
    }))
}

fn make_zone(setup: &Setup<'_>, index: usize, params: &ZoneParams) -> Result<Zone, WireError> {
    let key = |key: &str| format!("zones/{index}/{key}");
    let token = Path::parse(&params.token).map_err(|error| setup.error(&key("token"), &error.text))?;
    for ((from, to), axis) in params.from.into_iter().zip(params.to).zip(["x", "y", "z"]) {
        if !(from.is_finite() && to.is_finite() && from < to) {
            let text = format!("{axis} goes from {from} to {to}; the second number must be greater");
            return Err(setup.error(&key("to"), &text));
        }
    }
    Ok(Zone {
        token,
        from: params.from,
        to: params.to,
    })
}

impl Zone {
    /// Those that it overlaps.
    fn others<'a>(&'a self, all: &'a [Zone]) -> impl Iterator<Item = &'a Zone> {
        all.iter()
            .filter(|other| other.token != self.token && other.overlaps(self))
    }

    /// Whether they share more than a face.
    fn overlaps(&self, other: &Zone) -> bool {
        (0..3).all(|axis| self.from[axis] < other.to[axis] && other.from[axis] < self.to[axis])
    }
}

impl Manager for Zones {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let verdict = match question.verb {
            Verb::Grab | Verb::Accept => self.own(question, &Code::HELD),
            // Asked when a lent zone is to come back, and after a new configuration, which may have moved boxes.
            Verb::Renew => self.own(question, &Code::DENIED),
            _ => Verdict::allow_always(),
        };
        verdict.by(&self.label)
    }

    fn neighbours(&self, token: &Path) -> Vec<Path> {
        let Some(zone) = self.zones.iter().find(|zone| zone.token == *token) else {
            return Vec::new();
        };
        zone.others(&self.zones)
            .map(|other| other.token.clone())
            .collect()
    }

    /// `zone {from, to}`.
    fn facts(&self, context: &Path) -> Map {
        let corner = |at: [f64; 3]| Value::from(at.map(Value::Double).to_vec());
        match self.zones.iter().find(|zone| zone.token == *context) {
            Some(zone) => Map::new().with(
                "zone",
                Map::new()
                    .with("from", corner(zone.from))
                    .with("to", corner(zone.to)),
            ),
            None => Map::new(),
        }
    }
}

impl Zones {
    fn own(&self, question: &Question<'_>, code: &Code) -> Verdict {
        let Some(zone) = self.zones.iter().find(|zone| zone.token == *question.context) else {
            let text = format!(
                "{} has no box, so whom it would be in the way of is not known",
                question.context
            );
            return Verdict::deny(Code::DENIED, &*self.label, text);
        };
        for other in zone.others(&self.zones) {
            let Some(facts) = question.others.token(&other.token) else {
                continue;
            };
            if let Some(owner) = facts.owner.filter(|owner| !owner.asks) {
                let text = format!(
                    "{} overlaps {}, which {} holds",
                    question.context, other.token, owner.name
                );
                return Verdict::deny(code.clone(), &*self.label, text).earliest(facts.lease_end);
            }
        }
        Verdict::allow()
    }
}
