//! The five cameras of the lab (M54, M62) and where they stand.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::geometry::{Direction, Point};
use crate::robot::{Mounted, ToolFrame};
use crate::{Camera, DrawnPose, SettingsError, pan};

/// Which of the five cameras (M54, M62).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum View {
    /// Looks along the x axis, against its direction: y is to the right.
    X,
    /// Looks along the y axis: x is to the right.
    Y,
    /// Looks down on the table: x is to the right, y upwards.
    Top,
    /// Sits on the forearm, which the third joint moves, behind the wrist; looks past the gripper's tip and moves with the pose.
    Wrist,
    /// Stands at a corner of the lab, on a mount that turns and tilts by command (M62).
    Pan,
}

impl View {
    /// All views, in the order in which the lab lists them.
    pub const ALL: [View; 5] = [View::X, View::Y, View::Top, View::Wrist, View::Pan];

    /// The name that is also the camera's channel: `x`, `y`, `top`, `wrist`, `pan`.
    pub fn name(self) -> &'static str {
        match self {
            View::X => "x",
            View::Y => "y",
            View::Top => "top",
            View::Wrist => "wrist",
            View::Pan => "pan",
        }
    }

    /// Whether it stands still, so that all its images of one size have one matrix.
    pub fn is_fixed(self) -> bool {
        self.motion().is_none()
    }

    /// How it moves, in words, if it does.
    pub(crate) fn motion(self) -> Option<&'static str> {
        match self {
            View::X | View::Y | View::Top => None,
            View::Wrist => Some("the camera on the wrist moves with the arm"),
            View::Pan => Some("the camera pan turns and tilts by command"),
        }
    }

    /// The name under which it logs in: the user's own for x, and one with the view for the others, so that all five
    /// may be the same user and lists of members tell them apart.
    pub fn peer(self, user: &str) -> String {
        match self {
            View::X => user.to_owned(),
            view => format!("{user}-{view}"),
        }
    }

    /// The camera for an image of this size in pixels; only [`View::Wrist`] depends on the pose. That of [`View::Pan`] looks
    /// [home](crate::pan::HOME).
    pub fn camera(self, pose: &DrawnPose, width: u32, height: u32) -> Camera {
        let size = (width, height);
        let across = across(width, height);
        let fixed = |position: [f64; 3], target: [f64; 3], up: Direction, focal: f64| {
            Camera::look(
                Point::from(position),
                Point::from(target),
                up,
                focal * across,
                size,
            )
        };
        match self {
            View::X => fixed([1600.0, 0.0, 760.0], [0.0, 0.0, 225.0], Direction::z(), 1.3),
            View::Y => fixed([0.0, -1600.0, 760.0], [0.0, 0.0, 225.0], Direction::z(), 1.3),
            View::Top => fixed([0.0, 0.0, 3000.0], [0.0, 0.0, 0.0], Direction::y(), 2.65),
            View::Wrist => {
                let Mounted { at, ahead, up } = Mounted::new(&ToolFrame::new(&pose.drawable()));
                Camera::look(at, at + ahead * 300.0, up, 0.72 * across, size)
            }
            View::Pan => pan::HOME.camera(across, size),
        }
    }
}

/// The width of the part of an image that is 4:3: one of any shape shows at least what that shows.
pub(crate) fn across(width: u32, height: u32) -> f64 {
    f64::from(width).min(f64::from(height) * 4.0 / 3.0)
}

impl fmt::Display for View {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for View {
    type Err = SettingsError;

    fn from_str(name: &str) -> Result<Self, SettingsError> {
        let found = View::ALL.into_iter().find(|view| view.name() == name);
        found.ok_or_else(|| SettingsError::View(name.to_owned()))
    }
}
