//! Managers that all have to allow.

use mom_proto::{Code, Map, Value, Verb, WireError};
use proptest::prelude::*;

use super::{Ask, GRAB, ask, build, of, short, words};
use crate::{self as managers, Answer, Bucket, Expiry, GivenAnswer, Grant, Rate};
use crate::{Manager, Question, Registry, Scope, Setup, Standing, Terms, Verdict};

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
            max_age: None,
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
        max_age: None,
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

/// Says what its parameter says: a word and a number.
#[derive(Debug)]
struct Canned(String, u64);

impl Manager for Canned {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let Canned(word, number) = self;
        let denied = || Verdict::deny(Code::HELD, format!("no {number}"), "no");
        let label = format!("ask {number}");
        let verdict = match word.as_str() {
            "deny" => denied(),
            "queue" => denied().or_wait(Some(*number)),
            "defer" if question.given(&label).is_some_and(|given| given.allow) => Verdict::allow(),
            "defer" => Verdict::defer(label, managers::Ask::Creator, *number),
            "displace" => Verdict::displace(),
            "until" => Verdict::allow().until(Some(*number)),
            _ => Verdict::allow(),
        };
        // Also where nothing may stand by it.
        verdict.stands_until(Scope::AnyName, Some(1000 + *number))
    }
}

fn canned(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    #[derive(serde::Deserialize)]
    struct Params {
        word: String,
        number: u64,
    }
    let Params { word, number } = setup.params()?;
    Ok(Box::new(Canned(word, number)))
}

fn chain_of(said: &[(&str, u64)]) -> Box<dyn Manager> {
    let mut registry = Registry::builtin();
    registry.add_kind("canned", canned);
    let links = said.iter().map(|(word, number)| {
        let number = i64::try_from(*number).unwrap();
        of("canned").with("word", *word).with("number", number).into()
    });
    registry.build(&chain(links.collect()).into()).unwrap()
}

const WORDS: [&str; 6] = ["allow", "displace", "until", "deny", "defer", "queue"];

proptest! {
    /// A chain allows only if all its links do; else any denial comes before any question, and any question before
    /// any place in a line.
    #[test]
    fn a_chain_allows_only_what_all_links_allow(
        said in prop::collection::vec((prop::sample::select(WORDS.to_vec()), 1_u64..9), 1..9),
    ) {
        let verdict = ask(&mut *chain_of(&said), &GRAB);
        let first = |word: &str| said.iter().find(|(said, _)| *said == word).map(|(_, number)| *number);
        match &verdict.answer {
            Answer::Allow(grant) => {
                prop_assert!(said.iter().all(|(word, _)| ["allow", "displace", "until"].contains(word)));
                let until = said.iter().filter(|(word, _)| *word == "until").map(|(_, number)| *number).min();
                prop_assert_eq!(grant, &Grant { displace: first("displace").is_some(), until, priority: None });
                let stands = said.iter().map(|(_, number)| 1000 + number).min();
                let rate = None;
                prop_assert_eq!(verdict.standing, Standing::Stands { scope: Scope::AnyName, until: stands, rate, max_age: None });
            }
            Answer::Deny(denial) => {
                prop_assert_eq!(Some(denial.rule.clone()), first("deny").map(|number| format!("no {number}")));
            }
            Answer::Defer(defer) => {
                prop_assert_eq!((first("deny"), first("defer")), (None, Some(defer.within)));
                prop_assert_eq!(verdict.standing, Standing::Once);
            }
            Answer::Queue(wait) => {
                prop_assert_eq!((first("deny"), first("defer"), first("queue")), (None, None, wait.expected));
                prop_assert_eq!(verdict.standing, Standing::Once);
            }
        }
    }
}

fn yes(label: &str) -> GivenAnswer {
    GivenAnswer {
        label: label.into(),
        by: Some("dora".into()),
        allow: true,
        stands: false,
        text: String::new(),
    }
}

#[test]
fn each_link_is_asked_with_all_answers() {
    let mut manager = chain_of(&[("defer", 1), ("displace", 2), ("defer", 3)]);
    for (answers, expected) in [
        (vec![], "ask by ask 1"),
        (vec![yes("ask 3")], "ask by ask 1"),
        (vec![yes("ask 1")], "ask by ask 3"),
        (vec![yes("ask 1"), yes("ask 3")], "displace"),
    ] {
        let question = Ask {
            answers: &answers,
            ..GRAB
        };
        assert_eq!(short(&ask(&mut *manager, &question)), expected, "{answers:?}");
    }
}

