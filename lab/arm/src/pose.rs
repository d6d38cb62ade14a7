//! The pose of the hand: a position and two angles in the table's frame (M50).

use mom_client::{Map, Value};
use serde::{Deserialize, Serialize};

/// A vector in the table's frame: x, y, z in mm, or without a unit for a direction.
pub type Xyz = [f64; 3];

/// A pose of the hand, five degrees of freedom (M50): the point between the fingertips in mm, and
/// two angles in degrees.
///
/// The jaw line, along which the jaws open and close, always stays parallel to the table. `spin`
/// turns it about the vertical, counter-clockwise seen from above; at 0 it lies along x. `tilt`
/// leans the hand about the jaw line; at 0 the fingers point straight down.
///
/// ```
/// use mom_arm::Pose;
///
/// let home = Pose::new(0.0, 0.0, 300.0, 0.0, 0.0);
/// let there = Pose { x: 30.0, y: 40.0, ..home };
/// assert_eq!(home.distance(&there), 50.0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// mm to the right of the table's middle.
    pub x: f64,
    /// mm away from the viewer, from the table's middle.
    pub y: f64,
    /// mm above the table.
    pub z: f64,
    /// Degrees of the jaw line about the vertical.
    pub spin: f64,
    /// Degrees of the hand from the vertical, about the jaw line.
    pub tilt: f64,
}

/// The hand's own axes, as unit vectors in the table's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandAxes {
    /// Along the jaw line; always level.
    pub jaw: Xyz,
    /// Across the jaw line, level while the hand is not tilted.
    pub across: Xyz,
    /// The way the fingers point.
    pub approach: Xyz,
}

impl From<Pose> for Value {
    /// `{x, y, z, spin, tilt}`.
    fn from(pose: Pose) -> Value {
        let Pose { x, y, z, spin, tilt } = pose;
        let numbers = [("x", x), ("y", y), ("z", z), ("spin", spin), ("tilt", tilt)];
        let map = numbers.into_iter().fold(Map::new(), |map, (name, number)| {
            map.with(name, Value::Double(number))
        });
        map.into()
    }
}

/// The initial pose of the hand, and the target of `home`.
pub const HOME: Pose = Pose::new(0.0, 0.0, 300.0, 0.0, 0.0);

impl Pose {
    /// A pose from its five numbers: mm, mm, mm, degrees, degrees.
    #[must_use]
    pub const fn new(x: f64, y: f64, z: f64, spin: f64, tilt: f64) -> Self {
        Self { x, y, z, spin, tilt }
    }

    /// The point between the fingertips.
    #[must_use]
    pub const fn position(&self) -> Xyz {
        [self.x, self.y, self.z]
    }

    /// mm between the two points; the angles do not count.
    #[must_use]
    pub fn distance(&self, other: &Self) -> f64 {
        self.horizontal_distance(other).hypot(other.z - self.z)
    }

    /// mm between the two points, seen from above.
    #[must_use]
    pub fn horizontal_distance(&self, other: &Self) -> f64 {
        (other.x - self.x).hypot(other.y - self.y)
    }

    /// Degrees of the larger of the two turns, of spin and of tilt.
    #[must_use]
    pub fn turn(&self, other: &Self) -> f64 {
        (other.spin - self.spin).abs().max((other.tilt - self.tilt).abs())
    }

    /// The pose at `fraction` (0 to 1) of the straight way to `other`.
    ///
    /// Spin goes through 0 and never through ±180: the wrist's cables do not let it turn round.
    #[must_use]
    pub fn between(&self, other: &Self, fraction: f64) -> Self {
        Self {
            x: mix(self.x, other.x, fraction),
            y: mix(self.y, other.y, fraction),
            z: mix(self.z, other.z, fraction),
            spin: mix(self.spin, other.spin, fraction),
            tilt: mix(self.tilt, other.tilt, fraction),
        }
    }

