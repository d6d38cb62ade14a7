//! The robot: what its driver does at each frame, and when nobody says anything.

use mom_brs::{Code, Command, Frame};
use mom_wheels::pilot::Point;
use mom_wheels::{
    Chassis, Driver, DriverError, Fault, Motors, Pilot, PilotEnd, Sensors, Watchdog, WheelTime,
};

use crate::Glance;
use crate::status::Status;

/// The most points that wait to be driven to; VIA beyond them is dropped, and counted.
const MOST_POINTS: usize = 64;

/// µs until a driver that did not take a stop is told again.
const STOPS_AGAIN: WheelTime = 50_000;

/// What a robot does where the paper's did otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rules {
    /// Stops the motors when no frame comes for so long.
    pub watchdog: Watchdog,
    /// Whether the motors stop when the base station's connection is lost.
    pub stop_when_lost: bool,
}

impl Rules {
    /// As the paper has it (W9): motors run on when the base station falls silent, or is lost.
    pub const PAPER: Self = Self {
        watchdog: Watchdog::NONE,
        stop_when_lost: false,
    };
}

impl Default for Rules {
    /// Motors stop after 500 ms of silence, and when the connection is lost.
    fn default() -> Self {
        Self {
            watchdog: Watchdog::default(),
            stop_when_lost: true,
        }
    }
}

/// The decisions of a robot's program, without a connection and without a clock.
///
/// It executes each frame at once, and replies where the command asks for it (W1). Motors that nobody stops run until
/// the [watchdog](Rules::watchdog) does, which any frame feeds: on the way to a point too, so that a robot never drives
/// for longer than that without its base station.
pub struct Robot {
    driver: Box<dyn Driver>,
    chassis: Chassis,
    rules: Rules,
    /// When the last frame came.
    fed: WheelTime,
    /// Where it drives by itself.
    points: Vec<Point>,
    pilot: Option<Pilot>,
    /// Whether the motors may be running.
    running: bool,
    /// When the motors are to be stopped again, as the driver has refused it.
    stop_again: Option<WheelTime>,
    /// Whether the watchdog has stopped them, and nothing has moved them since.
    expired: bool,
    gave_up: bool,
    /// What the LEDs were set to.
    leds: u8,
    /// What failed at the driver since the last [`Robot::fault`].
    fault: Option<DriverError>,
}

impl std::fmt::Debug for Robot {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Robot")
            .field("rules", &self.rules)
            .field("running", &self.running)
            .finish_non_exhaustive()
    }
}

impl Robot {
    /// A robot that stands.
    #[must_use]
    pub fn new(driver: Box<dyn Driver>, chassis: Chassis, rules: Rules) -> Self {
        Self {
            driver,
            chassis,
            rules,
            fed: 0,
            points: Vec::new(),
            pilot: None,
            running: false,
            stop_again: None,
            expired: false,
            gave_up: false,
            leds: 0,
            fault: None,
        }
    }

    /// Carries a command out, and gives the reply if there is one.
    pub fn take(&mut self, frame: &Frame, now: WheelTime) -> Option<Frame> {
        self.advance(now);
        self.fed = now;
        match (frame.code(), frame.values()) {
            (Code::NULL, _) => Frame::reply(&Command::NULL, &[]).ok(),
            (Code::STATUS, _) => {
                let status = self.status(now)?;
                Frame::reply(&Command::STATUS, &[status.bits()]).ok()
            }
            (Code::MOTOR, &[left, right]) => {
                self.forget_points();
                // Clamped by the frame to what a motor takes.
                let value = |value: i32| i16::try_from(value).unwrap_or(0);
                self.set_motors(Motors::new(value(left), value(right)), now);
                None
            }
            (Code::LEDS, &[data]) => {
                let leds = (data & 0xff) as u8;
                let set = self.driver.set_leds(leds, now);
                if set.is_ok() {
                    self.leds = leds;
                }
                self.note(set);
                None
            }
            (Code::GOTO, &[x, y]) => {
                self.forget_points();
                self.drive_to(x, y, now);
                None
            }
            (Code::VIA, &[x, y]) => {
                self.drive_to(x, y, now);
                None
            }
            (Code::POSE, _) => self.pose(frame.command(), now),
            _ => None,
        }
    }

    /// The base station is gone.
    pub fn lost(&mut self, now: WheelTime) {
        self.advance(now);
        if self.rules.stop_when_lost {
            self.halt(now);
        }
    }

    /// Stops the motors.
    pub fn halt(&mut self, now: WheelTime) {
        self.forget_points();
        self.set_motors(Motors::STOP, now);
    }

