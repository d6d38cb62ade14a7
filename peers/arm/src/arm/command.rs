//! A command in the arm's queue, or while it is carried out.

use std::collections::VecDeque;

use super::HOME;
use crate::error::ArmError;
use crate::jog::Jog;
use crate::motion::ArmTime;
use crate::pose::Pose;
use crate::script::{Script, Statement};
use crate::state::{ArmEvent, CommandState, ScriptProgress};

#[derive(Debug, Clone)]
pub(super) struct QueuedScript {
    pub(super) id: u64,
    pub(super) script: Script,
    /// When it is too old to begin.
    pub(super) use_by: Option<ArmTime>,
}

/// The command being carried out.
#[derive(Debug, Clone)]
pub(super) struct Active {
    pub(super) command: QueuedScript,
    /// How many statements have begun.
    pub(super) begun: usize,
    /// The ends of the legs of this statement that have not begun.
    pub(super) legs: VecDeque<Pose>,
    pub(super) step: Step,
    /// Why no statement begins after the present one; none if the script goes on.
    pub(super) ends: Option<String>,
    /// Where the hand is going by the controller's present instruction.
    pub(super) leg: Option<Pose>,
    /// The present statement, if that is a velocity.
    pub(super) jog: Option<Jog>,
}

/// What is being done of the present statement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Step {
    None,
    /// Until this time.
    Waits(ArmTime),
    /// The controller carries out an instruction.
    Moves {
        /// It counts as done no earlier, wherever the hand is.
        lasts_until: ArmTime,
    },
}

impl QueuedScript {
    pub(super) fn progress(&self, begun: usize) -> ScriptProgress {
        let count = |count: usize| u32::try_from(count).expect("a script has at most 1000 statements");
        ScriptProgress {
            statement: count(begun),
            of: count(self.script.statements().len()),
        }
    }

    pub(super) fn event(&self, state: CommandState, begun: usize, error: Option<ArmError>) -> ArmEvent {
        ArmEvent::Command {
            id: self.id,
            state,
            progress: self.progress(begun),
            error,
        }
    }
}

/// Where a statement moves the hand from this pose, if it does.
pub(super) fn target(statement: &Statement, from: &Pose) -> Option<Pose> {
    match statement {
        Statement::Move(pose) => Some(*pose),
        Statement::By(by) => Some(from.plus(by)),
        Statement::Home => Some(HOME),
        Statement::Grip(_) | Statement::Wait(_) | Statement::Jog(..) | Statement::Reset => None,
    }
}
