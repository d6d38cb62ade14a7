//! Errors of the arm (M53): a code word, the controller's number, and a text.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::pose::Pose;

/// The stable code words of the arm's errors.
///
/// The first six are those of M53. Each has a number of the controller ([`ErrorName::code`]); the
/// numbers lie above 5000, clear of the hub's own table (100 to 499).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum ErrorName {
    /// The script cannot be read.
    Syntax,
    /// A pose lies outside the workspace (M50).
    WorkspaceBoundary,
    /// The link between the program and the controller failed, or one of the two fell silent, and the arm stopped.
    Link,
    /// The hand lines up with the forearm, or the forearm with the upper arm: a small move would need a fast turn.
    Singularity,
    /// A joint would have to bend or reach further than it can.
    JointLimit,
    /// The motors were overloaded by a contact, which has no other sensor (M49).
    TorqueOverload,
    /// The command was ended before its end, or never begun, because the arm was halted.
    Halted,
    /// The arm is stopped and takes no command until it is released.
    Stopped,
    /// Too many commands are waiting.
    QueueFull,
    /// A command of this id is still waiting or executing.
    DuplicateId,
    /// The token has changed hands, and the arm has not said yet that it stands.
    ChangingHands,
    /// The arm carries out something else that this cannot wait for.
    Busy,
    /// The command is older than it may be when it is used.
    TooOld,
    /// A relative command does not name the state that it is based on.
    NoState,
    /// The way leads through a zone that the commander does not own (M40).
    ZoneNotOwned,
}

impl ErrorName {
    /// Every name, in the order of the controller's numbers.
    pub const ALL: [Self; 15] = [
        Self::Syntax,
        Self::WorkspaceBoundary,
        Self::Link,
        Self::Singularity,
        Self::JointLimit,
        Self::TorqueOverload,
        Self::Halted,
        Self::Stopped,
        Self::QueueFull,
        Self::DuplicateId,
        Self::ChangingHands,
        Self::Busy,
        Self::TooOld,
        Self::NoState,
        Self::ZoneNotOwned,
    ];

    /// The code word, as it stands on the wire.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Syntax => "syntax",
            Self::WorkspaceBoundary => "workspace-boundary",
            Self::Link => "link",
            Self::Singularity => "singularity",
            Self::JointLimit => "joint-limit",
            Self::TorqueOverload => "torque-overload",
            Self::Halted => "halted",
            Self::Stopped => "stopped",
            Self::QueueFull => "queue-full",
            Self::DuplicateId => "duplicate-id",
            Self::ChangingHands => "changing-hands",
            Self::Busy => "busy",
            Self::TooOld => "too-old",
            Self::NoState => "no-state",
            Self::ZoneNotOwned => "zone-not-owned",
        }
    }

    /// The controller's number.
    #[must_use]
    pub const fn code(self) -> u16 {
        match self {
            Self::Syntax => 5001,
            Self::WorkspaceBoundary => 5002,
            Self::Link => 5003,
            Self::Singularity => 5004,
            Self::JointLimit => 5005,
            Self::TorqueOverload => 5006,
            Self::Halted => 5101,
            Self::Stopped => 5102,
            Self::QueueFull => 5103,
            Self::DuplicateId => 5104,
            Self::ChangingHands => 5105,
            Self::Busy => 5106,
            Self::TooOld => 5107,
            Self::NoState => 5108,
            Self::ZoneNotOwned => 5109,
        }
    }
}

impl ErrorName {
    /// Whether the same command may be taken a little later, although nothing about it changes.
    #[must_use]
    pub const fn is_retryable(self) -> bool {
        matches!(self, Self::QueueFull | Self::ChangingHands | Self::Busy)
    }
}

impl fmt::Display for ErrorName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// An error of the arm: plain words, with the code kept beside them (M53).
///
/// As `serde` content it is a map of `name`, `code`, `text` and, where they apply, `retry` (true: send the same command a
/// little later), `statement` (1 for the first), `position` (byte in the script) with its `line` and `column` (1 for the first, in characters), `nearest` (the known word meant) and
/// `reachable` (the nearest pose that the arm can reach instead, as far as one was looked for).
///
/// ```
/// use mom_arm::{ErrorName, Script};
///
/// let error = "grip open; mvoe 1 2 3 4 5".parse::<Script>().unwrap_err();
/// assert_eq!((error.name(), error.code()), (ErrorName::Syntax, 5001));
/// assert_eq!((error.statement(), error.position(), error.nearest()), (Some(2), Some(11), Some("move")));
/// assert_eq!((error.line(), error.column()), (Some(1), Some(12)));
/// assert_eq!(error.to_string(), "statement 2: there is no `mvoe`; did you mean `move`?");
/// ```
#[derive(Debug, Clone, PartialEq, thiserror::Error, Serialize, Deserialize)]
#[error("{text}")]
pub struct ArmError {
    name: ErrorName,
    code: u16,
    text: String,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    retry: bool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    statement: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    position: Option<usize>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    line: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    column: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    nearest: Option<String>,
    // Boxed, as most errors have none and an error is returned by value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    reachable: Option<Box<Pose>>,
}

