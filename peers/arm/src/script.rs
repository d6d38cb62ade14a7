//! Command scripts (M47): reading them and writing them.
//!
//! Statements are separated by `;` or by a new line; `#` begins a comment that lasts to the end of
//! its line. Words are lower case; numbers are decimal, with an exponent if wanted.
//!
//! | statement | does |
//! |---|---|
//! | `move x y z spin tilt` | moves the hand there by the path rule (M52): mm and degrees |
//! | `by dx dy dz dspin dtilt` | moves it there from where it is then |
//! | `grip open`, `grip close` | moves the jaws |
//! | `wait ms` | waits, 0 to 60 000 ms |
//! | `jog vx vy vz vspin vtilt` | moves the hand at this velocity for 200 ms: mm/s and degrees/s; a sixth number says for how many ms, 1000 at most |
//! | `home` | moves the hand to [`HOME`](crate::arm::HOME) |
//! | `reset` | puts hand, jaws and blocks back to where they were at the start, at once: this arm is simulated |
//!
//! A `jog` stands alone in its script. It does not wait: another one takes its place, and it is refused while the arm does something else.
//!
//! Statements take effect in the order written, each complete before the next begins. A waypoint of
//! the papers, gripper first and then the move (M51), is written `grip close; move …`.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::error::{ArmError, ErrorName};
use crate::jog::{self, Velocity};
use crate::pose::Pose;

/// The longest script, in bytes.
pub const MAX_BYTES: usize = 64 * 1024;
/// The most statements of a script.
pub const MAX_STATEMENTS: usize = 1000;
/// The longest `wait`, in ms.
pub const MAX_WAIT: u32 = 60_000;

/// A command to the jaws.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Grip {
    /// As far apart as they go; what they held falls.
    Open,
    /// Together, or until they hold something.
    Close,
}

/// One statement of a script.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Statement {
    /// Move the hand to a pose.
    Move(Pose),
    /// Move the hand by so much; the numbers of a pose are differences here.
    By(Pose),
    /// Move the jaws.
    Grip(Grip),
    /// Wait for so many ms.
    Wait(u32),
    /// Move the hand at a velocity for so many ms.
    Jog(Velocity, u32),
    /// Move the hand to its home pose.
    Home,
    /// Put everything back to where it was at the start.
    Reset,
}

/// A script: between 1 and [`MAX_STATEMENTS`] statements.
///
/// Its `Display` is a script that reads back as the same statements.
///
/// ```
/// use mom_arm::Script;
///
/// let script: Script = "move 100 50 200 0 0\ngrip close # got it".parse()?;
/// assert_eq!(script.to_string(), "move 100 50 200 0 0; grip close");
/// # Ok::<(), mom_arm::ArmError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Script(Vec<Statement>);

impl Script {
    /// The statements, in the order in which they take effect.
    #[must_use]
    pub fn statements(&self) -> &[Statement] {
        &self.0
    }
}

impl FromStr for Script {
    type Err = ArmError;

    /// Reads a script.
    ///
    /// # Errors
    ///
    /// [`ErrorName::Syntax`] with the statement's number, where the mistake begins, and
    /// the nearest known word where a word is unknown.
    fn from_str(text: &str) -> Result<Self, ArmError> {
        Self::read(text).map_err(|error| error.in_text(text))
    }
}

impl Script {
    /// Whether it says of a motion only how far it goes from where the hand is at the beginning, so that it is wrong from anywhere else (M35).
    #[must_use]
    pub fn is_relative(&self) -> bool {
        let motions = self.0.iter().find(|statement| {
            matches!(
                statement,
                Statement::Move(_) | Statement::Home | Statement::Reset | Statement::By(_)
            )
        });
        matches!(motions, Some(Statement::By(_)))
    }

    fn read(text: &str) -> Result<Self, ArmError> {
        if text.len() > MAX_BYTES {
            let length = text.len();
            return Err(syntax(
                MAX_BYTES,
                format!("the script has {length} bytes, at most {MAX_BYTES} are read"),
            ));
        }
        let mut statements = Vec::new();
        for mut words in split(text) {
            let Some(verb) = words.next() else { continue };
            let number = statements.len() + 1;
            if number > MAX_STATEMENTS {
                let text = format!("the script has more than {MAX_STATEMENTS} statements");
                return Err(syntax(verb.at, text));
            }
            let statement = Statement::read(verb, &mut words)
                .and_then(|statement| words.expect_end(verb.text).map(|()| statement));
            let number = u32::try_from(number).expect("at most MAX_STATEMENTS");
            statements.push(statement.map_err(|error| error.at_statement(number))?);
        }
        if statements.len() > 1
            && let Some(place) = statements
                .iter()
                .position(|one| matches!(one, Statement::Jog(..)))
        {
            let number = u32::try_from(place + 1).unwrap_or(u32::MAX);
            return Err(syntax(0, "`jog` stands alone in its script").at_statement(number));
        }
        if statements.is_empty() {
            return Err(syntax(0, "the script has no statement"));
        }
        Ok(Self(statements))
    }
}

