//! How a robot is stopped: all that acts is deactivated, and once the robot has confirmed it nothing of what was said before begins.

mod common;

use common::*;
use mom_rsp::middle::{Middle, Notice, Settings, State};
use proptest::prelude::*;

/// All that a robot does something by.
const ACTING: [u8; 8] = [LEFT, RIGHT, HEAD, ARM, LCD, SPEAKER, FIRE, SAY];

fn set_all(middle: &mut Middle<'_>, activated: bool) {
    for element in ACTING {
        let _ = middle.set_activated(element, activated);
    }
}

/// How often the robot's program was told to do something.
fn doings(world: &World) -> [usize; 3] {
    [
        world.told.executed.len(),
        world.told.outputs.len(),
        world.told.fragments.len(),
    ]
}

/// A call that a slow network still has when the stop is confirmed, and when all is active again, is not executed; the next one is.
#[test]
fn a_call_that_a_stop_has_overtaken_is_not_executed() {
    for element in [FIRE, SAY] {
        let mut world = World::up(Settings::default());
        world.weather.delay = 400;
        let ticket = world.middle.command(element, &[0, 1]).unwrap();
        world.middle.send_blob(SPEAKER, &[1; 20]).unwrap();
        world.run(25);
        world.weather.delay = 0;
        set_all(&mut world.middle, false);
        world.run(60);
        assert!(world.middle.is_confirmed());
        assert!(world.notices.contains(&Notice::Unknown { element, ticket }));
        assert!(
            ACTING
                .iter()
                .all(|acting| world.told.active.contains(&(*acting, false)))
        );
        set_all(&mut world.middle, true);
        world.run(60);
        assert!(world.middle.is_confirmed() && world.middle.active(element));
        world.run(600);
        assert_eq!(world.middle.state(), State::Up);
        assert_eq!((world.told.executed.len(), world.told.fragments.len()), (0, 0));
        world.middle.command(element, &[0, 2]).unwrap();
        world.run(60);
        assert_eq!(world.told.executed, [(element, vec![0, 2])]);
    }
}

/// However many calls were withdrawn on the way, the next one is new to the robot.
#[test]
fn a_call_is_executed_after_any_number_that_were_withdrawn() {
    let mut world = World::up(Settings::default());
    world.middle.command(SAY, &[0, 0]).unwrap();
    world.run(60);
    for _ in 0..200 {
        world.drop_down = |datagram| datagram[4] == 1;
        world.middle.command(SAY, &[0, 1]).unwrap();
        world.run(21);
        set_all(&mut world.middle, false);
        world.run(21);
        world.drop_down = |_| false;
        world.run(41);
        set_all(&mut world.middle, true);
        world.run(62);
    }
    assert_eq!(world.told.executed, [(SAY, vec![0, 0])]);
    world.middle.command(SAY, &[0, 2]).unwrap();
    world.run(60);
    assert_eq!(world.told.executed, [(SAY, vec![0, 0]), (SAY, vec![0, 2])]);
}

/// A stop does not wait until an earlier control is confirmed.
#[test]
fn a_stop_overtakes_a_control_that_is_under_way() {
    let mut world = World::up(Settings::default());
    world.middle.write(LEFT, &[0, 100]).unwrap();
    world.run(60);
    assert_eq!(world.told.last(LEFT), Some(&[0, 100][..]));
    // Nobody confirms that the period is another one, and what is switched on waits for that.
    world.drop_up = |datagram| datagram[4] == 0x82;
    world.middle.set_activated(RANGE, false).unwrap();
    world.middle.set_period(40).unwrap();
    world.run(100);
    world.middle.set_activated(RANGE, true).unwrap();
    world.run(100);
    assert!(!world.middle.is_confirmed() && !world.robot.is_active(RANGE));
    set_all(&mut world.middle, false);
    world.run(45);
    assert_eq!(world.told.last(LEFT), Some(&[0, 0][..]));
    assert!(!world.robot.is_active(RANGE), "it does no more than that");
    world.drop_up = |_| false;
    world.run(200);
    assert!(world.middle.is_confirmed() && world.robot.is_active(RANGE));
    assert!(!world.robot.is_active(LEFT));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, max_shrink_iters: 60, failure_persistence: None, ..ProptestConfig::default() })]

    /// After any calls, values and sounds, in any weather: once the robot has confirmed a stop, or begun another session, it is told
    /// nothing more, also when all is active again, until a command comes.
    #[test]
    fn nothing_begins_after_a_confirmed_stop(
        loss in 0..50_u64,
        twice in 0..40_u64,
        delay in 0..40_u64,
        jitter in 0..500_u64,
        seed in any::<u64>(),
        silence in prop_oneof![Just(500_u16), Just(60_000)],
        rounds in proptest::collection::vec((0..400_u64, 0..3_u64), 1..5),
    ) {
        let weather = Weather { loss, twice, delay, jitter };
        let mut world = World::new(Settings { silence, ..Settings::default() }, weather, seed);
        world.middle.start(world.now);
        for (busy, stops) in rounds {
            for number in 0..busy as u16 {
                let bytes = number.to_be_bytes();
                match world.random.below(12) {
                    0 => drop(world.middle.write(LEFT, &bytes)),
                    1 => drop(world.middle.write(HEAD, &bytes)),
                    2 => drop(world.middle.write(ARM, &bytes)),
                    3 => drop(world.middle.command(FIRE, &bytes)),
                    4 | 5 => drop(world.middle.command(SAY, &bytes)),
                    6 => drop(world.middle.send_blob(SPEAKER, &[1; 600])),
                    7 => drop(world.middle.set_period(20 + number % 3)),
                    _ => {}
                }
                world.step();
            }
            // A stop, and maybe others while it is under way and while all is being activated again.
            for again in 0..=stops {
                set_all(&mut world.middle, false);
                let pause = world.random.below(30);
world.run(pause);
                if again < stops && world.random.percent(50) {
                    set_all(&mut world.middle, true);
                    let pause = world.random.below(60);
world.run(pause);
                }
            }
            set_all(&mut world.middle, false);
            let since = world.notices.len();
            let mut confirmed = false;
            for _ in 0..60_000 {
                world.step();
                let is_new = world.notices[since..].contains(&Notice::Up) || world.middle.state() != State::Up;
                // A session that ended meanwhile has begun anew: by a packet of the robot in it.
                let is_heard = world.middle.heard_at().is_some_and(|at| at == world.now);
                confirmed = match is_new {
                    true => world.middle.state() == State::Up && is_heard,
                    false => world.middle.is_confirmed(),
                };
                if confirmed {
                    break;
                }
            }
            prop_assume!(confirmed);
            let before = doings(&world);
            let pause = world.random.below(100);
world.run(pause);
            set_all(&mut world.middle, true);
            let sessions = world.told.sessions.len();
            world.run(1500);
            // The end of a session gives each effector its safe value again.
            if world.told.sessions.len() == sessions {
                prop_assert_eq!(doings(&world), before);
            } else {
                prop_assert_eq!(world.told.executed.len(), before[0]);
                prop_assert_eq!(world.told.fragments.len(), before[2]);
            }
        }
    }
}
