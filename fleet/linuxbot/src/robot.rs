//! The robot: what its driver does at each frame, and when nobody says anything.

use mom_brs::{Code, Command, Frame};
use mom_wheels::pilot::Point;
use mom_wheels::{
    Chassis, Driver, DriverError, Fault, Motors, Pilot, PilotEnd, Sensors, Watchdog, WheelTime,
};

use crate::Glance;
use crate::status::Status;

#[cfg(test)]
mod tests;

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
/// the [watchdog](Rules::watchdog) does, which any frame feeds that is understood: on the way to a point too, so that a robot
/// never drives for longer than that without its base station. Its driver is told when that will be, for when this program stands still.
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
    /// Whether the driver may be held to a time.
    held: bool,
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
            held: false,
            stop_again: None,
            expired: false,
            gave_up: false,
            leds: 0,
            fault: None,
        }
    }

    /// Carries a command out, and gives the reply if there is one. It feeds the watchdog.
    pub fn take(&mut self, frame: &Frame, now: WheelTime) -> Option<Frame> {
        self.advance(now);
        self.feed(now);
        self.carry_out(frame, now)
    }

    /// The same for a command of a base station that is [astray](mom_brs::Parser::astray), so that it may have said something else.
    /// It feeds the watchdog only if it moves the robot: a `00` among the bytes of a stop does not.
    pub fn take_doubtful(&mut self, frame: &Frame, now: WheelTime) -> Option<Frame> {
        self.advance(now);
        if matches!(frame.code(), Code::MOTOR | Code::GOTO | Code::VIA) {
            self.feed(now);
        }
        self.carry_out(frame, now)
    }

    /// A command has come: motors that run may do so for as long as the watchdog says from now.
    fn feed(&mut self, now: WheelTime) {
        self.fed = now;
        if self.running && self.stop_again.is_none() && self.pilot.is_none() {
            self.hold(now);
        }
    }

    /// Has the driver stop the motors by itself when the watchdog would, as this program may stand still then.
    fn hold(&mut self, now: WheelTime) {
        let until = self.rules.watchdog.stops_at(self.fed);
        if until.is_some() || self.held {
            let held = self.driver.hold(until.unwrap_or(WheelTime::MAX), now);
            self.held = until.is_some() || held.is_err();
            self.note(held);
        }
    }

    fn carry_out(&mut self, frame: &Frame, now: WheelTime) -> Option<Frame> {
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
        self.held = true;
        let driven = pilot.drive(&mut *self.driver, now);
        match pilot.end() {
            None => self.note(driven),
            Some(PilotEnd::Arrived) => {
                self.forget_points();
                self.stopped(driven, now);
            }
            Some(PilotEnd::GaveUp(why)) => {
                tracing::info!(%why, "the route to a point is given up");
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

    /// Whether its driver has taken that the motors stand: nothing is on its way, and no stop is to be given again.
    #[must_use]
    pub fn stands(&self) -> bool {
        !self.running && self.stop_again.is_none() && self.pilot.is_none()
    }

    /// How it stands now; `None` if its sensors cannot be read.
    pub fn status(&mut self, now: WheelTime) -> Option<Status> {
        let sensors = self.sensors(now)?;
        Some(self.status_of(&sensors, now))
    }

    /// How it is now, for those who only look; `None` if its sensors cannot be read. No base station drives it, as far as it knows.
    pub fn glance(&mut self, now: WheelTime) -> Option<Glance> {
        let sensors = self.sensors(now)?;
        Some(Glance {
            pose: sensors.pose,
            motors: sensors.motors,
            // An empty battery makes them dark.
            leds: if sensors.battery == 0 { 0 } else { self.leds },
            status: self.status_of(&sensors, now),
            station: None,
        })
    }

    fn status_of(&mut self, sensors: &Sensors, now: WheelTime) -> Status {
        // What it cannot tell is not so.
        let parts = self.driver.parts(now).unwrap_or_default();
        Status {
            charging: parts.charging == Some(true),
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
        self.hold(now);
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
