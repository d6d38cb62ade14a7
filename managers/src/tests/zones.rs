//! Zones of which no two that overlap have different owners.

use super::*;
use crate::Tokens;

/// Who owns which zone.
#[derive(Debug)]
struct Owned(Vec<(&'static str, &'static str)>);

impl Tokens for Owned {
    fn token(&self, path: &Path) -> Option<TokenFacts<'_>> {
        let owner = self.0.iter().find(|(zone, _)| *zone == path.as_str());
        Some(TokenFacts {
            owner: owner.map(|(_, name)| Owner {
                name,
                user: name,
                groups: &[],
                level: 1,
                asks: *name == "alice",
            }),
            lease_end: Some(7_000),
            ..TokenFacts::default()
        })
    }
}

fn zone(token: &str, from: [f64; 3], to: [f64; 3]) -> Value {
    let numbers = |numbers: [f64; 3]| Value::from(numbers.map(Value::Double).to_vec());
    Map::new()
        .with("token", token)
        .with("from", numbers(from))
        .with("to", numbers(to))
        .into()
}

/// Left and right overlap in the middle; far touches right's face only.
fn zones() -> Map {
    of("zones").with(
        "zones",
        vec![
            zone("/zone/left", [-300.0, -300.0, 0.0], [20.0, 300.0, 450.0]),
            zone("/zone/right", [-20.0, -300.0, 0.0], [300.0, 300.0, 450.0]),
            zone("/zone/far", [300.0, -300.0, 0.0], [600.0, 300.0, 450.0]),
        ],
    )
}

fn grab(path: &str, verb: Verb, owned: Vec<(&'static str, &'static str)>) -> Verdict {
    let peer = PeerFacts {
        name: "alice".into(),
        user: "alice".into(),
        level: 1,
        groups: Vec::new().into(),
    };
    build(zones()).decide(&Question {
        peer: &peer,
        verb,
        context: &Path::parse(path).unwrap(),
        kind: ContextKind::Token,
        message: None,
        size: 0,
        age: None,
        token: Some(TokenFacts::default()),
        others: &Owned(owned),
        invited: false,
        created: false,
        answers: &[],
        repeated: false,
        now: 0,
        wall: Time::default(),
    })
}

#[test]
fn a_zone_that_overlaps_anothers_is_denied() {
    for (path, verb, owned, denied) in [
        ("/zone/left", Verb::Grab, vec![], None),
        (
            "/zone/left",
            Verb::Grab,
            vec![("/zone/right", "bob")],
            Some("/zone/left overlaps /zone/right, which bob holds"),
        ),
        (
            "/zone/left",
            Verb::Accept,
            vec![("/zone/right", "bob")],
            Some("/zone/left overlaps /zone/right, which bob holds"),
        ),
        ("/zone/left", Verb::Grab, vec![("/zone/right", "alice")], None),
        ("/zone/left", Verb::Grab, vec![("/zone/far", "bob")], None),
        ("/zone/right", Verb::Grab, vec![("/zone/far", "bob")], None),
        // Its own owner is the business of the other managers of the chain.
        ("/zone/left", Verb::Grab, vec![("/zone/left", "bob")], None),
        ("/zone/left", Verb::Release, vec![("/zone/right", "bob")], None),
        (
            "/zone/other",
            Verb::Grab,
            vec![],
            Some("/zone/other has no box, so whom it would be in the way of is not known"),
        ),
    ] {
        let verdict = grab(path, verb, owned.clone());
        let told = match &verdict.answer {
            Answer::Deny(denial) => Some(denial.text.as_str()),
            Answer::Allow(_) => None,
            other => panic!("{other:?}"),
        };
        assert_eq!(told, denied, "{verb} {path} {owned:?}");
    }
}

#[test]
fn boxes_are_checked() {
    for (spec, slot) in [
        (of("zones"), "zones"),
        (of("zones").with("zones", Vec::<Value>::new()), "zones"),
        (
            of("zones").with("zones", vec![zone("/zone/left", [0.0; 3], [1.0, 0.0, 1.0])]),
            "zones/0/to",
        ),
        (
            of("zones").with("zones", vec![zone("left", [0.0; 3], [1.0; 3])]),
            "zones/0/token",
        ),
        (
            of("zones").with(
                "zones",
                vec![
                    zone("/zone/left", [0.0; 3], [1.0; 3]),
                    zone("/zone/left", [2.0; 3], [3.0; 3]),
                ],
            ),
            "zones/1/token",
        ),
    ] {
        let error = Registry::builtin().build(&spec.clone().into()).unwrap_err();
        assert_eq!(
            error.get("slot").and_then(Value::as_str),
            Some(slot),
            "{spec:?}: {error}"
        );
    }
}
