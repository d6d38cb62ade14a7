//! The motors of the robot: simulated ones, and the place of the real ones.

use std::time::{Duration, Instant};

/// mm/s of `drive`.
const SPEED: f64 = 200.0;
/// degrees/s of `turn`.
const RATE: f64 = 60.0;
/// After so long the motors stand by themselves when they hear nothing: no program can halt them when its computer fails.
const DEADLINE: Duration = Duration::from_millis(300);

/// Motors that take what they are told at once. Real ones have the same functions.
pub(crate) struct Motors {
    x: f64,
    y: f64,
    heading: f64,
    speed: f64,
    rate: f64,
    since: Instant,
    /// When they were told something last.
    heard: Instant,
    /// When what it was told last is done.
    until: Option<Instant>,
}

impl Motors {
    /// The motors at `MOTORS`, such as /dev/ttyUSB0; simulated ones without it.
    pub(crate) fn find() -> anyhow::Result<Motors> {
        if let Ok(port) = std::env::var("MOTORS") {
            anyhow::bail!("no driver for the motors at {port} yet: write it in src/driver.rs");
        }
        Ok(Motors {
            x: 0.0,
            y: 0.0,
            heading: 0.0,
            speed: 0.0,
            rate: 0.0,
            since: Instant::now(),
            heard: Instant::now(),
            until: None,
        })
    }

    /// Goes on at so many mm/s and degrees/s.
    pub(crate) fn set_speed(&mut self, speed: f64, rate: f64) {
        let now = Instant::now();
        (self.x, self.y, self.heading) = self.at(now);
        (self.speed, self.rate, self.since, self.until) = (speed, rate, now, None);
        self.heard = now;
    }

    /// Goes on as it does, if it has not stood by itself.
    pub(crate) fn keep_alive(&mut self) {
        let now = Instant::now();
        if now > self.heard + DEADLINE {
            (self.x, self.y, self.heading) = self.at(now);
            (self.speed, self.rate, self.since) = (0.0, 0.0, now);
        }
        self.heard = now;
    }

    /// Stands, at once, whatever it does.
    pub(crate) fn brake(&mut self) {
        self.set_speed(0.0, 0.0);
    }

    /// Where it is: mm, mm, degrees; whole ones, since what is based on a state is refused once the position is another.
    pub(crate) fn pose(&self) -> (i32, i32, i32) {
        let (x, y, heading) = self.at(Instant::now());
        (
            x.round() as i32,
            y.round() as i32,
            (heading.round() as i32).rem_euclid(360),
        )
    }

    /// What is left, in %.
    pub(crate) fn battery(&self) -> i32 {
        100
    }

    /// Whether its emergency stop is pressed: of these motors, whether there is a file `estop` here.
    pub(crate) fn estop(&self) -> bool {
        std::path::Path::new("estop").exists()
    }

    /// Drives so many mm.
    pub(crate) fn drive(&mut self, way: f64) {
        self.go_on(SPEED.copysign(way), 0.0, way.abs() / SPEED);
    }

    /// Turns by so many degrees.
    pub(crate) fn turn(&mut self, angle: f64) {
        self.go_on(0.0, RATE.copysign(angle), angle.abs() / RATE);
    }

    /// Whether it has come to where it was told to drive; it stands there.
    pub(crate) fn is_there(&mut self) -> bool {
        let is_there = self.until.is_none_or(|until| until <= Instant::now());
        if is_there {
            self.brake();
        }
        is_there
    }

    fn go_on(&mut self, speed: f64, rate: f64, seconds: f64) {
        self.set_speed(speed, rate);
        self.until = Some(self.since + Duration::from_secs_f64(seconds));
    }

    fn at(&self, now: Instant) -> (f64, f64, f64) {
        let now = self.until.map_or(now, |until| until.min(now));
        let now = now.min(self.heard + DEADLINE);
        let seconds = now.saturating_duration_since(self.since).as_secs_f64();
        let middle = (self.heading + self.rate * seconds / 2.0).to_radians();
        let way = self.speed * seconds;
        (
            self.x + way * middle.cos(),
            self.y + way * middle.sin(),
            self.heading + self.rate * seconds,
        )
    }
}
