//! The robot as a machine: what statements do to its driver.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use mom_client::{Age, Card, Map};
use mom_device::{DeviceError, DeviceTime, ErrorName, Machine, Script, Word, Words};
use mom_wheels::pilot::{HOLD, PERIOD, Point};
use mom_wheels::{Chassis, Driver, DriverError, Fault, GiveUp, Motors, Parts, Pilot, PilotEnd, Sensors};

use crate::action::card_of;
use crate::{Action, Follower};

#[cfg(test)]
mod tests;

/// µs that it may take to come to its rest.
const SETTLES: DeviceTime = 500_000;
/// µs until a driver that did not take a stop is told again.
const STOPS_AGAIN: DeviceTime = 50_000;
/// µs until a robot at rest looks what is left in its battery.
const LOOKS_AGAIN: DeviceTime = 10_000_000;
/// µs between two times that the driver is given while motors run as a statement says.
const HOLDS_AGAIN: DeviceTime = 100_000;

/// A robot on its driver.
///
/// What fails by itself is fetched by [`Rover::take_failure`]; then all commands are to be ended with it.
///
/// Motors never run for longer than [`HOLD`] without it: their driver is told until when they may, again and again. A stop that the
/// driver refuses is given again until it is taken, and until then the robot moves, as far as it knows.
pub struct Rover {
    driver: Arc<Mutex<Box<dyn Driver>>>,
    chassis: Chassis,
    /// Its number, if it has one.
    unit: Option<u32>,
    now: DeviceTime,
    /// What it sensed last.
    sensors: Option<Sensors>,
    /// What it sensed beside that, as far as it has such parts.
    parts: Parts,
    /// Whether it ever told of a charge: what tells of none has no battery that is empty.
    has_gauge: bool,
    /// What the driver may be carrying out: what it was told last, but for a stop that it has not taken.
    motors: Motors,
    /// Until when it does so by itself.
    held: DeviceTime,
    /// When it is told to stop again, as it has not taken that.
    stop_again: Option<DeviceTime>,
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
    /// A robot that is told to stand, whatever its motors did before.
    #[must_use]
    pub fn new(driver: Box<dyn Driver>, chassis: Chassis, unit: Option<u32>) -> Self {
        let mut rover = Self::on(Arc::new(Mutex::new(driver)), chassis, unit);
        rover.stop();
        rover.advance(0);
        rover
    }

    fn on(driver: Arc<Mutex<Box<dyn Driver>>>, chassis: Chassis, unit: Option<u32>) -> Self {
        Self {
            driver,
            chassis,
            unit,
            now: 0,
            sensors: None,
            parts: Parts::default(),
            has_gauge: false,
            motors: Motors::STOP,
            held: 0,
            stop_again: None,
            leds: 0,
            doing: Doing::Nothing,
            settles: 0,
            failure: None,
        }
    }

    /// The same robot without what it was doing, for another channel: it is on the same driver, so this one has to be left alone.
    #[must_use]
    pub fn again(&self) -> Self {
        let mut rover = Self::on(Arc::clone(&self.driver), self.chassis, self.unit);
        (rover.now, rover.sensors, rover.parts) = (self.now, self.sensors, self.parts);
        rover.has_gauge = self.has_gauge;
        (rover.motors, rover.held, rover.stop_again) = (self.motors, self.held, self.stop_again);
        (rover.leds, rover.settles) = (self.leds, self.settles);
        rover
    }

    /// Whether its driver has taken that the motors stand.
    #[must_use]
    pub fn stands(&self) -> bool {
        self.motors == Motors::STOP && self.stop_again.is_none()
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
        self.stop();
    }

    fn driver(&self) -> MutexGuard<'_, Box<dyn Driver>> {
        // What a thread left behind that panicked is a driver all the same, and has to be stopped.
        self.driver.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells the driver to stop, also one that does not move. What it has not taken is not done: it is told again.
    fn stop(&mut self) {
        let told = self.driver().set_motors(Motors::STOP, self.now);
        match told {
            // An empty battery stops the motors by itself.
            Err(error) if error.fault() != Fault::Battery => {
                if self.stop_again.is_none() {
                    self.driver_failed(&error);
                }
                self.stop_again = Some(self.now.saturating_add(STOPS_AGAIN));
            }
            _ => {
                if !self.stands() {
                    self.settles = self.now.saturating_add(SETTLES);
                }
                (self.motors, self.stop_again) = (Motors::STOP, None);
            }
        }
    }

