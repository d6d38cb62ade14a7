use proptest::prelude::*;

use super::*;
use crate::switch;

fn robot(x: f64, y: f64, heading: f64) -> Simulated {
    let pose = Pose::new(x, y, heading);
    Simulated::new(Chassis::LINUXBOT, Power::LINUXBOT, Floor::ARENA, pose).expect("a robot")
}

fn set(robot: &mut Simulated, left: i16, right: i16, at: WheelTime) {
    robot.set_motors(Motors::new(left, right), at).expect("it can");
}

fn sense(robot: &mut Simulated, at: WheelTime) -> Sensors {
    robot.sensors(at).expect("it answers")
}

/// Each change that it announces until a time.
fn wakes(robot: &mut Simulated, until: WheelTime) -> Vec<WheelTime> {
    let mut wakes = Vec::new();
    while let Some(due) = robot.next_wake().filter(|due| *due <= until) {
        wakes.push(due);
        sense(robot, due);
    }
    wakes
}

#[test]
fn it_wakes_when_its_wheels_have_what_they_are_set_to() {
    let mut robot = Simulated::linuxbot();
    assert_eq!(robot.next_wake(), None, "it has not begun");
    set(&mut robot, 100, 100, 0);
    // The lag times ln(100 / 0.5).
    assert_eq!(wakes(&mut robot, 2_000_000), [529_832]);
    set(&mut robot, 0, 0, 2_000_000);
    assert!(!robot.is_standing(2_529_000));
    assert_eq!(wakes(&mut robot, 4_000_000), [2_529_832]);
    assert!(robot.is_standing(2_529_833));
}

#[test]
fn a_wall_stops_it_and_presses_its_front_until_it_backs_off() {
    let mut robot = robot(4500.0, 1000.0, 0.0);
    set(&mut robot, 500, 500, 0);
    let meets = *wakes(&mut robot, 5_000_000).last().expect("a wall");
    assert_eq!(sense(&mut robot, meets).switches, switch::FRONT);
    // 400 mm at 500 mm/s, and the lag.
    assert!((meets - 900_000).abs() < 1000, "{meets}");
    let stalled = sense(&mut robot, 10_000_000);
    assert_eq!(
        (stalled.switches, stalled.motors),
        (switch::FRONT, Motors::new(500, 500))
    );
    assert_eq!(stalled.pose, Some(Pose::new(4900.0, 1000.0, 0.0)));
    assert!(robot.is_standing(10_000_000));
    set(&mut robot, 0, 0, 10_000_000);
    assert_eq!(sense(&mut robot, 11_000_000).switches, switch::FRONT);
    set(&mut robot, -200, -200, 11_000_000);
    assert_eq!(sense(&mut robot, 11_000_000).switches, 0);
    let back = robot.pose(12_000_000).x;
    assert!((back - (4900.0 - 180.0)).abs() < 0.1, "{back}");
}

#[test]
fn backing_into_a_wall_presses_its_rear() {
    let mut robot = robot(300.0, 1000.0, 30.0);
    set(&mut robot, -300, -300, 0);
    let sensors = sense(&mut robot, 3_000_000);
    // The wall to the west is behind it, on its left.
    assert_eq!(sensors.switches, switch::REAR_LEFT);
    assert_eq!(sensors.pose.map(|pose| pose.x), Some(100.0));
}

#[test]
fn in_a_corner_it_goes_from_one_wall_to_the_other() {
    let mut robot = robot(200.0, 4000.0, 90.0);
    set(&mut robot, 500, 500, 0);
    assert_eq!(sense(&mut robot, 5_000_000).switches, switch::FRONT);
    // It turns to the west on the spot, and pushes that wall; the other stands at its right.
    set(&mut robot, -75, 75, 5_000_000);
    let quarter = (std::f64::consts::FRAC_PI_2 + 0.1) * 1e6;
    set(&mut robot, 0, 0, 5_000_000 + quarter as WheelTime);
    set(&mut robot, 300, 300, 8_000_000);
    assert_eq!(
        sense(&mut robot, 9_000_000).switches & switch::FRONT,
        switch::FRONT
    );
    let pose = robot.pose(9_000_000);
    assert!((pose.x - 100.0).abs() < 1e-6 && pose.y <= 4900.0, "{pose}");
}

