//! What a robot does of frames and of silence.

use mom_brs::file::EXTENDED;
use mom_wheels::{Simulated, switch};
use proptest::prelude::*;

use super::*;

const MS: WheelTime = 1000;

fn robot(rules: Rules) -> Robot {
    Robot::new(Box::new(Simulated::linuxbot()), Chassis::LINUXBOT, rules)
}

fn frame(name: &str, values: &[i32]) -> Frame {
    let command = EXTENDED.command(name).expect("it is in the table");
    Frame::new(command, values).expect("it has such parameters")
}

/// Lets time pass as a punctual driver does.
fn pass(robot: &mut Robot, until: WheelTime) {
    while let Some(due) = robot.next_wake().filter(|due| *due <= until) {
        robot.advance(due);
    }
    robot.advance(until);
}

fn place(robot: &mut Robot, now: WheelTime) -> (f64, f64) {
    let pose = robot
        .sensors(now)
        .and_then(|sensors| sensors.pose)
        .expect("it has odometry");
    (pose.x, pose.y)
}

fn replied(robot: &mut Robot, name: &str, now: WheelTime) -> Option<String> {
    robot.take(&frame(name, &[]), now).map(|reply| reply.to_string())
}

#[test]
fn it_replies_to_what_asks_for_it_and_to_nothing_else() {
    let mut robot = robot(Rules::default());
    assert_eq!(replied(&mut robot, "null", 0).as_deref(), Some("00"));
    let full = Status {
        battery: 100,
        ..Status::default()
    };
    assert_eq!(
        replied(&mut robot, "status", 0),
        Some(format!("04 {:05}", full.bits()))
    );
    assert_eq!(
        replied(&mut robot, "pose", 0).as_deref(),
        Some("12 02500 02500 00000")
    );
    for (name, values) in [
        ("motor", &[1, 2][..]),
        ("leds", &[3]),
        ("goto", &[4, 5]),
        ("via", &[6, 7]),
    ] {
        assert_eq!(robot.take(&frame(name, values), 0), None, "{name}");
    }
}

#[test]
fn motors_stop_half_a_second_after_the_last_frame() {
    let mut robot = robot(Rules::default());
    robot.take(&frame("motor", &[500, 500]), 0);
    robot.take(&frame("null", &[]), 300 * MS);
    pass(&mut robot, 799 * MS);
    assert!(robot.status(799 * MS).is_some_and(|status| status.moving));
    pass(&mut robot, 800 * MS);
    let status = robot.status(800 * MS).expect("it can be read");
    assert_eq!((status.moving, status.expired), (false, true));
    assert_eq!(robot.next_wake(), None, "it stands");
    // It is told until something moves it again.
    robot.take(&frame("null", &[]), 900 * MS);
    assert!(robot.status(900 * MS).is_some_and(|status| status.expired));
    robot.take(&frame("motor", &[0, 100]), 900 * MS);
    assert!(robot.status(900 * MS).is_some_and(|status| !status.expired));
}

#[test]
fn a_lost_base_station_stops_the_motors_but_in_the_paper() {
    for (rules, moving) in [(Rules::default(), false), (Rules::PAPER, true)] {
        let mut robot = robot(rules);
        robot.take(&frame("motor", &[-100, 100]), 0);
        robot.lost(100 * MS);
        pass(&mut robot, 100_000 * MS);
        assert_eq!(
            robot.status(100_000 * MS).map(|status| status.moving),
            Some(moving),
            "{rules:?}"
        );
    }
}

#[test]
fn it_drives_to_c_by_a_and_b() {
    let mut robot = robot(Rules::PAPER);
    for (x, y) in [(3000, 2500), (3000, 3000), (2500, 3000)] {
        robot.take(&frame("via", &[x, y]), 0);
    }
    let (mut seen, mut now) = (Vec::new(), 0);
    while let Some(due) = robot.next_wake() {
        now = due;
        robot.advance(due);
        seen.push(place(&mut robot, due));
    }
    let near = |(x, y): (f64, f64), to: (f64, f64)| (x - to.0).hypot(y - to.1) < 15.0;
    let mut points = [(3000.0, 2500.0), (3000.0, 3000.0), (2500.0, 3000.0)].into_iter();
    let mut next = points.next();
    for place in seen {
        if next.is_some_and(|point| near(place, point)) {
            next = points.next();
        }
    }
    assert_eq!(next, None, "it came by all of them, in their order");
    let status = robot.status(now).expect("it can be read");
    assert_eq!(
        (status.moving, status.on_its_way, status.gave_up),
        (false, false, false)
    );
    // GOTO replaces what is queued.
    robot.take(&frame("via", &[100, 100]), now);
    robot.take(&frame("goto", &[2500, 2500]), now);
    while let Some(due) = robot.next_wake() {
        now = due;
        robot.advance(due);
    }
    assert!(near(place(&mut robot, now), (2500.0, 2500.0)));
}

