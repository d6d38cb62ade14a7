//! The arm as its driver sees it.

use super::*;
use crate::controller::{Grip, LinkFault, Simulated};
use crate::motion::MAX_OPENING;
use crate::pose::{HOME, Pose};
use crate::state::Gripper;

const RED_HIGH: &str = "move -150 100 100 0 0";
const TAKE_RED: &str = "move -150 100 20 0 0; grip close; move -150 100 200 0 0";

/// Drives the arm until it has nothing to do, as a punctual driver would.
pub(super) fn run(arm: &mut Arm, events: &mut Vec<ArmEvent>) {
    let end = arm.queue.now().saturating_add(3_600_000_000);
    while let Some(due) = arm.next_wake() {
        assert!(due < end, "it never comes to rest: {arm:?}");
        arm.advance(due, events);
    }
}

/// What a script does to a fresh arm: its events and its last state.
fn play(script: &str) -> (Vec<ArmEvent>, ArmState) {
    let (mut arm, mut events) = (Arm::new(0), Vec::new());
    arm.submit(7, script, 0, &mut events)
        .unwrap_or_else(|error| panic!("{script}: {error}"));
    run(&mut arm, &mut events);
    (events, arm.state())
}

/// The command events as short words, such as `7 executing 1/2`.
pub(super) fn told(events: &[ArmEvent]) -> Vec<String> {
    let words = |event: &ArmEvent| match event {
        ArmEvent::State(_) => None,
        ArmEvent::Command {
            id,
            state,
            progress: ScriptProgress { statement, of },
            error,
        } => {
            let state = format!("{state:?}").to_lowercase();
            let error = error
                .as_ref()
                .map(|error| format!(" {}", error.name()))
                .unwrap_or_default();
            Some(format!("{id} {state} {statement}/{of}{error}"))
        }
    };
    events.iter().filter_map(words).collect()
}

fn last_error(events: &[ArmEvent]) -> Option<&DeviceError> {
    events.iter().rev().find_map(|event| match event {
        ArmEvent::Command { error, .. } => error.as_ref(),
        ArmEvent::State(_) => None,
    })
}

fn block<'a>(state: &'a ArmState, name: &str) -> &'a Block {
    state.blocks.iter().find(|block| block.name == name).unwrap()
}

#[test]
fn a_command_goes_through_its_states() {
    let (mut arm, mut events) = (Arm::new(0), Vec::new());
    arm.submit(1, "grip close; move 10 0 300 0 0", 0, &mut events)
        .unwrap();
    arm.submit(2, "wait 5", 0, &mut events).unwrap();
    assert_eq!(
        arm.state().executing,
        Some(Executing {
            id: 1,
            statement: 1,
            of: 2
        })
    );
    assert_eq!((arm.state().waiting, arm.state().moving), (1, true));
    run(&mut arm, &mut events);
    let want = [
        "1 waiting 0/2",
        "1 executing 1/2",
        "2 waiting 0/1",
        "1 executing 2/2",
        "1 finished 2/2",
        "2 executing 1/1",
        "2 finished 1/1",
    ];
    assert_eq!(told(&events), want);
    let state = arm.state();
    assert_eq!((state.executing, state.waiting, state.moving), (None, 0, false));
    // At rest before it is finished, and once more when it is known that it rests.
    assert!(matches!(events.last(), Some(ArmEvent::State(last)) if last.pose == state.pose));
    let before = events.iter().rev().nth(2);
    assert!(
        matches!(before, Some(ArmEvent::State(last)) if !last.moving && last.executing.is_none()),
        "{before:?}"
    );
}

#[test]
fn poses_are_told_at_20_hz_and_once_at_rest() {
    let (mut arm, mut events) = (Arm::new(1_000), Vec::new());
    // Two legs, 0.5 s and 0.4 s: the first ends just when a state is due.
    arm.submit(1, "move 75 0 240 0 0", 1_000, &mut events).unwrap();
    let mut times = Vec::new();
    while let Some(due) = arm.next_wake() {
        let before = events.len();
        arm.advance(due, &mut events);
        let states = events[before..]
            .iter()
            .filter(|event| matches!(event, ArmEvent::State(_)))
            .count();
        times.extend(std::iter::repeat_n(due - 1_000, states));
    }
    // And once when it is known that it rests.
    let ticks = (1..=18).chain([24]);
    let want: Vec<ArmTime> = ticks.map(|tick| tick * STATE_PERIOD).collect();
    assert_eq!(times, want);
}