#[test]
fn a_wall_that_it_only_bumps_into_is_felt_for_50_ms() {
    let mut robot = robot(4885.0, 1000.0, 0.0);
    set(&mut robot, 1000, 1000, 0);
    // It is reversed too late: its wheels still run on into the wall.
    set(&mut robot, -1000, -1000, 50_000);
    let all = wakes(&mut robot, 1_000_000);
    let meets = all[0];
    assert!(meets < 120_000, "{all:?}");
    assert_eq!(sense(&mut robot.clone(), 1_000_000).switches, 0);
    let mut again = self::robot(4885.0, 1000.0, 0.0);
    set(&mut again, 1000, 1000, 0);
    set(&mut again, -1000, -1000, 50_000);
    assert_eq!(sense(&mut again, meets - 1).switches, 0);
    assert_eq!(sense(&mut again, meets + PRESSED - 1).switches, switch::FRONT);
    assert_eq!(sense(&mut again, meets + PRESSED).switches, 0);
    assert_eq!(all[1], meets + PRESSED);
}

#[test]
fn at_a_wall_it_can_turn_on_the_spot() {
    let mut robot = robot(4900.0, 1000.0, 0.0);
    set(&mut robot, 100, 100, 0);
    assert_eq!(sense(&mut robot, 1_000_000).switches, switch::FRONT);
    set(&mut robot, -100, 100, 1_000_000);
    let turned = sense(&mut robot, 2_000_000);
    assert_eq!(turned.switches, 0);
    let pose = turned.pose.expect("odometry");
    assert_eq!((pose.x, pose.y), (4900.0, 1000.0));
    assert!(pose.heading > 60.0, "{pose}");
}

#[test]
fn what_it_does_draws_from_its_battery() {
    let used = |commands: &dyn Fn(&mut Simulated)| {
        let mut robot = robot(500.0, 2500.0, 0.0);
        commands(&mut robot);
        Power::LINUXBOT.capacity - robot.charge(10_000_000)
    };
    let rest = used(&|robot| assert_eq!(sense(robot, 0).battery, 100));
    assert!((rest - 80.0).abs() < 1e-6, "{rest}");
    let lit = used(&|robot| robot.set_leds(0b0101_0001, 0).expect("it can"));
    assert!((lit - 83.0).abs() < 1e-6, "{lit}");
    // Two wheels at 300 mm/s of 1000 take 2.4 W, for 10 s less the lag.
    let driving = used(&|robot| set(robot, 300, 300, 0));
    assert!((driving - 80.0 - 2.4 * 9.9).abs() < 1e-6, "{driving}");
    // It stalls at once: no lag.
    let stalled = used(&|robot| {
        *robot = self::robot(4900.0, 2500.0, 0.0);
        set(robot, 300, 300, 0);
    });
    assert!((stalled - 80.0 - 2.4 * 10.0).abs() < 1e-3, "{stalled}");
}

#[test]
fn an_empty_battery_stops_motors_and_leds_for_good() {
    let mut robot = robot(500.0, 2500.0, 0.0).with_battery(1);
    // 720 J at 8 W, 8 LEDs and two wheels at 20 mm/s.
    robot.set_leds(0xff, 0).expect("it can");
    set(&mut robot, 20, 20, 0);
    let watts = 8.0 + 0.8 + 2.0 * 4.0 * 0.02;
    let empty = *wakes(&mut robot, 600_000_000).last().expect("its end");
    let want = (720.0 + 4.0 * 0.02 * 2.0 * 0.1) / watts;
    // It comes to rest after it is empty, within ln(20 / 0.5) lags.
    assert!((empty as f64 / 1e6 - want - 0.369).abs() < 0.01, "{empty} {want}");
    let sensors = sense(&mut robot, 600_000_000);
    assert_eq!((sensors.battery, sensors.motors), (0, Motors::STOP));
    assert_eq!(
        (robot.leds(600_000_000), robot.is_standing(600_000_000)),
        (0, true)
    );
    for refused in [
        robot.set_motors(Motors::new(1, 0), 600_000_000),
        robot.set_leds(1, 600_000_000),
    ] {
        assert_eq!(refused.map_err(|error| error.fault()), Err(Fault::Battery));
    }
    assert_eq!(robot.set_motors(Motors::STOP, 600_000_000), Ok(()));
    assert_eq!(robot.next_wake(), None);
    robot.recharge(40, 601_000_000);
    let sensors = sense(&mut robot, 602_000_000);
    assert_eq!((sensors.battery, sensors.motors), (40, Motors::STOP));
    set(&mut robot, 100, 100, 602_000_000);
    assert!(!robot.is_standing(603_000_000));
}

