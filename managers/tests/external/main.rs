//! A kind of manager that another crate makes, with nothing but what this one shows (the example of the guide).

mod small_only;

use mom_managers::{Answer, Manager, NoTokens, PeerFacts, Question, Registry, Verdict};
use mom_proto::{Code, ContextKind, Map, Path, Time, Value, Verb};

const GUIDE: &str = include_str!("../../../docs/managers.md");
const EXAMPLE: &str = include_str!("small_only.rs");

fn registry() -> Registry {
    let mut registry = small_only::registry();
    let spec = Map::new().with("kind", "small-only").with("most", 4096);
    registry.define("small", spec.into());
    registry
}

/// Alice's message of a size, or another verb of hers.
fn ask(manager: &mut dyn Manager, verb: Verb, size: usize) -> Verdict {
    let context = Path::parse("/chat").expect("it is a path");
    let peer = PeerFacts {
        name: "alice".into(),
        user: "alice".into(),
        level: 1,
        groups: Vec::new().into(),
    };
    manager.decide(&Question {
        peer: &peer,
        verb,
        context: &context,
        kind: ContextKind::Channel,
        message: (verb == Verb::Send).then_some("say"),
        size,
        age: None,
        token: None,
        others: &NoTokens,
        invited: false,
        created: false,
        answers: &[],
        repeated: false,
        now: 0,
        wall: Time::default(),
    })
}

fn check(manager: &mut dyn Manager, table: &[(Verb, usize, Option<&str>)]) {
    for (verb, size, denied_by) in table {
        let verdict = ask(manager, *verb, *size);
        match &verdict.answer {
            Answer::Allow(_) => assert_eq!(*denied_by, None, "{verb} of {size}"),
            Answer::Deny(denial) => {
                assert_eq!(Some(denial.rule.as_str()), *denied_by, "{verb} of {size}");
                assert_eq!(denial.code, Code::DENIED);
            }
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn the_example_is_the_one_of_the_guide() {
    assert!(
        GUIDE.contains(EXAMPLE.trim_end()),
        "docs/managers.md shows another small_only.rs"
    );
}

#[test]
fn it_is_made_by_its_name() {
    let mut manager = registry().build(&"small".into()).unwrap();
    check(
        &mut *manager,
        &[
            (Verb::Send, 4096, None),
            (Verb::Send, 4097, Some("small")),
            (Verb::Join, 4097, None),
        ],
    );
}

#[test]
fn it_narrows_what_others_of_a_chain_allow() {
    let rule = Map::new()
        .with("allow", vec!["send".into()])
        .with("name", "all talk");
    let roles = Map::new().with("kind", "roles").with("rules", vec![rule.into()]);
    let inline = Map::new().with("kind", "small-only").with("most", 10);
    let links: Vec<Value> = vec![roles.into(), "small".into(), inline.into()];
    let chain = Map::new().with("kind", "chain").with("of", links);
    let mut manager = registry().build(&chain.into()).unwrap();
    check(
        &mut *manager,
        &[
            (Verb::Send, 10, None),
            (Verb::Send, 11, Some("chain/small-only")),
            (Verb::Send, 5000, Some("small")),
            (Verb::Join, 0, Some("chain/roles")),
        ],
    );
    let verdict = ask(&mut *manager, Verb::Send, 1);
    assert_eq!(verdict.rule.as_deref(), Some("chain/roles/all talk"));
}

#[test]
fn what_is_wrong_with_it_is_told_with_its_key() {
    for (params, slot) in [
        (Map::new().with("most", 0), "of/0/most"),
        (Map::new().with("most", "large"), "of/0/most"),
        (Map::new().with("most", 1).with("least", 1), "of/0/least"),
    ] {
        let link = params.with("kind", "small-only");
        let chain = Map::new().with("kind", "chain").with("of", vec![link.into()]);
        let error = registry().build(&chain.into()).expect_err("it is wrong");
        assert_eq!(error.get("slot").and_then(Value::as_str), Some(slot), "{error}");
    }
    let error = registry().build(&"smal-only".into()).expect_err("there is none");
    assert_eq!(error.get("nearest"), Some(&"small-only".into()));
}
