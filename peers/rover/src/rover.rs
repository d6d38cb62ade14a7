//! The robot as a machine: what statements do to its driver.

use std::fmt;

use mom_client::{Age, Map};
use mom_device::{DeviceError, DeviceTime, ErrorName, Machine, Script, Word, Words};
use mom_fleet::Action;
use mom_wheels::pilot::{PERIOD, Point};
use mom_wheels::{Chassis, Driver, DriverError, Fault, Motors, Pilot, PilotEnd, Sensors};

use crate::Follower;

/// µs that it may take to come to its rest.
const SETTLES: DeviceTime = 500_000;

/// A robot on its driver.
///
/// What fails by itself is fetched by [`Rover::take_failure`]; then all commands are to be ended with it.
pub struct Rover {
    driver: Box<dyn Driver>,
    chassis: Chassis,
    /// Its number, if it has one.
    unit: Option<u32>,
    now: DeviceTime,
    /// What it sensed last.
    sensors: Option<Sensors>,
    motors: Motors,
    leds: i32,
    doing: Doing,
    /// Until when it may not have come to its rest.
    settles: DeviceTime,
    failure: Option<DeviceError>,
}

/// What it does of the statement that was begun last.
#[derive(Debug)]
enum Doing {
    Nothing,
    /// It is done then.
    Done(DeviceTime),
    /// The motors are set until then; then they stop, unless the next statement sets them.
    Motors(DeviceTime),
    Drives(Pilot),
    Follows {
        follower: Follower,
        /// When it steers next; none while its leader is lost.
        due: Option<DeviceTime>,
    },
}

impl fmt::Debug for Rover {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Rover")
            .field("motors", &self.motors)
            .field("doing", &self.doing)
            .finish_non_exhaustive()
    }
}

impl Rover {
    /// A robot that stands.
    #[must_use]
    pub fn new(driver: Box<dyn Driver>, chassis: Chassis, unit: Option<u32>) -> Self {
        let mut rover = Self {
            driver,
            chassis,
            unit,
            now: 0,
            sensors: None,
            motors: Motors::STOP,
            leds: 0,
            doing: Doing::Nothing,
            settles: 0,
            failure: None,
        };
        rover.advance(0);
        rover
    }

    /// Where it is, `{x, y, heading}`, once it knows.
    #[must_use]
    pub fn pose(&self) -> Option<Map> {
        let pose = self.sensors?.pose?;
        let heading = whole(pose.heading).rem_euclid(360);
        let map = Map::new().with("x", whole(pose.x)).with("y", whole(pose.y));
        Some(map.with("heading", heading))
    }

    /// A peer has said that it is there, so long ago. Nothing comes of it but from the leader, if it has one, and none of a pose of
    /// unknown age.
    pub fn heard(&mut self, peer: &str, at: Point, age: Option<Age>) {
        let Doing::Follows { follower, due } = &mut self.doing else {
            return;
        };
        if &**follower.leader() != peer {
            return;
        }
        let Some(oldest) = age.and_then(|age| age.at_most()) else {
            return;
        };
        let oldest = DeviceTime::try_from(oldest.as_micros()).unwrap_or(DeviceTime::MAX);
        match follower.heard(at, self.now.saturating_sub(oldest)) {
            Ok(()) => *due = due.or(Some(self.now)),
            Err(strayed) => self.fail(DeviceError::new(ErrorName::Halted, strayed.to_string())),
        }
    }

    /// Whether something failed since [`Rover::take_failure`] was called last.
    #[must_use]
    pub fn has_failed(&self) -> bool {
        self.failure.is_some()
    }

    /// What failed, if something did.
    pub fn take_failure(&mut self) -> Option<DeviceError> {
        self.failure.take()
    }

    fn fail(&mut self, error: DeviceError) {
        self.stand();
        // The first one is what there is to be told.
        self.failure.get_or_insert(error);
    }

    fn stand(&mut self) {
        self.doing = Doing::Nothing;
        self.set_motors(Motors::STOP);
    }

