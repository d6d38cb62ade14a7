//! Which commands there are, and of what parameters: the paper's four (W4), and tables of others.

use core::fmt;

use crate::number::{CODE, GROUP, HIGHEST, LOWEST};
use crate::{LONGEST, MOST};

/// The two digits that begin a frame: 0 to 99.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Code(u8);

impl Code {
    /// `00`: the robot says the same (W8).
    pub const NULL: Code = Code(0);
    /// `04`: the robot says how it is, as a bit mask.
    pub const STATUS: Code = Code(4);
    /// `06`: the speeds of both motors.
    pub const MOTOR: Code = Code(6);
    /// `07`: the lights.
    pub const LEDS: Code = Code(7);
    /// `10`, of our own robots: drive there, instead of what was queued.
    pub const GOTO: Code = Code(10);
    /// `11`, of our own robots: drive there after what is queued (W17).
    pub const VIA: Code = Code(11);
    /// `12`, of our own robots: the robot says where it is.
    pub const POSE: Code = Code(12);
    /// `90`, of our own robots: the robot says, unasked, who holds it.
    pub const HOLDER: Code = Code(90);

    /// How many codes two digits make.
    const ALL: usize = 100;

    /// The code of a number, `None` for more than 99.
    #[must_use]
    pub const fn new(number: u8) -> Option<Code> {
        if number as usize >= Code::ALL {
            return None;
        }
        Some(Code(number))
    }

    /// Its number, 0 to 99.
    #[must_use]
    pub const fn number(self) -> u8 {
        self.0
    }
}

/// Two digits, as on the wire.
impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:02}", self.0)
    }
}

/// One parameter of a command or of a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameter {
    /// A word: lower-case letters, digits and `-`, a letter first.
    pub name: &'static str,
    /// The lowest value; values below become it.
    pub min: i32,
    /// The highest value; values above become it.
    pub max: i32,
}

impl Parameter {
    /// A parameter of a name and of the values from `min` to `max`.
    #[must_use]
    pub const fn new(name: &'static str, min: i32, max: i32) -> Parameter {
        Parameter { name, min, max }
    }

    /// The value nearest to `value` that the parameter can have. Whatever the bounds are, `%05d` can hold it.
    #[must_use]
    pub fn clamp(&self, value: i32) -> i32 {
        value.min(self.max).max(self.min).clamp(LOWEST, HIGHEST)
    }
}

/// Who speaks: both directions use the same codes, with parameters of their own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Direction {
    /// The base station to the robot.
    Command,
    /// The robot to the base station.
    Reply,
}

/// An entry of a table: what one code means in each direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Command {
    /// What begins its frames.
    pub code: Code,
    /// A word: lower-case letters, digits and `-`, a letter first.
    pub name: &'static str,
    /// The parameters of the command; `None` if a base station never says it, but robots do, unasked.
    pub parameters: Option<&'static [Parameter]>,
    /// The parameters of the reply; `None` if there is no reply.
    pub reply: Option<&'static [Parameter]>,
}

/// The paper's commands, for tables that begin with them (W4, W5, W6).
impl Command {
    /// Are you there? The reply is the same.
    pub const NULL: Command = Command {
        code: Code::NULL,
        name: "null",
        parameters: Some(&[]),
        reply: Some(&[]),
    };
    /// How is it? A bit mask, whose bits are the robot's own: the paper gives none (W6).
    pub const STATUS: Command = Command {
        code: Code::STATUS,
        name: "status",
        parameters: Some(&[]),
        reply: Some(&[Parameter::new("bits", 0, HIGHEST)]),
    };
    /// The speeds of both motors. There is no reply.
    pub const MOTOR: Command = Command {
        code: Code::MOTOR,
        name: "motor",
        parameters: Some(&[
            Parameter::new("left", -1000, 1000),
            Parameter::new("right", -1000, 1000),
        ]),
        reply: None,
    };
    /// Which lights are on: a bit for each. There is no reply.
    pub const LEDS: Command = Command {
        code: Code::LEDS,
        name: "leds",
        parameters: Some(&[Parameter::new("data", 0, 255)]),
        reply: None,
    };
}