    /// The pose that differs from this one by so much in each of its numbers.
    #[must_use]
    pub fn plus(&self, by: &Self) -> Self {
        Self {
            x: self.x + by.x,
            y: self.y + by.y,
            z: self.z + by.z,
            spin: self.spin + by.spin,
            tilt: self.tilt + by.tilt,
        }
    }

    /// The hand's axes in this pose.
    #[must_use]
    pub fn frame(&self) -> HandAxes {
        let (sin, cos) = self.spin.to_radians().sin_cos();
        let (lean, upright) = self.tilt.to_radians().sin_cos();
        HandAxes {
            jaw: [cos, sin, 0.0],
            across: [-sin * upright, cos * upright, lean],
            approach: [-sin * lean, cos * lean, -upright],
        }
    }
}

/// The number at `fraction` of the way; never outside the two ends, whatever the rounding.
pub(crate) fn mix(from: f64, to: f64, fraction: f64) -> f64 {
    (from + (to - from) * fraction).clamp(from.min(to), from.max(to))
}

pub(crate) fn dot(a: Xyz, b: Xyz) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn minus(a: Xyz, b: Xyz) -> Xyz {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `point + direction × length`.
pub(crate) fn along(point: Xyz, direction: Xyz, length: f64) -> Xyz {
    [
        point[0] + direction[0] * length,
        point[1] + direction[1] * length,
        point[2] + direction[2] * length,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn frame_follows_spin_and_tilt() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        for (spin, tilt, jaw, approach) in [
            (0.0, 0.0, [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]),
            (90.0, 0.0, [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]),
            (0.0, 45.0, [1.0, 0.0, 0.0], [0.0, half, -half]),
            (90.0, 45.0, [0.0, 1.0, 0.0], [-half, 0.0, -half]),
            (0.0, -45.0, [1.0, 0.0, 0.0], [0.0, -half, -half]),
        ] {
            let frame = Pose::new(0.0, 0.0, 0.0, spin, tilt).frame();
            for axis in 0..3 {
                assert!(
                    (frame.jaw[axis] - jaw[axis]).abs() < 1e-12,
                    "{spin} {tilt} {frame:?}"
                );
                assert!(
                    (frame.approach[axis] - approach[axis]).abs() < 1e-12,
                    "{spin} {tilt} {frame:?}"
                );
            }
        }
    }

    #[test]
    fn distances_leave_the_angles_out() {
        let a = Pose::new(0.0, 0.0, 0.0, 0.0, 0.0);
        let b = Pose::new(3.0, 4.0, 12.0, -80.0, 40.0);
        assert_eq!(
            (a.horizontal_distance(&b), a.distance(&b), a.turn(&b)),
            (5.0, 13.0, 80.0)
        );
    }

    proptest! {
        #[test]
        fn frame_is_orthonormal_with_a_level_jaw_line(spin in -180.0..180.0, tilt in -45.0..45.0) {
            let HandAxes { jaw, across, approach } = Pose::new(0.0, 0.0, 0.0, spin, tilt).frame();
            for (a, b, want) in [
                (jaw, jaw, 1.0), (across, across, 1.0), (approach, approach, 1.0),
                (jaw, across, 0.0), (jaw, approach, 0.0), (across, approach, 0.0),
            ] {
                prop_assert!((dot(a, b) - want).abs() < 1e-9);
            }
            prop_assert_eq!(jaw[2], 0.0);
        }

        #[test]
        fn between_never_leaves_the_two_ends(from in -500.0..500.0, to in -500.0..500.0, at in 0.0..=1.0) {
            let (a, b) = (Pose::new(from, to, from, to, from), Pose::new(to, from, to, from, to));
            let middle = a.between(&b, at);
            for value in [middle.x, middle.y, middle.z, middle.spin, middle.tilt] {
                prop_assert!((f64::min(from, to)..=f64::max(from, to)).contains(&value));
            }
            prop_assert_eq!(a.between(&b, 0.0), a);
        }
    }
}
