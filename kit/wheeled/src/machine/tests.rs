//! What statements do to a robot, and what a driver that does not obey does to them.

use std::sync::atomic::{AtomicUsize, Ordering};

use mom_client::Value;
use mom_device::{Command, CommandQueue, ErrorName, Order, QueueEvent};
use mom_wheels::{Floor, Pose, Power, Simulated};

use super::*;

const MS: DeviceTime = 1000;

struct Stage {
    queue: CommandQueue<Rover>,
    now: DeviceTime,
    events: Vec<QueueEvent>,
}

impl Stage {
    fn new() -> Self {
        let pose = Pose::new(1000.0, 1000.0, 0.0);
        let robot = Simulated::new(Chassis::LINUXBOT, Power::LINUXBOT, Floor::ARENA, pose).expect("a robot");
        Self::on(robot)
    }

    fn on(robot: Simulated) -> Self {
        Self {
            queue: CommandQueue::new(Rover::new(Box::new(robot), Chassis::LINUXBOT, None)),
            now: 0,
            events: Vec::new(),
        }
    }

    fn command(&mut self, script: &str) -> Result<(), DeviceError> {
        let command = Command {
            order: Order {
                peer: "alice".into(),
                id: None,
                fence: None,
            },
            script: Script::read::<Rover>(script)?,
            use_by: None,
        };
        self.queue.submit(command, self.now, &mut self.events)
    }

    fn heard(&mut self, peer: &str, x: f64, error: Option<u64>) {
        let age = Age {
            micros: 0,
            error_micros: error,
        };
        let what = |rover: &mut Rover| rover.heard(peer, Point::new(x, 1000.0), Some(age));
        self.queue.note(self.now, what, &mut self.events);
    }

    fn pass(&mut self, until: DeviceTime) {
        while let Some(due) = self.queue.next_wake().filter(|due| *due <= until) {
            self.now = due.max(self.now);
            self.queue.advance(self.now, &mut self.events);
        }
        self.now = until;
        self.queue.advance(until, &mut self.events);
    }

    fn x(&self) -> i64 {
        let x = self.queue.state().position.get("x").and_then(Value::as_int);
        x.expect("it knows where it is")
    }

    fn said(&self, key: &str) -> Option<Value> {
        self.queue.state().report.get(key).cloned()
    }

    /// How commands ended since this was asked last.
    fn ended(&mut self) -> Vec<&'static str> {
        let events = std::mem::take(&mut self.events);
        let ends = events.iter().filter_map(|event| match event {
            QueueEvent::Finished(_) => Some("finished"),
            QueueEvent::Failed(..) => Some("failed"),
            _ => None,
        });
        ends.collect()
    }
}

#[test]
fn it_drives_as_the_robots_of_a_gateway_do() {
    let mut stage = Stage::new();
    stage
        .command("motor 300 300 1000; wait 700; goto 2000 1000; leds 5")
        .expect("it can");
    stage.pass(1600 * MS);
    assert!((1200..1350).contains(&stage.x()), "{}", stage.x());
    assert!(!stage.queue.state().moving, "motors stop when their time is over");
    stage.pass(20_000 * MS);
    assert_eq!(stage.ended(), ["finished"]);
    assert!((stage.x() - 2000).abs() < 15, "{}", stage.x());
    assert_eq!(stage.said("leds"), Some(Value::from(5)));
}

#[test]
fn a_wall_is_a_failure_that_is_told_once() {
    let mut stage = Stage::new();
    stage.command("goto 9000 1000").expect("it is a place");
    stage.pass(30_000 * MS);
    let mut failure = None;
    let take = |rover: &mut Rover| failure = rover.take_failure();
    stage.queue.note(stage.now, take, &mut stage.events);
    let failure = failure.expect("there is a wall");
    assert_eq!(failure.name(), ErrorName::Obstacle);
    assert!(!stage.queue.machine().has_failed() && !stage.queue.state().moving);
}