impl fmt::Display for Script {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, statement) in self.0.iter().enumerate() {
            if place > 0 {
                f.write_str("; ")?;
            }
            write!(f, "{statement}")?;
        }
        Ok(())
    }
}

const VERBS: &[&str] = &["move", "by", "grip", "wait", "jog", "home", "reset"];
const GRIPS: &[&str] = &["open", "close"];

impl Statement {
    fn read(verb: Word<'_>, words: &mut Words<'_>) -> Result<Self, ArmError> {
        match verb.text {
            "move" => {
                let mut number = |which| words.number("move", "five numbers, x y z spin tilt", which);
                Ok(Self::Move(Pose {
                    x: number("x")?,
                    y: number("y")?,
                    z: number("z")?,
                    spin: number("spin")?,
                    tilt: number("tilt")?,
                }))
            }
            "by" => {
                let mut number = |which| words.number("by", "five numbers, dx dy dz dspin dtilt", which);
                Ok(Self::By(Pose {
                    x: number("dx")?,
                    y: number("dy")?,
                    z: number("dz")?,
                    spin: number("dspin")?,
                    tilt: number("dtilt")?,
                }))
            }
            "grip" => match words.need("grip", "`open` or `close`", "it")? {
                Word { text: "open", .. } => Ok(Self::Grip(Grip::Open)),
                Word { text: "close", .. } => Ok(Self::Grip(Grip::Close)),
                other => Err(unknown(other, GRIPS)),
            },
            "wait" => {
                let word = words.need("wait", "a time in ms", "it")?;
                match word.text.parse::<u32>() {
                    Ok(ms) if ms <= MAX_WAIT => Ok(Self::Wait(ms)),
                    _ => Err(syntax(
                        word.at,
                        format!(
                            "`wait` takes a whole number of ms from 0 to {MAX_WAIT}, not `{}`",
                            word.short()
                        ),
                    )),
                }
            }
            "jog" => Self::read_jog(words),
            "home" => Ok(Self::Home),
            "reset" => Ok(Self::Reset),
            _ => Err(unknown(verb, VERBS)),
        }
    }
}

impl Statement {
    fn read_jog(words: &mut Words<'_>) -> Result<Self, ArmError> {
        let at = words.at;
        let mut number = |which| words.number("jog", "five velocities, vx vy vz vspin vtilt", which);
        let velocity = Velocity::of([
            number("vx")?,
            number("vy")?,
            number("vz")?,
            number("vspin")?,
            number("vtilt")?,
        ]);
        velocity.check().map_err(|error| error.at_position(at))?;
        let ms = match words.next() {
            None => jog::DEFAULT_MS,
            Some(word) => match word.text.parse() {
                Ok(ms @ 1..=jog::MOST_MS) => ms,
                _ => {
                    let text = format!(
                        "`jog` lasts a whole number of ms from 1 to {}, not `{}`",
                        jog::MOST_MS,
                        word.short()
                    );
                    return Err(syntax(word.at, text));
                }
            },
        };
        Ok(Self::Jog(velocity, ms))
    }
}

/// Numbers, each behind a blank.
fn write_numbers(f: &mut fmt::Formatter<'_>, numbers: [f64; 5]) -> fmt::Result {
    numbers.into_iter().try_for_each(|value| {
        // Debug writes very large and very small numbers with an exponent, Display never does.
        let plain = value == 0.0 || (1e-5..1e15).contains(&value.abs());
        if plain {
            write!(f, " {value}")
        } else {
            write!(f, " {value:?}")
        }
    })
}

impl fmt::Display for Statement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Move(pose) => {
                f.write_str("move")?;
                write_numbers(f, [pose.x, pose.y, pose.z, pose.spin, pose.tilt])
            }
            Self::By(pose) => {
                f.write_str("by")?;
                write_numbers(f, [pose.x, pose.y, pose.z, pose.spin, pose.tilt])
            }
            Self::Jog(velocity, ms) => {
                f.write_str("jog")?;
                write_numbers(f, velocity.numbers())?;
                write!(f, " {ms}")
            }
            Self::Grip(Grip::Open) => f.write_str("grip open"),
            Self::Grip(Grip::Close) => f.write_str("grip close"),
            Self::Wait(ms) => write!(f, "wait {ms}"),
            Self::Home => f.write_str("home"),
            Self::Reset => f.write_str("reset"),
        }
    }
}

