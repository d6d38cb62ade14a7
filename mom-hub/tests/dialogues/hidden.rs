//! What a peer may not look up is not there, as far as it hears.

use mom_hub::{Effect, Input};
use mom_proto::{ContextNumber, Map, Value};

use crate::stage::{Stage, context, lab, of};

const VERBS: [&str; 24] = [
    "context lookup",
    "context list",
    "context info",
    "context members",
    "context stats",
    "context audit",
    "context explain",
    "context what-if",
    "context join",
    "context leave",
    "context delete",
    "context invite",
    "context expel",
    "token grab",
    "token release",
    "token renew",
    "token give",
    "token accept",
    "token request",
    "token break",
    "token inhibit",
    "token uninhibit",
    "message say",
    "message stop",
];

/// Only bob may know of `/lab/secret` and what is in it.
fn stage() -> Stage {
    let rule = Map::new()
        .with("users", vec![Value::from("bob")])
        .with("allow", vec![Value::from("*")]);
    let secret = Map::new()
        .with("kind", "roles")
        .with("rules", vec![Value::Map(rule)]);
    let mut contexts = lab(Map::new());
    contexts.push(context("/lab/secret", "session").with("manager", secret));
    contexts.push(context("/lab/secret/key", "token"));
    contexts.push(context("/lab/secret/talk", "channel"));
    let mut stage = Stage::new(contexts);
    for name in ["alice", "bob"] {
        stage.enter(name, 1);
    }
    stage.say("bob", "context join /lab/secret");
    stage
}

/// The only answer to this, as its content with the path and the number that were named left out.
fn heard(stage: &mut Stage, input: Input, named: &str) -> String {
    stage.give(input);
    let replies = stage.effects.iter().filter_map(|effect| match effect {
        Effect::Reply { parcel, .. } => Some(parcel),
        _ => None,
    });
    let replies: Vec<String> = replies
        .map(|parcel| format!("{} {:?} {:?}", parcel.name(), parcel.context, parcel.value()))
        .collect();
    replies.join("; ").replace(named, "…")
}

#[test]
fn hidden_paths_are_answered_as_if_nothing_were_there() {
    let mut stage = stage();
    for verb in VERBS {
        for (hidden, nothing) in [
            ("/lab/secret", "/lab/nowhere"),
            ("/lab/secret/key", "/lab/nowhere/key"),
            ("/lab/secret/talk", "/lab/secret/nobody"),
        ] {
            let mut say = |path: &str| {
                let input = stage.request("alice", &format!("{verb} {path}"));
                heard(&mut stage, input, path)
            };
            let (of_hidden, of_nothing) = (say(hidden), say(nothing));
            assert_eq!(of_hidden, of_nothing, "{verb} {hidden}");
            assert!(of_hidden.starts_with("unknown-path"), "{verb}: {of_hidden}");
        }
    }
}

#[test]
fn hidden_numbers_are_answered_as_if_nothing_had_them() {
    let mut stage = stage();
    let secret = stage.hub.routes();
    let talk = secret
        .iter()
        .find(|route| route.path.as_str() == "/lab/secret/talk");
    let talk = talk.expect("a channel has a route").number;
    for verb in VERBS {
        let mut say = |number: ContextNumber| {
            let mut input = stage.request("alice", &format!("{verb} /"));
            if let Input::Request { parcel, .. } = &mut input {
                (parcel.context, parcel.number) = (None, Some(number));
            }
            heard(&mut stage, input, &number.0.to_string())
        };
        assert_eq!(say(talk), say(ContextNumber(7777)), "{verb}");
    }
}

#[test]
fn the_audit_log_knows_why() {
    let mut stage = stage();
    stage.say("alice", "context join /lab/secret");
    let facts = stage.facts();
    assert!(facts.iter().any(|fact| fact.contains("code=denied")), "{facts:?}");
}

#[test]
fn hidden_paths_are_suggested_to_nobody_else() {
    let mut stage = stage();
    for (name, suggested) in [("alice", false), ("bob", true)] {
        let input = stage.request(name, "context join /lab/secre");
        let heard = heard(&mut stage, input, "/lab/secre ");
        assert_eq!(heard.contains("nearest"), suggested, "{heard}");
    }
    let guard = Map::new()
        .with("token", "/lab/secret/key")
        .with("names", vec![Value::from("*")]);
    for (token, path) in [("/lab/secret/key", "/lab/a"), ("/lab/secret/ke", "/lab/b")] {
        let mut input = stage.request("alice", &format!("context create {path} kind=channel"));
        if let Input::Request { parcel, .. } = &mut input {
            let guard = guard.clone().with("token", token);
            parcel.content = Some(Map::new().with("kind", "channel").with("guard", guard).into());
        }
        assert_eq!(stage.give(input), ["alice< unknown-path"], "{token}");
    }
}

#[test]
fn who_may_not_look_up_a_context_does_not_hear_that_it_comes_and_goes() {
    let mut stage = stage();
    let rule = Map::new()
        .with("users", vec![Value::from("bob")])
        .with("allow", vec![Value::from("*")]);
    let own = Map::new()
        .with("kind", "roles")
        .with("rules", vec![Value::Map(rule)]);
    for (manager, hears) in [(None, true), (Some(own), false)] {
        let mut input = stage.request("bob", "context create /lab/made kind=session");
        if let (Input::Request { parcel, .. }, Some(manager)) = (&mut input, manager) {
            parcel.content = Some(Map::new().with("kind", "session").with("manager", manager).into());
        }
        for (what, heard) in [
            ("created", stage.give(input)),
            ("deleted", stage.say("bob", "context delete /lab/made")),
        ] {
            let told = |name| of(&heard, &[name]).iter().any(|line| line.contains(what));
            assert_eq!((told("alice"), told("bob")), (hears, true), "{heard:?}");
        }
    }
}
