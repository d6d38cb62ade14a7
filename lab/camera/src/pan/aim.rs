//! Where the camera looks: its two angles, their limits, and what it sees from there.

use std::fmt;
use std::ops::RangeInclusive;

use mom_client::{Map, Value};
use mom_device::{DeviceError, ErrorName};
use serde::{Deserialize, Serialize};

use crate::Camera;
use crate::geometry::{Direction, Point};

/// Degrees to which the mount pans: all around but for its cable.
pub const PANS: RangeInclusive<f64> = -170.0..=170.0;
/// Degrees to which it tilts.
pub const TILTS: RangeInclusive<f64> = -60.0..=30.0;
/// Arm and table in the middle of the image: where it looks first, and the target of `home`.
pub const HOME: Aim = Aim::new(0.0, -20.0);

/// Where the lens is, mm: beside the corner of the table that both scales meet.
pub(crate) const MOUNT: [f64; 3] = [1250.0, -1250.0, 860.0];
/// The focal length, as a part of the image's width.
const FOCAL: f64 = 1.05;
/// Steps of the mount's motors in a degree.
const STEPS: f64 = 1000.0;

/// Where the camera looks, degrees.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Aim {
    /// About the vertical: 0 looks across the middle of the table, positive angles are to the right of it.
    pub pan: f64,
    /// From the level: positive angles look up.
    pub tilt: f64,
}

impl Default for Aim {
    fn default() -> Self {
        HOME
    }
}

impl Aim {
    /// An aim of these angles, in degrees.
    #[must_use]
    pub const fn new(pan: f64, tilt: f64) -> Self {
        Self { pan, tilt }
    }

    /// Further by so much, at the next step of the motors, so that sums of decimals stay decimals.
    #[must_use]
    pub fn plus(&self, by: &Aim) -> Aim {
        let step = |angle: f64| match angle.abs() < 1e6 {
            true => (angle * STEPS).round() / STEPS,
            false => angle,
        };
        Aim::new(step(self.pan + by.pan), step(self.tilt + by.tilt))
    }

    /// Whether the mount can turn there.
    ///
    /// # Errors
    ///
    /// `joint-limit`, with the nearest aim that it can turn to.
    pub fn check(&self) -> Result<(), DeviceError> {
        let nearest = self.nearest();
        let (which, angle, limits) = match () {
            () if nearest.pan != self.pan => ("pan", self.pan, PANS),
            () if nearest.tilt != self.tilt => ("tilt", self.tilt, TILTS),
            () => return Ok(()),
        };
        let text = format!(
            "{which} is {angle}°, but the mount turns from {} to {}°; the nearest that it reaches is {nearest}",
            limits.start(),
            limits.end()
        );
        Err(DeviceError::new(ErrorName::JointLimit, text).with_reachable(nearest.to_map()))
    }

    /// The nearest aim that the mount can turn to; what is not a number counts as 0.
    fn nearest(&self) -> Aim {
        let clamp = |angle: f64, limits: RangeInclusive<f64>| match angle.is_nan() {
            true => 0.0,
            false => angle.clamp(*limits.start(), *limits.end()),
        };
        Aim::new(clamp(self.pan, PANS), clamp(self.tilt, TILTS))
    }

    /// `{pan, tilt}`.
    pub(crate) fn to_map(self) -> Map {
        Map::new()
            .with("pan", Value::Double(self.pan))
            .with("tilt", Value::Double(self.tilt))
    }

    /// The camera that looks there, for an image of this size; `across` is the width of the part of it that is 4:3.
    pub(crate) fn camera(self, across: f64, size: (u32, u32)) -> Camera {
        let Aim { pan, tilt } = self.nearest();
        let lens = Point::from(MOUNT);
        Camera::look(
            lens,
            lens + direction(pan, tilt),
            Direction::z(),
            FOCAL * across,
            size,
        )
    }
}

/// The direction of an aim, of length 1.
pub(crate) fn direction(pan: f64, tilt: f64) -> Direction {
    let [x, y, _] = MOUNT;
    // Pan angles count clockwise seen from above, those of the world the other way.
    let bearing = f64::atan2(-y, -x) - pan.to_radians();
    let (up, level) = tilt.to_radians().sin_cos();
    Direction::new(bearing.cos() * level, bearing.sin() * level, up)
}

impl fmt::Display for Aim {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.pan, self.tilt)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_those_of_the_image() {
        let middle = |aim: Aim| aim.camera(640.0, (640, 480)).project([0.0, 0.0, 0.0]);
        let [u, v] = middle(HOME).expect("it is seen");
        assert!((u - 320.0).abs() < 1e-6 && (200.0..400.0).contains(&v), "{u} {v}");
        let [right, _] = middle(HOME.plus(&Aim::new(10.0, 0.0))).expect("it is seen");
        assert!(right < u - 50.0, "what is seen goes left when it turns right");
        let [_, up] = middle(HOME.plus(&Aim::new(0.0, 10.0))).expect("it is seen");
        assert!(up > v + 50.0, "what is seen goes down when it looks up");
        assert_eq!(middle(Aim::new(150.0, 0.0)), None, "it is behind");
    }

    #[test]
    fn the_nearest_that_it_reaches_is_told() {
        for (aim, words) in [
            (
                Aim::new(200.0, -20.0),
                "pan is 200°, but the mount turns from -170 to 170°; the nearest that it reaches is 170 -20",
            ),
            (
                Aim::new(0.0, -61.5),
                "tilt is -61.5°, but the mount turns from -60 to 30°; the nearest that it reaches is 0 -60",
            ),
        ] {
            let error = aim.check().expect_err("it is out of reach");
            assert_eq!((error.name(), error.text()), (ErrorName::JointLimit, words));
            assert_eq!(aim.nearest().check(), Ok(()), "it is within reach");
            assert_eq!(
                error.reachable(),
                Some(&aim.nearest().to_map().into()),
                "it is told in words and as data"
            );
        }
        for wrong in [f64::NAN, f64::INFINITY, f64::MIN] {
            assert!(Aim::new(wrong, 0.0).check().is_err());
            assert!(HOME.plus(&Aim::new(0.0, wrong)).check().is_err());
            let camera = Aim::new(wrong, wrong).camera(64.0, (64, 48));
            assert!(camera.matrix().iter().all(|number| number.is_finite()));
        }
        for edge in [Aim::new(-170.0, 30.0), Aim::new(170.0, -60.0)] {
            assert_eq!(edge.check(), Ok(()));
        }
    }

    #[test]
    fn sums_of_decimals_are_decimals() {
        let sum = (0..1700).fold(Aim::new(0.0, 0.0), |sum, _| sum.plus(&Aim::new(0.1, 0.01)));
        assert_eq!(sum, Aim::new(170.0, 17.0));
    }
}