#[test]
fn the_battery_is_0_only_when_it_is_empty() {
    let mut robot = Simulated::linuxbot().with_battery(1);
    sense(&mut robot, 0);
    let empty = robot.next_wake().expect("it empties");
    assert_eq!(empty, 90_000_000);
    assert_eq!(sense(&mut robot, empty - 1).battery, 1);
    assert_eq!(sense(&mut robot, empty).battery, 0);
    assert_eq!(
        sense(&mut Simulated::linuxbot().with_battery(200), 0).battery,
        100
    );
    assert_eq!(sense(&mut Simulated::linuxbot().with_battery(0), 0).battery, 0);
}

#[test]
fn time_begins_when_it_is_first_given_and_never_runs_back() {
    let late = 1_700_000_000_000_000;
    let mut robot = Simulated::linuxbot();
    assert_eq!(sense(&mut robot, late).battery, 100);
    set(&mut robot, 100, 100, late);
    let there = robot.pose(late + 1_000_000);
    assert_eq!(robot.pose(late), there);
    assert_eq!(robot.pose(WheelTime::MIN), there);
    let end = sense(&mut robot, WheelTime::MAX);
    assert_eq!((end.battery, end.motors), (0, Motors::STOP));
    assert_eq!(robot.next_wake(), None);
}

#[test]
fn without_odometry_it_does_not_sense_its_pose() {
    let mut robot = Simulated::linuxbot().without_odometry();
    assert_eq!(sense(&mut robot, 0).pose, None);
    assert_eq!(robot.pose(0), Pose::new(2500.0, 2500.0, 0.0));
}

#[test]
fn a_robot_that_stands_at_its_charger_is_charged_until_it_drives_away() {
    let here = crate::Point::new(2500.0, 2500.0);
    let mut robot = Simulated::linuxbot().with_battery(0).with_charger(here);
    let charging = |robot: &mut Simulated, at| robot.parts(at).expect("it answers").charging;
    // From 0 on, and the driver says when.
    assert_eq!(charging(&mut robot, 0), Some(true));
    const S: WheelTime = 1_000_000;
    let minute = 60 * S;
    let gained = robot.charge(minute);
    assert!((gained - 60.0 * 32.0).abs() < 1.0, "{gained} J");
    assert_eq!(sense(&mut robot, minute).battery, 3);
    // A full one stays full.
    assert_eq!(sense(&mut robot, 60 * minute).battery, 100);
    robot
        .set_motors(Motors::new(500, 500), 60 * minute)
        .expect("it is full");
    assert_eq!(charging(&mut robot, 60 * minute), Some(false));
    // Beside it, it stands without.
    robot.set_motors(Motors::STOP, 60 * minute + S).expect("it stops");
    assert_eq!(charging(&mut robot, 61 * minute), Some(false));
    let away = robot.charge(61 * minute);
    assert!(robot.charge(62 * minute) < away);
    // It comes back, and is charged no sooner than it stands.
    robot
        .set_motors(Motors::new(-500, -500), 62 * minute)
        .expect("it drives");
    robot.set_motors(Motors::STOP, 62 * minute + S).expect("it stops");
    assert_eq!(charging(&mut robot, 62 * minute + S), Some(false));
    let wake = std::iter::from_fn(|| {
        let wake = robot.next_wake()?;
        sense(&mut robot, wake);
        Some(robot.is_standing(wake))
    });
    assert_eq!(wake.take(3).last(), Some(true));
    assert_eq!(charging(&mut robot, 62 * minute + 3 * S), Some(true));
    // One without a charger knows of none.
    assert_eq!(charging(&mut Simulated::linuxbot(), 0), None);
}