impl Command {
    /// The parameters in one direction, `None` if there is no frame of this code in it.
    #[must_use]
    pub const fn said(&self, direction: Direction) -> Option<&'static [Parameter]> {
        match direction {
            Direction::Command => self.parameters,
            Direction::Reply => self.reply,
        }
    }

    /// The bytes of its frame in one direction (W7), `None` if there is no such frame.
    #[must_use]
    pub fn length(&self, direction: Direction) -> Option<usize> {
        let parameters = self.said(direction)?;
        Some((CODE + parameters.len() * GROUP).min(LONGEST))
    }

    /// Whether robots say it unasked, and base stations never.
    #[must_use]
    pub const fn is_reply_only(&self) -> bool {
        self.parameters.is_none()
    }
}

/// A checked set of commands.
///
/// All is `'static`, so that a table costs a microcontroller no memory but its constants.
#[derive(Clone, Copy)]
pub struct Table {
    commands: &'static [Command],
    /// For each code the place in `commands`, or `NOWHERE`.
    index: [u8; Code::ALL],
}

const NOWHERE: u8 = u8::MAX;

/// The four commands of the paper (W4, W5, W6).
pub static PAPER: Table = match Table::new(&[Command::NULL, Command::STATUS, Command::MOTOR, Command::LEDS]) {
    Ok(table) => table,
    Err(_) => panic!("the paper's commands are a table"),
};

/// Why commands are no table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum TableFault {
    /// Two commands have this code.
    CodeTwice(Code),
    /// A name of a command is not a word, or two commands have it.
    Name(&'static str),
    /// A name of a parameter is not a word, or two parameters of one frame have it.
    ParameterName(&'static str),
    /// This command has neither parameters nor a reply, so nobody can say it.
    NeverSaid(Code),
    /// A command or reply of this code has more than [`MOST`] parameters.
    TooMany(Code),
    /// This parameter can have no value, or one that `%05d` cannot hold.
    Range(&'static str),
}

impl fmt::Display for TableFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::CodeTwice(code) => write!(f, "two commands have the code {code}"),
            Self::Name(name) => write!(f, "the command `{name}` needs a word of its own as its name"),
            Self::ParameterName(name) => {
                write!(f, "the parameter `{name}` needs a word of its own as its name")
            }
            Self::NeverSaid(code) => write!(f, "{code} is neither a command nor a reply"),
            Self::TooMany(code) => write!(f, "{code} has more than {MOST} parameters"),
            Self::Range(name) => {
                write!(
                    f,
                    "`{name}` needs a range within {LOWEST} to {HIGHEST}, the lowest first"
                )
            }
        }
    }
}

impl core::error::Error for TableFault {}

impl Table {
    /// Checks commands. In a constant, a fault can stop the compiler:
    ///
    /// ```
    /// use mom_brs::{Code, Command, Parameter, Table};
    ///
    /// const BEEP: Command = Command {
    ///     code: Code::new(20).unwrap(),
    ///     name: "beep",
    ///     parameters: Some(&[Parameter::new("hertz", 20, 20_000)]),
    ///     reply: None,
    /// };
    /// static ROBOT: Table = match Table::new(&[Command::NULL, Command::MOTOR, BEEP]) {
    ///     Ok(table) => table,
    ///     Err(_) => panic!("not a table"),
    /// };
    /// assert_eq!(ROBOT.command("beep").map(|beep| beep.code), Code::new(20));
    /// ```
    ///
    /// # Errors
    ///
    /// The first fault.
    pub const fn new(commands: &'static [Command]) -> Result<Table, TableFault> {
        let mut index = [NOWHERE; Code::ALL];
        let mut at = 0;
        while at < commands.len() {
            let command = &commands[at];
            let code = command.code;
            // A code found twice ends this, so `at` stays below the number of codes.
            if index[code.0 as usize] != NOWHERE {
                return Err(TableFault::CodeTwice(code));
            }
            index[code.0 as usize] = at as u8;
            if !is_word(command.name) || position(commands, command.name) != at {
                return Err(TableFault::Name(command.name));
            }
            if command.parameters.is_none() && command.reply.is_none() {
                return Err(TableFault::NeverSaid(code));
            }
            if let Some(fault) = parameters_fault(code, command.parameters) {
                return Err(fault);
            }
            if let Some(fault) = parameters_fault(code, command.reply) {
                return Err(fault);
            }
            at += 1;
        }
        Ok(Table { commands, index })
    }