/// A word and the byte at which it begins.
#[derive(Clone, Copy)]
struct Word<'a> {
    text: &'a str,
    at: usize,
}

impl Word<'_> {
    /// The word for an error's text, shortened.
    fn short(&self) -> String {
        let mut short: String = self.text.chars().take(24).collect();
        if short.len() < self.text.len() {
            short.push('…');
        }
        short
    }
}

/// The words of one statement that are still to be read.
struct Words<'a> {
    rest: &'a str,
    at: usize,
}

impl<'a> Iterator for Words<'a> {
    type Item = Word<'a>;

    fn next(&mut self) -> Option<Word<'a>> {
        let trimmed = self.rest.trim_start();
        self.at += self.rest.len() - trimmed.len();
        let end = trimmed.find(char::is_whitespace).unwrap_or(trimmed.len());
        let word = Word {
            text: &trimmed[..end],
            at: self.at,
        };
        self.rest = &trimmed[end..];
        self.at += end;
        (end > 0).then_some(word)
    }
}

impl<'a> Words<'a> {
    fn need(&mut self, verb: &str, takes: &str, which: &str) -> Result<Word<'a>, ArmError> {
        self.next()
            .ok_or_else(|| syntax(self.at, format!("`{verb}` takes {takes}; {which} is missing")))
    }

    fn number(&mut self, verb: &str, takes: &str, which: &str) -> Result<f64, ArmError> {
        let word = self.need(verb, takes, which)?;
        // `parse` also takes `inf` and `nan`, and makes an infinity of what is too large.
        match word.text.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(syntax(
                word.at,
                format!("{which} is `{}`, which is not a number", word.short()),
            )),
        }
    }

    fn expect_end(&mut self, verb: &str) -> Result<(), ArmError> {
        match self.next() {
            None => Ok(()),
            Some(word) => Err(syntax(
                word.at,
                format!(
                    "`{verb}` ends before `{}`; is a `;` or a new line missing?",
                    word.short()
                ),
            )),
        }
    }
}

/// The statements of a script as words, without their comments; some may have no word.
fn split(text: &str) -> impl Iterator<Item = Words<'_>> {
    let offset = move |part: &str| part.as_ptr() as usize - text.as_ptr() as usize;
    text.split('\n').flat_map(move |line| {
        let code = line.split_once('#').map_or(line, |(code, _comment)| code);
        code.split(';').map(move |rest| Words {
            rest,
            at: offset(rest),
        })
    })
}

fn syntax(at: usize, text: impl Into<String>) -> ArmError {
    ArmError::new(ErrorName::Syntax, text).at_position(at)
}

fn unknown(word: Word<'_>, known: &[&'static str]) -> ArmError {
    let nearest = known
        .iter()
        .min_by_key(|candidate| edits(&word.text.to_lowercase(), candidate))
        .expect("every list of known words has some");
    syntax(
        word.at,
        format!("there is no `{}`; did you mean `{nearest}`?", word.short()),
    )
    .with_nearest(nearest)
}

