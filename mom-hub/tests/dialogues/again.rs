//! What reaches another peer cannot be sent to it again and again, and what costs the hub is bounded.

use mom_hub::{ContextSpec, Hub, Settings};
use mom_managers::Registry;
use mom_proto::{Code, Map, Value, from_value};

use crate::stage::{Stage, context, lab, level_or_lease, of};

/// alice owns the token of the lab; bob and carol are there.
fn stage() -> Stage {
    let mut stage = Stage::new(lab(level_or_lease(60_000, "lazy")));
    for name in ["alice", "bob", "carol"] {
        stage.enter(name, 1);
    }
    stage.say("alice", "token grab /lab/key");
    stage
}

const TOO_EARLY: &str = "try-later rule=not again and again";

#[test]
fn a_peer_is_invited_to_the_same_context_once_in_ten_seconds() {
    let mut stage = stage();
    let invite = "context invite /lab peer=bob";
    assert_eq!(stage.say("alice", invite), ["bob< invited by=alice", "alice< ok"]);
    assert_eq!(
        stage.say("carol", invite),
        [format!("carol< {TOO_EARLY}")],
        "by whomever"
    );
    let heard = stage.say("alice", "context invite /lab/arm peer=bob");
    assert_eq!(of(&heard, &["alice"]), ["alice< ok"], "another context");
    stage.at(9_999);
    assert_eq!(stage.say("alice", invite), [format!("alice< {TOO_EARLY}")]);
    stage.at(10_000);
    assert_eq!(stage.say("alice", invite), ["bob< invited by=alice", "alice< ok"]);
}

#[test]
fn an_owner_who_says_no_is_asked_four_times_in_ten_seconds() {
    let mut stage = stage();
    for ms in [0, 1000, 2000, 3000] {
        stage.at(ms);
        let heard = stage.say("bob", "token request /lab/key");
        assert_eq!(of(&heard, &["alice"]), ["alice< requested peer=bob"]);
        stage.say("alice", "token decline /lab/key peer=bob");
    }
    assert_eq!(
        stage.say("bob", "token request /lab/key"),
        [format!("bob< {TOO_EARLY}")]
    );
    let heard = stage.say("carol", "token request /lab/key");
    assert_eq!(of(&heard, &["alice"]), ["alice< requested peer=carol"]);
    stage.at(10_000);
    let heard = stage.say("bob", "token request /lab/key");
    assert_eq!(of(&heard, &["alice"]), ["alice< requested peer=bob"]);
}

#[test]
fn who_leaves_and_comes_back_asks_no_sooner() {
    let mut stage = stage();
    for _ in 0..4 {
        stage.say("bob", "token request /lab/key");
        stage.say("bob", "context leave /lab");
        stage.say("bob", "context join /lab");
    }
    assert_eq!(
        stage.say("bob", "token request /lab/key"),
        [format!("bob< {TOO_EARLY}")]
    );
}

#[test]
fn an_offer_is_made_to_the_same_peer_four_times_in_ten_seconds() {
    let mut stage = stage();
    let give = "token give /lab/key to=bob";
    let offered = |heard: &[String]| {
        of(heard, &["bob"])
            .iter()
            .any(|line| line.starts_with("bob< offer"))
    };
    for _ in 0..2 {
        assert!(offered(&stage.say("alice", give)));
        assert!(offered(&stage.say("alice", give)), "while it stands");
        stage.say("alice", "token give /lab/key to=carol");
    }
    assert_eq!(stage.say("alice", give), [format!("alice< {TOO_EARLY}")]);
    stage.say("alice", "token release /lab/key");
    stage.say("alice", "token grab /lab/key");
    assert_eq!(
        stage.say("alice", give),
        [format!("alice< {TOO_EARLY}")],
        "not for grabbing it anew"
    );
    stage.at(10_000);
    assert!(offered(&stage.say("alice", give)));
}

#[test]
fn who_agrees_can_be_asked_again_at_once() {
    let mut stage = stage();
    for _ in 0..6 {
        stage.say("alice", "token give /lab/key to=bob for=1000");
        let heard = stage.say("bob", "token accept /lab/key");
        let news = of(&heard, &["bob"]);
        assert!(
            news.iter().any(|line| line.starts_with("bob< ok from=alice")),
            "{heard:?}"
        );
        stage.say("bob", "token release /lab/key");
    }
    for _ in 0..6 {
        stage.say("bob", "token request /lab/key");
        stage.say("alice", "token accept /lab/key peer=bob");
        let heard = stage.say("bob", "token give /lab/key to=alice");
        assert!(
            heard.iter().any(|line| line.starts_with("alice< offer")),
            "{heard:?}"
        );
        stage.say("alice", "token accept /lab/key");
    }
}

#[test]
fn a_token_guards_so_many_channels_at_most() {
    let mut contexts = vec![
        context("/lab", "session"),
        context("/lab/key", "token").with("manager", "first-come"),
    ];
    let guard = Map::new()
        .with("token", "/lab/key")
        .with("names", vec!["command".into()]);
    let arm = |number: usize| context(&format!("/lab/arm{number}"), "channel").with("guard", guard.clone());
    contexts.extend((0..257).map(arm));
    let made = |contexts: &[Map]| {
        let specs = contexts.iter().map(|spec| from_value(Value::Map(spec.clone())));
        let specs: Vec<ContextSpec> = specs.map(|spec| spec.expect("a context")).collect();
        Hub::new(Settings::default(), Registry::builtin(), &"open".into(), &specs)
    };
    let error = made(&contexts).expect_err("one too many");
    assert_eq!((error.entry, error.error.code), (Some(2 + 256), Code::FULL));
    contexts.pop();
    assert!(made(&contexts).is_ok());
}
