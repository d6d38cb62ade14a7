//! Jogging: the hand moves at a velocity for as long as its owner says so again and again, slows down before it would leave the
//! workspace or what its joints allow, and ends at rest.

use serde::{Deserialize, Serialize};

use crate::motion::{ArmTime, SPEED, TURN_SPEED};
use crate::pose::Pose;
use crate::reach;
use crate::workspace::WORKSPACE;
use mom_device::{DeviceError, ErrorName};

/// ms for which a velocity holds that does not say.
pub const DEFAULT_MS: u32 = 200;
/// ms for which one may hold at most: who is gone must not drive on.
pub const MOST_MS: u32 = 1000;
/// µs between two changes of speed.
pub const TICK: ArmTime = 10_000;
/// mm/s² of the hand.
pub const ACCELERATION: f64 = 600.0;
/// Degrees/s² of spin and of tilt.
pub const TURN_ACCELERATION: f64 = 360.0;

/// A velocity of the hand: mm/s and degrees/s.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Velocity {
    /// mm/s to the right.
    pub x: f64,
    /// mm/s away from the viewer.
    pub y: f64,
    /// mm/s upward.
    pub z: f64,
    /// Degrees/s, counter-clockwise seen from above.
    pub spin: f64,
    /// Degrees/s about the jaw line.
    pub tilt: f64,
}

/// A motion whose velocity is told while it lasts.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Jog {
    wanted: Velocity,
    speed: Velocity,
    until: ArmTime,
}

impl Velocity {
    /// A velocity from its five numbers.
    #[must_use]
    pub const fn of([x, y, z, spin, tilt]: [f64; 5]) -> Self {
        Self { x, y, z, spin, tilt }
    }

    /// Its five numbers.
    #[must_use]
    pub const fn numbers(&self) -> [f64; 5] {
        [self.x, self.y, self.z, self.spin, self.tilt]
    }

    /// mm/s of the hand, whatever the direction.
    #[must_use]
    pub fn linear(&self) -> f64 {
        self.x.hypot(self.y).hypot(self.z)
    }

    /// Checks that the arm can move so fast.
    ///
    /// # Errors
    ///
    /// [`ErrorName::Syntax`] with the speed and the largest one.
    pub(crate) fn check(&self) -> Result<(), DeviceError> {
        let turn = self.spin.abs().max(self.tilt.abs());
        let text = match (self.linear() > SPEED, turn > TURN_SPEED) {
            (true, _) => format!(
                "{:.0} mm/s is too fast, the hand moves at {SPEED} at most",
                self.linear()
            ),
            (_, true) => format!("{turn:.0} degrees/s is too fast, the hand turns at {TURN_SPEED} at most"),
            _ => return Ok(()),
        };
        Err(DeviceError::new(ErrorName::Syntax, text))
    }

    fn is_zero(&self) -> bool {
        *self == Self::default()
    }

    /// The velocity that is as near to `wanted` as it can be after this time.
    fn toward(&self, wanted: &Self, seconds: f64) -> Self {
        let (most, turn) = (ACCELERATION * seconds, TURN_ACCELERATION * seconds);
        let change = Self {
            x: wanted.x - self.x,
            y: wanted.y - self.y,
            z: wanted.z - self.z,
            ..Self::default()
        };
        let part = (most / change.linear()).min(1.0);
        let part = if part.is_nan() { 1.0 } else { part };
        Self {
            x: self.x + change.x * part,
            y: self.y + change.y * part,
            z: self.z + change.z * part,
            spin: self.spin + (wanted.spin - self.spin).clamp(-turn, turn),
            tilt: self.tilt + (wanted.tilt - self.tilt).clamp(-turn, turn),
        }
    }

    /// Where the hand is after this time.
    fn from(&self, pose: &Pose, seconds: f64) -> Pose {
        let moved = Pose {
            x: pose.x + self.x * seconds,
            y: pose.y + self.y * seconds,
            z: pose.z + self.z * seconds,
            spin: pose.spin + self.spin * seconds,
            tilt: pose.tilt + self.tilt * seconds,
        };
        // Rounding must not take it out.
        Pose {
            x: moved.x.clamp(*WORKSPACE.x.start(), *WORKSPACE.x.end()),
            y: moved.y.clamp(*WORKSPACE.y.start(), *WORKSPACE.y.end()),
            z: moved.z.clamp(*WORKSPACE.z.start(), *WORKSPACE.z.end()),
            spin: moved.spin.clamp(*WORKSPACE.spin.start(), *WORKSPACE.spin.end()),
            tilt: moved.tilt.clamp(*WORKSPACE.tilt.start(), *WORKSPACE.tilt.end()),
        }
    }

