//! The four cameras of the lab (M54) and where they stand.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::geometry::{Direction, Point};
use crate::robot::ToolFrame;
use crate::{Camera, DrawnPose, SettingsError};

/// Which of the four cameras (M54).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum View {
    /// Looks along the x axis, against its direction: y is to the right.
    X,
    /// Looks along the y axis: x is to the right.
    Y,
    /// Looks down on the table: x is to the right, y upwards.
    Top,
    /// Sits on the gripper, looks at its tip and moves with the pose.
    Wrist,
}

impl View {
    /// All views, in the order in which the lab lists them.
    pub const ALL: [View; 4] = [View::X, View::Y, View::Top, View::Wrist];

    /// The name that is also the camera's channel: `x`, `y`, `top`, `wrist`.
    pub fn name(self) -> &'static str {
        match self {
            View::X => "x",
            View::Y => "y",
            View::Top => "top",
            View::Wrist => "wrist",
        }
    }

    /// Whether it stands still, so that all its images of one size have one matrix.
    pub fn is_fixed(self) -> bool {
        self != View::Wrist
    }

    /// The name under which it logs in: the user's own for x, and one with the view for the others, so that all four
    /// may be the same user and lists of members tell them apart.
    pub fn peer(self, user: &str) -> String {
        match self {
            View::X => user.to_owned(),
            view => format!("{user}-{view}"),
        }
    }

    /// The camera for an image of this size in pixels; only [`View::Wrist`] depends on the pose.
    pub fn camera(self, pose: &DrawnPose, width: u32, height: u32) -> Camera {
        let size = (width, height);
        // An image of any shape shows at least what one of 4:3 shows.
        let across = f64::from(width).min(f64::from(height) * 4.0 / 3.0);
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
                let tool = ToolFrame::new(&pose.drawable());
                let target = tool.at([0.0, 45.0, -60.0]);
                Camera::look(tool.at(WRIST_MOUNT), target, tool.across(), 0.72 * across, size)
            }
        }
    }
}

/// Where the wrist's camera sits in the tool's frame, mm: beside the flange, out of the way of the jaws.
pub(crate) const WRIST_MOUNT: [f64; 3] = [0.0, 105.0, 165.0];

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