    /// Sets the motors, until then at most; the driver keeps them for [`HOLD`] unless it is told again. What fails ends with a stop.
    fn drive(&mut self, motors: Motors, until: DeviceTime) {
        if motors == Motors::STOP {
            return self.stop();
        }
        let held = until.min(self.now.saturating_add(HOLD));
        let mut driver = self.driver();
        let told = driver.hold(held, self.now);
        let told = told.and_then(|()| driver.set_motors(motors, self.now));
        drop(driver);
        // It may have taken what it refused.
        (self.motors, self.held) = (motors, held);
        if let Err(error) = told {
            self.driver_failed(&error);
            self.stop();
        }
    }

    /// Has the driver keep the motors on, before it stops them by itself; they are to run until then.
    fn hold(&mut self, until: DeviceTime) {
        let held = until.min(self.now.saturating_add(HOLD));
        let told = self.driver().hold(held, self.now);
        match told {
            Ok(()) => self.held = held,
            Err(error) => {
                self.driver_failed(&error);
                self.stop();
            }
        }
    }

    /// When the driver is given a later time; none if what it has is the end, or nothing is to run for so long.
    fn holds_again(&self) -> Option<DeviceTime> {
        let Doing::Motors(until) = self.doing else {
            return None;
        };
        let again = self.held.saturating_sub(HOLD).saturating_add(HOLDS_AGAIN);
        (self.motors != Motors::STOP && self.held < until).then_some(again)
    }

    /// Whether the driver has stopped motors that should have run on, because nobody told it in time that they do.
    fn has_lapsed(&self) -> bool {
        let ended = matches!(self.doing, Doing::Motors(until) if self.held >= until);
        // One that has not taken its last stop is told that again, and has failed by that already.
        let is_stopping = self.stop_again.is_some();
        self.motors != Motors::STOP && self.now > self.held && !ended && !is_stopping
    }

    fn driver_failed(&mut self, error: &DriverError) {
        self.doing = Doing::Nothing;
        let name = match error.fault() {
            Fault::Battery => ErrorName::Battery,
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
            Doing::Motors(_) if self.has_gauge && sensors.battery == 0 => {
                let text = "the robot stands: its battery is empty";
                self.fail(DeviceError::new(ErrorName::Battery, text));
            }
            Doing::Motors(_) => {}
            Doing::Drives(pilot) => {
                let motors = pilot.steer(sensors, now);
                let end = pilot.end();
                if let Some(motors) = motors {
                    self.drive(motors, DeviceTime::MAX);
                }
                match end {
                    None => {}
                    // It is there when it stands there.
                    Some(PilotEnd::Arrived) if !self.has_failed() => self.doing = Doing::Done(now),
                    Some(PilotEnd::Arrived) => {}
                    Some(PilotEnd::GaveUp(why)) => {
                        let (name, advice) = match why {
                            GiveUp::Battery { .. } => (ErrorName::Battery, ""),
                            _ => (ErrorName::Obstacle, "; drive it away from there with `motor`"),
                        };
                        let text = format!("the robot gave up its route: {why}{advice}");
                        self.fail(DeviceError::new(name, text));
                    }
                }
            }
            Doing::Follows { follower, due } => {
                let hindered = match sensors {
                    Sensors { battery: 0, .. } => Some((ErrorName::Battery, "the battery is empty")),
                    Sensors { pose: None, .. } => Some((ErrorName::Obstacle, "it does not know where it is")),
                    Sensors { switches: 1.., .. } => Some((ErrorName::Obstacle, "something is in its way")),
                    _ => None,
                };
                if let Some((name, why)) = hindered {
                    let text = format!("the robot stopped following {}: {why}", follower.leader());
                    return self.fail(DeviceError::new(name, text));
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
                if motors != self.motors || motors != Motors::STOP {
                    self.drive(motors, DeviceTime::MAX);
                }
            }
        }
    }
}

/// The program was not there for so long.
fn stood_still(micros: DeviceTime) -> DeviceError {
    let text = format!(
        "the robot was halted: its program stood still for {} ms, and motors run for {} ms without it",
        micros / 1000,
        HOLD / 1000
    );
    DeviceError::new(ErrorName::Halted, text)
}

fn whole(value: f64) -> i32 {
    value.round().clamp(-1e6, 1e6) as i32
}

impl Machine for Rover {
    type Action = Action;

