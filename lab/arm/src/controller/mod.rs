//! The seam between the program and the machine: a robot controller, real or simulated.
//!
//! [`Arm`](crate::Arm) is what the paper's PC did: it reads scripts, keeps the path rule and the queue, and gives one [`Instruction`] after
//! the other. A [`Controller`] carries them out. [`Simulated`] is an S4-like one with the lab's blocks; who has a real one implements this
//! trait, with [`rapid::instruction`](crate::rapid::instruction) as the text of each instruction if it speaks RAPID (M51).

use std::fmt;

use crate::blocks::Block;
use crate::motion::{ArmTime, Posture};
use crate::pose::Pose;
use mom_device::{DeviceError, ErrorName};
use serde::{Deserialize, Serialize};

mod link;
mod simulated;
#[cfg(test)]
mod tests;
mod traced;

pub use link::LinkFault;
pub use simulated::{Simulated, WATCHDOG};
pub use traced::Traced;

/// A command to the jaws.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Grip {
    /// As far apart as they go; what they held falls.
    Open,
    /// Together, or until they hold something.
    Close,
}

/// One thing that a controller is told to do; the next one follows when it is done.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Instruction {
    /// Straight to a pose, as fast as the controller goes (150 mm/s, M49), and to a halt there.
    Move(Pose),
    /// Straight to a pose in just so many µs: a piece of a jog, of which the next one follows at once.
    Glide(Pose, ArmTime),
    /// Jaws open or closed.
    Grip(Grip),
}

/// What has become of an instruction.
#[derive(Debug, Clone, PartialEq)]
pub enum Progress {
    /// It is being carried out.
    Busy,
    /// It was done at this time, which is not later than the time asked for. One that is told early is waited for where the instruction
    /// says how long it takes.
    Done(ArmTime),
    /// It ended early, at this time, and the arm stands where that happened.
    Failed(ArmTime, DeviceError),
}

/// What a controller knows of the machine.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// Where the hand is, and how far the jaws are open.
    pub posture: Posture,
    /// What the jaws were last told.
    pub grip: Grip,
    /// The name of the block in the jaws, where that is known.
    pub holding: Option<String>,
    /// The blocks, where they are known; a real controller knows none.
    pub blocks: Vec<Block>,
}

/// A robot controller. Time is an argument, in µs from any beginning; it never goes back.
///
/// ```
/// use mom_arm::{Arm, pose::HOME};
/// use mom_arm::controller::{Controller, Instruction, Progress, Reading};
/// use mom_arm::motion::{ArmTime, Posture};
/// use mom_arm::Grip;
/// use mom_device::DeviceError;
///
/// /// A machine that is there at once, and keeps a list of what it was told.
/// #[derive(Debug, Default)]
/// struct Recorder { told: Vec<Instruction>, at: Option<Posture> }
///
/// impl Controller for Recorder {
///     fn begin(&mut self, instruction: &Instruction, _now: ArmTime) -> Result<(), DeviceError> {
///         self.told.push(*instruction);
///         if let Instruction::Move(pose) = instruction {
///             self.at = Some(Posture { pose: *pose, opening: 80.0 });
///         }
///         Ok(())
///     }
///     fn advance(&mut self, now: ArmTime) -> Progress { Progress::Done(now) }
///     fn halt(&mut self, _now: ArmTime) {}
///     fn next_wake(&self) -> Option<ArmTime> { None }
///     fn reading(&self) -> Reading {
///         let posture = self.at.unwrap_or(Posture { pose: HOME, opening: 80.0 });
///         Reading { posture, grip: Grip::Open, holding: None, blocks: Vec::new() }
///     }
/// }
///
/// let mut arm = Arm::with_controller(0, Box::new(Recorder::default()));
/// arm.submit(1, "move 100 50 200 0 0", 0, &mut Vec::new())?;
/// assert_eq!(arm.state().pose.x, 100.0);
/// # Ok::<(), DeviceError>(())
/// ```
pub trait Controller: fmt::Debug + Send {
    /// Begins an instruction; the one before it has ended.
    ///
    /// # Errors
    ///
    /// Why it cannot begin, such as [`ErrorName::Link`]. Then nothing moves.
    fn begin(&mut self, instruction: &Instruction, now: ArmTime) -> Result<(), DeviceError>;

    /// Lets time pass until `now`, or until the instruction ends, if that is earlier. Where none is being carried out, the answer does not
    /// count.
    fn advance(&mut self, now: ArmTime) -> Progress;

    /// Stops hand and jaws where they are. What was being carried out is over.
    fn halt(&mut self, now: ArmTime);

    /// When [`Controller::advance`] is to be called next; `None` while nothing happens by itself.
    fn next_wake(&self) -> Option<ArmTime>;

    /// What it knows of the machine now; the last that it knew, while the link is down.
    fn reading(&self) -> Reading;

    /// Where the hand is, and how far the jaws are open, of what it knows.
    fn posture(&self) -> Posture {
        self.reading().posture
    }

    /// Whether anything moves by itself without an instruction, such as a block that falls.
    fn is_unsettled(&self) -> bool {
        false
    }

    /// Whether the link from this program to the controller stands (M53). While it does not, nothing is known of the machine.
    fn is_linked(&self) -> bool {
        true
    }

    /// Puts machine and blocks back to how they were at the start, at once.
    ///
    /// # Errors
    ///
    /// That this cannot be done; only a simulated one can.
    fn reset(&mut self, _now: ArmTime) -> Result<(), DeviceError> {
        let text =
            "only the simulated arm can be put back by `reset`; use `home`, and put the blocks back by hand";
        Err(DeviceError::new(ErrorName::Syntax, text))
    }
}
