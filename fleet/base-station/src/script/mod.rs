//! Scripts: when the base station sends what to whom (W16, W17).
//!
//! The robots have no sequences; they carry out each command at once. A script is text, a statement on each line or
//! between `;`, with comments from `#`:
//!
//! ```text
//! 1 motor 100 100              # UNIT COMMAND VALUES…, a command of the table
//! 1,3-5 leds 255               # several units
//! all motor 0 0                # the whole fleet
//! 3 to 1000 500 via 200 300    # drive to a place, in mm, by others: GOTO and VIA of our own robots
//! wait 500                     # milliseconds
//! repeat 10                    # up to its end, in one another up to 8 deep
//!   1 motor 50 -50; wait 200
//! end
//! 2 status
//! on 2 reply status            # waits until unit 2 has replied, at most 3 s, or the script fails
//! ```
//!
//! `to` replaces what the robot has queued: its first place is a GOTO, each further one a VIA, the last of them the one
//! that is named first. `on` is content with a reply that came since the script last sent that command to the unit.
//!
//! Each script ends: in at most [`MOST_STEPS`] steps, and, waits and all, within [`LONGEST`]. What does not is refused when
//! it is read.

mod interpreter;
mod parse;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use mom_brs::{Code, Frame, Table};
use mom_toml_faults::Spot;

use crate::fleet::Unit;

pub use interpreter::{Action, Interpreter, NoReply};

/// The most bytes of a script.
pub const MOST_BYTES: usize = 1 << 20;

/// The most steps of a script: each frame to each unit, each wait, and each turn of a repetition is one.
pub const MOST_STEPS: u64 = 1_000_000;

/// The longest that a script may take, in µs: a day.
pub const LONGEST: i64 = 24 * 3600 * 1_000_000;

/// The most repetitions in one another.
pub const DEEPEST: usize = 8;

/// How long `on … reply` waits, in µs.
pub const REPLY_WITHIN: i64 = 3_000_000;

/// A script that was read and found right.
#[derive(Clone, Debug, PartialEq)]
pub struct Script {
    steps: Arc<[Step]>,
}

/// What a statement has become.
#[derive(Clone, Debug, PartialEq)]
enum Step {
    Send {
        units: Arc<[Unit]>,
        frame: Frame,
    },
    Wait {
        micros: i64,
    },
    Reply {
        unit: Unit,
        code: Code,
        spot: Spot,
    },
    Repeat {
        count: u64,
    },
    /// The end of the repetition whose first step is there.
    End {
        first: usize,
    },
}

/// What is wrong in a script.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ScriptFault {
    /// Nobody knows this word here.
    UnknownWord,
    /// A unit is not a number, or not in the fleet.
    Unit,
    /// Something is missing at the end of a statement.
    Missing,
    /// A statement goes on after its end.
    TooMuch,
    /// A value is not a number, or out of range.
    Value,
    /// A command has no reply.
    NoReply,
    /// A repetition has no end, or an end no repetition; or they are too deep.
    Nesting,
    /// The table does not have the commands for a statement.
    NoCommand,
    /// It is too long, in bytes, in steps or in time.
    TooLong,
}

/// What is wrong in a script, and where.
pub type ScriptError = mom_toml_faults::FileError<ScriptFault>;

impl Script {
    /// Reads a script for the units of a fleet and the commands of a table.
    ///
    /// ```
    /// use mom_base_station::script::{Action, Interpreter, Script};
    /// use mom_brs::PAPER;
    ///
    /// let script = Script::parse("1 motor 100 100; wait 500; all motor 0 0", &[1, 2], &PAPER)?;
    /// let mut interpreter = Interpreter::new(script, 0);
    /// let mut next = |now| match interpreter.poll(now) {
    ///     Action::Send(unit, frame) => format!("{unit}: {frame}"),
    ///     action => format!("{action:?}"),
    /// };
    /// assert_eq!(next(0), "1: 06 00100 00100");
    /// assert_eq!(next(0), "Wait(500000)");
    /// assert_eq!(next(500_000), "1: 06 00000 00000");
    /// assert_eq!(next(500_000), "2: 06 00000 00000");
    /// assert_eq!(next(500_000), "Done");
    ///
    /// let error = Script::parse("wait 500\n1 moter 1 1", &[1], &PAPER).unwrap_err();
    /// assert_eq!(error.to_string(), "line 2, column 3: there is no command `moter`; did you mean `motor`?");
    /// # Ok::<(), mom_base_station::script::ScriptError>(())
    /// ```
    ///
    /// # Errors
    ///
    /// The first fault, and its place.
    pub fn parse(text: &str, units: &[Unit], table: &'static Table) -> Result<Script, ScriptError> {
        let steps = parse::steps(text, units, table).map_err(|found| found.at(text))?;
        Ok(Script { steps: steps.into() })
    }

    /// The units that it sends to, the lowest first.
    #[must_use]
    pub fn units(&self) -> Vec<Unit> {
        let mut units = Vec::new();
        for step in self.steps.iter() {
            if let Step::Send { units: more, .. } = step {
                units.extend_from_slice(more);
            }
        }
        units.sort_unstable();
        units.dedup();
        units
    }

    /// The replies that come if all goes well and each step is done once: for each frame whose command has a reply, the
    /// unit and the code.
    #[must_use]
    pub fn replies(&self) -> Vec<(Unit, Code)> {
        let mut replies = Vec::new();
        for step in self.steps.iter() {
            if let Step::Send { units, frame } = step
                && frame.command().reply.is_some()
            {
                replies.extend(units.iter().map(|unit| (*unit, frame.code())));
            }
        }
        replies
    }
}