#[test]
fn it_follows_the_leader_alone_and_none_of_unknown_age() {
    let mut stage = Stage::new();
    stage.command("follow rover-a 300").expect("it can");
    for (peer, error) in [("mallory", Some(0)), ("rover-a~2", Some(0)), ("rover-a", None)] {
        stage.heard(peer, 1900.0, error);
        stage.pass(stage.now + 400 * MS);
        assert_eq!(stage.x(), 1000, "{peer} {error:?}");
        assert_eq!(stage.said("lost-leader"), Some(Value::from(true)), "{peer}");
    }
    stage.heard("rover-a", 1900.0, Some(0));
    stage.pass(stage.now + 400 * MS);
    assert_eq!(stage.said("lost-leader"), Some(Value::from(false)));
    assert!(stage.x() > 1000 && stage.queue.state().moving);
    // An error of 100 ms takes as much of its limit.
    stage.heard("rover-a", 1910.0, Some(100_000));
    let begin = stage.now;
    stage.pass(begin + 399 * MS);
    assert!(stage.queue.machine().motors != Motors::STOP);
    stage.pass(begin + 400 * MS);
    assert_eq!(stage.queue.machine().motors, Motors::STOP);
    assert_eq!(stage.said("lost-leader"), Some(Value::from(true)));
    assert_eq!(stage.ended(), [""; 0], "it waits for its leader");
}

#[test]
fn any_new_command_ends_following_and_so_does_a_halt() {
    for script in ["wait 1000", "leds 1", "motor 100 100 50"] {
        let mut stage = Stage::new();
        stage.command("wait 10; follow rover-a 300").expect("it can");
        stage.pass(10 * MS);
        stage.heard("rover-a", 1900.0, Some(0));
        stage.pass(300 * MS);
        assert!(stage.queue.state().moving);
        stage.command(script).expect("it can");
        assert_eq!(stage.said("leader"), None, "{script}");
        stage.heard("rover-a", 1920.0, Some(0));
        stage.pass(1500 * MS);
        assert!(!stage.queue.state().moving, "{script}");
        assert_eq!(stage.ended(), ["finished"; 2], "{script}");
    }
    let mut stage = Stage::new();
    stage.command("follow rover-a 300").expect("it can");
    stage.heard("rover-a", 1900.0, Some(0));
    stage.pass(300 * MS);
    stage.queue.halt(stage.now, "a test", &mut stage.events);
    assert_eq!(stage.queue.machine().motors, Motors::STOP);
    assert_eq!((stage.ended(), stage.said("leader")), (vec!["failed"], None));
}

#[test]
fn an_empty_battery_ends_each_motion_as_battery() {
    for script in ["motor 1000 -1000 60000", "goto 4000 4000", "follow rover-a 300"] {
        let power = Power {
            capacity: 30.0,
            ..Power::LINUXBOT
        };
        let (floor, pose) = (Floor::ARENA, Pose::new(1000.0, 1000.0, 0.0));
        let robot = Simulated::new(Chassis::LINUXBOT, power, floor, pose).expect("a robot");
        let mut stage = Stage::on(robot);
        stage.command(script).expect("it can");
        stage.heard("rover-a", 1900.0, Some(0));
        stage.pass(15_000 * MS);
        let mut failure = None;
        let take = |rover: &mut Rover| failure = rover.take_failure();
        stage.queue.note(stage.now, take, &mut stage.events);
        let failure = failure.expect("its battery is empty");
        assert_eq!(failure.name(), ErrorName::Battery, "{script}: {failure}");
        assert_eq!(stage.said("battery"), Some(Value::from(0)), "{script}");
        // As its peer does.
        stage.queue.fail(stage.now, &failure, &mut stage.events);
        stage.events.clear();
        // What it is told then is refused as that, too.
        stage.command("motor 100 100 100").expect("it is read");
        stage.pass(stage.now + 10 * MS);
        let refused = stage
            .events
            .iter()
            .any(|event| matches!(event, QueueEvent::Failed(_, error) if error.name() == ErrorName::Battery));
        assert!(refused, "{script}");
    }
}