#[test]
fn a_late_driver_gets_the_latest_pose_only() {
    let (mut arm, mut events) = (Arm::new(0), Vec::new());
    arm.submit(1, "move 300 0 300 0 0", 0, &mut events).unwrap();
    events.clear();
    arm.advance(1_020_000, &mut events);
    assert_eq!(events, [ArmEvent::State(arm.state())]);
    assert!((arm.state().pose.x - 153.0).abs() < 1e-9);
    assert_eq!(arm.next_wake(), Some(1_050_000));
    arm.advance(500_000, &mut events);
    assert!(
        (arm.state().pose.x - 153.0).abs() < 1e-9,
        "time does not run backwards"
    );
}

#[test]
fn a_waiting_arm_tells_nothing() {
    let (events, state) = play("wait 60000");
    assert_eq!(
        told(&events),
        ["7 waiting 0/1", "7 executing 1/1", "7 finished 1/1"]
    );
    // Where it was then, and that it rests.
    assert_eq!(events.len(), 5);
    assert_eq!(state.pose, HOME);
}

/// Where the hand waits after a motion is told at once, or who predicts has it go on.
#[test]
fn a_wait_after_a_motion_tells_where_the_hand_stands() {
    let (mut arm, mut events) = (Arm::new(0), Vec::new());
    arm.submit(1, "move 10 0 300 0 0; wait 1000", 0, &mut events)
        .unwrap();
    while arm
        .state()
        .executing
        .is_some_and(|executing| executing.statement == 1)
    {
        arm.advance(arm.next_wake().unwrap(), &mut events);
    }
    let Some(ArmEvent::State(last)) = events.last() else {
        panic!("no state: {events:?}");
    };
    assert_eq!((last.moving, last.pose.x), (false, 10.0));
}

#[test]
fn blocks_are_taken_carried_and_put_down() {
    for (script, name, place, holding) in [
        (TAKE_RED, "red", [-150.0, 100.0, 200.0], Some("red")),
        (
            &format!("{TAKE_RED}; move 0 -100 20 90 0; grip open; home"),
            "red",
            [0.0, -100.0, 20.0],
            None,
        ),
        (
            &format!("{TAKE_RED}; move 0 -100 200 0 0; grip open"),
            "red",
            [0.0, -100.0, 20.0],
            None,
        ),
        (
            &format!("{TAKE_RED}; move 150 100 60 0 0; grip open; home"),
            "red",
            [150.0, 100.0, 60.0],
            None,
        ),
        (
            &format!("{TAKE_RED}; grip close; home"),
            "red",
            [0.0, 0.0, 300.0],
            Some("red"),
        ),
        // The upper of two is taken off again.
        (
            &format!(
                "{TAKE_RED}; move 150 100 60 0 0; grip open; wait 5; grip close; move 0 -50 20 0 0; grip open"
            ),
            "red",
            [0.0, -50.0, 20.0],
            None,
        ),
        // Taken 8 mm above its middle, it hangs lower by as much.
        (
            "move -150 100 28 0 0; grip close; move -150 100 200 0 0",
            "red",
            [-150.0, 100.0, 192.0],
            Some("red"),
        ),
        (
            "grip close; grip open; grip close",
            "red",
            [-150.0, 100.0, 20.0],
            None,
        ),
    ] {
        let (events, state) = play(script);
        assert_eq!(last_error(&events), None, "{script}");
        let Block { x, y, z, .. } = *block(&state, name);
        for (got, want) in [x, y, z].into_iter().zip(place) {
            assert!((got - want).abs() < 1e-9, "{script}: {x} {y} {z}");
        }
        assert_eq!(state.holding.as_deref(), holding, "{script}");
    }
}

