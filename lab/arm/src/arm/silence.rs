//! What becomes of commands whose program stands still.

use mom_device::Machine;

use super::tests::told;
use super::{Arm, STATE_PERIOD};
use crate::machine::ArmMachine;
use crate::motion::SPEED;
use crate::pose::HOME;

#[test]
fn a_silent_driver_halts_the_arm() {
    for (silence, want) in [
        (ArmMachine::PATIENCE, "1 executing 1/1"),
        (ArmMachine::PATIENCE + 1, "1 error 1/1 halted"),
        (i64::MAX - 100_000, "1 error 1/1 halted"),
    ] {
        let (mut arm, mut events) = (Arm::new(0), Vec::new());
        arm.submit(1, "move 300 300 450 180 0", 0, &mut events).unwrap();
        arm.advance(STATE_PERIOD + silence, &mut events);
        let told = told(&events);
        assert_eq!(told.last().unwrap(), want);
        let way = HOME.z + SPEED * (STATE_PERIOD + ArmMachine::PATIENCE) as f64 / 1e6;
        let z_then_level = arm.state().pose.z + HOME.horizontal_distance(&arm.state().pose);
        assert!(z_then_level <= way + 1e-6, "{z_then_level} {way}");
    }
}

#[test]
fn behind_a_silent_driver_no_statement_begins() {
    let (mut arm, mut events) = (Arm::new(0), Vec::new());
    arm.submit(1, "move 0 0 310 0 0; move 0 0 100 0 0", 0, &mut events)
        .unwrap();
    arm.submit(2, "home", 0, &mut events).unwrap();
    arm.advance(6_000_000, &mut events);
    assert_eq!(told(&events)[3..], ["1 error 1/2 halted", "2 error 0/1 halted"]);
    assert!((arm.state().pose.z - 310.0).abs() < 1e-6 && !arm.is_busy());
}

/// A velocity is told piece by piece: of a program that stood still none begins, and the hand stands where the last one has left it.
#[test]
fn behind_a_silent_driver_no_piece_of_a_velocity_begins() {
    let (mut arm, mut events) = (Arm::new(0), Vec::new());
    arm.submit(1, "jog 100 0 0 0 0 1000", 0, &mut events).unwrap();
    while arm.queue.now() < 300_000 {
        arm.advance(arm.next_wake().unwrap(), &mut events);
    }
    let before = arm.state().pose.x;
    arm.advance(arm.queue.now() + 700_000, &mut events);
    assert_eq!(told(&events).last().unwrap(), "1 error 1/1 halted");
    let way = arm.state().pose.x - before;
    assert!((0.0..2.0).contains(&way), "{way}");
}
