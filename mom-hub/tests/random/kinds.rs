//! Managers of the tests' own making: they fail, defer, count and take turns.

use std::sync::Arc;

use mom_managers::{
    Answer, Ask, Bucket, Denial, Grant, Manager, Question, Rate, Registry, Scope, Standing, Terms, Verdict,
    Wait,
};
use mom_proto::{Code, Micros, Verb, WireError};

/// µs
pub(crate) const HOLD: Micros = 3_000_000;
/// µs
pub(crate) const NOTICE: Micros = 1_000_000;
/// What `counted` allows.
pub(crate) const RATE: Rate = Rate {
    parcels: Bucket {
        per_second: 2,
        burst: 2,
    },
    bytes: Bucket::UNLIMITED,
};

/// All of them.
pub(crate) fn add_kinds(registry: &mut Registry) {
    registry.add_kind("moody", |_| made(Moody));
    registry.add_kind("own", |setup| made(Own(setup.label.into())));
    registry.add_kind("chaired", |setup| made(Chaired(setup.label.into())));
    registry.add_kind("turns", |_| made(Turns));
    registry.add_kind("counted", |_| made(Counted));
}

fn made(manager: impl Manager + 'static) -> Result<Box<dyn Manager>, WireError> {
    Ok(Box::new(manager))
}

/// Fails, denies, defers without end or allows, as the time and the peer have it.
#[derive(Debug)]
struct Moody;

impl Manager for Moody {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        if matches!(question.verb, Verb::Info | Verb::Members) {
            return Verdict::allow();
        }
        let seed = question.now / 1_000_000 + question.verb.word().len() as u64;
        let mood = question
            .peer
            .name
            .bytes()
            .fold(seed, |sum, byte| sum * 31 + u64::from(byte));
        match mood % 8 {
            // Without the noise of a panic.
            0 => std::panic::resume_unwind(Box::new("a bad day")),
            1 => Verdict::deny(Code::DENIED, "moody", "not today"),
            2 => Verdict::deny(Code::HELD, "moody", "not now"),
            3 => anyone("moody", 1_000_000),
            _ => Verdict::allow(),
        }
    }
}

/// As `self`: who made the context is asked about all but looking.
#[derive(Debug)]
struct Own(Arc<str>);

impl Manager for Own {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let asked = matches!(
            question.verb,
            Verb::Grab | Verb::Send | Verb::Join | Verb::Inhibit
        );
        match question.given(&self.0) {
            _ if !asked || question.created => Verdict::allow(),
            Some(given) if given.allow && given.stands => Verdict::allow().stands(Scope::ThisName),
            Some(given) if given.allow => Verdict::allow(),
            Some(_) => Verdict::deny(Code::DENIED, &*self.0, "its maker said no"),
            None => Verdict::defer(Arc::clone(&self.0), Ask::Creator, 1_500_000),
        }
    }
}

/// As `moderated`: the operators who are there are asked, except about stops, and what they allow may end.
#[derive(Debug)]
struct Chaired(Arc<str>);

impl Manager for Chaired {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let asked = matches!(question.verb, Verb::Grab | Verb::Send | Verb::Break);
        let chair = question.peer.groups.iter().any(|group| group == "operator");
        if !asked || chair {
            return Verdict::allow();
        }
        // Nobody is asked about what cannot be granted now: it may wait.
        let token = question.token.unwrap_or_default();
        if question.verb == Verb::Grab && token.owner.is_some_and(|owner| !owner.asks) {
            return Verdict::deny(Code::HELD, &*self.0, "another peer has it");
        }
        match question.given(&self.0) {
            Some(given) if given.allow => Verdict {
                answer: Answer::Allow(Grant {
                    displace: false,
                    until: given.stands.then_some(question.now + 4_000_000),
                    priority: None,
                }),
                ..Verdict::allow()
            },
            Some(_) => Verdict::deny(Code::DENIED, &*self.0, "no chair allows it"),
            None => anyone(&self.0, 3_000_000),
        }
    }
}

fn anyone(label: &str, within: Micros) -> Verdict {
    let chairs = Ask::Chairs {
        users: Arc::new([]),
        groups: Arc::new(["operator".to_owned()]),
        min_level: None,
    };
    Verdict::defer(label, chairs, within)
}

/// As `queue`: one after the other, each for a while.
#[derive(Debug)]
struct Turns;

impl Manager for Turns {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let token = question.token.unwrap_or_default();
        let taken = token.owner.is_some_and(|owner| !owner.asks);
        if question.verb != Verb::Grab || !taken {
            return Verdict::allow();
        }
        let denial = Denial {
            code: Code::HELD,
            text: "another peer's turn".to_owned(),
            rule: "turns".to_owned(),
            earliest: token.lease_end,
        };
        let expected = token.lease_end;
        Verdict {
            answer: Answer::Queue(Wait { denial, expected }),
            ..Verdict::allow()
        }
    }

    fn terms(&self) -> Terms {
        Terms {
            lease: Some(20_000_000),
            hold: Some(HOLD),
            notice: NOTICE,
            ..Terms::default()
        }
    }
}

/// As `quota`: a verdict that stands for a second, with a rate.
#[derive(Debug)]
struct Counted;

impl Manager for Counted {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        Verdict {
            standing: Standing::Stands {
                scope: Scope::AnyName,
                until: Some(question.now + 1_000_000),
                rate: Some(RATE),
                // It allows older ones too, but wants to be asked.
                max_age: Some(500_000),
            },
            ..Verdict::allow()
        }
    }
}