/// What an earlier script left behind does not matter to one that begins with `reset`, whatever the hand holds or where
/// the blocks lie.
#[test]
fn a_reset_puts_all_back() {
    let start = Arm::new(0).state();
    let stack = format!("reset; {TAKE_RED}; move 150 100 60 0 0; grip open; home");
    for left in ["grip close", TAKE_RED, &stack] {
        let (events, state) = play(&format!("{left}; reset"));
        assert_eq!(last_error(&events), None, "{left}");
        let place = |state: &ArmState| {
            (
                state.pose,
                state.gripper,
                state.holding.clone(),
                state.blocks.clone(),
            )
        };
        assert_eq!(place(&state), place(&start), "{left}");
        let (events, _) = play(&format!("{left}; {stack}; {stack}"));
        assert_eq!(last_error(&events), None, "{left}");
    }
    let told = |event: &ArmEvent| matches!(event, ArmEvent::State(state) if state.blocks == start.blocks);
    let (events, _) = play(&format!("{TAKE_RED}; reset; wait 60000"));
    assert!(events.iter().any(told), "who looks on sees it at once");
}

#[test]
fn the_jaws_open_as_far_as_the_block_is_wide() {
    for (script, grip, opening) in [
        ("wait 0", Grip::Open, MAX_OPENING),
        ("grip close", Grip::Close, 0.0),
        ("grip close; grip open", Grip::Open, MAX_OPENING),
        (TAKE_RED, Grip::Close, 40.0),
    ] {
        assert_eq!(play(script).1.gripper, Gripper { grip, opening }, "{script}");
    }
}

#[test]
fn what_the_hand_runs_into_overloads_the_motors() {
    let on_blue = format!("{TAKE_RED}; move 150 100 60 0 0; grip open");
    for (script, words, end) in [
        (
            format!("grip close; {RED_HIGH}; move -150 100 20 0 0; home"),
            Some("statement 3: the motors are overloaded: a finger met block red"),
            "7 error 3/4 torque-overload",
        ),
        (
            format!("{TAKE_RED}; move -150 100 0 0 0"),
            Some("block red in the jaws met the table"),
            "7 error 4/4 torque-overload",
        ),
        // What lies on the block in the jaws goes along.
        (
            format!("{on_blue}; move 150 100 20 0 0; grip close; home"),
            None,
            "7 finished 8/8",
        ),
        // The jaws close on a corner of the block.
        (
            "move -150 117 20 0 0; grip close".to_owned(),
            Some("a finger met block red"),
            "7 error 2/2 torque-overload",
        ),
        // Open jaws pass the block on both sides.
        (
            "move -150 0 20 0 0; move -150 100 20 0 0".to_owned(),
            None,
            "7 finished 2/2",
        ),
        // The palm just clears a tower of two.
        (format!("{on_blue}; move 150 100 20 0 0"), None, "7 finished 6/6"),
    ] {
        let (events, state) = play(&script);
        assert_eq!(told(&events).last().unwrap(), end, "{script}");
        let text = last_error(&events).map(DeviceError::text);
        assert!(
            text.zip(words).is_none_or(|(text, words)| text.contains(words)),
            "{script}: {text:?}"
        );
        assert_eq!((state.moving, state.executing), (false, None), "{script}");
    }
}

#[test]
fn the_arm_gets_away_from_what_it_ran_into() {
    let (mut arm, mut events) = (Arm::new(0), Vec::new());
    arm.submit(
        1,
        &format!("grip close; {RED_HIGH}; move -150 100 20 0 0"),
        0,
        &mut events,
    )
    .unwrap();
    arm.submit(2, "home", 0, &mut events).unwrap();
    run(&mut arm, &mut events);
    let told_so_far = told(&events);
    assert_eq!(
        told_so_far[told_so_far.len() - 2..],
        ["1 error 3/3 torque-overload", "2 error 0/1 halted"]
    );
    let z = arm.state().pose.z;
    assert!((38.0..41.0).contains(&z), "{z}");
    arm.submit(
        3,
        &format!("home; grip open; {TAKE_RED}"),
        arm.queue.now(),
        &mut events,
    )
    .unwrap();
    run(&mut arm, &mut events);
    assert_eq!(arm.state().holding.as_deref(), Some("red"));
}