    /// Sets the motors; whatever becomes of it, an order to stop is given again by whoever stops the next time.
    fn set_motors(&mut self, motors: Motors) {
        if motors == Motors::STOP && self.motors != Motors::STOP {
            self.settles = self.now.saturating_add(SETTLES);
        }
        self.motors = motors;
        if let Err(error) = self.driver.set_motors(motors, self.now) {
            self.driver_failed(&error);
        }
    }

    fn driver_failed(&mut self, error: &DriverError) {
        self.doing = Doing::Nothing;
        let name = match error.fault() {
            Fault::Battery => ErrorName::Obstacle,
            _ => ErrorName::Link,
        };
        let text = format!("the robot cannot drive: {error}");
        self.failure.get_or_insert(DeviceError::new(name, text));
    }

    fn steer(&mut self, sensors: &Sensors) {
        let now = self.now;
        match &mut self.doing {
            Doing::Nothing | Doing::Done(_) => {}
            // Later than its end by a moment, so that a `motor` that follows at once sets other values without a stop between.
            Doing::Motors(until) if now > *until => self.stand(),
            Doing::Motors(_) => {}
            Doing::Drives(pilot) => {
                let motors = pilot.steer(sensors, now);
                let end = pilot.end();
                if let Some(motors) = motors {
                    self.set_motors(motors);
                }
                match end {
                    None => {}
                    Some(PilotEnd::Arrived) => self.doing = Doing::Done(now),
                    Some(PilotEnd::GaveUp(why)) => {
                        let text = format!(
                            "the robot gave its way up: {why}; drive it away from there with `motor`"
                        );
                        self.fail(DeviceError::new(ErrorName::Obstacle, text));
                    }
                }
            }
            Doing::Follows { follower, due } => {
                let hindered = match sensors {
                    Sensors { battery: 0, .. } => Some("the battery is empty"),
                    Sensors { pose: None, .. } => Some("it does not know where it is"),
                    Sensors { switches: 1.., .. } => Some("something is in its way"),
                    _ => None,
                };
                if let Some(why) = hindered {
                    let text = format!("the robot follows {} no more: {why}", follower.leader());
                    return self.fail(DeviceError::new(ErrorName::Obstacle, text));
                }
                if due.is_none_or(|due| due > now) {
                    return;
                }
                let motors = sensors
                    .pose
                    .map_or(Motors::STOP, |pose| follower.steer(pose, &self.chassis, now));
                *due = follower
                    .lost_at()
                    .filter(|lost| *lost > now)
                    .map(|lost| lost.min(now.saturating_add(PERIOD)));
                if motors != self.motors {
                    self.set_motors(motors);
                }
            }
        }
    }
}

fn whole(value: f64) -> i32 {
    value.round().clamp(-1e6, 1e6) as i32
}

impl Machine for Rover {
    type Action = Action;

    const NAME: &str = "the robot";
    const VERBS: &[&str] = Action::VERBS;
    const PERIOD: DeviceTime = 100_000;

    fn read(verb: Word<'_>, words: &mut Words<'_>) -> Option<Result<Action, DeviceError>> {
        Action::read(verb, words)
    }

    fn is_moving(&self) -> bool {
        self.motors != Motors::STOP || self.now < self.settles
    }

    fn plan(&mut self, script: &Script<Action>) -> Result<(), DeviceError> {
        let count = script.statements().len();
        for (action, number) in script.actions() {
            if matches!(action, Action::Follow { .. })
                && usize::try_from(number).is_ok_and(|number| number < count)
            {
                let text =
                    "nothing comes after `follow` in a script, as it goes on until another command comes";
                return Err(DeviceError::new(ErrorName::Syntax, text).at_statement(number));
            }
        }
        Ok(())
    }