#[test]
fn a_wall_on_the_way_is_told() {
    let mut robot = robot(Rules::PAPER);
    robot.take(&frame("goto", &[9000, 2500]), 0);
    let mut now = 0;
    while let Some(due) = robot.next_wake() {
        now = due;
        robot.advance(due);
    }
    let status = robot.status(now).expect("it can be read");
    assert_eq!(
        (status.gave_up, status.on_its_way, status.moving),
        (true, false, false)
    );
    assert_eq!(status.switches & switch::FRONT, switch::FRONT);
}

/// A simulated robot whose driver refuses the next so many stops.
struct Stubborn {
    robot: Simulated,
    refuses: usize,
}

impl Driver for Stubborn {
    fn set_motors(&mut self, motors: Motors, at: WheelTime) -> Result<(), DriverError> {
        if motors == Motors::STOP && self.refuses > 0 {
            self.refuses -= 1;
            return Err(DriverError::new(Fault::Motors, "they do not obey"));
        }
        self.robot.set_motors(motors, at)
    }

    fn set_leds(&mut self, leds: u8, at: WheelTime) -> Result<(), DriverError> {
        self.robot.set_leds(leds, at)
    }

    fn sensors(&mut self, at: WheelTime) -> Result<Sensors, DriverError> {
        self.robot.sensors(at)
    }

    fn next_wake(&mut self) -> Option<WheelTime> {
        Driver::next_wake(&mut self.robot)
    }
}

#[test]
fn a_stop_that_the_driver_refuses_is_tried_until_it_stands() {
    let stubborn = |refuses| {
        let robot = Simulated::linuxbot();
        Robot::new(
            Box::new(Stubborn { robot, refuses }),
            Chassis::LINUXBOT,
            Rules::default(),
        )
    };
    let moves = |robot: &mut Robot, now| robot.status(now).map(|status| status.moving);
    // What stops it: its base station, the loss of that, and the watchdog.
    type Stop = fn(&mut Robot);
    let stops: [(Stop, WheelTime); 3] = [
        (
            |robot| assert_eq!(robot.take(&frame("motor", &[0, 0]), 100 * MS), None),
            100 * MS,
        ),
        (|robot| robot.lost(100 * MS), 100 * MS),
        (|robot| pass(robot, 500 * MS), 500 * MS),
    ];
    for (stop, now) in stops {
        let mut robot = stubborn(3);
        robot.take(&frame("motor", &[100, 100]), 0);
        stop(&mut robot);
        assert_eq!(robot.fault().map(|error| error.fault()), Some(Fault::Motors));
        assert_eq!(robot.next_wake(), Some(now + 50 * MS));
        let expired = robot.status(now).map(|status| status.expired);
        pass(&mut robot, now + 149 * MS);
        assert_eq!(moves(&mut robot, now + 149 * MS), Some(true));
        pass(&mut robot, now + 150 * MS);
        assert_eq!(moves(&mut robot, now + 150 * MS), Some(false));
        assert_eq!(robot.next_wake(), None, "it stands");
        let still = robot.status(now + 150 * MS).map(|status| status.expired);
        assert_eq!(still, expired, "who has stopped it is told as before");
    }
    // What moves it again has the last word.
    let mut robot = stubborn(1);
    robot.take(&frame("motor", &[100, 100]), 0);
    robot.take(&frame("motor", &[0, 0]), 10 * MS);
    robot.take(&frame("motor", &[200, 200]), 20 * MS);
    pass(&mut robot, 400 * MS);
    assert_eq!(moves(&mut robot, 400 * MS), Some(true));
    // So it is at the end of a way.
    let mut robot = stubborn(1);
    robot.take(&frame("goto", &[2500, 2500]), 0);
    assert_eq!(robot.next_wake(), Some(50 * MS));
    pass(&mut robot, 50 * MS);
    assert_eq!(robot.next_wake(), None);
}