/// How many letters must be changed, added or left out to make one word of the other.
fn edits(word: &str, known: &str) -> usize {
    let known: Vec<char> = known.chars().collect();
    let mut row: Vec<usize> = (0..=known.len()).collect();
    for (place, letter) in word.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = place + 1;
        for (column, other) in known.iter().enumerate() {
            let changed = diagonal + usize::from(letter != *other);
            diagonal = row[column + 1];
            row[column + 1] = changed.min(diagonal + 1).min(row[column] + 1);
        }
    }
    row[known.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn reads_statements() {
        let at = |x| Statement::Move(Pose::new(x, 50.0, 200.0, 0.0, -4.5));
        let close = Statement::Grip(Grip::Close);
        for (text, want) in [
            ("move 100 50 200 0 -4.5; grip close", vec![at(100.0), close]),
            (
                "\n;; move 1e2 +50 2e+2 -0 -4.5\r\n;grip\tclose;",
                vec![at(100.0), close],
            ),
            ("# nothing; move\n grip close# move", vec![close]),
            (
                "grip open\nhome;reset;wait 0; wait 60000",
                vec![
                    Statement::Grip(Grip::Open),
                    Statement::Home,
                    Statement::Reset,
                    Statement::Wait(0),
                    Statement::Wait(60_000),
                ],
            ),
        ] {
            assert_eq!(text.parse::<Script>().map(|script| script.0), Ok(want), "{text}");
        }
    }

    #[test]
    fn refuses_with_statement_position_and_nearest_word() {
        for (text, statement, position, nearest, words) in [
            ("", None, 0, None, "no statement"),
            (" # home\n ; ", None, 0, None, "no statement"),
            (
                "mvoe 1 2 3 4 5",
                Some(1),
                0,
                Some("move"),
                "no `mvoe`; did you mean `move`",
            ),
            ("home;\n  GRIP open", Some(2), 8, Some("grip"), "no `GRIP`"),
            (
                "# é\ngrip closed",
                Some(1),
                10,
                Some("close"),
                "did you mean `close`",
            ),
            ("grip", Some(1), 4, None, "missing"),
            ("grip open close", Some(1), 10, None, "`grip` ends before `close`"),
            ("move 1 2 3 4", Some(1), 12, None, "tilt is missing"),
            ("move 1 2 3 4;home", Some(1), 12, None, "tilt is missing"),
            ("move 1 2 3 4 5 6", Some(1), 15, None, "ends before `6`"),
            (
                "move 1, 2 3 4 5",
                Some(1),
                5,
                None,
                "x is `1,`, which is not a number",
            ),
            ("move 1 inf 3 4 5", Some(1), 7, None, "y is `inf`"),
            ("move 1 2 NaN 4 5", Some(1), 9, None, "z is `NaN`"),
            ("move 1 2 3 1e999 5", Some(1), 11, None, "spin is `1e999`"),
            ("wait 60001", Some(1), 5, None, "0 to 60000"),
            ("wait -1", Some(1), 5, None, "0 to 60000"),
            ("wait 1.5", Some(1), 5, None, "0 to 60000"),
            ("home now", Some(1), 5, None, "ends before `now`"),
        ] {
            let error = text.parse::<Script>().expect_err(text);
            assert_eq!(error.name(), ErrorName::Syntax);
            assert_eq!(
                (error.statement(), error.position(), error.nearest()),
                (statement, Some(position), nearest),
                "{text}: {error}"
            );
            assert!(error.text().contains(words), "{text}: {error}");
        }
    }

    #[test]
    fn is_bounded() {
        assert!("home;".repeat(MAX_STATEMENTS).parse::<Script>().is_ok());
        let error = "home;".repeat(MAX_STATEMENTS + 1).parse::<Script>().unwrap_err();
        assert_eq!(error.position(), Some(5 * MAX_STATEMENTS));
        let padded = |length: usize| format!("home{}", " ".repeat(length - 4));
        assert!(padded(MAX_BYTES).parse::<Script>().is_ok());
        assert!(padded(MAX_BYTES + 1).parse::<Script>().is_err());
        let error = "x".repeat(MAX_BYTES).parse::<Script>().unwrap_err();
        assert!(error.text().len() < 200, "{error}");
    }

    fn statement() -> impl Strategy<Value = Statement> {
        let number = prop_oneof![
            -400.0..400.0_f64,
            Just(0.0),
            Just(-0.0),
            proptest::num::f64::NORMAL
        ];
        prop_oneof![
            proptest::array::uniform5(number.clone())
                .prop_map(|[x, y, z, a, b]| Statement::Move(Pose::new(x, y, z, a, b))),
            proptest::array::uniform5(number)
                .prop_map(|[x, y, z, a, b]| Statement::By(Pose::new(x, y, z, a, b))),
            prop_oneof![Just(Grip::Open), Just(Grip::Close)].prop_map(Statement::Grip),
            (0..=MAX_WAIT).prop_map(Statement::Wait),
            Just(Statement::Home),
        ]
    }

    proptest! {
        #[test]
        fn display_reads_back(statements in proptest::collection::vec(statement(), 1..50)) {
            let script = Script(statements);
            prop_assert_eq!(script.to_string().parse::<Script>(), Ok(script));
        }

        #[test]
        fn no_text_panics_and_positions_lie_within_it(text in "(move|grip|open|wait|[0-9.eE+-]|[ ;#\n]|é|.){0,40}") {
            match text.parse::<Script>() {
                Ok(script) => prop_assert_eq!(script.to_string().parse::<Script>(), Ok(script)),
                Err(error) => prop_assert!(text.is_char_boundary(error.position().unwrap())),
            }
        }
    }
}