    /// Lets time pass until `now`: the pilot steers, and the watchdog looks.
    pub fn advance(&mut self, now: WheelTime) {
        if let Some(due) = self.stop_again {
            if now >= due {
                self.stop(now);
            }
            return;
        }
        if self.running && self.rules.watchdog.must_stop(self.fed, now) {
            self.halt(now);
            self.expired = true;
            return;
        }
        let Some(pilot) = &mut self.pilot else { return };
        let driven = pilot.drive(&mut *self.driver, now);
        match pilot.end() {
            None => self.note(driven),
            Some(PilotEnd::Arrived) => {
                self.forget_points();
                self.stopped(driven, now);
            }
            Some(PilotEnd::GaveUp(why)) => {
                tracing::info!(%why, "the way to a point is given up");
                self.forget_points();
                self.gave_up = true;
                self.stopped(driven, now);
            }
        }
    }

    /// When [`Robot::advance`] is to be called next; `None` while nothing happens by itself.
    #[must_use]
    pub fn next_wake(&self) -> Option<WheelTime> {
        if self.stop_again.is_some() {
            return self.stop_again;
        }
        let watchdog = self.rules.watchdog.stops_at(self.fed).filter(|_| self.running);
        let pilot = self.pilot.as_ref().and_then(Pilot::next_wake);
        [watchdog, pilot].into_iter().flatten().min()
    }

    /// How it stands now; `None` if its sensors cannot be read.
    pub fn status(&mut self, now: WheelTime) -> Option<Status> {
        let sensors = self.sensors(now)?;
        Some(self.status_of(&sensors))
    }

    /// How it is now, for those who only look; `None` if its sensors cannot be read. No base station drives it, as far as it knows.
    pub fn glance(&mut self, now: WheelTime) -> Option<Glance> {
        let sensors = self.sensors(now)?;
        Some(Glance {
            pose: sensors.pose,
            motors: sensors.motors,
            // An empty battery makes them dark.
            leds: if sensors.battery == 0 { 0 } else { self.leds },
            status: self.status_of(&sensors),
            station: None,
        })
    }

    fn status_of(&self, sensors: &Sensors) -> Status {
        Status {
            expired: self.expired,
            on_its_way: self.pilot.is_some(),
            gave_up: self.gave_up,
            ..Status::of(sensors)
        }
    }

    /// What failed at the driver since this was asked last.
    pub fn fault(&mut self) -> Option<DriverError> {
        self.fault.take()
    }

    fn pose(&mut self, command: &'static Command, now: WheelTime) -> Option<Frame> {
        let pose = self.sensors(now)?.pose?;
        let whole = |value: f64| value.round().clamp(-1e6, 1e6) as i32;
        let heading = whole(pose.heading).rem_euclid(360);
        Frame::reply(command, &[whole(pose.x), whole(pose.y), heading]).ok()
    }

    fn sensors(&mut self, now: WheelTime) -> Option<Sensors> {
        match self.driver.sensors(now) {
            Ok(sensors) => Some(sensors),
            Err(error) => {
                self.fault = Some(error);
                None
            }
        }
    }

    fn set_motors(&mut self, motors: Motors, now: WheelTime) {
        self.expired = false;
        if motors == Motors::STOP {
            return self.stop(now);
        }
        let set = self.driver.set_motors(motors, now);
        (self.running, self.stop_again) = (true, None);
        self.note(set);
    }

    fn stop(&mut self, now: WheelTime) {
        let set = self.driver.set_motors(Motors::STOP, now);
        self.stopped(set, now);
    }

    /// Takes note of what the driver said to a stop. One that it refused is tried again, unless a command moves
    /// the robot before: nothing else would stop it.
    fn stopped(&mut self, set: Result<(), DriverError>, now: WheelTime) {
        self.running = set.is_err();
        self.note(set);
        self.stop_again = self.running.then(|| now.saturating_add(STOPS_AGAIN));
    }

    fn drive_to(&mut self, x: i32, y: i32, now: WheelTime) {
        let reached = self.pilot.as_ref().map_or(0, Pilot::reached);
        self.points.drain(..reached.min(self.points.len()));
        if self.points.len() >= MOST_POINTS {
            tracing::warn!("a point is dropped: {MOST_POINTS} are waiting already");
            return;
        }
        self.points.push(Point::new(f64::from(x), f64::from(y)));
        self.pilot = Some(Pilot::new(self.chassis, self.points.clone(), now));
        (self.running, self.stop_again, self.expired, self.gave_up) = (true, None, false, false);
        self.advance(now);
    }

    fn forget_points(&mut self) {
        self.points.clear();
        self.pilot = None;
    }

    fn note(&mut self, done: Result<(), DriverError>) {
        if let Err(error) = done {
            // An empty battery is told by STATUS, and stops the motors by itself.
            if error.fault() == Fault::Battery {
                self.running = false;
            }
            self.fault = Some(error);
        }
    }
}

#[cfg(test)]
mod tests {
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
        // Whoever stops it: its base station, the loss of that, and the watchdog.
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
}