#[test]
fn a_robot_at_its_charger_says_that_it_is_charged() {
    let driver = Simulated::linuxbot()
        .with_battery(40)
        .with_charger(mom_wheels::Point::new(2500.0, 2500.0));
    let mut robot = Robot::new(Box::new(driver), Chassis::LINUXBOT, Rules::default());
    let charged = Status {
        battery: 40,
        charging: true,
        ..Status::default()
    };
    assert_eq!(
        replied(&mut robot, "status", 0),
        Some(format!("04 {:05}", charged.bits()))
    );
    assert_eq!(Status::from_bits(charged.bits()), charged);
    let later = robot.status(600_000_000).expect("it knows");
    assert!(later.charging && later.battery > 60, "{later:?}");
}

#[test]
fn a_dead_battery_is_told_and_nothing_waits_for_it() {
    let dead = Simulated::linuxbot().with_battery(0);
    let mut robot = Robot::new(Box::new(dead), Chassis::LINUXBOT, Rules::default());
    robot.take(&frame("motor", &[500, 500]), 0);
    assert_eq!(robot.fault().map(|error| error.fault()), Some(Fault::Battery));
    assert_eq!(robot.status(0), Some(Status::default()));
    assert_eq!(robot.next_wake(), None);
}

proptest! {
    /// Whatever is said, and however late it is heard: it never runs for longer than the watchdog lets it.
    #[test]
    fn it_never_runs_without_its_base_station(said in proptest::collection::vec((0..6, -2000..2000, -2000..2000, 0..900 * MS), 1..40)) {
        let mut robot = robot(Rules::default());
        let mut now = 0;
        for (what, x, y, later) in said {
            let frame = match what {
                0 => frame("null", &[]),
                1 => frame("status", &[]),
                2 => frame("motor", &[x, y]),
                3 => frame("goto", &[x + 2500, y + 2500]),
                4 => frame("via", &[x + 2500, y + 2500]),
                _ => frame("leds", &[x]),
            };
            robot.take(&frame, now);
            let until = now + later;
            pass(&mut robot, until);
            if later >= Watchdog::LIMIT {
                prop_assert!(robot.status(until).is_some_and(|status| !status.moving && !status.on_its_way));
            }
            now = until;
        }
        pass(&mut robot, now + Watchdog::LIMIT);
        prop_assert_eq!(robot.next_wake(), None);
    }
}

/// What its program does not do in time the driver does: here nobody calls the robot for seconds, as of a program that is stopped.
#[test]
fn its_driver_stops_the_motors_when_its_program_stands_still() {
    let driven = |robot: &mut Robot, name, values: &[i32]| {
        robot.take(&frame(name, values), 0);
        robot.advance(0);
        robot.take(&frame("null", &[]), 100 * MS);
        let begun = place(robot, 100 * MS).0;
        // It reads its sensors before it looks at its watchdog.
        let sensors = robot.sensors(9000 * MS).expect("it can be read");
        (sensors.motors, sensors.pose.map_or(0.0, |pose| pose.x) - begun)
    };
    for (name, values, most) in [
        ("motor", &[1000, 1000][..], 600.0),
        ("goto", &[4500, 2500], 360.0),
    ] {
        let (motors, way) = driven(&mut robot(Rules::default()), name, values);
        assert_eq!(motors, Motors::STOP, "{name}");
        assert!((100.0..most).contains(&way), "{name}: {way} mm");
    }
    // In the paper there is no such thing, also after a way, which has it.
    let mut paper = robot(Rules::PAPER);
    paper.take(&frame("goto", &[2600, 2500]), 0);
    pass(&mut paper, 200 * MS);
    paper.take(&frame("motor", &[10, 10]), 200 * MS);
    let sensors = paper.sensors(9000 * MS).expect("it can be read");
    assert_eq!(sensors.motors, Motors::new(10, 10));
}

/// A `00` that is read among the bytes of something else is not a word of a base station that is understood.
#[test]
fn what_is_doubtful_feeds_the_watchdog_only_by_moving_the_robot() {
    for (doubtful, expired) in [(false, false), (true, true)] {
        let mut robot = robot(Rules::default());
        robot.take(&frame("motor", &[500, 500]), 0);
        let null = frame("null", &[]);
        let reply = match doubtful {
            true => robot.take_doubtful(&null, 300 * MS),
            false => robot.take(&null, 300 * MS),
        };
        assert_eq!(reply.map(|reply| reply.code()), Some(Code::NULL));
        pass(&mut robot, 600 * MS);
        assert_eq!(robot.status(600 * MS).map(|status| status.expired), Some(expired));
        robot.take_doubtful(&frame("motor", &[1, 1]), 600 * MS);
        pass(&mut robot, 1099 * MS);
        assert!(robot.status(1099 * MS).is_some_and(|status| status.moving));
    }
}
