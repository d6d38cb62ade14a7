//! Where the hand is.

use nalgebra::{Rotation3, Vector3};
use serde::{Deserialize, Serialize};

/// A pose of the arm: the tip in mm on the table, and two angles in degrees (M50).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Along the table's x axis, mm.
    pub x: f64,
    /// Along the table's y axis, mm.
    pub y: f64,
    /// Above the table, mm.
    pub z: f64,
    /// About the vertical, degrees.
    pub spin: f64,
    /// From the vertical, degrees.
    pub tilt: f64,
}

impl Pose {
    /// The command that moves the arm there.
    #[must_use]
    pub fn command(&self) -> String {
        let Pose { x, y, z, spin, tilt } = self;
        format!("move {x} {y} {z} {spin} {tilt}")
    }

    /// The place in the world of a point of the gripper's frame, mm: along the jaw line, across it, and from the tip
    /// towards the wrist. The gripper is turned by `Rz(spin) Rx(tilt)`.
    ///
    /// ```
    /// use mom_drive::Pose;
    ///
    /// let pose = Pose { x: 10.0, y: 20.0, z: 30.0, spin: 90.0, tilt: 0.0 };
    /// let [x, y, z] = pose.place([0.0, -100.0, 60.0]);
    /// assert!((x - 110.0).abs() < 1e-9 && (y - 20.0).abs() < 1e-9 && (z - 90.0).abs() < 1e-9);
    /// ```
    #[must_use]
    pub fn place(&self, offset: [f64; 3]) -> [f64; 3] {
        let spin = Rotation3::from_axis_angle(&Vector3::z_axis(), self.spin.to_radians());
        let tilt = Rotation3::from_axis_angle(&Vector3::x_axis(), self.tilt.to_radians());
        let tip = Vector3::new(self.x, self.y, self.z);
        (tip + spin * tilt * Vector3::from(offset)).into()
    }

    /// Whether it is the same place, but for what is lost on the way of a number.
    #[must_use]
    pub fn is_at(&self, other: &Pose) -> bool {
        let (a, b) = (self.numbers(), other.numbers());
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6)
    }

    /// `[x, y, z, spin, tilt]`.
    #[must_use]
    pub fn numbers(&self) -> [f64; 5] {
        [self.x, self.y, self.z, self.spin, self.tilt]
    }

    /// mm between the tips.
    #[must_use]
    pub fn distance(&self, other: &Pose) -> f64 {
        (self.x - other.x).hypot(self.y - other.y).hypot(self.z - other.z)
    }
}
