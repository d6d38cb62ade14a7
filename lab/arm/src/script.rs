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
//! | `jog vx vy vz vspin vtilt` | moves the hand at this velocity for 200 ms: mm/s and degrees/s; a sixth number says for how many ms, 1000
//! at most |
//! | `home` | moves the hand to [`HOME`](crate::pose::HOME) |
//! | `reset` | puts hand, jaws and blocks back to where they were at the start, at once: this arm is simulated |
//!
//! A `jog` stands alone in its script. It does not wait: another one takes its place, and it is refused while the arm does something else.
//!
//! Statements take effect in the order written, each complete before the next begins. A waypoint of
//! the papers, gripper first and then the move (M51), is written `grip close; move …`.

use std::fmt;
use std::str::FromStr;

use mom_device::DeviceError;

use crate::action::{Action, check_jogs};
use crate::machine::ArmMachine;

pub use mom_device::{MAX_BYTES, MAX_STATEMENTS, MAX_WAIT};

/// One statement of a script.
pub type Statement = mom_device::Statement<Action>;

/// A script: between 1 and [`MAX_STATEMENTS`] statements.
///
/// Its `Display` is a script that reads back as the same statements.
///
/// ```
/// use mom_arm::Script;
///
/// let script: Script = "move 100 50 200 0 0\ngrip close # got it".parse()?;
/// assert_eq!(script.to_string(), "move 100 50 200 0 0; grip close");
/// # Ok::<(), mom_device::DeviceError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Script(mom_device::Script<Action>);

impl Script {
    /// The statements, in the order in which they take effect.
    #[must_use]
    pub fn statements(&self) -> &[Statement] {
        self.0.statements()
    }

    /// Whether it says of a motion only how far it goes from where the hand is at the beginning, so that it is wrong from anywhere else
    /// (M35).
    #[must_use]
    pub fn is_relative(&self) -> bool {
        self.0.is_relative::<ArmMachine>()
    }

    /// As a device takes it.
    pub(crate) fn into_inner(self) -> mom_device::Script<Action> {
        self.0
    }
}

impl FromStr for Script {
    type Err = DeviceError;

    /// Reads a script.
    ///
    /// # Errors
    ///
    /// `syntax` with the statement's number, where the mistake begins, and the nearest known word where a word is unknown.
    fn from_str(text: &str) -> Result<Self, DeviceError> {
        let script = mom_device::Script::read::<ArmMachine>(text)?;
        check_jogs(&script)?;
        Ok(Self(script))
    }
}

impl fmt::Display for Script {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, statement) in self.statements().iter().enumerate() {
            if place > 0 {
                f.write_str("; ")?;
            }
            write!(f, "{statement}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use mom_device::ErrorName;
    use proptest::prelude::*;

    use super::*;
    use crate::controller::Grip;
    use crate::pose::Pose;

    #[test]
    fn reads_statements() {
        let at = |x| Statement::Do(Action::Move(Pose::new(x, 50.0, 200.0, 0.0, -4.5)));
        let close = Statement::Do(Action::Grip(Grip::Close));
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
                    Statement::Do(Action::Grip(Grip::Open)),
                    Statement::Do(Action::Home),
                    Statement::Do(Action::Reset),
                    Statement::Wait(0),
                    Statement::Wait(60_000),
                ],
            ),
        ] {
            let read = text.parse::<Script>().map(|script| script.statements().to_vec());
            assert_eq!(read, Ok(want), "{text}");
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
                .prop_map(|[x, y, z, a, b]| Statement::Do(Action::Move(Pose::new(x, y, z, a, b)))),
            proptest::array::uniform5(number)
                .prop_map(|[x, y, z, a, b]| Statement::Do(Action::By(Pose::new(x, y, z, a, b)))),
            prop_oneof![Just(Grip::Open), Just(Grip::Close)]
                .prop_map(|grip| Statement::Do(Action::Grip(grip))),
            (0..=MAX_WAIT).prop_map(Statement::Wait),
            Just(Statement::Do(Action::Home)),
        ]
    }

    proptest! {
        #[test]
        fn display_reads_back(statements in proptest::collection::vec(statement(), 1..50)) {
            let text = statements.iter().map(Statement::to_string).collect::<Vec<_>>().join(";\n");
            let script = text.parse::<Script>().unwrap();
            prop_assert_eq!(script.statements(), statements);
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