#[test]
fn it_tells_that_it_is_charged_and_how_far() {
    let robot = Simulated::linuxbot().with_battery(40);
    let mut stage = Stage::on(robot.with_charger(Point::new(2500.0, 2500.0)));
    stage.pass(MS);
    assert_eq!(stage.said("charging"), Some(Value::from(true)));
    // At rest, with nobody who asks it.
    stage.pass(600_000 * MS);
    let Some(Value::Int(battery)) = stage.said("battery") else {
        panic!("it tells its battery");
    };
    assert!((65..=67).contains(&battery), "{battery} %");
    stage.command("motor 500 500 1000").expect("it can");
    stage.pass(stage.now + 2000 * MS);
    assert_eq!(stage.said("charging"), Some(Value::from(false)));
    assert_eq!(Stage::new().said("charging"), None);
}

#[test]
fn a_small_robot_drives_as_its_file_says() {
    let lego = crate::Model::parse(include_str!("../../../../config/lego.toml")).expect("it is right");
    let pose = Pose::new(1000.0, 1000.0, 0.0);
    let robot = Simulated::new(lego.chassis, lego.power, Floor::ARENA, pose).expect("a robot");
    let rover = Rover::new(Box::new(robot.with_fittings(lego.fittings)), lego.chassis, None);
    let mut stage = Stage::new();
    stage.queue = CommandQueue::new(rover);
    // 300 mm/s at full speed.
    stage.command("motor 1000 1000 2000").expect("it can");
    stage.pass(3000 * MS);
    assert!((1560..=1610).contains(&stage.x()), "{}", stage.x());
    let light = stage.said("light");
    stage.command("goto 1000 1000; goto 2300 1000").expect("it can");
    stage.pass(stage.now + 60_000 * MS);
    assert!((2285..=2315).contains(&stage.x()), "{}", stage.x());
    assert_ne!(stage.said("light"), light, "another tile");
    // Its touch sensor is at the front.
    stage.command("motor 1000 1000 20000").expect("it can");
    stage.pass(stage.now + 20_500 * MS);
    assert_eq!(
        stage.said("switches"),
        Some(Value::from(i64::from(mom_wheels::switch::FRONT)))
    );
    stage.events.clear();
    stage.command("leds 1").expect("it is read");
    stage.pass(stage.now + 10 * MS);
    let refused = stage
        .events
        .iter()
        .any(|event| matches!(event, QueueEvent::Failed(_, error) if error.text().contains("has no LEDs")));
    assert!(refused, "{:?}", stage.events);
}

#[test]
fn nothing_comes_after_follow() {
    let mut stage = Stage::new();
    let error = stage
        .command("follow rover-a 300; leds 1")
        .expect_err("it never ends");
    assert_eq!(
        error.text(),
        "statement 1: `follow` must be the last command of a script: it runs until the next command"
    );
}

/// A simulated robot whose driver refuses the next so many stops, and counts those that it is given.
struct Stubborn {
    robot: Simulated,
    refuses: Arc<AtomicUsize>,
    stops: Arc<AtomicUsize>,
}

impl Driver for Stubborn {
    fn set_motors(&mut self, motors: Motors, at: DeviceTime) -> Result<(), DriverError> {
        if motors == Motors::STOP {
            self.stops.fetch_add(1, Ordering::Relaxed);
            let left = self.refuses.load(Ordering::Relaxed);
            if left > 0 {
                self.refuses.store(left - 1, Ordering::Relaxed);
                return Err(DriverError::new(Fault::Motors, "they do not obey"));
            }
        }
        self.robot.set_motors(motors, at)
    }
    fn hold(&mut self, until: DeviceTime, at: DeviceTime) -> Result<(), DriverError> {
        self.robot.hold(until, at)
    }
    fn set_leds(&mut self, leds: u8, at: DeviceTime) -> Result<(), DriverError> {
        self.robot.set_leds(leds, at)
    }
    fn sensors(&mut self, at: DeviceTime) -> Result<Sensors, DriverError> {
        self.robot.sensors(at)
    }
    fn next_wake(&mut self) -> Option<DeviceTime> {
        Driver::next_wake(&mut self.robot)
    }
}