#[test]
fn nothing_of_a_refused_command_moves() {
    for (script, name, statement) in [
        ("", ErrorName::Syntax, None),
        ("grip close; mvoe 1 2 3 4 5", ErrorName::Syntax, Some(2)),
        (
            "grip close; move 10 0 300 0 0; move 0 0 451 0 0",
            ErrorName::WorkspaceBoundary,
            Some(3),
        ),
        ("home; move 0 0 300 0 46", ErrorName::WorkspaceBoundary, Some(2)),
        ("grip close; move 300 0 0 90 45", ErrorName::JointLimit, Some(2)),
        // Both poses can be reached; on the way between them hand and forearm line up.
        (
            "move 0 0 0 -90 0; move 0 0 0 -90 45",
            ErrorName::Singularity,
            Some(2),
        ),
    ] {
        let (mut arm, mut events) = (Arm::new(0), Vec::new());
        run(&mut arm, &mut Vec::new());
        let before = arm.state();
        let error = arm.submit(1, script, arm.queue.now(), &mut events).unwrap_err();
        assert_eq!(
            (error.name(), error.statement()),
            (name, statement),
            "{script}: {error}"
        );
        assert_eq!(
            (arm.state(), arm.next_wake(), events),
            (before, None, vec![]),
            "{script}"
        );
    }
}

#[test]
fn a_command_is_checked_from_where_those_before_it_lead() {
    // At the far edge the hand cannot turn from one side to the other while it leans: half-way a joint
    // comes to its limit. From home it can go to either side.
    let (one_side, other_side) = ("move 300 0 0 0 45", "move 300 0 0 180 45");
    let (mut arm, mut events) = (Arm::new(0), Vec::new());
    arm.submit(1, one_side, 0, &mut events).unwrap();
    let refused = |arm: &mut Arm, events: &mut Vec<ArmEvent>| arm.submit(2, other_side, 0, events).err();
    assert_eq!(
        refused(&mut arm, &mut events).map(|error| error.name()),
        Some(ErrorName::JointLimit)
    );
    // What is halted leads nowhere any more.
    arm.halt(0, "test", &mut events);
    assert_eq!(refused(&mut arm, &mut events), None);
    run(&mut arm, &mut events);
    assert_eq!(arm.state().pose, Pose::new(300.0, 0.0, 0.0, 180.0, 45.0));
}

#[test]
fn halt_drops_everything_and_is_not_latched() {
    let (mut arm, mut events) = (Arm::new(0), Vec::new());
    arm.halt(0, "nothing to do", &mut events);
    assert_eq!((events.len(), arm.state().seq), (0, 0));
    arm.submit(1, "move 300 0 300 0 0", 0, &mut events).unwrap();
    arm.submit(2, "home", 0, &mut events).unwrap();
    events.clear();
    arm.halt(510_000, "the owner left", &mut events);
    assert_eq!(told(&events), ["1 error 1/1 halted", "2 error 0/1 halted"]);
    assert_eq!(
        last_error(&events).unwrap().text(),
        "the arm was halted: the owner left"
    );
    assert!((arm.state().pose.x - 76.5).abs() < 1e-9);
    // It is not said to stand before that is measured.
    assert!(arm.state().moving && arm.next_wake().is_some());
    run(&mut arm, &mut events);
    assert_eq!((arm.queue.now(), arm.state().moving), (860_000, false));
    arm.advance(9_000_000, &mut events);
    assert!((arm.state().pose.x - 76.5).abs() < 1e-9);
    arm.submit(1, "home", 9_000_000, &mut events).unwrap();
    run(&mut arm, &mut events);
    assert_eq!(arm.state().pose, HOME);
}

