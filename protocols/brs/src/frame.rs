//! One command or reply with its values, and its bytes.

use core::fmt;
use core::ops::Deref;

use crate::number::{CODE, GROUP, digit, group, value};
use crate::table::{Code, Command, Direction, Parameter};
use crate::{LONGEST, MOST};

/// A command or a reply with its values, each within the range of its parameter.
///
/// `{}` writes it as it is on the wire, `06 00050 -0050`; `{:#}` as people read it, `motor left=50 right=-50`.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Frame {
    command: &'static Command,
    direction: Direction,
    parameters: &'static [Parameter],
    values: [i32; MOST],
    /// A bit for each value that was clamped, the lowest for the first.
    clamped: u8,
}

/// Why there is no such frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum FrameFault {
    /// Nobody says this code in this direction: robots do not reply to it, or base stations do not send it.
    NeverSaid {
        /// The name of the command.
        name: &'static str,
        /// The direction asked for.
        direction: Direction,
    },
    /// There are too many or too few values.
    Count {
        /// The name of the command.
        name: &'static str,
        /// How many it takes.
        takes: usize,
        /// How many were given.
        given: usize,
    },
}

impl fmt::Display for FrameFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NeverSaid {
                name,
                direction: Direction::Command,
            } => {
                write!(f, "`{name}` is said by robots only")
            }
            Self::NeverSaid {
                name,
                direction: Direction::Reply,
            } => write!(f, "`{name}` has no reply"),
            Self::Count { name, takes, given } => write!(f, "`{name}` takes {takes} values, not {given}"),
        }
    }
}

impl core::error::Error for FrameFault {}

impl Frame {
    /// A command with its values. Values out of range become the nearest that the parameter can have: see
    /// [`is_clamped`](Frame::is_clamped).
    ///
    /// # Errors
    ///
    /// Base stations do not send it, or it takes another number of values.
    pub fn new(command: &'static Command, values: &[i32]) -> Result<Frame, FrameFault> {
        Frame::said(command, Direction::Command, values)
    }

    /// A reply with its values, clamped like those of commands.
    ///
    /// # Errors
    ///
    /// The command has no reply, or the reply takes another number of values.
    pub fn reply(command: &'static Command, values: &[i32]) -> Result<Frame, FrameFault> {
        Frame::said(command, Direction::Reply, values)
    }

    /// A command or a reply with its values.
    ///
    /// # Errors
    ///
    /// As of [`Frame::new`] and [`Frame::reply`].
    pub fn said(
        command: &'static Command,
        direction: Direction,
        values: &[i32],
    ) -> Result<Frame, FrameFault> {
        let name = command.name;
        let parameters = command
            .said(direction)
            .ok_or(FrameFault::NeverSaid { name, direction })?;
        let (takes, given) = (parameters.len(), values.len());
        // A command that is of no table may have more parameters than a frame can hold.
        if takes != given || takes > MOST {
            return Err(FrameFault::Count { name, takes, given });
        }
        Ok(Frame::clamped(
            command,
            direction,
            parameters,
            values.iter().copied(),
        ))
    }

    /// What was read, whose parameters are as many as those of the command.
    pub(crate) fn read(
        command: &'static Command,
        direction: Direction,
        parameters: &'static [Parameter],
        groups: &[[u8; GROUP]],
    ) -> Frame {
        Frame::clamped(command, direction, parameters, groups.iter().map(value))
    }

    fn clamped(
        command: &'static Command,
        direction: Direction,
        parameters: &'static [Parameter],
        given: impl Iterator<Item = i32>,
    ) -> Frame {
        let mut values = [0; MOST];
        let mut clamped = 0;
        for (at, ((value, parameter), given)) in values.iter_mut().zip(parameters).zip(given).enumerate() {
            *value = parameter.clamp(given);
            if *value != given {
                clamped |= 1 << at;
            }
        }
        Frame {
            command,
            direction,
            parameters,
            values,
            clamped,
        }
    }