    /// As much of it as leaves room to brake before the workspace's edge.
    fn within_workspace(&self, pose: &Pose, seconds: f64) -> Self {
        let brake = |speed: f64, at: f64, range: &std::ops::RangeInclusive<f64>, acceleration: f64| {
            let edge = if speed > 0.0 {
                range.end() - at
            } else {
                at - range.start()
            };
            // Half the acceleration, since other directions may brake as well.
            let room = (edge - speed.abs() * seconds).max(0.0);
            let most = (acceleration * room).sqrt();
            speed.clamp(-most, most)
        };
        Self {
            x: brake(self.x, pose.x, &WORKSPACE.x, ACCELERATION),
            y: brake(self.y, pose.y, &WORKSPACE.y, ACCELERATION),
            z: brake(self.z, pose.z, &WORKSPACE.z, ACCELERATION),
            spin: brake(self.spin, pose.spin, &WORKSPACE.spin, TURN_ACCELERATION),
            tilt: brake(self.tilt, pose.tilt, &WORKSPACE.tilt, TURN_ACCELERATION),
        }
    }

    /// The time in which it comes to rest, s.
    fn braking_time(&self) -> f64 {
        let turn = self.spin.abs().max(self.tilt.abs());
        (self.linear() / ACCELERATION).max(turn / TURN_ACCELERATION)
    }
}

impl Jog {
    /// Goes on from `before`, if the hand is jogged already.
    pub(crate) fn begin(wanted: Velocity, until: ArmTime, before: Option<&Jog>) -> Self {
        Self {
            wanted,
            speed: before.map(|jog| jog.speed).unwrap_or_default(),
            until,
        }
    }

    /// Where the hand is a [`TICK`] later; none when it is at rest and the time is over.
    pub(crate) fn next(&mut self, from: &Pose, now: ArmTime) -> Option<Pose> {
        let seconds = TICK as f64 / 1e6;
        let mut wanted = match now < self.until {
            true => self.wanted,
            false if self.speed.is_zero() => return None,
            false => Velocity::default(),
        };
        // Where the joints end is not known before it is tried, so it is tried as far ahead as braking takes.
        let fastest = self.speed.toward(&wanted, seconds);
        let ahead = fastest.from(from, seconds + fastest.braking_time());
        if reach::check_leg(from, &ahead).is_err() {
            wanted = Velocity::default();
        }
        let speed = self
            .speed
            .toward(&wanted, seconds)
            .within_workspace(from, seconds);
        let next = speed.from(from, seconds);
        match reach::check(&next) {
            Ok(()) => {
                self.speed = speed;
                Some(next)
            }
            Err(_) => {
                self.speed = Velocity::default();
                Some(*from)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn velocity() -> impl Strategy<Value = Velocity> {
        let (way, turn) = (-86.0..86.0, -90.0..90.0);
        (way.clone(), way.clone(), way, turn.clone(), turn).prop_map(|(x, y, z, spin, tilt)| Velocity {
            x,
            y,
            z,
            spin,
            tilt,
        })
    }

    proptest! {
        /// However it is driven: inside, reachable, no faster than it may, and at rest in the end.
        #[test]
        fn a_jog_stays_inside_and_ends_at_rest(wanted in proptest::collection::vec((velocity(), 1_i64..80), 1..12)) {
            let (mut pose, mut now, mut jog) = (crate::pose::HOME, 0, None::<Jog>);
            for (velocity, ticks) in wanted {
                let mut next = Jog::begin(velocity, now + ticks * TICK, jog.as_ref());
                for _ in 0..ticks {
                    let before = next.speed;
                    let moved = next.next(&pose, now).unwrap();
                    now += TICK;
                    prop_assert!(moved.distance(&pose) <= SPEED * 0.01 + 1e-9);
                    prop_assert!(WORKSPACE.check(&moved).is_ok() && reach::check(&moved).is_ok(), "{:?}", moved);
                    // Speeding up is bounded; the edge may stop it faster.
                    prop_assert!(next.speed.linear() - before.linear() <= ACCELERATION * 0.01 + 1e-9);
                    pose = moved;
                }
                jog = Some(next);
            }
            let mut jog = jog.unwrap();
            let mut ticks = 0;
            while let Some(moved) = jog.next(&pose, now) {
                (pose, now, ticks) = (moved, now + TICK, ticks + 1);
                prop_assert!(ticks < 40, "it brakes within 0.4 s");
            }
            prop_assert!(WORKSPACE.check(&pose).is_ok() && reach::check(&pose).is_ok());
        }
    }

    #[test]
    fn it_slows_down_before_the_edge() {
        let mut pose = Pose::new(200.0, 0.0, 300.0, 0.0, 0.0);
        let mut jog = Jog::begin(
            Velocity {
                x: 150.0,
                ..Velocity::default()
            },
            ArmTime::MAX,
            None,
        );
        let mut speeds = Vec::new();
        for tick in 0..300 {
            let next = jog.next(&pose, tick * TICK).unwrap();
            speeds.push((next.x - pose.x) / 0.01);
            pose = next;
        }
        let fastest = speeds.iter().copied().fold(0.0, f64::max);
        assert!((149.0..=150.0 + 1e-6).contains(&fastest), "{fastest}");
        assert!((299.0..=300.0).contains(&pose.x), "{}", pose.x);
        // No step of the braking is harder than the motors allow.
        let hardest = speeds
            .windows(2)
            .map(|pair| pair[0] - pair[1])
            .fold(0.0, f64::max);
        assert!(hardest <= ACCELERATION * 0.011, "{hardest}");
    }
}
