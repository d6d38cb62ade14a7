//! The wall clock is set while the hub runs: calendars go by it, leases do not.

use mom_hub::{Effect, Input};
use mom_proto::{Map, Value};

use crate::stage::{Stage, lab};

const HOUR: i64 = 3_600_000_000;

/// A calendar of one day of 1970: from noon to one alice's.
fn noon(verbs: &[&str]) -> Map {
    let slot = Map::new()
        .with("from", "1970-01-01T12:00:00Z")
        .with("to", "1970-01-01T13:00:00Z")
        .with("users", vec![Value::from("alice")]);
    let verbs: Vec<Value> = verbs.iter().map(|verb| Value::from(*verb)).collect();
    let manager = Map::new()
        .with("kind", "schedule")
        .with("free", "deny")
        .with("slots", vec![Value::from(slot)])
        .with("verbs", verbs);
    Map::new().with("manager", manager)
}

fn step(stage: &mut Stage, ahead: i64) {
    stage.give(Input::Wall { ahead });
    let told = stage.effects.iter().any(|effect| match effect {
        Effect::Audit(fact) => fact.what == "clock-stepped",
        _ => false,
    });
    assert!(told, "{:?}", stage.effects);
}

#[test]
fn a_calendar_follows_the_wall_clock_and_a_grant_does_not() {
    let mut stage = Stage::new(lab(noon(&["grab"])));
    stage.enter("alice", 1);
    stage.enter("bob", 1);
    let refused = stage.say("alice", "token grab /lab/key");
    assert!(refused[0].contains("denied"), "{refused:?}");
    step(&mut stage, 12 * HOUR);
    let granted = stage.say("alice", "token grab /lab/key");
    assert!(granted.iter().any(|line| line.contains("grabbed")), "{granted:?}");
    assert!(stage.say("bob", "token grab /lab/key")[0].contains("denied"));
    // What she was promised lasts as long as it was promised.
    step(&mut stage, 20 * HOUR);
    assert!(stage.say("alice", "token renew /lab/key")[0].contains("ok"));
    let lost = stage.at(3_600_000);
    assert!(lost.iter().any(|line| line.contains("released")), "{lost:?}");
    // The same time again is not a step.
    stage.give(Input::Wall { ahead: 20 * HOUR });
    assert_eq!(stage.effects, []);
}

/// A verdict that stands until a slot ends does not outlive the slot, nor one that stood for good its reason.
#[test]
fn standing_verdicts_end_with_a_step() {
    let mut contexts = lab(Map::new());
    let arm = contexts.last_mut().expect("an arm");
    for (key, value) in noon(&["send"]) {
        arm.set(&key, value);
    }
    let mut stage = Stage::new(contexts);
    stage.enter("alice", 1);
    stage.enter("bob", 1);
    let say = "message hello /lab/arm";
    step(&mut stage, 12 * HOUR);
    stage.say("alice", say);
    let standing = |stage: &Stage| {
        let routes = stage.hub.routes();
        let arm = routes.iter().find(|route| route.path.as_str() == "/lab/arm");
        let alice = arm.expect("the arm").member(stage.peer("alice"));
        alice.expect("a member").standing("hello", stage.now).is_some()
    };
    assert!(standing(&stage), "her messages need not be asked about");
    step(&mut stage, 14 * HOUR);
    assert!(!standing(&stage), "the slot is over");
    let refused = stage.say("alice", say);
    assert!(refused[0].contains("denied"), "{refused:?}");
}
