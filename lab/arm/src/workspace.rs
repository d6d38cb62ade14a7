//! The part of space in which the hand may be (M50).

use std::ops::RangeInclusive;

use crate::pose::Pose;
use mom_device::{DeviceError, ErrorName};

/// The box and the cone of M50: 600 × 600 × 450 mm above the table, and the hand inside an inverted
/// cone whose apex measures 90°.
///
/// Tilt is signed, −45 to 45: because the jaw line stays level, the hand can lean to either side of
/// it, and a signed angle lets it pass through the vertical without a turn of spin.
#[derive(Debug, Clone, PartialEq)]
pub struct Workspace {
    /// mm.
    pub x: RangeInclusive<f64>,
    /// mm.
    pub y: RangeInclusive<f64>,
    /// mm above the table.
    pub z: RangeInclusive<f64>,
    /// Degrees.
    pub spin: RangeInclusive<f64>,
    /// Degrees.
    pub tilt: RangeInclusive<f64>,
}

/// The workspace of the lab (M50).
pub const WORKSPACE: Workspace = Workspace {
    x: -300.0..=300.0,
    y: -300.0..=300.0,
    z: 0.0..=450.0,
    spin: -180.0..=180.0,
    tilt: -45.0..=45.0,
};

impl Workspace {
    /// Checks that the pose lies inside; the limits themselves are allowed.
    ///
    /// The box and the cone are convex, so a straight way between two poses inside stays inside.
    ///
    /// # Errors
    ///
    /// [`ErrorName::WorkspaceBoundary`] that names the first axis outside, its value and its limits.
    ///
    /// ```
    /// use mom_arm::{Pose, workspace::WORKSPACE};
    ///
    /// let error = WORKSPACE.check(&Pose::new(0.0, 320.0, 100.0, 0.0, 0.0)).unwrap_err();
    /// assert_eq!(error.text(), "y is 320 mm, but the workspace reaches from -300 to 300 mm");
    /// ```
    pub fn check(&self, pose: &Pose) -> Result<(), DeviceError> {
        for (axis, unit, value, range) in [
            ("x", "mm", pose.x, &self.x),
            ("y", "mm", pose.y, &self.y),
            ("z", "mm", pose.z, &self.z),
            ("spin", "degrees", pose.spin, &self.spin),
            ("tilt", "degrees", pose.tilt, &self.tilt),
        ] {
            if !range.contains(&value) {
                let (low, high) = (range.start(), range.end());
                return Err(DeviceError::new(
                    ErrorName::WorkspaceBoundary,
                    format!(
                        "{axis} is {value} {unit}, but the workspace reaches from {low} to {high} {unit}"
                    ),
                ));
            }
        }
        Ok(())
    }

    /// The pose inside that is nearest to this one in each of its five numbers.
    #[must_use]
    pub fn nearest(&self, pose: &Pose) -> Pose {
        let within = |value: f64, range: &RangeInclusive<f64>| value.clamp(*range.start(), *range.end());
        Pose::new(
            within(pose.x, &self.x),
            within(pose.y, &self.y),
            within(pose.z, &self.z),
            within(pose.spin, &self.spin),
            within(pose.tilt, &self.tilt),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_inside_and_the_next_number_is_not() {
        let middle = [0.0, 0.0, 200.0, 0.0, 0.0];
        let pose = |v: [f64; 5]| Pose::new(v[0], v[1], v[2], v[3], v[4]);
        for (place, axis, low, high) in [
            (0, "x is", -300.0, 300.0),
            (1, "y is", -300.0, 300.0),
            (2, "z is", 0.0, 450.0),
            (3, "spin is", -180.0, 180.0),
            (4, "tilt is", -45.0, 45.0),
        ] {
            let with = |value: f64| {
                let mut values = middle;
                values[place] = value;
                WORKSPACE.check(&pose(values))
            };
            assert_eq!((with(low), with(high)), (Ok(()), Ok(())), "{axis}");
            for outside in [f64::next_down(low), f64::next_up(high), f64::NAN, f64::INFINITY] {
                let error = with(outside).unwrap_err();
                assert_eq!(error.name(), ErrorName::WorkspaceBoundary);
                assert!(error.text().starts_with(axis), "{error}");
                assert!(error.text().contains(&format!("from {low} to {high}")), "{error}");
            }
        }
    }
}
