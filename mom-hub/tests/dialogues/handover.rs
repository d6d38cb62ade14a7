//! Handing over by agreement, in the cases where it is easily told wrongly.

use mom_hub::Settings;
use mom_managers::{Manager, Question, Registry, Verdict};
use mom_proto::{Map, Verb};

use crate::stage::{Stage, lab, level_or_lease, of};

fn stage() -> Stage {
    let mut stage = Stage::new(lab(level_or_lease(60_000, "lazy")));
    for (name, level) in [("alice", 1), ("bob", 1), ("carol", 5)] {
        stage.enter(name, level);
    }
    stage.say("alice", "token grab /lab/key");
    stage
}

#[test]
fn who_offered_is_told_that_its_offer_is_lost() {
    let mut stage = stage();
    stage.say("alice", "token give /lab/key to=bob");
    let heard = stage.say("carol", "token grab /lab/key");
    let lapsed = |name: &str| {
        let lines = of(&heard, &[name]).into_iter();
        lines.filter(|line| line.contains("lapsed")).collect::<Vec<_>>()
    };
    for name in ["alice", "bob"] {
        let line = format!("{name}< lapsed what=offer by=alice to=bob reason=lost");
        assert_eq!(lapsed(name), [line], "{heard:?}");
    }
    assert_eq!(lapsed("carol"), [""; 0], "it is none of the new owner's business");
}

#[test]
fn who_was_asked_is_told_that_the_request_is_lost() {
    let mut stage = stage();
    stage.say("bob", "token request /lab/key");
    let heard = stage.say("carol", "token grab /lab/key");
    for name in ["alice", "bob"] {
        let line = format!("{name}< lapsed what=request by=bob to=alice reason=lost");
        assert!(heard.contains(&line), "{heard:?}");
    }
    assert!(heard.contains(&"bob< withdrawn".to_owned()), "{heard:?}");
}

#[test]
fn a_delegate_gives_nothing_on() {
    let mut stage = stage();
    stage.say("alice", "token give /lab/key to=bob for=5000");
    stage.say("bob", "token accept /lab/key");
    assert_eq!(
        stage.say("bob", "token give /lab/key to=carol"),
        ["bob< denied rule=delegation"]
    );
    stage.say("carol", "token request /lab/key");
    assert_eq!(
        stage.say("bob", "token accept /lab/key peer=carol"),
        ["bob< denied rule=delegation"],
        "neither when it is asked"
    );
}

#[test]
fn a_device_in_nobodys_hands_is_safe() {
    // The delegate gives back to who is not there any more.
    let mut stage = stage();
    stage.say("alice", "token give /lab/key to=bob for=5000");
    stage.say("bob", "token accept /lab/key");
    stage.say("alice", "context leave /lab");
    let heard = stage.say("bob", "token release /lab/key");
    assert_eq!(
        of(&heard, &["carol"]),
        [
            "carol< halt of hub",
            "carol< released owner=bob by=bob reason=released fence=2"
        ]
    );
    // The giver's return has to be stored first.
    let mut stage = Stage::durable(lab(Map::new()));
    for name in ["alice", "bob", "carol"] {
        stage.enter(name, 1);
    }
    stage.say("alice", "token grab /lab/key");
    stage.answer(true);
    stage.say("alice", "token give /lab/key to=bob for=5000");
    stage.say("bob", "token accept /lab/key");
    stage.answer(true);
    let heard = stage.say("bob", "token release /lab/key");
    let carol = of(&heard, &["carol"]);
    let halted = carol.first().is_some_and(|line| line == "carol< halt of hub");
    assert!(
        halted || carol.is_empty(),
        "nobody has it, and it was not halted: {carol:?}"
    );
}

#[test]
fn a_promise_outlasts_the_time_of_the_request() {
    let mut stage = Stage::durable(lab(level_or_lease(60_000, "lazy")));
    stage.enter("alice", 1);
    stage.enter("bob", 1);
    stage.say("alice", "token grab /lab/key");
    stage.answer(true);
    stage.say("bob", "token request /lab/key within=1000");
    stage.say("alice", "token accept /lab/key peer=bob");
    assert_eq!(
        stage.at(1000),
        [""; 0],
        "the owner has said yes; only the store has not"
    );
    let heard = stage.answer(true);
    let bob = of(&heard, &["bob"]);
    assert_eq!(
        bob,
        [
            "bob< halt of hub",
            "bob< released owner=alice by=bob reason=given fence=1",
            "bob< grabbed owner=bob fence=2",
            "bob< ok fence=2"
        ],
        "{bob:?}"
    );
}

#[test]
fn a_promise_that_cannot_be_stored_is_told_to_both() {
    let mut stage = Stage::durable(lab(level_or_lease(60_000, "lazy")));
    stage.enter("alice", 1);
    stage.enter("bob", 1);
    stage.say("alice", "token grab /lab/key");
    stage.answer(true);
    stage.say("bob", "token request /lab/key within=1000");
    stage.say("alice", "token accept /lab/key peer=bob");
    let heard = stage.answer(false);
    assert_eq!(heard, ["alice< storage-failed", "bob< storage-failed"]);
    assert_eq!(
        stage.say("alice", "message command /lab/arm").len(),
        2,
        "alice drives on"
    );
}

/// Fails whatever it is asked, after a second.
#[derive(Debug)]
struct Failing;

impl Manager for Failing {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        if question.now >= 1_000_000 && question.verb != Verb::Lookup {
            std::panic::resume_unwind(Box::new("a bug"));
        }
        Verdict::allow()
    }
}

