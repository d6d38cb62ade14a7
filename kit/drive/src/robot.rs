//! The state of the arm.

use serde::Deserialize;

use crate::Pose;

/// What of the arm's state matters to programs that drive it.
#[derive(Debug, Clone, Deserialize)]
#[non_exhaustive]
pub struct RobotState {
    /// Rises with every change of the state.
    pub seq: i64,
    /// Where the hand is.
    pub pose: Pose,
    /// What the jaws hold.
    #[serde(default)]
    pub holding: Option<String>,
    /// Whether it moves, or may do so because the link to its controller is down.
    #[serde(default)]
    pub moving: bool,
    /// Whether it is stopped and takes no command.
    #[serde(default)]
    pub stopped: bool,
}

impl RobotState {
    /// Whether it rests at a pose.
    #[must_use]
    pub fn rests_at(&self, pose: &Pose) -> bool {
        !self.moving && self.pose.is_at(pose)
    }
}
