//! Where a token, or the way to a device, goes in ways that are easily forgotten.

use mom_hub::{Holder, Record, Settings};
use mom_managers::{Answer, Grant, Manager, Question, Registry, Verdict};
use mom_proto::{Map, Verb};

use crate::stage::{EPOCH, Stage, context, lab, level_or_lease, of};

#[test]
fn for_whom_a_restart_keeps_a_token_passes_those_for_whom_it_does_not() {
    let alice = Holder {
        user: "alice".to_owned(),
        name: "alice".to_owned(),
    };
    let record = Record {
        path: mom_proto::Path::parse("/lab/key").expect("a path"),
        fence: EPOCH << 20,
        owner: Some(alice),
        before: None,
        lease: Some(60_000_000),
    };
    let settings = Settings {
        epoch: EPOCH + 1,
        durable: true,
        records: vec![record],
        ..Settings::default()
    };
    let contexts = lab(level_or_lease(60_000, "lazy"));
    let mut stage = Stage::with(contexts, Registry::builtin(), settings);
    for name in ["alice", "bob", "carol"] {
        stage.enter(name, 1);
    }
    stage.say("carol", "token inhibit /lab/key");
    stage.say("bob", "token grab /lab/key wait=unlimited");
    stage.say("alice", "token grab /lab/key wait=unlimited");
    stage.say("carol", "token uninhibit /lab/key");
    let heard = stage.answer(true);
    assert!(
        of(&heard, &["alice"])
            .iter()
            .any(|line| line.starts_with("alice< ok")),
        "{heard:?}"
    );
}

#[test]
fn a_device_is_safe_before_its_channel_is_deleted() {
    let mut contexts = lab(level_or_lease(60_000, "lazy"));
    contexts.retain(|spec| spec.get("path") != Some(&"/lab/arm".into()));
    contexts.push(context("/shed", "session").with("presence", "none"));
    let mut stage = Stage::new(contexts);
    for name in ["alice", "arm"] {
        stage.enter(name, 1);
        stage.say(name, "context join /shed");
    }
    let guard = Map::new()
        .with("token", "/lab/key")
        .with("names", vec!["command".into()]);
    let mut create = stage.request("alice", "context create /shed/arm kind=channel");
    if let mom_hub::Input::Request { parcel, .. } = &mut create {
        let content = Map::new()
            .with("kind", "channel")
            .with("presence", "none")
            .with("guard", guard);
        **parcel = (**parcel).clone().content(content);
    }
    stage.give(create);
    stage.say("arm", "context join /shed/arm");
    stage.say("alice", "token grab /lab/key");
    let heard = stage.say("alice", "context delete /shed/arm");
    assert_eq!(
        of(&heard, &["arm"]),
        ["arm< halt of hub", "arm< deleted by=alice"]
    );
    assert_eq!(
        of(&stage.say("alice", "token info /lab/key"), &["alice"]),
        ["alice< ok owner=alice fence=1"],
        "the token stays its owner's"
    );
}

/// Grants until ten seconds after the start, to any peer.
#[derive(Debug)]
struct UntilTen;

impl Manager for UntilTen {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let until = (question.verb == Verb::Grab).then_some(10_000_000);
        let displace = false;
        Verdict {
            answer: Answer::Allow(Grant {
                displace,
                until,
                priority: None,
            }),
            ..Verdict::allow()
        }
    }
}

#[test]
fn what_goes_back_to_nobody_is_made_safe() {
    for (ms, halted) in [(9_000, false), (11_000, true)] {
        let mut registry = Registry::builtin();
        registry.add_kind("until-ten", |_| Ok(Box::new(UntilTen)));
        let token = Map::new()
            .with("manager", "until-ten")
            .with("safe-on-give", false);
        let contexts = lab(token);
        let mut stage = Stage::with(contexts, registry, Settings::default());
        for name in ["alice", "bob", "arm"] {
            stage.enter(name, 1);
        }
        stage.say("alice", "token grab /lab/key");
        stage.say("alice", "token give /lab/key to=bob for=60000");
        stage.say("bob", "token accept /lab/key");
        stage.at(ms);
        let heard = of(&stage.say("bob", "token release /lab/key"), &["arm"]);
        let halts = heard.iter().any(|line| line == "arm< halt of hub");
        assert_eq!(halts, halted, "{heard:?}");
    }
}