#[test]
#[rustfmt::skip]
fn one_chairs_word_does_not_count_for_another() {
    let chaired = |user: &str| -> Value {
        of("moderated").with("chairs", Map::new().with("users", words(&[user]))).into()
    };
    let mut registry = Registry::builtin();
    // A name that looks like that of a link without one.
    registry.define("chain/moderated~2", chaired("fred"));
    let inner = chain(vec![chaired("gina")]).into();
    let links = vec![chaired("dora"), chaired("erik"), "chain/moderated~2".into(), inner];
    let mut manager = registry.build(&chain(links).into()).unwrap();
    let mut answers = Vec::new();
    for label in ["chain/moderated", "chain/moderated~3", "chain/moderated~2", "chain/chain/moderated"] {
        let verdict = ask(&mut *manager, &Ask { answers: &answers, ..GRAB });
        assert_eq!(short(&verdict), format!("ask by {label}"));
        answers.push(yes(label));
    }
    assert_eq!(short(&ask(&mut *manager, &Ask { answers: &answers, ..GRAB })), "allow");
}

#[test]
#[rustfmt::skip]
fn rates_are_the_narrowest_and_a_denial_has_none() {
    let limit = |parcels: i64, bytes: i64| -> Value {
        let limit = Map::new().with("parcels", parcels).with("bytes", bytes);
        of("quota").with("limits", vec![limit.into()]).into()
    };
    let bucket = |rate| Bucket { per_second: rate, burst: rate };
    let rate = Some(Rate { parcels: bucket(3), bytes: bucket(4) });
    let send = Ask { verb: Verb::Send, message: Some("say"), ..GRAB };
    for (links, expected) in
        [(vec![limit(3, 9), "open".into(), limit(5, 4)], rate), (vec![limit(3, 9), "closed".into()], None)]
    {
        let verdict = ask(&mut *build(chain(links.clone())), &send);
        let expected = Standing::Stands { scope: Scope::AnyName, until: None, rate: expected, max_age: None };
        assert_eq!(verdict.standing, expected, "{links:?}");
    }
}

#[test]
fn a_chain_is_named_by_its_first_link_and_a_denial_by_its_own() {
    for (links, expected) in [
        (vec!["open".into(), "queue".into()], "open"),
        (vec!["queue".into(), "closed".into()], "closed"),
    ] {
        let links: Vec<Value> = links;
        let verdict = ask(&mut *build(chain(links)), &GRAB);
        assert_eq!(verdict.rule.as_deref(), Some(expected));
    }
}

#[test]
fn the_terms_are_those_of_the_first_link_that_names_them() {
    let eager = || of("queue").with("expiry", "eager").with("notice", 0);
    for (links, expected) in [
        (vec![of("open")], Terms::default()),
        (
            vec![
                of("first-come"),
                of("queue").with("hold", 5),
                of("level-or-lease").with("hold", 6).with("deadman", 7),
            ],
            Terms {
                lease: Some(180_000_000),
                expiry: Expiry::Lazy,
                deadman: Some(7000),
                hold: Some(5000),
                by_level: false,
                notice: 10_000_000,
            },
        ),
        // A lease and what happens at its end belong together.
        (
            vec![
                eager(),
                of("first-come").with("lease", 8),
                of("first-come").with("lease", 9).with("expiry", "eager"),
            ],
            Terms {
                lease: Some(8000),
                ..Terms::default()
            },
        ),
        (
            vec![of("queue"), of("open")],
            Terms {
                notice: 10_000_000,
                ..Terms::default()
            },
        ),
        (
            vec![eager(), of("open")],
            Terms {
                expiry: Expiry::Eager,
                ..Terms::default()
            },
        ),
    ] {
        let links: Vec<Value> = links.into_iter().map(Value::from).collect();
        assert_eq!(build(chain(links.clone())).terms(), expected, "{links:?}");
    }
}

#[test]
fn a_chain_has_sixteen_links_at_most() {
    let of = |links| Registry::builtin().build(&chain(vec!["open".into(); links]).into());
    assert!(of(16).is_ok());
    for links in [17, 18] {
        let error = of(links).expect_err("too many");
        assert!(error.text.contains("at most 16 managers"), "{error}");
    }
    assert!(of(0).expect_err("none").text.contains("at least one"));
}
