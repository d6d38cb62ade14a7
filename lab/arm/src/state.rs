//! Reports of the arm: its state, and the progress of its commands.

use serde::{Deserialize, Serialize};

use crate::blocks::Block;
use crate::controller::Grip;
use crate::pose::Pose;
use mom_device::DeviceError;

/// How far a command has come (M42).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CommandState {
    /// In the arm's queue, checked and accepted.
    Waiting,
    /// On its way to the arm; only the sender knows this state, the arm never reports it.
    Sending,
    /// Being carried out.
    Executing,
    /// Carried out to its end.
    Finished,
    /// Refused or ended before its end; an error says why.
    Error,
}

/// Which statement of how many.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ScriptProgress {
    /// The statement being executed, or the last one begun; 1 for the first, 0 before it.
    pub statement: u32,
    /// How many statements the command has.
    pub of: u32,
}

/// The command being carried out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Executing {
    /// The command's id.
    pub id: u64,
    /// The statement being executed, 1 for the first.
    pub statement: u32,
    /// How many statements the command has.
    pub of: u32,
}

/// The jaws.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Gripper {
    /// What they were last told.
    pub grip: Grip,
    /// mm between them.
    pub opening: f64,
}

/// The whole state of the arm and its table at one time: enough to draw it from.
///
/// The sizes of the hand for drawing are the constants of [`contact`](crate::contact); where the parts of the
/// arm behind it are, [`reach::links`](crate::reach::links) says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ArmState {
    /// Rises with every change of the state.
    pub seq: u64,
    /// Where the hand is.
    pub pose: Pose,
    /// How the jaws are.
    pub gripper: Gripper,
    /// The name of the block in the jaws.
    pub holding: Option<String>,
    /// Every block, always in the same order.
    pub blocks: Vec<Block>,
    /// Whether the hand or the jaws move, or may do so because the link to the controller is down.
    pub moving: bool,
    /// Whether the link to the controller stands (M53). While it is down, pose, gripper and blocks are the last that were known.
    #[serde(default = "yes", skip_serializing_if = "is_true")]
    pub linked: bool,
    /// Whether the arm is stopped and takes no command.
    pub stopped: bool,
    /// The command being carried out.
    pub executing: Option<Executing>,
    /// How many commands wait behind it.
    pub waiting: usize,
    /// The newest fence of its token that the arm has heard of. None where no owner was heard of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fence: Option<u64>,
}

const fn yes() -> bool {
    true
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands over a reference")]
const fn is_true(value: &bool) -> bool {
    *value
}

/// The events of the arm, in order.
#[derive(Debug, Clone, PartialEq)]
pub enum ArmEvent {
    /// A command changed its state or began its next statement.
    Command {
        /// The command's id.
        id: u64,
        /// Its state now.
        state: CommandState,
        /// How far it has come.
        progress: ScriptProgress,
        /// Why, where the state is `error`.
        error: Option<DeviceError>,
    },
    /// The arm's state changed: every 50 ms while it moves, and at rest at the end of each command.
    State(ArmState),
}
