//! Managers that all have to allow.

use mom_proto::{Map, Value, Verb, WireError};

use super::{Ask, GRAB, ask, build, of, short};
use crate::{Manager, Question, Registry, Scope, Setup, Standing, Verdict};

fn chain(links: Vec<Value>) -> Map {
    of("chain").with("of", links)
}

#[test]
fn the_first_denial_is_the_answer() {
    let lease = || Value::from("level-or-lease");
    let grabbers = Map::new().with("allow", vec!["grab".into()]).with("min-level", 1);
    let roles = || Value::from(of("roles").with("rules", vec![grabbers.clone().into()]));
    let held = Ask {
        owner: Some(("bob", 1, false)),
        lease_end: Some(7),
        ..GRAB
    };
    for (links, question, expected) in [
        (vec![roles(), lease()], GRAB, "allow"),
        (vec![roles(), lease()], held, "level-or-lease: held at 7"),
        (
            vec![roles(), lease()],
            Ask { level: 0, ..held },
            "chain/roles: denied",
        ),
        (
            vec![lease(), roles()],
            Ask { level: 0, ..held },
            "level-or-lease: held at 7",
        ),
        // One link that takes it from its owner is enough, if all allow.
        (vec![roles(), lease()], Ask { level: 2, ..held }, "displace"),
        (vec![lease(), roles()], Ask { level: 2, ..held }, "displace"),
        (vec!["open".into()], held, "allow"),
        (vec!["open".into(), "closed".into()], GRAB, "closed: denied"),
        (
            vec![chain(vec![roles()]).into(), lease()],
            held,
            "level-or-lease: held at 7",
        ),
    ] {
        // A link that is named is known by its name, one that is written out by where it is.
        let mut manager = build(chain(links.clone()));
        assert_eq!(short(&ask(&mut *manager, &question)), expected, "{links:?}");
    }
}

/// Allows for as long as its parameters say.
#[derive(Debug)]
struct Until(Standing);

impl Manager for Until {
    fn decide(&mut self, _: &Question<'_>) -> Verdict {
        Verdict {
            standing: self.0,
            ..Verdict::allow()
        }
    }
}

fn until(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let params: Map = setup.params::<Value>()?.as_map().cloned().unwrap_or_default();
    let until = params
        .get("until")
        .and_then(Value::as_int)
        .and_then(|until| u64::try_from(until).ok());
    let scope = match params.contains_key("this") {
        true => Scope::ThisName,
        false => Scope::AnyName,
    };
    let once = params.contains_key("once");
    Ok(Box::new(Until(if once {
        Standing::Once
    } else {
        Standing::Stands {
            scope,
            until,
            rate: None,
        }
    })))
}

#[test]
fn a_chain_stands_as_long_as_all_its_links() {
    let mut registry = Registry::builtin();
    registry.add_kind("until", until);
    let until = |time: i64| of("until").with("until", time);
    let stands = |scope, until| Standing::Stands {
        scope,
        until,
        rate: None,
    };
    for (links, expected) in [
        (vec![of("open")], stands(Scope::AnyName, None)),
        (
            vec![until(5), until(3), of("open")],
            stands(Scope::AnyName, Some(3)),
        ),
        (
            vec![until(3), of("until").with("this", true)],
            stands(Scope::ThisName, Some(3)),
        ),
        (vec![until(3), of("until").with("once", true)], Standing::Once),
        // A denial stands no longer than the allowances before it.
        (vec![until(3), of("closed")], stands(Scope::AnyName, Some(3))),
        (vec![of("closed"), until(3)], stands(Scope::AnyName, None)),
    ] {
        let links: Vec<Value> = links.into_iter().map(Value::from).collect();
        let mut manager = registry.build(&chain(links.clone()).into()).unwrap();
        let question = Ask {
            verb: Verb::Send,
            message: Some("say"),
            ..GRAB
        };
        assert_eq!(ask(&mut *manager, &question).standing, expected, "{links:?}");
    }
}