#[test]
fn a_robot_has_the_parts_that_it_was_fitted_with() {
    const S: WheelTime = 1_000_000;
    let fittings = crate::Fittings {
        switches: switch::FRONT,
        leds: 0,
        light: Some(50.0),
        odometry: false,
    };
    let at = |x, heading| {
        let pose = Pose::new(x, 250.0, heading);
        let robot = Simulated::new(Chassis::LINUXBOT, Power::LINUXBOT, Floor::ARENA, pose);
        robot.expect("it is on the floor").with_fittings(fittings)
    };
    let light = |robot: &mut Simulated| robot.parts(0).expect("it answers").light;
    assert_eq!(light(&mut Simulated::linuxbot()), None);
    // The tile under the sensor counts, and not the one under the axle.
    let [there, next] = [light(&mut at(440.0, 0.0)), light(&mut at(460.0, 0.0))];
    assert_eq!([there, next], [Some(55), Some(43)]);
    assert_eq!(light(&mut at(460.0, 180.0)), there);

    let mut robot = at(200.0, 180.0);
    let error = robot.set_leds(1, 0).expect_err("it has none");
    assert_eq!(
        (error.fault(), error.to_string()),
        (crate::Fault::Leds, "the robot has no LEDs".to_owned())
    );
    robot.set_leds(0, 0).expect("all are dark");
    robot.set_motors(Motors::new(500, 500), 0).expect("it drives");
    let met = sense(&mut robot, S);
    assert_eq!((met.switches, met.pose), (switch::FRONT, None));
    robot.set_motors(Motors::new(-500, -500), S).expect("it drives");
    let met = sense(&mut robot, 20 * S);
    assert_eq!(
        (met.switches, robot.is_standing(20 * S)),
        (0, true),
        "it has no switch at its rear"
    );
}

#[test]
fn a_robot_in_a_wall_or_of_nonsense_is_refused() {
    let place = |x, heading| {
        let pose = Pose { x, y: 500.0, heading };
        Simulated::new(Chassis::LINUXBOT, Power::LINUXBOT, Floor::ARENA, pose)
            .map(|_| ())
            .map_err(|error| error.code())
    };
    assert_eq!(place(100.0, 0.0), Ok(()));
    for (x, heading) in [
        (99.9, 0.0),
        (4900.1, 0.0),
        (f64::NAN, 0.0),
        (500.0, f64::INFINITY),
    ] {
        assert_eq!(place(x, heading), Err(5212), "{x} {heading}");
    }
    let power = Power {
        idle: -1.0,
        ..Power::LINUXBOT
    };
    let error = Simulated::new(Chassis::LINUXBOT, power, Floor::ARENA, Pose::default()).map(|_| ());
    assert_eq!(error.map_err(|error| error.code()), Err(5211));
}

#[test]
fn a_fleet_stands_on_its_floor_without_overlap() {
    assert!(Simulated::fleet(0).is_empty());
    for n in [1, 2, 3, 5, 1000] {
        let floor = fleet_floor(n);
        let mut fleet = Simulated::fleet(n);
        let places: Vec<Pose> = fleet.iter_mut().map(|robot| robot.pose(0)).collect();
        assert_eq!(places.len(), usize::from(n));
        assert!(fleet.iter().all(|robot| robot.floor() == floor));
        let limits = Limits::new(floor, CELL / 2.0);
        for (index, one) in places.iter().enumerate() {
            assert!(limits.holds(one.x, one.y), "{n}: {one}");
            for other in &places[..index] {
                assert!((one.x - other.x).hypot(one.y - other.y) >= CELL, "{one} {other}");
            }
        }
    }
    assert_eq!(fleet_floor(u16::MAX).width, 256.0 * CELL);
}

/// What may be done to a robot, and how many µs later.
#[derive(Debug, Clone)]
enum Deed {
    Motors(i16, i16),
    Leds(u8),
    Recharge(u8),
}

fn deed() -> impl Strategy<Value = (Deed, WheelTime)> {
    let value = || prop_oneof![Just(0), Just(500), Just(-500), -1000..=1000_i16];
    let deed = prop_oneof![
        8 => (value(), value()).prop_map(|(left, right)| Deed::Motors(left, right)),
        1 => any::<u8>().prop_map(Deed::Leds),
        1 => (0..=100_u8).prop_map(Deed::Recharge),
    ];
    (deed, 0..3_000_000_i64)
}

fn obey(robot: &mut Simulated, deed: &Deed, at: WheelTime) {
    // What an empty battery refuses is part of what may happen.
    let _obeyed = match deed {
        Deed::Motors(left, right) => robot.set_motors(Motors::new(*left, *right), at),
        Deed::Leds(leds) => robot.set_leds(*leds, at),
        Deed::Recharge(percent) => {
            robot.recharge(*percent, at);
            Ok(())
        }
    };
}