/// A stage with such a driver: how many stops it will refuse, and how many it was given.
fn stubborn() -> (Stage, Arc<AtomicUsize>, Arc<AtomicUsize>) {
    let (refuses, stops) = (Arc::<AtomicUsize>::default(), Arc::<AtomicUsize>::default());
    let driver = Stubborn {
        robot: Simulated::linuxbot(),
        refuses: Arc::clone(&refuses),
        stops: Arc::clone(&stops),
    };
    let mut stage = Stage::new();
    stage.queue = CommandQueue::new(Rover::new(Box::new(driver), Chassis::LINUXBOT, None));
    (stage, refuses, stops)
}

/// The motors were to run until then; that they may run on is told already.
#[test]
fn a_driver_that_takes_no_stop_fails_once_however_long_that_lasts() {
    let (mut stage, refuses, given) = stubborn();
    stage.command("motor 100 100 60000").expect("it can");
    stage.pass(300 * MS);
    refuses.store(1_000_000, Ordering::Relaxed);
    let before = given.load(Ordering::Relaxed);
    stage.queue.halt(stage.now, "a test", &mut stage.events);
    let mut failures = 0;
    for ms in 300..3300 {
        stage.pass(ms * MS);
        stage.queue.note(
            stage.now,
            |rover| failures += usize::from(rover.take_failure().is_some()),
            &mut stage.events,
        );
    }
    let given = given.load(Ordering::Relaxed) - before;
    assert_eq!(failures, 1);
    assert!((40..=61).contains(&given), "{given} stops in three seconds");
}

#[test]
fn a_stop_that_the_driver_refuses_is_given_again_and_not_done_before() {
    type Stop = fn(&mut Stage);
    let stops: [Stop; 3] = [
        |stage| stage.queue.halt(stage.now, "a test", &mut stage.events),
        |stage| {
            stage
                .queue
                .stop(stage.now, "a test", ErrorName::Stopped, &mut stage.events);
        },
        // The end of a statement.
        |stage| stage.pass(1001 * MS),
    ];
    for (stop, number) in stops.into_iter().zip(1..) {
        let (mut stage, refuses, given) = stubborn();
        stage.command("motor 100 100 1000").expect("it can");
        stage.pass(300 * MS);
        refuses.store(4, Ordering::Relaxed);
        let before = given.load(Ordering::Relaxed);
        stop(&mut stage);
        let begun = stage.now;
        while refuses.load(Ordering::Relaxed) > 0 {
            let state = stage.queue.state();
            assert!(
                state.moving && !stage.queue.machine().stands(),
                "{number}: it has not taken it"
            );
            assert_eq!(stage.said("halting"), Some(Value::from(true)), "{number}");
            stage.pass(stage.now + 50 * MS);
            assert!(stage.now < begun + 1000 * MS, "{number}: nobody tells it again");
        }
        stage.pass(stage.now + 50 * MS);
        assert!(stage.queue.machine().stands(), "{number}");
        assert_eq!(stage.said("halting"), None, "{number}");
        assert_eq!(given.load(Ordering::Relaxed) - before, 5, "{number}");
        // It has failed once, and its program hears of it.
        let mut failures = 0;
        stage.queue.note(
            stage.now,
            |rover| failures += usize::from(rover.take_failure().is_some()),
            &mut stage.events,
        );
        assert_eq!(failures, 1, "{number}");
        stage.pass(stage.now + 1500 * MS);
        assert!(!stage.queue.state().moving, "{number}");
    }
}

#[test]
fn a_halt_at_rest_reaches_the_driver_too() {
    let (mut stage, refuses, given) = stubborn();
    stage.pass(2000 * MS);
    assert_eq!(
        given.load(Ordering::Relaxed),
        1,
        "it was told to stand when it began"
    );
    stage.queue.halt(stage.now, "a test", &mut stage.events);
    assert_eq!(given.load(Ordering::Relaxed), 2);
    assert!(!stage.queue.state().moving, "it has taken it");
    refuses.store(1, Ordering::Relaxed);
    stage
        .queue
        .stop(stage.now, "a test", ErrorName::Stopped, &mut stage.events);
    assert!(stage.queue.state().moving, "nobody knows that it stands");
    stage.pass(stage.now + 50 * MS);
    assert_eq!(given.load(Ordering::Relaxed), 4);
}

