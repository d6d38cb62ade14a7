use mom_arm::Script;
use proptest::prelude::*;

use super::*;

fn now() -> Time {
    Time::from_micros(10_000_000).unwrap()
}

fn block(name: &str, x: f64, y: f64, z: f64, yaw: f64) -> Object {
    Object {
        x,
        y,
        z,
        yaw,
        error: 0.3,
        seen: Time::from_micros(9_500_000),
        ..Object::new(name, 40.0, [1, 2, 3])
    }
}

fn lab() -> Vec<Object> {
    vec![
        block("red", -150.0, 100.0, 20.0, 0.0),
        block("green", 0.0, 150.0, 20.0, 20.0),
        block("blue", 150.0, 100.0, 20.0, 0.0),
    ]
}

fn on(name: &str) -> Goal {
    Goal::On(name.to_owned())
}

fn at(x: f64, y: f64) -> Goal {
    Goal::At { x, y, yaw: None }
}

#[test]
fn a_block_is_taken_from_above_and_put_down_without_pressing() {
    let plan = plan(&lab().into_iter().collect(), "red", &on("blue"), now()).unwrap();
    assert_eq!(plan.place, [150.0, 100.0, 60.0]);
    assert_eq!(
        plan.scripts[0],
        "grip open; move -150 100 150 0 0; move -150 100 20 0 0; grip close; move -150 100 150 0 0; \
         move 150 100 150 0 0; move 150 100 61 0 0; grip open; move 150 100 150 0 0"
    );
}

#[test]
fn the_hand_turns_with_the_block_and_to_its_goal() {
    let objects: Objects = lab().into_iter().collect();
    let plan = plan(&objects, "green", &on("blue"), now()).unwrap();
    let first = &plan.scripts[0];
    assert!(
        first.contains("move 0 150 20 20 0") && first.contains("move 150 100 61 0 0"),
        "{first}"
    );
    let turned = Goal::At {
        x: 100.0,
        y: -50.0,
        yaw: Some(45.0),
    };
    let plan = super::plan(&objects, "green", &turned, now()).unwrap();
    assert!(
        plan.scripts[0].contains("move 100 -50 21 45 0"),
        "{:?}",
        plan.scripts
    );
}

/// With the lab's objects changed, this is refused in these words.
fn check(change: &dyn Fn(&mut Vec<Object>), what: &str, goal: &Goal, words: &[&str]) {
    let mut all = lab();
    change(&mut all);
    let error = plan(&all.into_iter().collect(), what, goal, now()).expect_err("refused");
    for word in words {
        assert!(error.text.contains(word), "{word:?} in {error:?}");
    }
    assert!(!error.hint.is_empty());
}

#[test]
fn what_cannot_be_done_is_refused_with_what_is_in_the_way() {
    let as_is = |_: &mut Vec<Object>| {};
    check(
        &as_is,
        "redd",
        &on("blue"),
        &["no object \"redd\"", "did you mean red", "seen 0.5 s ago"],
    );
    check(&as_is, "purple", &on("blue"), &["there are blue", "green", "red"]);
    check(&as_is, "red", &on("bleu"), &["did you mean blue"]);
    check(&as_is, "red", &on("red"), &["on itself"]);
    check(
        &as_is,
        "red",
        &at(150.0, 120.0),
        &["no room for red at 150 120: blue is too near"],
    );
    check(
        &|all| all[0].held = true,
        "red",
        &on("blue"),
        &["red is in the jaws"],
    );
    check(
        &|all| all[1].held = true,
        "red",
        &on("blue"),
        &["the jaws hold green"],
    );
    check(
        &|all| all[0].seen = Time::from_micros(7_000_000),
        "red",
        &on("blue"),
        &[
            "no camera has seen red for 3.0 s",
            "nearest to where it was is green (seen 0.5 s ago)",
        ],
    );
    check(
        &|all| all[0].seen = Time::from_micros(12_000_000),
        "red",
        &on("blue"),
        &["the time at which red was seen is yet to come"],
    );
    check(
        &|all| all[2].written_by = Some("carol".to_owned()),
        "red",
        &on("blue"),
        &["no camera has seen blue since carol wrote its place"],
    );
}

#[test]
fn what_has_something_on_it_stays() {
    check(
        &|all| all[1] = block("green", -150.0, 102.0, 60.0, 0.0),
        "red",
        &on("blue"),
        &["green lies on red"],
    );
    check(
        &|all| all[1] = block("green", 150.0, 102.0, 60.0, 0.0),
        "red",
        &on("blue"),
        &["green lies on blue"],
    );
    check(
        &|all| all[0] = block("red", 150.0, 102.0, 61.0, 0.0),
        "red",
        &on("blue"),
        &["red lies on blue already"],
    );
    check(
        &|all| all[0].z = -380.0,
        "red",
        &on("blue"),
        &["fallen off the table"],
    );
    check(
        &|all| all[0].error = 9.0,
        "red",
        &on("blue"),
        &["known only to within 9 mm"],
    );
}