    fn begin(&mut self, action: &Action, now: DeviceTime) -> Result<(), DeviceError> {
        self.now = now;
        if !matches!(action, Action::Motor { .. }) && self.motors != Motors::STOP {
            self.stand();
        }
        self.doing = match action {
            Action::Motor { left, right, ms } => {
                let value = |value: i32| i16::try_from(value).unwrap_or(0);
                self.set_motors(Motors::new(value(*left), value(*right)));
                Doing::Motors(now.saturating_add(DeviceTime::from(*ms) * 1000))
            }
            Action::Leds(data) => {
                let set = self.driver.set_leds((data & 0xff) as u8, now);
                set.map_err(|error| DeviceError::new(ErrorName::Link, error.to_string()))?;
                self.leds = *data;
                Doing::Done(now)
            }
            Action::Drive(points) => {
                let points: Vec<Point> = points
                    .iter()
                    .map(|(x, y)| Point::new(f64::from(*x), f64::from(*y)))
                    .collect();
                Doing::Drives(Pilot::new(self.chassis, points, now))
            }
            Action::Follow { leader, distance } => Doing::Follows {
                follower: Follower::new(leader.clone(), f64::from(*distance)),
                due: None,
            },
        };
        match self.failure.take() {
            Some(error) => Err(error),
            None => Ok(()),
        }
    }

    fn done_at(&self) -> Option<DeviceTime> {
        match self.doing {
            Doing::Done(at) | Doing::Motors(at) => Some(at),
            Doing::Nothing | Doing::Drives(_) | Doing::Follows { .. } => None,
        }
    }

    fn gives_way(&self) -> bool {
        matches!(self.doing, Doing::Follows { .. })
    }

    fn halt(&mut self, now: DeviceTime) {
        self.now = now;
        self.stand();
    }

    fn advance(&mut self, now: DeviceTime) {
        self.now = now;
        match self.driver.sensors(now) {
            Ok(sensors) => {
                self.sensors = Some(sensors);
                self.steer(&sensors);
            }
            Err(error) => {
                let drives = !matches!(self.doing, Doing::Nothing | Doing::Done(_));
                self.sensors = None;
                if drives {
                    self.stand();
                    self.driver_failed(&error);
                }
            }
        }
    }

    fn next_wake(&self) -> Option<DeviceTime> {
        let doing = match &self.doing {
            Doing::Nothing | Doing::Done(_) => None,
            Doing::Motors(until) => Some(until.saturating_add(1)),
            Doing::Drives(pilot) => pilot.next_wake(),
            Doing::Follows { due, .. } => *due,
        };
        let settles = (self.motors == Motors::STOP && self.now < self.settles).then_some(self.settles);
        [doing, settles].into_iter().flatten().min()
    }

    /// `{x, y, heading}` in mm, mm and degrees, if it knows.
    fn position(&self) -> Map {
        self.pose().unwrap_or_default()
    }

    /// `{unit?, linked, leds, battery?, switches?, leader?, lost-leader?, gap?}`: percent, a mask of bits; whom it follows, whether it
    /// stands because it does not know where that is, and mm along the trail between them.
    fn report(&self) -> Map {
        let mut map = match self.unit {
            Some(unit) => Map::new().with("unit", i64::from(unit)),
            None => Map::new(),
        };
        map.set("linked", self.sensors.is_some());
        map.set("leds", self.leds);
        if let Some(sensors) = self.sensors {
            map.set("battery", i64::from(sensors.battery));
            map.set("switches", i64::from(sensors.switches));
        }
        if let Doing::Follows { follower, .. } = &self.doing {
            map.set("leader", &**follower.leader());
            map.set("lost-leader", follower.is_lost(self.now));
            let here = self.sensors.and_then(|sensors| sensors.pose);
            if let Some(gap) = here.and_then(|here| follower.gap(Point::new(here.x, here.y))) {
                map.set("gap", whole(gap));
            }
        }
        map
    }
}

#[cfg(test)]
mod tests {
    use mom_client::Value;
    use mom_device::{Command, CommandQueue, Order, QueueEvent};
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
            let robot =
                Simulated::new(Chassis::LINUXBOT, Power::LINUXBOT, Floor::ARENA, pose).expect("a robot");
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
    fn nothing_comes_after_follow() {
        let mut stage = Stage::new();
        let error = stage
            .command("follow rover-a 300; leds 1")
            .expect_err("it never ends");
        assert_eq!(
            error.text(),
            "statement 1: nothing comes after `follow` in a script, as it goes on until another command comes"
        );
    }
}
