//! Each halt reaches the controller.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use super::tests::{run, told};
use super::*;
use crate::controller::{Grip, Instruction, Progress, Reading};
use crate::motion::{MAX_OPENING, Posture};
use crate::pose::HOME;

/// A controller that is there at once, counts how often it is halted, and can be out of reach.
#[derive(Debug)]
struct AtOnce(Posture, Arc<AtomicU32>, Arc<AtomicBool>);

impl Controller for AtOnce {
    fn begin(&mut self, instruction: &Instruction, _now: ArmTime) -> Result<(), DeviceError> {
        if let Instruction::Move(pose) | Instruction::Glide(pose, _) = instruction {
            self.0.pose = *pose;
        }
        Ok(())
    }

    fn advance(&mut self, now: ArmTime) -> Progress {
        Progress::Done(now)
    }

    fn halt(&mut self, _now: ArmTime) {
        self.1.fetch_add(1, Ordering::Relaxed);
    }

    fn next_wake(&self) -> Option<ArmTime> {
        None
    }

    fn is_linked(&self) -> bool {
        !self.2.load(Ordering::Relaxed)
    }

    fn reading(&self) -> Reading {
        Reading {
            posture: self.0,
            grip: Grip::Open,
            holding: None,
            blocks: Vec::new(),
        }
    }
}

#[test]
fn a_controller_hears_each_halt_and_a_jog_takes_its_time_where_it_is_there_at_once() {
    let posture = Posture {
        pose: HOME,
        opening: MAX_OPENING,
    };
    let controller = AtOnce(posture, Arc::default(), Arc::default());
    let (halts, lost) = (Arc::clone(&controller.1), Arc::clone(&controller.2));
    let (mut arm, mut events) = (Arm::with_controller(0, Box::new(controller)), Vec::new());
    // At rest, too, and where it is stopped already.
    arm.halt(0, "test", &mut events);
    assert_eq!(halts.load(Ordering::Relaxed), 1);
    for times in 1..3 {
        let before = halts.load(Ordering::Relaxed);
        arm.stop(0, "test", &mut events);
        assert!(
            halts.load(Ordering::Relaxed) > before,
            "the stop of number {times}"
        );
    }
    arm.unstop(0, &mut events);
    arm.submit(1, "jog 100 0 0 0 0 500", 0, &mut events).unwrap();
    run(&mut arm, &mut events);
    assert_eq!(told(&events).last().unwrap(), "1 finished 1/1");
    // It rests when it has stood for 0.3 s.
    let now = arm.queue.now();
    assert!((800_000..1_200_000).contains(&now), "{now}");
    assert!(
        (30.0..60.0).contains(&arm.state().pose.x),
        "{:?}",
        arm.state().pose
    );
    // What it was told while it was out of reach has not reached it.
    let (before, now) = (halts.load(Ordering::Relaxed), arm.queue.now());
    for (away, at) in [(true, now), (false, now + 1)] {
        lost.store(away, Ordering::Relaxed);
        arm.advance(at, &mut events);
    }
    assert_eq!(halts.load(Ordering::Relaxed), before + 1);
    // Its program ends.
    let before = halts.load(Ordering::Relaxed);
    drop(arm);
    assert_eq!(halts.load(Ordering::Relaxed), before + 1);
}