#[test]
fn a_manager_that_fails_keeps_nobody_from_giving_up() {
    let mut registry = Registry::builtin();
    registry.add_kind("failing", |_| Ok(Box::new(Failing)));
    let contexts = lab(Map::new().with("manager", "failing"));
    let mut stage = Stage::with(contexts, registry, Settings::default());
    for name in ["alice", "bob", "carol", "dave"] {
        stage.enter(name, 1);
    }
    stage.say("alice", "token grab /lab/key");
    stage.say("alice", "token give /lab/key to=carol");
    stage.say("bob", "token grab /lab/key wait=unlimited");
    stage.at(1000);
    assert_eq!(
        stage.say("dave", "token grab /lab/key"),
        ["dave< denied rule=failed manager"]
    );
    for (name, line) in [
        ("carol", "token decline /lab/key"),
        ("bob", "token release /lab/key"),
        ("alice", "token release /lab/key"),
        ("alice", "context leave /lab"),
    ] {
        let heard = stage.say(name, line);
        let ok = format!("{name}< ok");
        assert_eq!(heard.last(), Some(&ok), "{line}: {heard:?}");
    }
}

#[test]
fn an_agreement_ends_with_the_ownership() {
    let mut stage = Stage::durable(lab(level_or_lease(60_000, "lazy")));
    for name in ["alice", "bob"] {
        stage.enter(name, 1);
    }
    stage.say("alice", "token grab /lab/key");
    stage.answer(true);
    stage.say("alice", "token give /lab/key to=bob");
    stage.say("bob", "token accept /lab/key");
    let heard = stage.gone("alice");
    assert!(
        of(&heard, &["bob"]).contains(&"bob< lapsed what=offer by=alice to=bob reason=lost".to_owned()),
        "{heard:?}"
    );
    assert_eq!(
        heard.last().map(String::as_str),
        Some("bob< no-offer"),
        "{heard:?}"
    );
    assert_eq!(stage.answer(true), [""; 0]);
    assert_eq!(stage.say("bob", "token info /lab/key"), ["bob< ok fence=1"]);
}

#[test]
fn who_lost_the_token_by_level_may_offer_it_again() {
    for preempted in [false, true] {
        let mut stage = stage();
        for _ in 0..4 {
            stage.say("alice", "token give /lab/key to=bob");
        }
        match preempted {
            true => {
                stage.say("carol", "token grab /lab/key");
                stage.say("carol", "token release /lab/key");
            }
            false => drop(stage.say("alice", "token release /lab/key")),
        }
        stage.say("alice", "token grab /lab/key");
        let heard = stage.say("alice", "token give /lab/key to=bob");
        let refused = heard.iter().any(|line| line.starts_with("alice< try-later"));
        assert_eq!(refused, !preempted, "{heard:?}");
    }
}

#[test]
fn what_returns_continues_the_turn_that_it_was_given_in() {
    let manager = Map::new()
        .with("kind", "level-or-lease")
        .with("lease", 600_000)
        .with("queue", true)
        .with("hold", 10_000)
        .with("notice", 1_000);
    let mut stage = Stage::new(lab(Map::new().with("manager", manager)));
    for name in ["alice", "bob", "carol"] {
        stage.enter(name, 1);
    }
    stage.say("alice", "token grab /lab/key");
    stage.at(2_000);
    stage.say("alice", "token give /lab/key to=bob for=1000");
    stage.say("bob", "token accept /lab/key");
    stage.at(3_000);
    stage.say("carol", "token grab /lab/key wait=unlimited");
    assert_eq!(stage.at(9_999), [""; 0]);
    let heard = stage.at(10_000);
    assert!(
        heard.iter().any(|line| line.starts_with("carol< ok")),
        "ten seconds since alice had it: {heard:?}"
    );
}

#[test]
fn an_owners_yes_to_a_request_ends_with_the_ownership_too() {
    let mut stage = Stage::durable(lab(level_or_lease(60_000, "lazy")));
    for (name, level) in [("alice", 1), ("bob", 1), ("carol", 5)] {
        stage.enter(name, level);
    }
    stage.say("alice", "token grab /lab/key");
    stage.answer(true);
    stage.say("bob", "token request /lab/key");
    stage.say("alice", "token accept /lab/key peer=bob");
    let heard = stage.say("alice", "context leave /lab");
    assert!(
        of(&heard, &["bob"]).contains(&"bob< no-offer".to_owned()),
        "{heard:?}"
    );
    stage.answer(true);
    assert_eq!(
        stage.say("bob", "token info /lab/key"),
        ["bob< ok fence=1"],
        "nobody has it"
    );
}

#[test]
fn a_number_of_commands_is_one_at_least() {
    let mut stage = stage();
    for (commands, code) in [
        ("0", "bad-content"),
        ("9007199254740992", "bad-content"),
        ("1", "ok"),
    ] {
        let heard = stage.say(
            "alice",
            &format!("token give /lab/key to=bob commands={commands}"),
        );
        assert_eq!(heard.last(), Some(&format!("alice< {code}")), "{commands}");
    }
}

#[test]
fn a_stop_is_none_of_the_commands_that_are_counted() {
    let mut contexts = lab(level_or_lease(60_000, "lazy"));
    let guard = Map::new()
        .with("token", "/lab/key")
        .with("names", vec!["*".into()]);
    contexts[2].set("guard", guard);
    let mut stage = Stage::new(contexts);
    for name in ["alice", "bob"] {
        stage.enter(name, 1);
    }
    stage.say("alice", "token grab /lab/key");
    stage.say("alice", "token give /lab/key to=bob commands=1");
    stage.say("bob", "token accept /lab/key");
    for (line, passes) in [("stop", true), ("stop", true), ("move", true), ("move", false)] {
        let heard = stage.say("bob", &format!("message {line} /lab/arm"));
        assert_eq!(
            of(&heard, &["alice"]).len(),
            usize::from(passes),
            "{line}: {heard:?}"
        );
    }
}