    /// Its entry in the table.
    #[must_use]
    pub const fn command(&self) -> &'static Command {
        self.command
    }

    /// Its code.
    #[must_use]
    pub const fn code(&self) -> Code {
        self.command.code
    }

    /// Whether it is a command or a reply.
    #[must_use]
    pub const fn direction(&self) -> Direction {
        self.direction
    }

    /// Its parameters.
    #[must_use]
    pub const fn parameters(&self) -> &'static [Parameter] {
        self.parameters
    }

    /// Its values, one for each parameter.
    #[must_use]
    pub fn values(&self) -> &[i32] {
        self.values.get(..self.parameters.len()).unwrap_or(&self.values)
    }

    /// The value of a parameter by its name.
    #[must_use]
    pub fn value(&self, name: &str) -> Option<i32> {
        let mut named = self.parameters.iter().zip(self.values());
        named
            .find(|(parameter, _)| parameter.name == name)
            .map(|(_, value)| *value)
    }

    /// Whether a value was out of range, when the frame was made or when it was read, so that another stands here.
    #[must_use]
    pub const fn is_clamped(&self) -> bool {
        self.clamped != 0
    }

    /// How many values were out of range.
    #[must_use]
    pub const fn clamped_values(&self) -> u32 {
        self.clamped.count_ones()
    }

    /// Its bytes.
    #[must_use]
    pub fn encode(&self) -> Encoded {
        let mut encoded = Encoded {
            bytes: [0; LONGEST],
            length: 0,
        };
        let code = u32::from(self.code().number());
        let (start, rest) = encoded.bytes.split_at_mut(CODE);
        start.copy_from_slice(&[digit(code / 10), digit(code)]);
        encoded.length = CODE;
        for (bytes, value) in rest.as_chunks_mut::<GROUP>().0.iter_mut().zip(self.values()) {
            *bytes = group(*value);
            encoded.length += GROUP;
        }
        encoded
    }
}

impl fmt::Display for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !f.alternate() {
            return f.write_str(self.encode().as_str());
        }
        f.write_str(self.command.name)?;
        let mut named = self.parameters.iter().zip(self.values());
        named.try_for_each(|(parameter, value)| write!(f, " {}={value}", parameter.name))
    }
}

impl fmt::Debug for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let clamped = if self.is_clamped() { ", clamped" } else { "" };
        write!(f, "{:?}({self}{clamped})", self.direction)
    }
}

/// The bytes of a frame, on the stack.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Encoded {
    bytes: [u8; LONGEST],
    length: usize,
}

impl Encoded {
    /// The bytes.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..self.length).unwrap_or_default()
    }

    /// The same as text: digits, spaces and `-`.
    #[must_use]
    pub fn as_str(&self) -> &str {
        core::str::from_utf8(self.as_bytes()).unwrap_or_default()
    }
}

impl Deref for Encoded {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.as_bytes()
    }
}

impl fmt::Debug for Encoded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.as_str())
    }
}

#[cfg(test)]
mod tests {
    use std::format;

    use super::*;
    use crate::PAPER;

    fn motor() -> &'static Command {
        PAPER.get(Code::MOTOR).unwrap()
    }

    #[test]
    fn values_out_of_range_are_clamped_and_said_so() {
        let frame = Frame::new(motor(), &[-1001, 1000]).unwrap();
        assert_eq!(frame.values(), [-1000, 1000]);
        assert!(frame.is_clamped());
        assert_eq!(frame.clamped_values(), 1);
        assert!(!Frame::new(motor(), &[-1000, 1000]).unwrap().is_clamped());
        let extreme = Frame::new(motor(), &[i32::MIN, i32::MAX]).unwrap();
        assert_eq!(
            (extreme.values(), extreme.clamped_values()),
            (&[-1000, 1000][..], 2)
        );
    }

    #[test]
    fn a_frame_is_written_for_the_wire_and_for_people() {
        let frame = Frame::new(motor(), &[50, -50]).unwrap();
        assert_eq!(format!("{frame}"), "06 00050 -0050");
        assert_eq!(format!("{frame:#}"), "motor left=50 right=-50");
        assert_eq!(format!("{frame:?}"), "Command(06 00050 -0050)");
        assert_eq!((frame.value("right"), frame.value("up")), (Some(-50), None));
    }

    #[test]
    fn a_frame_has_the_values_that_its_command_takes() {
        let fault = Frame::new(motor(), &[1]).unwrap_err();
        assert_eq!(
            fault,
            FrameFault::Count {
                name: "motor",
                takes: 2,
                given: 1
            }
        );
        assert_eq!(format!("{fault}"), "`motor` takes 2 values, not 1");
        let fault = Frame::reply(motor(), &[]).unwrap_err();
        assert_eq!(format!("{fault}"), "`motor` has no reply");
    }

    #[test]
    fn a_command_of_no_table_is_held_to_what_a_frame_can_hold() {
        static WIDE: Command = Command {
            code: Code::GOTO,
            name: "wide",
            parameters: Some(&[Parameter::new("x", i32::MIN, i32::MAX)]),
            reply: Some(&[Parameter::new("x", 0, 1); 9]),
        };
        assert_eq!(Frame::new(&WIDE, &[i32::MAX]).unwrap().values(), [99_999]);
        assert!(Frame::reply(&WIDE, &[0; 9]).is_err());
    }
}