proptest! {
    /// Whatever is done to it: it stays on the floor and below its speed, its battery only empties, and asking it often
    /// changes nothing. What it senses beside its pose changes only at commands and when it said that it would wake.
    #[test]
    fn it_keeps_what_it_promises(
        deeds in proptest::collection::vec(deed(), 1..12), seed in 0..1000_i64, x in 100.0..900.0, y in 100.0..900.0,
    ) {
        let floor = Floor { width: 1000.0, depth: 1000.0 };
        let power = Power { capacity: 400.0, ..Power::LINUXBOT };
        let mut robot = Simulated::new(Chassis::LINUXBOT, power, floor, Pose::new(x, y, seed as f64)).expect("a robot");
        let (mut seldom, mut now) = (robot.clone(), 0);
        let mut last = (robot.pose(0), robot.charge(0));
        for (deed, later) in deeds {
            obey(&mut robot, &deed, now);
            obey(&mut seldom, &deed, now);
            if matches!(deed, Deed::Recharge(_)) {
                last.1 = robot.charge(now);
            }
            let until = now + later;
            let mut count = 0;
            while now < until {
                let before = sense(&mut robot, now);
                let wake = robot.next_wake();
                prop_assert!(wake.is_none_or(|wake| wake > now));
                // A little short of the wake, and then at it.
                let step = 20_000 + (seed * 37) % 9000;
                let soon = (now + step).min(until);
                let (next, woken) = match wake {
                    Some(wake) if wake <= soon && wake - 1 > now => (wake - 1, false),
                    Some(wake) if wake <= soon => (wake, true),
                    _ => (soon, false),
                };
                let after = sense(&mut robot, next);
                if !woken {
                    prop_assert_eq!((after.switches, after.motors), (before.switches, before.motors));
                    prop_assert_eq!(after.battery == 0, before.battery == 0);
                }
                let (pose, charge) = (robot.pose(next), robot.charge(next));
                let seconds = (next - now) as f64 / 1e6;
                prop_assert!((100.0..=900.0).contains(&pose.x) && (100.0..=900.0).contains(&pose.y), "{pose}");
                let moved = (pose.x - last.0.x).hypot(pose.y - last.0.y);
                // To be set to a wall takes it up to 1 µs too far, or what went unseen beside a wall.
                prop_assert!(moved <= 1000.0 * seconds + 0.06, "{moved} mm in {seconds} s");
                prop_assert!(charge <= last.1, "{charge} J after {} J", last.1);
                (last, now, count) = ((pose, charge), next, count + 1);
                prop_assert!(count < 2000, "it does not wake for ever");
            }
        }
        prop_assert_eq!(sense(&mut robot, now), sense(&mut seldom, now));
        prop_assert!((robot.charge(now) - seldom.charge(now)).abs() < 1e-9);
    }
}

/// However late it is asked for: what its program does not prolong ends at its time.
#[test]
fn motors_stop_when_they_are_held_no_longer() {
    let at = |asked: &[WheelTime]| {
        let mut robot = Simulated::linuxbot();
        robot.hold(600_000, 0).expect("it can");
        set(&mut robot, 500, 500, 0);
        for time in asked {
            robot.pose(*time);
        }
        let sensors = robot.sensors(9_000_000).expect("it can be read");
        (sensors.motors, sensors.pose.map(|pose| pose.x.round()))
    };
    assert_eq!(at(&[]), (Motors::STOP, Some(2800.0)), "500 mm/s for 600 ms");
    assert_eq!(at(&[]), at(&[100_000, 599_999, 600_000, 600_001, 5_000_000]));
    let mut robot = Simulated::linuxbot();
    robot.hold(600_000, 0).expect("it can");
    set(&mut robot, 100, 100, 0);
    assert!(wakes(&mut robot, 300_000).iter().all(|due| *due < 600_000));
    robot.pose(550_000);
    assert_eq!(robot.next_wake(), Some(600_000));
    robot.hold(900_000, 550_000).expect("it can");
    assert!(
        robot
            .sensors(899_999)
            .is_ok_and(|sensors| sensors.motors != Motors::STOP)
    );
    robot.hold(WheelTime::MAX, 899_999).expect("it can");
    assert!(
        robot
            .sensors(5_000_000)
            .is_ok_and(|sensors| sensors.motors != Motors::STOP)
    );
}
