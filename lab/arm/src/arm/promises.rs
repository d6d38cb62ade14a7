//! Properties of the arm for any commands and any timing of its driver.

use mom_device::Machine;
use proptest::prelude::*;

use super::tests::{run, told};
use super::*;
use crate::blocks::FLOOR;
use crate::motion::{JAW_SPEED, SPEED, TURN_SPEED};
use crate::pose::{HOME, Pose};
use crate::workspace::WORKSPACE;

/// A statement that often has to do with the blocks.
fn statement() -> impl Strategy<Value = String> {
    let level = prop_oneof![
        Just((-150.0, 100.0)),
        Just((0.0, 150.0)),
        Just((150.0, 100.0)),
        Just((160.0, 95.0)),
        (-300.0..=300.0, -300.0..=300.0_f64),
    ];
    let z = prop_oneof![Just(20.0), Just(60.0), Just(100.0), 0.0..=450.0_f64];
    let spin = prop_oneof![Just(0.0), Just(20.0), -180.0..=180.0_f64];
    let tilt = prop_oneof![4 => Just(0.0), 1 => -45.0..=45.0_f64];
    prop_oneof![
        4 => (level, z, spin, tilt).prop_map(|((x, y), z, spin, tilt)| format!("move {x} {y} {z} {spin} {tilt}")),
        2 => Just("grip close".to_owned()),
        2 => Just("grip open".to_owned()),
        1 => (0..300_u32).prop_map(|ms| format!("wait {ms}")),
        1 => Just("home".to_owned()),
    ]
}

#[derive(Debug, Clone)]
enum Act {
    Submit(String),
    Halt,
    Stop,
    Unstop,
    Pass(ArmTime),
    Finish,
}

fn act() -> impl Strategy<Value = Act> {
    prop_oneof![
        6 => proptest::collection::vec(statement(), 1..8).prop_map(|all| Act::Submit(all.join(";"))),
        1 => Just(Act::Halt),
        1 => Just(Act::Stop),
        2 => Just(Act::Unstop),
        6 => (0..700_000_i64).prop_map(Act::Pass),
        4 => Just(Act::Finish),
    ]
}

