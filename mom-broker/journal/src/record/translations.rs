//! Translates numbers of the recorded hub into those of the replaying hub.

use std::collections::BTreeMap;

use mom_hub::{Effect, Ticket};
use mom_proto::{MAX_ID, Parcel, Path, Value};

use super::outcome::{Outcome, outcomes};

/// Numbers of the recorded hub with their counterparts here. Where both hubs decide alike they are equal.
#[derive(Debug, Default)]
pub(super) struct Translations {
    /// By token and number.
    fences: BTreeMap<(String, u64), u64>,
    questions: BTreeMap<u64, u64>,
    tickets: BTreeMap<u64, u64>,
    /// The token that guards each channel, in this hub.
    guards: BTreeMap<Path, String>,
}

impl Translations {
    /// Notes a route of this hub.
    pub(super) fn route(&mut self, route: &mom_hub::Route) {
        match &route.guard {
            Some(guard) => self.guards.insert(route.path.clone(), guard.token.to_string()),
            None => self.guards.remove(&route.path),
        };
    }

    /// Learns from both decisions on the same input; gives the tickets for which only this hub waits.
    pub(super) fn note(&mut self, effects: &[Effect], left: &mut Vec<&Outcome>) -> Vec<Ticket> {
        let mut own = Vec::new();
        for effect in effects {
            if let Effect::Route(route) = effect {
                self.route(route);
            }
        }
        for outcome in outcomes(effects, None) {
            let same = left.iter().position(|other| same_thing(&outcome, other));
            let there = same.map(|place| left.remove(place));
            match (&outcome, there) {
                (
                    Outcome::Granted {
                        context,
                        fence: Some(here),
                        ..
                    },
                    Some(Outcome::Granted {
                        fence: Some(there), ..
                    }),
                ) => drop(self.fences.insert((context.clone(), *there), *here)),
                (
                    Outcome::Asked {
                        question: Some(here), ..
                    },
                    Some(Outcome::Asked {
                        question: Some(there),
                        ..
                    }),
                ) => {
                    self.questions.insert(*there, *here);
                }
                (Outcome::Stored { ticket: here, .. }, Some(Outcome::Stored { ticket: there, .. })) => {
                    self.tickets.insert(*there, *here);
                }
                (Outcome::Stored { ticket, .. }, _) => own.push(Ticket(*ticket)),
                _ => {}
            }
        }
        own
    }

    /// Translates a fence that was named on this channel.
    pub(super) fn fence(&self, channel: Option<&Path>, fence: u64) -> u64 {
        let token = channel.and_then(|channel| self.guards.get(channel));
        let here = token.and_then(|token| self.fences.get(&(token.clone(), fence)));
        here.copied().unwrap_or(fence)
    }

    /// Translates a ticket; none if nothing was stored.
    pub(super) fn ticket(&mut self, there: u64) -> Option<Ticket> {
        self.tickets.remove(&there).map(Ticket)
    }

    /// Lets a verdict answer the same question here.
    pub(super) fn verdict(&self, parcel: &mut Parcel) {
        let mut value = parcel.value();
        let Value::Map(map) = &mut value else { return };
        let Some(there) = map.get("consult").and_then(Value::as_int) else {
            return;
        };
        let here = u64::try_from(there)
            .ok()
            .and_then(|there| self.questions.get(&there));
        // An answer to a question that this hub did not ask is too late, even if another question has its number.
        let here = here.copied().unwrap_or(MAX_ID);
        map.set("consult", i64::try_from(here).unwrap_or(i64::MAX));
        parcel.content = Some(value.into());
    }
}

fn same_thing(here: &Outcome, there: &Outcome) -> bool {
    match (here, there) {
        (
            Outcome::Granted { context, owner, .. },
            Outcome::Granted {
                context: other,
                owner: who,
                ..
            },
        ) => context == other && owner == who,
        (Outcome::Asked { context, .. }, Outcome::Asked { context: other, .. })
        | (Outcome::Stored { context, .. }, Outcome::Stored { context: other, .. }) => context == other,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use mom_hub::PeerId;
    use mom_proto::{Family, Map};

    fn consult(number: u64, context: &str) -> Effect {
        let mut parcel = Parcel::new(Family::Manager, "consult").context(Path::parse(context).unwrap());
        parcel.id = Some(number);
        Effect::Deliver {
            to: vec![PeerId(1)],
            parcel: Arc::new(parcel),
        }
    }

    /// A verdict answers the question about the same request, whatever its number is here.
    #[test]
    fn questions_are_those_of_the_replay() {
        let asked = |question, context: &str| Outcome::Asked {
            context: context.to_owned(),
            question: Some(question),
        };
        let recorded = [asked(7, "/b"), asked(8, "/a"), asked(9, "/c")];
        let mut translations = Translations::default();
        let mut left = recorded.iter().collect();
        let effects = [consult(2, "/a"), consult(3, "/b"), consult(4, "/d")];
        assert!(translations.note(&effects, &mut left).is_empty());
        assert_eq!(left.len(), 1);
        for (there, here) in [(7, 3), (8, 2), (9, MAX_ID)] {
            let content = Map::new().with("consult", there).with("allow", true);
            let mut parcel = Parcel::new(Family::Manager, "verdict").content(content);
            translations.verdict(&mut parcel);
            let here = i64::try_from(here).unwrap();
            let content = Map::new().with("consult", here).with("allow", true);
            assert_eq!(parcel.content, Some(content.into()), "{there}");
        }
    }
}
