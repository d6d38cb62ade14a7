//! What is left in the battery, as a function of time.

use super::motion::{Motion, Speeds};
use crate::{Chassis, Power, WheelTime};

/// The charge at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Charge {
    /// When it was known.
    pub(super) since: WheelTime,
    /// J.
    pub(super) joules: f64,
    /// J in a full battery.
    pub(super) full: f64,
}

/// What draws from the battery from a time on.
#[derive(Debug, Clone, Copy)]
pub(super) enum Load<'a> {
    /// So many W; what is below 0 fills the battery.
    Steady(f64),
    /// So many W, and the wheels of a motion that began at a time.
    Moving {
        watts: f64,
        /// J for each mm that a rim travels.
        friction: f64,
        motion: &'a Motion,
        began: WheelTime,
        wheel_base: f64,
    },
}

impl Charge {
    /// So many percent of a full battery; more than 100 are 100.
    pub(super) fn of(percent: u8, power: &Power, since: WheelTime) -> Self {
        let full = power.capacity;
        let joules = full * f64::from(percent.min(100)) / 100.0;
        Self { since, joules, full }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.joules <= 0.0
    }

    /// The same at a later time, which is not after [`Self::empties`].
    pub(super) fn at(&self, load: &Load<'_>, now: WheelTime) -> Self {
        let used = load.energy(self.since, now);
        if self.is_empty() && used >= 0.0 {
            return Self { since: now, ..*self };
        }
        // Rounding must not empty it a µs before the time that was announced.
        let joules = (self.joules - used).clamp(f64::MIN_POSITIVE, self.full);
        Self {
            since: now,
            joules,
            ..*self
        }
    }

    /// In percent, rounded up, so that 0 is an empty battery.
    pub(super) fn percent(&self, power: &Power) -> u8 {
        (self.joules / power.capacity * 100.0).ceil().clamp(0.0, 100.0) as u8
    }

    /// When it will be empty, if ever.
    pub(super) fn empties(&self, load: &Load<'_>) -> Option<WheelTime> {
        let even = load.even_from(self.since);
        let before = load.energy(self.since, even);
        if before >= self.joules {
            return Some(self.narrow(load, even));
        }
        let watts = load.even_watts();
        let seconds = (self.joules - before) / watts;
        let time = even.saturating_add((seconds * 1e6).ceil() as WheelTime);
        // What lasts for the rest of time never ends.
        (watts > 0.0 && time < WheelTime::MAX).then_some(time)
    }

    /// The first µs at which it is empty, which is not later than `until`.
    fn narrow(&self, load: &Load<'_>, until: WheelTime) -> WheelTime {
        let (mut left, mut empty) = (self.since, until);
        while empty - left > 1 {
            let middle = left + (empty - left) / 2;
            if load.energy(self.since, middle) >= self.joules {
                empty = middle;
            } else {
                left = middle;
            }
        }
        empty
    }
}

impl Load<'_> {
    /// J between two times.
    fn energy(&self, since: WheelTime, until: WheelTime) -> f64 {
        match *self {
            Self::Steady(watts) => watts * seconds(since, until),
            Self::Moving {
                watts,
                friction,
                motion,
                began,
                ..
            } => {
                let travel = motion.travel(seconds(began, until)) - motion.travel(seconds(began, since));
                watts * seconds(since, until) + friction * travel
            }
        }
    }

    /// From when on, not before `since`, it is the same at all times.
    fn even_from(&self, since: WheelTime) -> WheelTime {
        match *self {
            Self::Steady(_) => since,
            Self::Moving { motion, began, .. } => {
                let settled = began.saturating_add((motion.settles() * 1e6).ceil() as WheelTime);
                settled.max(since)
            }
        }
    }

    /// W, from then on.
    fn even_watts(&self) -> f64 {
        match *self {
            Self::Steady(watts) => watts,
            Self::Moving {
                watts,
                friction,
                motion,
                wheel_base,
                ..
            } => watts + friction * rims(motion.targets(), wheel_base),
        }
    }
}

/// J for each mm that a rim travels.
pub(super) fn friction(power: &Power, chassis: &Chassis) -> f64 {
    power.wheel / chassis.full_speed
}

/// mm/s of both rims together.
pub(super) fn rims(speeds: Speeds, wheel_base: f64) -> f64 {
    let [left, right] = speeds.wheels(wheel_base);
    left.abs() + right.abs()
}

/// Seconds between two times; 0 if the second is not later.
pub(super) fn seconds(since: WheelTime, until: WheelTime) -> f64 {
    until.saturating_sub(since).max(0) as f64 / 1e6
}
