//! What is said to a course of commands, and what it says is to be done.

use crate::end::{CommandEnd, Halt};

/// The state that a relative command is based on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Basis {
    /// It is not relative.
    #[default]
    Nothing,
    /// The newest one in which the device rests.
    Newest,
    /// The one with this id, which who commands has seen.
    State(u64),
}

/// How far a command has come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Progress {
    /// The device has taken it, and says so.
    Device {
        /// Whether it waits, or is carried out.
        state: String,
        /// The statement that is carried out, 0 before the first.
        statement: u32,
        /// How many there are.
        of: u32,
    },
    /// It will be sent again, since what is in its way passes: the error's name, and its words.
    Again {
        /// `changing-hands`, `link`, `too-old`; also `expired`, `try-later` and `late` of what a device asks for.
        why: String,
        /// The device's or the hub's words.
        text: String,
    },
}

/// What is to be done next.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Step {
    /// The command is to be sent. Then [`Course::sent`], or [`Course::refused`].
    Send {
        /// The state that it is based on.
        on: Option<u64>,
        /// The `next` that it answers.
        to: Option<u64>,
    },
    /// It has come further.
    Tell(Progress),
    /// The hub is to be asked about the token. Then [`Course::asked`].
    Ask,
    /// The token is to be given back. Then [`Course::released`].
    Release,
    /// The device is to be told to stop.
    Stop,
    /// It has ended.
    End(CommandEnd),
    /// The work has ended.
    Halted(Halt),
}