#[tokio::test]
async fn where_its_program_ends_the_driver_is_told_until_it_takes_the_stop() {
    let (mut stage, refuses, given) = stubborn();
    stage.command("motor 100 100 60000").expect("it can");
    stage.pass(300 * MS);
    refuses.store(2, Ordering::Relaxed);
    let before = given.load(Ordering::Relaxed);
    let mut rover = stage.queue.machine().again();
    let begin = tokio::time::Instant::now() - std::time::Duration::from_millis(300);
    crate::stand(&mut rover, begin).await;
    assert!(rover.stands(), "its program ends no sooner");
    assert!(given.load(Ordering::Relaxed) >= before + 3 && refuses.load(Ordering::Relaxed) == 0);
}

#[test]
fn nothing_begins_before_the_last_stop_is_taken() {
    let (mut stage, refuses, _) = stubborn();
    stage.command("motor 100 100 5000").expect("it can");
    stage.pass(300 * MS);
    refuses.store(1000, Ordering::Relaxed);
    stage.queue.halt(stage.now, "a test", &mut stage.events);
    stage.ended();
    stage.command("motor 100 100 5000").expect("it is read");
    assert_eq!(stage.ended(), ["failed"]);
    // The same robot for another channel knows that it has not stopped.
    let again = stage.queue.machine().again();
    assert!(!again.stands() && again.next_wake().is_some());
}

/// Nobody calls the robot for seconds, as when its program is stopped; then all that was due is due at once.
#[test]
fn of_a_program_that_stood_still_the_motion_ends_and_no_later_statement_begins() {
    for (script, at, finished) in [
        ("motor 300 300 1000; leds 7; motor 300 300 1000", 300, false),
        // Its end was near, and the driver had it: it was carried out, and what came after it is late.
        ("motor 300 300 1000; leds 7; motor 300 300 1000", 900, false),
        ("motor 300 300 1000", 900, true),
        ("goto 4000 1000; leds 7", 1000, false),
        ("motor 300 300 100; wait 1000; leds 7", 300, false),
    ] {
        let mut stage = Stage::new();
        stage.command(script).expect("it can");
        stage.pass(at * MS);
        let before = stage.x();
        stage.now = 6000 * MS;
        stage.queue.advance(stage.now, &mut stage.events);
        let mut failure = None;
        stage.queue.note(
            stage.now,
            |rover| failure = rover.take_failure(),
            &mut stage.events,
        );
        if let Some(error) = failure {
            assert!(error.text().contains("stood still"), "{error}");
            stage.queue.fail(stage.now, &error, &mut stage.events);
        }
        stage.pass(9000 * MS);
        assert_eq!(
            stage.ended(),
            [if finished { "finished" } else { "failed" }],
            "{script} at {at}"
        );
        assert_eq!(stage.said("leds"), Some(Value::from(0)), "{script} at {at}");
        let way = stage.x() - before;
        // 600 mm/s on its way, for 500 ms and until its wheels stand.
        assert!(way <= 370, "{script} at {at}: {way} mm without its program");
        assert!(!stage.queue.state().moving);
    }
}

#[test]
fn motors_run_as_long_as_the_statement_says() {
    let mut stage = Stage::new();
    stage
        .command("motor 300 300 3000; motor -300 -300 1000")
        .expect("it can");
    for after in [100, 600, 1500, 2999] {
        stage.pass(after * MS);
        assert!(stage.queue.state().moving, "after {after} ms");
    }
    let x = stage.x();
    assert!((1800..1900).contains(&x), "{x}");
    stage.pass(5000 * MS);
    assert!((stage.x() - 1600).abs() < 30, "{}", stage.x());
    assert_eq!(stage.ended(), ["finished"]);
}