    /// All commands, in the order in which they were given.
    #[must_use]
    pub const fn commands(&self) -> &'static [Command] {
        self.commands
    }

    /// The command of a code.
    #[must_use]
    pub fn get(&self, code: Code) -> Option<&'static Command> {
        let at = self.index.get(usize::from(code.0))?;
        self.commands.get(usize::from(*at))
    }

    /// The command of a name, in capitals or not.
    #[must_use]
    pub fn command(&self, name: &str) -> Option<&'static Command> {
        let mut commands = self.commands.iter();
        commands.find(|command| command.name.eq_ignore_ascii_case(name))
    }
}

impl fmt::Debug for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.commands).finish()
    }
}

/// Two tables of the same commands in the same order are the same table.
impl PartialEq for Table {
    fn eq(&self, other: &Table) -> bool {
        self.commands == other.commands
    }
}

impl Eq for Table {}

/// Lower-case letters, digits and `-`, a letter first.
pub(crate) const fn is_word(name: &str) -> bool {
    let bytes = name.as_bytes();
    let mut at = 0;
    while at < bytes.len() {
        let good = match bytes[at] {
            b'a'..=b'z' => true,
            b'0'..=b'9' | b'-' => at > 0,
            _ => false,
        };
        if !good {
            return false;
        }
        at += 1;
    }
    !bytes.is_empty()
}

/// Whether a parameter can have these bounds.
pub(crate) const fn is_range(min: i32, max: i32) -> bool {
    LOWEST <= min && min <= max && max <= HIGHEST
}

const fn parameters_fault(code: Code, parameters: Option<&'static [Parameter]>) -> Option<TableFault> {
    let Some(parameters) = parameters else {
        return None;
    };
    if parameters.len() > MOST {
        return Some(TableFault::TooMany(code));
    }
    let mut at = 0;
    while at < parameters.len() {
        let parameter = &parameters[at];
        let mut first = 0;
        while !same(parameters[first].name, parameter.name) {
            first += 1;
        }
        if !is_word(parameter.name) || first != at {
            return Some(TableFault::ParameterName(parameter.name));
        }
        if !is_range(parameter.min, parameter.max) {
            return Some(TableFault::Range(parameter.name));
        }
        at += 1;
    }
    None
}

/// The first command of a name that one of them has.
const fn position(commands: &[Command], name: &str) -> usize {
    let mut at = 0;
    while !same(commands[at].name, name) {
        at += 1;
    }
    at
}

