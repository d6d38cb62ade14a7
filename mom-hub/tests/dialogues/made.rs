//! Contexts that are made and go: which paths may be made, what ends by itself, and what is shown after it.

use mom_hub::{Effect, Input, Settings};
use mom_managers::Registry;
use mom_proto::{Code, Limit, Limits, Map, Path, Value};

use crate::stage::{Stage, context, lab, of};

fn with_limits(limits: Limits) -> Stage {
    let settings = Settings {
        limits,
        ..Settings::default()
    };
    let mut stage = Stage::with(
        vec![context("/lab", "session").with("presence", "none")],
        Registry::builtin(),
        settings,
    );
    stage.enter("alice", 1);
    stage
}

/// The answer to a line of alice.
fn answer(stage: &mut Stage, line: &str) -> String {
    let heard = stage.say("alice", line);
    of(&heard, &["alice"]).pop().unwrap_or_default()
}

#[test]
fn a_path_may_be_as_long_and_as_deep_as_the_limits_say() {
    let mut stage = with_limits(Limits {
        path: 8,
        ..Limits::default()
    });
    assert_eq!(
        answer(&mut stage, "context create /lab/abc kind=channel"),
        "alice< ok"
    );
    assert_eq!(
        answer(&mut stage, "context create /lab/abcd kind=channel"),
        "alice< bad-path"
    );

    let mut stage = with_limits(Limits {
        path_levels: 2,
        ..Limits::default()
    });
    assert_eq!(
        answer(&mut stage, "context create /lab/abc kind=session"),
        "alice< ok"
    );
    stage.say("alice", "context join /lab/abc");
    assert_eq!(
        answer(&mut stage, "context create /lab/abc/d kind=channel"),
        "alice< bad-path"
    );
}

#[test]
fn a_transient_context_goes_with_its_last_member() {
    let mut contexts = lab(Map::new());
    contexts.push(context("/lab/stays", "channel").with("transient", true));
    let mut stage = Stage::new(contexts);
    for name in ["alice", "bob"] {
        stage.enter(name, 1);
    }
    stage.say("alice", "context create /lab/goes kind=channel transient=true");
    stage.say("alice", "context create /lab/made kind=channel");
    for path in ["/lab/goes", "/lab/made", "/lab/stays"] {
        for name in ["alice", "bob"] {
            stage.say(name, &format!("context join {path}"));
        }
        stage.say("alice", &format!("context leave {path}"));
        let is_there = |stage: &mut Stage| answer(stage, &format!("context lookup {path}")) == "alice< ok";
        assert!(is_there(&mut stage), "{path}: bob is still in it");
        stage.say("bob", &format!("context leave {path}"));
        assert_eq!(is_there(&mut stage), path != "/lab/goes", "{path}");
    }
}

#[test]
fn a_token_that_is_given_away_halts_its_device_unless_it_says_otherwise() {
    for safe_on_give in [None, Some(true), Some(false)] {
        let token = match safe_on_give {
            None => Map::new(),
            Some(safe_on_give) => Map::new().with("safe-on-give", safe_on_give),
        };
        let mut stage = Stage::new(lab(token));
        for name in ["alice", "bob", "arm"] {
            stage.enter(name, 1);
        }
        stage.say("alice", "token grab /lab/key");
        stage.say("alice", "token give /lab/key to=bob");
        let heard = of(&stage.say("bob", "token accept /lab/key"), &["arm"]);
        let halted = heard.first().is_some_and(|line| line == "arm< halt of hub");
        assert_eq!(halted, safe_on_give != Some(false), "{heard:?}");
    }
}

/// The fence of the guard in the newest route of the arm that the last input gave.
fn shown_fence(stage: &Stage) -> Option<u64> {
    let mut routes = stage.effects.iter().filter_map(|effect| match effect {
        Effect::Route(route) if route.path.as_str() == "/lab/arm" => route.guard.as_ref(),
        _ => None,
    });
    routes.next_back().map(|guard| guard.fence & ((1 << 20) - 1))
}