/// Must hold between any two observations of the arm.
fn check_step(
    before: &(ArmTime, ArmState),
    after: &(ArmTime, ArmState),
    settled: bool,
) -> Result<(), TestCaseError> {
    let seconds = (after.0 - before.0) as f64 / 1e6;
    let (old, new) = (&before.1, &after.1);
    prop_assert_eq!(WORKSPACE.check(&new.pose), Ok(()));
    prop_assert!(
        old.pose.distance(&new.pose) <= SPEED * seconds + 1e-6,
        "{:?} {:?}",
        before,
        after
    );
    prop_assert!(old.pose.turn(&new.pose) <= TURN_SPEED * seconds + 1e-6);
    prop_assert!((old.gripper.opening - new.gripper.opening).abs() <= JAW_SPEED * seconds + 1e-6);
    prop_assert!(new.seq > old.seq || new == old, "{:?} {:?}", before, after);

    prop_assert_eq!(new.blocks.len(), 3);
    for (index, block) in new.blocks.iter().enumerate() {
        prop_assert_eq!(&block.name, &old.blocks[index].name);
        let solid = block.solid();
        if !settled {
            continue;
        }
        // Between two ticks of the simulation the hand may be a little way into what it pushes.
        if new.moving {
            for other in new.blocks[..index].iter().map(Block::solid) {
                let deep = solid.way_out(&other).map_or(0.0, |(_, depth)| depth);
                let height = (solid.top() - other.bottom()).min(other.top() - solid.bottom());
                prop_assert!(deep.min(height) < 4.0, "{:?} is in {:?}", block, other);
            }
            continue;
        }
        for other in &new.blocks[..index] {
            prop_assert!(!solid.overlaps(&other.solid()), "{:?} {:?}", block, other);
        }
        if new.holding.as_ref() == Some(&block.name) {
            let offset = new.pose.distance(&Pose::new(block.x, block.y, block.z, 0.0, 0.0));
            prop_assert!(offset < 25.0, "{:?} {:?}", new.pose, block);
        } else if block.tilt == 0.0 {
            let lies = solid.bottom().abs() < 1e-6
                || (solid.bottom() - FLOOR).abs() < 1e-6
                || new.blocks.iter().any(|below| {
                    (below.solid().top() - solid.bottom()).abs() < 1.5 && below.solid().overlaps_level(&solid)
                });
            prop_assert!(lies, "{:?} floats", block);
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { max_shrink_iters: 2_000, ..ProptestConfig::with_cases(300) })]

    #[test]
    fn the_arm_keeps_its_promises(acts in proptest::collection::vec(act(), 1..14)) {
        let (mut arm, mut now, mut events) = (Arm::new(0), 0, Vec::new());
        let (mut before, mut accepted) = ((now, arm.state()), Vec::new());
        for (act, id) in acts.into_iter().chain([Act::Finish]).zip(0..) {
            match act {
                Act::Submit(script) => {
                    if arm.submit(id, &script, now, &mut events).is_ok() {
                        accepted.push(id);
                    }
                }
                Act::Halt => arm.halt(now, "test", &mut events),
                Act::Stop => arm.stop(now, "test", &mut events),
                Act::Unstop => arm.unstop(now, &mut events),
                Act::Pass(time) => {
                    now += time;
                    arm.advance(now, &mut events);
                }
                Act::Finish => {
                    let begin = now;
                    while let Some(due) = arm.next_wake() {
                        prop_assert!(due >= now);
                        prop_assert!(due < begin + 600_000_000, "it never comes to rest: {:?}", arm);
                        now = due;
                        arm.advance(now, &mut events);
                        let after = (now, arm.state());
                        check_step(&before, &after, !arm.queue.machine().is_changing())?;
                        before = after;
                    }
                }
            }
            let after = (now, arm.state());
            check_step(&before, &after, !arm.queue.machine().is_changing())?;
            before = after;
        }
        let mut ended: Vec<u64> = events.iter().filter_map(|event| match event {
            ArmEvent::Command { id, state: CommandState::Finished | CommandState::Error, .. } => Some(*id),
            _ => None,
        }).collect();
        ended.sort_unstable();
        prop_assert_eq!(ended, accepted);
        let seqs: Vec<u64> = events.iter().filter_map(|event| match event {
            ArmEvent::State(state) => Some(state.seq),
            ArmEvent::Command { .. } => None,
        }).collect();
        prop_assert!(seqs.is_sorted_by(|a, b| a < b), "{:?}", seqs);
    }

    #[test]
    fn the_way_does_not_depend_on_when_the_driver_looks(
        script in proptest::collection::vec(statement(), 1..8), looks in proptest::collection::vec(1..200_000_i64, 0..60),
    ) {
        let script = script.join(";");
        let (mut punctual, mut curious) = (Arm::new(0), Arm::new(0));
        let (mut events, mut others) = (Vec::new(), Vec::new());
        if punctual.submit(1, &script, 0, &mut events).is_ok() {
            curious.submit(1, &script, 0, &mut others).unwrap();
            let mut now = 0;
            for look in looks {
                now += look;
                curious.advance(now, &mut others);
            }
            run(&mut punctual, &mut events);
            run(&mut curious, &mut others);
            prop_assert_eq!(told(&events), told(&others));
            prop_assert_eq!(ArmState { seq: 0, ..punctual.state() }, ArmState { seq: 0, ..curious.state() });
        }
    }

    #[test]
    fn the_hand_goes_by_the_path_rule(x in -300.0..=300.0_f64, y in -300.0..=300.0_f64, z in 0.0..=450.0_f64, spin in -180.0..=180.0_f64) {
        let (mut arm, mut events) = (Arm::with_blocks(0, []), Vec::new());
        let top = HOME.z.max(z);
        arm.submit(1, &format!("move {x} {y} {z} {spin} 0"), 0, &mut events).unwrap();
        let mut before = arm.state().pose;
        while let Some(due) = arm.next_wake() {
            for time in [due - 7_000, due] {
                arm.advance(time, &mut events);
                let pose = arm.state().pose;
                let (level, turned) = (before.horizontal_distance(&pose), before.turn(&pose));
                // Between two observations it can turn from one leg into the other, but only at the top.
                prop_assert!(level + turned == 0.0 || before.z == top || pose.z == top);
                prop_assert!(level + turned == 0.0 || pose.z == top || z < HOME.z);
                before = pose;
            }
        }
        prop_assert_eq!(before, Pose::new(x, y, z, spin, 0.0));
    }
}