    const NAME: &str = "the robot";
    const VERBS: &[&str] = Action::VERBS;
    const PERIOD: DeviceTime = 100_000;
    const PATIENCE: DeviceTime = HOLD;
    // It tells whole mm and degrees.
    const TOLERANCE: f64 = 2.0;

    fn card(&self) -> Card {
        card_of("A robot on two wheels").verbs(Action::verbs())
    }

    fn read(verb: Word<'_>, words: &mut Words<'_>) -> Option<Result<Action, DeviceError>> {
        Action::read(verb, words)
    }

    fn is_moving(&self) -> bool {
        !self.stands() || self.now < self.settles
    }

    fn is_reached(&self) -> bool {
        self.sensors.is_some()
    }

    fn plan(&mut self, script: &Script<Action>) -> Result<(), DeviceError> {
        let count = script.statements().len();
        for (action, number) in script.actions() {
            if matches!(action, Action::Follow { .. })
                && usize::try_from(number).is_ok_and(|number| number < count)
            {
                let text = "`follow` must be the last command of a script: it runs until the next command";
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
        if let Some(error) = self.failure.take() {
            return Err(error);
        }
        if self.stop_again.is_some() {
            let text = "the driver did not accept the last stop, so the robot starts nothing";
            return Err(DeviceError::new(ErrorName::Link, text));
        }
        self.doing = Doing::Nothing;
        let doing = match action {
            Action::Motor { left, right, ms } => {
                let value = |value: i32| i16::try_from(value).unwrap_or(0);
                let until = now.saturating_add(DeviceTime::from(*ms) * 1000);
                self.drive(Motors::new(value(*left), value(*right)), until);
                Doing::Motors(until)
            }
            Action::Leds(data) => {
                let set = self.driver().set_leds((data & 0xff) as u8, now);
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
            None => {
                self.doing = doing;
                Ok(())
            }
        }
    }

    fn done_at(&self) -> Option<DeviceTime> {
        match self.doing {
            Doing::Done(at) => Some(at),
            // Not before the driver has its end: it may let go before.
            Doing::Motors(until) => (self.motors == Motors::STOP || self.held >= until).then_some(until),
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
        let before = std::mem::replace(&mut self.now, now);
        if self.stop_again.is_some_and(|due| now >= due) {
            self.stop();
        }
        if self.has_lapsed() {
            self.fail(stood_still(now.saturating_sub(before)));
        } else if let (true, Doing::Motors(until)) =
            (self.holds_again().is_some_and(|due| now >= due), &self.doing)
        {
            self.hold(*until);
        }
        let sensed = {
            let mut driver = self.driver();
            driver
                .sensors(now)
                .and_then(|sensors| Ok((sensors, driver.parts(now)?)))
        };
        match sensed {
            Ok((sensors, parts)) => {
                (self.sensors, self.parts) = (Some(sensors), parts);
                self.has_gauge |= sensors.battery > 0;
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
        let settles = (self.stands() && self.now < self.settles).then_some(self.settles);
        // It may tell something again.
        let looks = if self.sensors.is_none() {
            PERIOD
        } else {
            LOOKS_AGAIN
        };
        let looks = Some(self.now.saturating_add(looks));
        [doing, settles, self.stop_again, self.holds_again(), looks]
            .into_iter()
            .flatten()
            .min()
    }

    /// `{x, y, heading}` in mm, mm and degrees, if it knows.
    fn position(&self) -> Map {
        self.pose().unwrap_or_default()
    }

    /// `{unit?, linked, leds, halting?, battery?, switches?, charging?, light?, leader?, lost-leader?, gap?}`: whether
    /// it was told to stop, and its driver has not taken that; percent, a mask of bits, whether the battery is being
    /// charged, percent; whom it follows, whether it stands because it does not know where that is, and mm along the
    /// trail between them.
    fn report(&self) -> Map {
        let mut map = match self.unit {
            Some(unit) => Map::new().with("unit", i64::from(unit)),
            None => Map::new(),
        };
        map.set("linked", self.sensors.is_some());
        map.set("leds", self.leds);
        if self.stop_again.is_some() {
            map.set("halting", true);
        }
        if let Some(sensors) = self.sensors {
            map.set("battery", i64::from(sensors.battery));
            map.set("switches", i64::from(sensors.switches));
            if let Some(charging) = self.parts.charging {
                map.set("charging", charging);
            }
            if let Some(light) = self.parts.light {
                map.set("light", i64::from(light));
            }
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