#[test]
fn a_channel_whose_token_is_gone_shows_the_fence_of_that_one() {
    let mut stage = with_limits(Limits::default());
    for key in ["/lab/one", "/lab/two"] {
        stage.say("alice", &format!("context create {key} kind=token"));
    }
    let mut create = stage.request("alice", "context create /lab/arm");
    if let Input::Request { parcel, .. } = &mut create {
        let guard = Map::new()
            .with("token", "/lab/one")
            .with("names", vec!["command".into()]);
        **parcel = (**parcel)
            .clone()
            .content(Map::new().with("kind", "channel").with("guard", guard));
    }
    stage.give(create);
    stage.say("alice", "token grab /lab/one");
    assert_eq!(shown_fence(&stage), Some(1));
    stage.say("alice", "context delete /lab/one");
    assert_eq!(shown_fence(&stage), Some(1));
    for _ in 0..3 {
        stage.say("alice", "token grab /lab/two");
        stage.say("alice", "token release /lab/two");
    }
    stage.say("alice", "context delete /lab/two");
    assert_eq!(
        shown_fence(&stage),
        None,
        "what becomes of other tokens is nothing to it"
    );
    stage.say("alice", "context create /lab/one kind=token");
    stage.say("alice", "token grab /lab/one");
    assert_eq!(shown_fence(&stage), Some(5));
}

#[test]
fn a_number_leads_to_its_path() {
    let mut stage = with_limits(Limits::default());
    stage.say("alice", "context create /lab/arm kind=channel");
    stage.say("alice", "context join /lab/arm");
    let number = stage.effects.iter().find_map(|effect| match effect {
        Effect::Route(route) => Some(route.number),
        _ => None,
    });
    let number = number.expect("a channel that is joined has a route");
    assert_eq!(stage.hub.path(number).map(Path::as_str), Some("/lab/arm"));
    stage.say("alice", "context delete /lab/arm");
    assert_eq!(stage.hub.path(number), None);
}

#[test]
fn what_a_new_configuration_cannot_make_is_a_fact() {
    let mut stage = with_limits(Limits::default());
    stage.say("alice", "context create /lab/way kind=channel");
    let lab = context("/lab", "session").with("presence", "none");
    stage.configure(vec![lab, context("/lab/way/end", "channel")], Vec::new());
    let facts = stage.effects.iter().filter_map(|effect| match effect {
        Effect::Audit(fact) if fact.what == "refused" => Some(fact),
        _ => None,
    });
    let facts: Vec<_> = facts.collect();
    let [fact] = &facts[..] else { panic!("{facts:?}") };
    assert_eq!(fact.context.as_ref().map(Path::as_str), Some("/lab/way/end"));
    assert_eq!(fact.code, Some(Code::WRONG_KIND));
    let text = fact.text.as_deref().unwrap_or_default();
    assert!(text.contains("/lab/way"), "{text}");
}

#[test]
fn a_channel_says_what_it_keeps_and_who_waits() {
    let keep = Map::new()
        .with("latest", true)
        .with("parcels", 5)
        .with("bytes", 1000)
        .with("age", 2000);
    let arm = context("/lab/arm", "channel")
        .with("keep", keep.clone())
        .with("overflow", "wait")
        .with("pace", 60_000);
    let mut stage = Stage::new(vec![
        context("/lab", "session"),
        arm,
        context("/lab/chat", "channel"),
    ]);
    stage.arrive("alice", 1);
    stage.say("alice", "context join /lab");
    for line in ["context join", "context info"] {
        for (path, wanted) in [("/lab/arm", Some(&keep)), ("/lab/chat", None)] {
            stage.say("alice", &format!("{line} {path}"));
            let mut replies = stage.effects.iter().filter_map(|effect| match effect {
                Effect::Reply { parcel, .. } => Some(parcel.value()),
                _ => None,
            });
            let reply = replies.next_back().expect("an answer");
            let kept = reply.get("keep").and_then(Value::as_map);
            assert_eq!(kept, wanted, "{line} {path}");
            if line == "context info" {
                let pace = (path == "/lab/arm").then_some(&Value::Int(60_000));
                assert_eq!(reply.get("pace"), pace, "{path}");
            }
            let overflow = reply.get("overflow").and_then(Value::as_str);
            assert_eq!(
                overflow == Some("wait"),
                wanted.is_some(),
                "{line} {path}: {overflow:?}"
            );
        }
    }
}

#[test]
fn a_peer_joins_as_many_contexts_as_the_limits_say() {
    let mut stage = with_limits(Limits {
        // The root, the lab, and one more.
        joined: Limit::At(3),
        ..Limits::default()
    });
    for name in ["a", "b"] {
        stage.say("alice", &format!("context create /lab/{name} kind=channel"));
    }
    assert_eq!(
        answer(&mut stage, "context join /lab/a"),
        "alice< ok",
        "the second one"
    );
    assert_eq!(answer(&mut stage, "context join /lab/b"), "alice< full");
    assert_eq!(
        answer(&mut stage, "context join /lab/a"),
        "alice< ok",
        "it has joined that"
    );
    stage.say("alice", "context leave /lab/a");
    assert_eq!(answer(&mut stage, "context join /lab/b"), "alice< ok");
}