#[test]
fn stop_is_latched() {
    let (mut arm, mut events) = (Arm::new(0), Vec::new());
    arm.submit(1, "move 300 0 300 0 0", 0, &mut events).unwrap();
    arm.stop(100_000, "bob pressed stop", &mut events);
    assert_eq!(told(&events).last().unwrap(), "1 error 1/1 stopped");
    run(&mut arm, &mut events);
    let count = events.len();
    arm.stop(600_000, "again", &mut events);
    arm.halt(600_000, "again", &mut events);
    assert_eq!(events.len(), count);
    for refused in [2, 3] {
        let error = arm.submit(refused, "home", 600_000, &mut events).unwrap_err();
        assert_eq!(error.name(), ErrorName::Stopped);
    }
    assert!(arm.state().stopped);
    arm.unstop(600_000, &mut events);
    assert_eq!(events.last(), Some(&ArmEvent::State(arm.state())));
    assert!(!arm.state().stopped && arm.next_wake().is_none());
    arm.submit(4, "home", 600_000, &mut events).unwrap();
    run(&mut arm, &mut events);
    assert_eq!(told(&events).last().unwrap(), "4 finished 1/1");
}

#[test]
fn a_halt_keeps_the_block_in_the_jaws() {
    let (mut arm, mut events) = (Arm::new(0), Vec::new());
    arm.submit(1, &format!("{TAKE_RED}; home"), 0, &mut events)
        .unwrap();
    while arm
        .state()
        .executing
        .is_some_and(|executing| executing.statement < 4)
    {
        arm.advance(arm.next_wake().unwrap(), &mut events);
    }
    arm.halt(arm.queue.now() + 77_000, "test", &mut events);
    let state = arm.state();
    let red = block(&state, "red");
    assert_eq!((red.x, red.y, red.z), (state.pose.x, state.pose.y, state.pose.z));
    assert_eq!(state.holding.as_deref(), Some("red"));
}

#[test]
fn a_link_is_not_missed_while_nothing_moves() {
    let (mut arm, mut events) = (Arm::new(0), Vec::new());
    arm.submit(1, "wait 60000; home", 0, &mut events).unwrap();
    assert_eq!(arm.next_wake(), Some(60_000_000));
    arm.advance(60_000_000, &mut events);
    assert_eq!(told(&events).last().unwrap(), "1 finished 2/2");
    arm.advance(ArmTime::MAX, &mut events);
    assert_eq!(last_error(&events), None);
}

/// A link that fails while a script waits ends it: nobody knows where the hand is then. What comes after is checked from where it is.
#[test]
fn a_link_that_fails_during_a_wait_ends_the_script() {
    let fault = LinkFault {
        after: 1_000_000,
        lasting: 1_000_000,
    };
    let controller = Simulated::new(0, []).failing(fault);
    let (mut arm, mut events) = (Arm::with_controller(0, Box::new(controller)), Vec::new());
    let script = "wait 5000; move 300 0 300 0 0; move 300 0 0 0 45";
    arm.submit(1, script, 0, &mut events).unwrap();
    for now in [1_000_000, 2_000_000, 2_500_000] {
        arm.advance(now, &mut events);
    }
    assert!(arm.state().linked);
    assert_eq!(told(&events).last().unwrap(), "1 error 1/3 link");
    // Refused in `a_command_is_checked_from_where_those_before_it_lead`.
    let next = arm.submit(2, "move 300 0 0 180 45", 2_500_000, &mut events);
    assert_eq!(next, Ok(()));
}

#[test]
fn the_queue_is_bounded_and_ids_are_unique_in_it() {
    let (mut arm, mut events) = (Arm::new(0), Vec::new());
    for id in 0..=MAX_WAITING as u64 {
        arm.submit(id, "wait 1000", 0, &mut events).unwrap();
    }
    for (id, want) in [
        (999, ErrorName::QueueFull),
        (0, ErrorName::DuplicateId),
        (64, ErrorName::DuplicateId),
    ] {
        assert_eq!(arm.submit(id, "home", 0, &mut events).unwrap_err().name(), want);
    }
    arm.submit(0, "home", 1_000_000, &mut events).unwrap();
    run(&mut arm, &mut events);
    let ended = told(&events)
        .iter()
        .filter(|words| words.contains("finished"))
        .count();
    assert_eq!(ended, MAX_WAITING + 2);
}
