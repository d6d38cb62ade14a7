//! How the hand and the jaws move: straight, at 150 mm/s (M49), as a pure function of time.

use crate::pose::{Pose, mix};

/// A time or a duration in int microseconds.
pub type ArmTime = i64;

/// mm/s of the hand (M49).
pub const SPEED: f64 = 150.0;
/// Degrees/s of spin and of tilt.
pub const TURN_SPEED: f64 = 90.0;
/// mm/s by which the jaws' opening changes.
pub const JAW_SPEED: f64 = 200.0;
/// mm between the jaws when they are open.
pub const MAX_OPENING: f64 = 80.0;

/// The hand's pose and the jaws' opening: all that moves by itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Posture {
    /// Where the hand is.
    pub pose: Pose,
    /// mm between the jaws, 0 to [`MAX_OPENING`].
    pub opening: f64,
}

impl Posture {
    /// The posture at `fraction` (0 to 1) of the way to `other`.
    #[must_use]
    pub fn between(&self, other: &Self, fraction: f64) -> Self {
        Self {
            pose: self.pose.between(&other.pose, fraction),
            opening: mix(self.opening, other.opening, fraction),
        }
    }

    /// How long the way to `other` takes at full speed, rounded up so that no speed is exceeded.
    #[must_use]
    pub fn duration(&self, other: &Self) -> ArmTime {
        let seconds = (self.pose.distance(&other.pose) / SPEED)
            .max(self.pose.turn(&other.pose) / TURN_SPEED)
            .max((other.opening - self.opening).abs() / JAW_SPEED);
        (seconds * 1e6).ceil() as ArmTime
    }
}

/// A straight motion from one posture to another, of constant speed.
///
/// The slowest of position, angles and jaws sets the duration; the others keep step with it.
///
/// ```
/// use mom_arm::{Pose, motion::{Leg, Posture}};
///
/// let from = Posture { pose: Pose::new(0.0, 0.0, 300.0, 0.0, 0.0), opening: 80.0 };
/// let to = Posture { pose: Pose { x: 75.0, ..from.pose }, ..from };
/// let leg = Leg::new(from, to);
/// assert_eq!(leg.duration(), 500_000);
/// assert_eq!(leg.at(100_000).pose.x, 15.0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leg {
    from: Posture,
    to: Posture,
    duration: ArmTime,
}

impl Leg {
    /// The leg between two postures.
    #[must_use]
    pub fn new(from: Posture, to: Posture) -> Self {
        Self {
            from,
            to,
            duration: from.duration(&to),
        }
    }

    /// One that takes just so long, which is at least what it needs.
    pub(crate) const fn lasting(from: Posture, to: Posture, duration: ArmTime) -> Self {
        Self { from, to, duration }
    }

    /// µs from its beginning to its end.
    #[must_use]
    pub const fn duration(&self) -> ArmTime {
        self.duration
    }

    /// The posture so many µs after the beginning; before it the first, after the end the last.
    #[must_use]
    pub fn at(&self, elapsed: ArmTime) -> Posture {
        if elapsed >= self.duration {
            return self.to;
        }
        self.from
            .between(&self.to, elapsed.max(0) as f64 / self.duration as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HOME: Posture = Posture {
        pose: Pose::new(0.0, 0.0, 300.0, 0.0, 0.0),
        opening: MAX_OPENING,
    };

    #[test]
    fn the_slowest_sets_the_duration() {
        let pose = HOME.pose;
        for (to, want) in [
            (HOME, 0),
            (
                Posture {
                    pose: Pose { x: 150.0, ..pose },
                    ..HOME
                },
                1_000_000,
            ),
            (
                Posture {
                    pose: Pose {
                        x: 150.0,
                        spin: 180.0,
                        ..pose
                    },
                    ..HOME
                },
                2_000_000,
            ),
            (
                Posture {
                    pose: Pose {
                        x: 1.0,
                        tilt: -45.0,
                        ..pose
                    },
                    ..HOME
                },
                500_000,
            ),
            (Posture { opening: 0.0, ..HOME }, 400_000),
        ] {
            assert_eq!(Leg::new(HOME, to).duration(), want, "{to:?}");
        }
    }

    #[test]
    fn ends_exactly_and_stays_there() {
        let to = Posture {
            pose: Pose::new(99.9, -12.3, 7.7, 33.3, 11.1),
            opening: 0.1,
        };
        let leg = Leg::new(HOME, to);
        for (elapsed, want) in [(-5, HOME), (0, HOME), (leg.duration(), to), (ArmTime::MAX, to)] {
            assert_eq!(leg.at(elapsed), want, "{elapsed}");
        }
    }

    proptest! {
        #[test]
        fn never_faster_than_the_limits(
            x in -300.0..300.0, z in 0.0..450.0, spin in -180.0..180.0,
            opening in 0.0..MAX_OPENING, early in 0..5_000_000_i64, span in 1..2_000_000_i64,
        ) {
            let leg = Leg::new(HOME, Posture { pose: Pose::new(x, -x, z, spin, 0.0), opening });
            let (a, b) = (leg.at(early), leg.at(early + span));
            let seconds = span as f64 / 1e6;
            prop_assert!(a.pose.distance(&b.pose) <= SPEED * seconds + 1e-9);
            prop_assert!(a.pose.turn(&b.pose) <= TURN_SPEED * seconds + 1e-9);
            prop_assert!((a.opening - b.opening).abs() <= JAW_SPEED * seconds + 1e-9);
        }
    }
}