/// Equality of texts, for constants.
const fn same(one: &str, other: &str) -> bool {
    let (one, other) = (one.as_bytes(), other.as_bytes());
    if one.len() != other.len() {
        return false;
    }
    let mut at = 0;
    while at < one.len() {
        if one[at] != other[at] {
            return false;
        }
        at += 1;
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: Command = Command {
        code: Code(20),
        name: "one",
        parameters: Some(&[]),
        reply: None,
    };
    const X: Parameter = Parameter::new("x", 0, 1);

    fn fault(commands: &'static [Command]) -> TableFault {
        Table::new(commands).unwrap_err()
    }

    #[test]
    fn codes_have_two_digits() {
        assert_eq!(Code::new(99).map(Code::number), Some(99));
        assert_eq!(Code::new(100), None);
        assert_eq!(std::format!("{}", Code::STATUS), "04");
    }

    #[test]
    fn the_lengths_of_the_paper_follow_from_the_codes() {
        let length = |name, direction| PAPER.command(name).and_then(|command| command.length(direction));
        let names = ["null", "status", "motor", "leds"];
        assert_eq!(
            names.map(|name| length(name, Direction::Command)),
            [2, 2, 14, 8].map(Some)
        );
        assert_eq!(
            names.map(|name| length(name, Direction::Reply)),
            [Some(2), Some(8), None, None]
        );
    }

    #[test]
    fn commands_are_found_by_code_and_by_name() {
        assert_eq!(PAPER.get(Code::MOTOR).map(|motor| motor.name), Some("motor"));
        assert_eq!(PAPER.get(Code::GOTO), None);
        assert_eq!(PAPER.command("LEDS").map(|leds| leds.code), Some(Code::LEDS));
        assert_eq!(PAPER.command("led"), None);
    }

    #[test]
    fn a_code_is_used_once() {
        const SAME: Command = Command { name: "two", ..ONE };
        assert_eq!(fault(&[ONE, SAME]), TableFault::CodeTwice(Code(20)));
    }

    #[test]
    fn a_name_is_a_word_and_used_once() {
        const SAME: Command = Command {
            code: Code(21),
            ..ONE
        };
        const LOUD: Command = Command { name: "One", ..ONE };
        const EMPTY: Command = Command { name: "", ..ONE };
        const DIGIT: Command = Command { name: "1st", ..ONE };
        assert_eq!(fault(&[ONE, SAME]), TableFault::Name("one"));
        assert_eq!(fault(&[LOUD]), TableFault::Name("One"));
        assert_eq!(fault(&[EMPTY]), TableFault::Name(""));
        assert_eq!(fault(&[DIGIT]), TableFault::Name("1st"));
        assert!(is_word("a-1"));
    }

    #[test]
    fn somebody_says_each_command() {
        const MUTE: Command = Command {
            parameters: None,
            ..ONE
        };
        assert_eq!(fault(&[MUTE]), TableFault::NeverSaid(Code(20)));
        const UNASKED: Command = Command {
            reply: Some(&[X]),
            ..MUTE
        };
        let table = Table::new(&[UNASKED]).unwrap();
        let command = table.get(Code(20)).unwrap();
        assert!(command.is_reply_only());
        assert_eq!(command.length(Direction::Command), None);
        assert_eq!(command.length(Direction::Reply), Some(8));
    }

    #[test]
    fn parameters_are_at_most_eight_with_names_and_ranges() {
        const fn of(parameters: &'static [Parameter]) -> Command {
            Command {
                reply: Some(parameters),
                ..ONE
            }
        }
        const TWICE: Command = of(&[X, X]);
        const LOUD: Command = of(&[Parameter::new("X", 0, 1)]);
        const EMPTY: Command = of(&[Parameter::new("x", 1, 0)]);
        const LOW: Command = of(&[Parameter::new("x", LOWEST - 1, 0)]);
        const HIGH: Command = of(&[Parameter::new("x", 0, HIGHEST + 1)]);
        const NINE: Command = of(&[X; 9]);
        assert_eq!(fault(&[TWICE]), TableFault::ParameterName("x"));
        assert_eq!(fault(&[LOUD]), TableFault::ParameterName("X"));
        for command in [&[EMPTY], &[LOW], &[HIGH]] as [&'static [Command]; 3] {
            assert_eq!(fault(command), TableFault::Range("x"));
        }
        assert_eq!(fault(&[NINE]), TableFault::TooMany(Code(20)));
    }
}