/// Neighbours on two sides leave the other two; on all four there is no way.
#[test]
fn jaws_open_where_nothing_stands() {
    let mut all = lab();
    all[1] = block("green", -105.0, 100.0, 20.0, 0.0);
    let plan = plan(&all.clone().into_iter().collect(), "red", &at(0.0, -100.0), now()).unwrap();
    for script in &plan.scripts {
        assert!(
            script.contains("move -150 100 20 90 0") || script.contains("move -150 100 20 -90 0"),
            "{script}"
        );
    }
    all[2] = block("blue", -150.0, 145.0, 20.0, 0.0);
    let error = super::plan(&all.into_iter().collect(), "red", &at(0.0, -100.0), now()).expect_err("no room");
    assert!(
        error.text.contains("the open jaws have no room at -150 100"),
        "{error:?}"
    );
}

/// Jaws open, and move aside, only above everything.
#[test]
fn the_hand_rises_before_its_jaws_open() {
    let plan = plan(&lab().into_iter().collect(), "red", &on("blue"), now()).unwrap();
    let hand = |z: f64| Pose {
        x: 10.0,
        y: -20.0,
        z,
        spin: 30.0,
        tilt: 5.0,
    };
    let rise = plan.rise_from(&hand(25.0));
    assert_eq!(rise.as_deref(), Some("move 10 -20 150 30 5"));
    assert_eq!(plan.rise_from(&hand(150.0)), None);
}

#[test]
fn a_block_has_arrived_when_it_lies_as_it_was_to() {
    let turned = |yaw: Option<f64>| {
        let goal = Goal::At {
            x: 100.0,
            y: -50.0,
            yaw,
        };
        plan(&lab().into_iter().collect(), "green", &goal, now()).unwrap()
    };
    let there = |yaw: f64| block("green", 103.0, -46.0, 20.0, yaw);
    assert_eq!(arrived(&there(45.0), &turned(Some(-315.0))), Ok(5.0));
    assert_eq!(arrived(&there(88.0), &turned(Some(1.0))), Ok(5.0));
    assert_eq!(arrived(&there(20.0), &turned(Some(45.0))), Err(Missed::Turn));
    assert_eq!(arrived(&there(70.0), &turned(None)), Ok(5.0));
    let stacked = block("green", 103.0, -46.0, 60.0, 45.0);
    assert_eq!(arrived(&stacked, &turned(None)), Err(Missed::Place));
}

/// The arm, which says how a block lies, obeys each plan, and nothing else moves.
fn carry_out(script: &str) -> Vec<mom_arm::Block> {
    use mom_arm::{Arm, ArmEvent};
    let mut arm = Arm::new(0);
    let mut events = Vec::new();
    arm.submit(1, script, 0, &mut events).expect("it can be reached");
    let mut now = 0;
    while let Some(wake) = arm.next_wake() {
        now = wake.max(now + 1);
        arm.advance(now, &mut events);
    }
    for event in &events {
        if let ArmEvent::Command {
            error: Some(error), ..
        } = event
        {
            panic!("{script}: {error}");
        }
    }
    arm.state().blocks
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn plans_can_be_read_and_turn_by_quarters(yaw in 0.0..90.0_f64, goal in -360.0..360.0_f64, x in -200.0..200.0_f64) {
        let mut all = lab();
        all[0].yaw = yaw;
        let goal = Goal::At { x, y: -150.0, yaw: Some(goal) };
        let plan = plan(&all.into_iter().collect(), "red", &goal, now()).unwrap();
        prop_assert!(!plan.scripts.is_empty());
        for script in &plan.scripts {
            prop_assert!(script.parse::<Script>().is_ok(), "{script}");
        }
    }
}

#[test]
fn the_arm_does_what_is_planned() {
    for (what, goal, place) in [
        ("red", on("blue"), [150.0, 100.0, 60.0]),
        ("green", on("red"), [-150.0, 100.0, 60.0]),
        ("green", at(100.0, -50.0), [100.0, -50.0, 20.0]),
        ("blue", at(-100.0, 100.0), [-100.0, 100.0, 20.0]),
    ] {
        let plan = plan(&lab().into_iter().collect(), what, &goal, now()).unwrap();
        let after = carry_out(&plan.scripts[0]);
        for (block, before) in after.iter().zip(mom_arm::Block::lab()) {
            let expected = if block.name == what {
                place
            } else {
                [before.x, before.y, before.z]
            };
            let off = [
                block.x - expected[0],
                block.y - expected[1],
                block.z - expected[2],
            ];
            assert!(
                off.iter().all(|off| off.abs() < 1.5),
                "{what}: {block:?} {expected:?}"
            );
        }
    }
}
