//! `schedule`: reserved slots of the calendar.

use std::sync::Arc;

use mom_proto::{Code, Micros, Verb, WireError};
use serde::Deserialize;

use crate::calendar::{self, Span};
use crate::held::other_owner;
use crate::params::Verbs;
use crate::who::{Who, WhoParams};
use crate::{Manager, Question, Scope, Setup, Verdict};

/// The most slots of one schedule: each question checks all of them.
const MOST: usize = 1024;

/// The most consecutive slots that are joined: a longer grant ends there, and later gaps are not searched.
const STEPS: usize = 64;

/// The verbs that give control of a token.
const DEFAULT_VERBS: [Verb; 3] = [Verb::Grab, Verb::Accept, Verb::Inhibit];

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    slots: Vec<SlotParams>,
    #[serde(default)]
    free: Free,
    verbs: Option<Vec<String>>,
}

/// The rule outside all slots.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Free {
    /// Everybody may.
    #[default]
    Allow,
    /// Nobody may.
    Deny,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct SlotParams {
    name: Option<String>,
    from: String,
    to: String,
    days: Option<Vec<String>>,
    users: Option<Vec<String>>,
    groups: Option<Vec<String>>,
    min_level: Option<i32>,
}

/// Admits only the listed peers during a slot.
#[derive(Debug)]
struct Schedule {
    label: Arc<str>,
    slots: Vec<Period>,
    free: Free,
    verbs: Verbs,
}

#[derive(Debug)]
struct Period {
    name: Arc<str>,
    span: Span,
    who: Who,
}

pub(crate) fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let params: Params = setup.params()?;
    if params.slots.is_empty() {
        return Err(setup.error("slots", "a schedule needs at least one slot"));
    }
    if params.slots.len() > MOST {
        return Err(setup.error("slots", &format!("a schedule has at most {MOST} slots")));
    }
    let slots = params.slots.into_iter().enumerate();
    let slots: Result<Vec<Period>, WireError> =
        slots.map(|(index, slot)| make_slot(setup, index, slot)).collect();
    Ok(Box::new(Schedule {
        label: setup.label.into(),
        slots: slots?,
        free: params.free,
        verbs: Verbs::read_or(setup, params.verbs, &DEFAULT_VERBS)?,
    }))
}

fn make_slot(setup: &Setup<'_>, index: usize, params: SlotParams) -> Result<Period, WireError> {
    let key = format!("slots/{index}");
    let name = params.name.unwrap_or_else(|| format!("slot {}", index + 1));
    let who = WhoParams {
        users: params.users,
        groups: params.groups,
        min_level: params.min_level,
    };
    Ok(Period {
        name: format!("{}/{name}", setup.label).into(),
        span: Span::read(setup, &key, &params.from, &params.to, params.days.as_deref())?,
        who: Who::read(setup, &key, who)?,
    })
}

impl Manager for Schedule {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        if !self.verbs.narrow(question.verb) {
            return Verdict::allow_always().by(&self.label);
        }
        let at = question.wall.micros();
        let (verdict, by) = match self.reserved(at).find(|slot| slot.who.fits(question.peer)) {
            Some(own) => (self.grant(question, at), &own.name),
            None => match (self.reserved(at).next(), self.free) {
                (Some(slot), _) => (self.refuse(question, at, Some(slot)), &slot.name),
                (None, Free::Deny) => (self.refuse(question, at, None), &self.label),
                (None, Free::Allow) => (self.lend(question, at), &self.label),
            },
        };
        let verdict = verdict.by(by);
        match question.message {
            // The answer to a message depends on the slots alone.
            Some(_) => verdict.stands_until(
                Scope::AnyName,
                self.next_change(at).map(|end| clock(question, end)),
            ),
            None => verdict,
        }
    }
}

impl Schedule {
    /// The slots that contain this instant.
    fn reserved(&self, at: i64) -> impl Iterator<Item = &Period> {
        self.slots.iter().filter(move |slot| slot.span.end(at).is_some())
    }

    /// The slots that list the peer.
    fn own<'a>(&'a self, question: &Question<'a>) -> impl Iterator<Item = &'a Period> {
        let peer = question.peer;
        self.slots.iter().filter(move |slot| slot.who.fits(peer))
    }

    /// During the peer's own slot: grants the token until the slot's end, also from an owner without a slot.
    fn grant(&self, question: &Question<'_>, at: i64) -> Verdict {
        let in_the_way = other_owner(question).filter(|_| question.verb == Verb::Grab);
        let evicts =
            in_the_way.is_some_and(|owner| !self.reserved(at).any(|slot| slot.who.fits_owner(&owner)));
        let verdict = match evicts {
            true => Verdict::displace(),
            false => Verdict::allow(),
        };
        verdict.until(Some(clock(question, self.own_end(question, at))))
    }

    /// Outside all slots: grants until the next slot begins, or, if that is the peer's own, until it ends.
    fn lend(&self, question: &Question<'_>, at: i64) -> Verdict {
        let next = self
            .slots
            .iter()
            .filter_map(|slot| slot.span.next_begin(at))
            .min();
        Verdict::allow().until(next.map(|begin| clock(question, self.own_end(question, begin))))
    }

    fn refuse(&self, question: &Question<'_>, at: i64, reserved: Option<&Period>) -> Verdict {
        let earliest = self.next_allowed(question, at);
        let context = question.context;
        let state = match reserved.and_then(|slot| Some((slot, slot.span.end(at)?))) {
            Some((slot, end)) => {
                let (who, end) = (slot.who.words(), calendar::words(end));
                format!("{context} is reserved for {who} until {end}")
            }
            None => format!("{context} is reserved for nobody now"),
        };
        let yours = match earliest {
            Some(earliest) => format!("you may from {} on", calendar::words(earliest)),
            None => "no later slot is yours".to_owned(),
        };
        let rule = reserved.map_or(&self.label, |slot| &slot.name);
        Verdict::deny(Code::DENIED, &**rule, format!("{state}; {yours}"))
            .earliest(earliest.map(|earliest| clock(question, earliest)))
    }

    /// The end of the peer's own consecutive slots at this instant; else this instant.
    fn own_end(&self, question: &Question<'_>, at: i64) -> i64 {
        let mut end = at;
        for _ in 0..STEPS {
            match self.own(question).filter_map(|slot| slot.span.end(end)).max() {
                Some(later) => end = later,
                None => break,
            }
        }
        end
    }

    /// The next instant at which the peer may.
    fn next_allowed(&self, question: &Question<'_>, at: i64) -> Option<i64> {
        let begins = self.own(question).filter_map(|slot| slot.span.next_begin(at));
        let own = begins.min();
        if self.free == Free::Deny {
            return own;
        }
        let mut now = at;
        for _ in 0..STEPS {
            match self.slots.iter().filter_map(|slot| slot.span.end(now)).max() {
                Some(end) if own.is_none_or(|own| end < own) => now = end,
                Some(_) => return own,
                None => return Some(now),
            }
        }
        own
    }

    /// The first instant after this one at which any slot begins or ends.
    fn next_change(&self, at: i64) -> Option<i64> {
        let spans = self.slots.iter().map(|slot| &slot.span);
        spans
            .flat_map(|span| [span.end(at), span.next_begin(at)])
            .flatten()
            .min()
    }
}

/// A later instant on the hub's clock, which does not jump.
fn clock(question: &Question<'_>, at: i64) -> Micros {
    let ahead = at.saturating_sub(question.wall.micros());
    question
        .now
        .saturating_add(u64::try_from(ahead).unwrap_or_default())
}