impl ArmError {
    /// An error with its plain words.
    #[must_use]
    pub fn new(name: ErrorName, text: impl Into<String>) -> Self {
        Self {
            name,
            code: name.code(),
            text: text.into(),
            retry: name.is_retryable(),
            statement: None,
            position: None,
            line: None,
            column: None,
            nearest: None,
            reachable: None,
        }
    }

    /// The code word.
    #[must_use]
    pub const fn name(&self) -> ErrorName {
        self.name
    }

    /// The controller's number.
    #[must_use]
    pub const fn code(&self) -> u16 {
        self.code
    }

    /// Plain words, with the statement's number in front where there is one.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The number of the statement concerned, 1 for the first.
    #[must_use]
    pub const fn statement(&self) -> Option<u32> {
        self.statement
    }

    /// The byte of the script at which the mistake begins.
    #[must_use]
    pub const fn position(&self) -> Option<usize> {
        self.position
    }

    /// The line of the script at which the mistake begins, 1 for the first.
    #[must_use]
    pub const fn line(&self) -> Option<u32> {
        self.line
    }

    /// The character of that line at which the mistake begins, 1 for the first.
    #[must_use]
    pub const fn column(&self) -> Option<u32> {
        self.column
    }

    /// The known word that is nearest to an unknown one.
    #[must_use]
    pub fn nearest(&self) -> Option<&str> {
        self.nearest.as_deref()
    }

    /// The nearest pose that the arm can reach instead of the one that it cannot.
    #[must_use]
    pub fn reachable(&self) -> Option<&Pose> {
        self.reachable.as_deref()
    }

    /// The same error, where the same command may be taken a little later.
    #[must_use]
    pub(crate) fn with_retry(mut self) -> Self {
        self.retry = true;
        self
    }

    /// The same error, said of a statement (1 for the first).
    #[must_use]
    pub(crate) fn at_statement(mut self, statement: u32) -> Self {
        self.text = format!("statement {statement}: {}", self.text);
        self.statement = Some(statement);
        self
    }

    /// The same error, said of a byte of the script.
    #[must_use]
    pub(crate) fn at_position(mut self, position: usize) -> Self {
        self.position = Some(position);
        self
    }

    /// The same error, with the line and the column of its position in this script.
    #[must_use]
    pub(crate) fn in_text(mut self, script: &str) -> Self {
        let before = self.position.and_then(|position| script.get(..position));
        if let Some(before) = before {
            let count = |count: usize| u32::try_from(count + 1).ok();
            let last = before.rsplit('\n').next().unwrap_or_default();
            self.line = count(before.matches('\n').count());
            self.column = count(last.chars().count());
        }
        self
    }

    /// The same error, with the pose that can be reached instead.
    #[must_use]
    pub(crate) fn with_reachable(mut self, pose: Pose) -> Self {
        self.reachable = Some(Box::new(pose));
        self
    }

    /// The same error, with the pose as far as which the hand could go; also in words.
    #[must_use]
    pub(crate) fn with_way_to(mut self, pose: Pose) -> Self {
        let Pose { x, y, z, spin, tilt } = pose;
        self.text = format!(
            "{}; on this way the hand can go as far as {x} {y} {z} {spin} {tilt}",
            self.text
        );
        self.with_reachable(pose)
    }

    /// The same error, with the word that was probably meant.
    #[must_use]
    pub(crate) fn with_nearest(mut self, nearest: &str) -> Self {
        self.nearest = Some(nearest.to_owned());
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::de::IntoDeserializer;
    use serde::de::value::{Error, StrDeserializer};

    #[test]
    fn code_words_and_numbers_are_unique_and_stand_for_the_name() {
        for (place, name) in ErrorName::ALL.into_iter().enumerate() {
            let word: StrDeserializer<'_, Error> = name.as_str().into_deserializer();
            assert_eq!(ErrorName::deserialize(word), Ok(name));
            for other in &ErrorName::ALL[..place] {
                assert!(other.code() < name.code(), "{other} {name}");
            }
        }
    }

    #[test]
    fn statement_stands_in_the_words() {
        let error = ArmError::new(ErrorName::JointLimit, "too far").at_statement(3);
        assert_eq!(
            (error.to_string().as_str(), error.statement()),
            ("statement 3: too far", Some(3))
        );
    }
}
