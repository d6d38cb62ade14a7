//! Errors of devices, in the shape and with the names and numbers of the lab's arm (M53), so that its drivers read them
//! of all.

use std::fmt;

use mom_client::Value;
use serde::{Deserialize, Serialize};

/// The stable code words of a device's errors, each with a number of its own ([`ErrorName::code`]).
///
/// The numbers lie above 5000, clear of the hub's own table (100 to 499); the first six are those of M53.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum ErrorName {
    /// The script cannot be read.
    Syntax,
    /// A place lies outside of where the device can be.
    WorkspaceBoundary,
    /// The link to the device itself failed, so that nothing is known of it.
    Link,
    /// The hand lines up with the forearm, or the forearm with the upper arm: a small move would need a fast turn.
    Singularity,
    /// A joint or an axis would have to turn further than it can.
    JointLimit,
    /// The motors were overloaded by a contact, which has no other sensor (M49).
    TorqueOverload,
    /// The command was ended before its end, or never begun, because the device was halted.
    Halted,
    /// The device is stopped and takes no command until it is released.
    Stopped,
    /// Too many commands are waiting.
    QueueFull,
    /// A command of this id is still waiting or executing.
    DuplicateId,
    /// The device still moves as its old owner had it move.
    ChangingHands,
    /// The device carries out something else that this cannot wait for.
    Busy,
    /// The command is older than it may be when it begins.
    TooOld,
    /// A relative command does not name the state that it is based on.
    NoState,
    /// The way leads through a zone that the owner of the device does not own (M40).
    ZoneNotOwned,
    /// Something is in the way.
    Obstacle,
    /// The device has no energy left to do it.
    Battery,
    /// An emergency stop at the device itself is pressed: nobody but who stands beside it can reset that.
    Estop,
}

impl ErrorName {
    /// Every name, in the order of the numbers.
    pub const ALL: [Self; 18] = [
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
        Self::Obstacle,
        Self::Battery,
        Self::Estop,
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
            Self::Obstacle => "obstacle",
            Self::Battery => "battery",
            Self::Estop => "estop",
        }
    }

    /// Its number.
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
            Self::Obstacle => 5110,
            Self::Battery => 5111,
            Self::Estop => 5112,
        }
    }

    /// Whether the same command may be taken a little later, although nothing about it changes.
    #[must_use]
    pub const fn is_retryable(self) -> bool {
        matches!(self, Self::QueueFull | Self::Busy)
    }
}

impl fmt::Display for ErrorName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// An error of a device: plain words, with the code kept beside them.
///
/// As content it is a map of `name`, `code`, `text` and, where they apply, `retry`, `statement` (1 for the first), `position` (byte in
/// the script) with its `line` and `column` (1 for the first), `nearest` (the known word meant), `late` (ms since it had come to rest) and
/// `reachable` (the nearest position that the device can reach).
#[derive(Debug, Clone, PartialEq, thiserror::Error, Serialize)]
#[error("{text}")]
pub struct DeviceError {
    name: ErrorName,
    code: u16,
    text: String,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    retry: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    statement: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    position: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    line: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    column: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    nearest: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    late: Option<u32>,
    // Boxed, as most errors have none and an error is returned by value.
    #[serde(skip_serializing_if = "Option::is_none")]
    reachable: Option<Box<Value>>,
}

impl DeviceError {
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
            late: None,
            reachable: None,
        }
    }

    /// A mistake in a script, at this byte.
    #[must_use]
    pub fn syntax(position: usize, text: impl Into<String>) -> Self {
        let mut error = Self::new(ErrorName::Syntax, text);
        error.position = Some(position);
        error
    }

    /// The code word.
    #[must_use]
    pub const fn name(&self) -> ErrorName {
        self.name
    }

    /// The number of the code word.
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

    /// The known word that is nearest to an unknown one.
    #[must_use]
    pub const fn nearest(&self) -> Option<&'static str> {
        self.nearest
    }

    /// The nearest position that the device can reach instead of the one that it cannot.
    #[must_use]
    pub fn reachable(&self) -> Option<&Value> {
        self.reachable.as_deref()
    }

    /// The line and the column of the script at which the mistake begins, 1 for the first.
    #[must_use]
    pub fn place(&self) -> Option<(u32, u32)> {
        self.line.zip(self.column)
    }

    /// Whether the same command may be taken a little later, although nothing about it changes.
    #[must_use]
    pub const fn may_be_retried(&self) -> bool {
        self.retry
    }

    /// The same error, where the same command may be taken a little later.
    #[must_use]
    pub fn with_retry(mut self) -> Self {
        self.retry = true;
        self
    }

    /// The same error, of a device that had come to rest so many ms ago, as its program had stood still.
    #[must_use]
    pub fn late_by(mut self, ms: u32) -> Self {
        self.late = Some(ms);
        self
    }

    /// How many ms ago it had come to rest.
    #[must_use]
    pub const fn late(&self) -> Option<u32> {
        self.late
    }

    /// The same error, said of a byte of the script.
    #[must_use]
    pub fn at_position(mut self, position: usize) -> Self {
        self.position = Some(position);
        self
    }

    /// The same error in other words.
    #[must_use]
    pub fn in_words(mut self, text: impl Into<String>) -> Self {
        self.text = text.into();
        self
    }

    /// The same error, said of a statement (1 for the first).
    #[must_use]
    pub fn at_statement(mut self, statement: u32) -> Self {
        self.text = format!("statement {statement}: {}", self.text);
        self.statement = Some(statement);
        self
    }

    /// The same error, with the position that can be reached instead.
    #[must_use]
    pub fn with_reachable(mut self, position: impl Into<Value>) -> Self {
        self.reachable = Some(Box::new(position.into()));
        self
    }

    /// The same error, with the line and the column of its position in this script.
    pub(crate) fn in_text(mut self, script: &str) -> Self {
        if let Some(before) = self.position.and_then(|position| script.get(..position)) {
            let last = before.rsplit('\n').next().unwrap_or_default();
            let count = |count: usize| u32::try_from(count + 1).ok();
            self.line = count(before.matches('\n').count());
            self.column = count(last.chars().count());
        }
        self
    }

    /// The same error, with the word that was probably meant.
    #[must_use]
    pub fn with_nearest(mut self, nearest: &'static str) -> Self {
        self.nearest = Some(nearest);
        self
    }
}

#[cfg(test)]
mod tests {
    use serde::de::IntoDeserializer;
    use serde::de::value::{Error, StrDeserializer};

    use super::*;

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
    fn an_error_tells_all_that_was_said_of_it() {
        let error = DeviceError::new(ErrorName::Obstacle, "a cat")
            .at_statement(2)
            .at_position(7)
            .late_by(30);
        assert_eq!((error.name(), error.code()), (ErrorName::Obstacle, 5110));
        assert_eq!(error.text(), "statement 2: a cat");
        assert_eq!(
            (error.statement(), error.position(), error.late()),
            (Some(2), Some(7), Some(30))
        );
        assert_eq!(
            (error.nearest(), error.reachable(), error.place()),
            (None, None, None)
        );
        assert!(!error.may_be_retried() && error.clone().with_retry().may_be_retried());
        assert_eq!(error.in_words("a dog").text(), "a dog");
    }

    #[test]
    fn the_protocol_has_a_row_for_each() {
        let document = include_str!("../../../docs/PROTOCOL.md");
        let row = |line: &str| -> Option<(u16, String, bool)> {
            let cells: Vec<&str> = line.split('|').map(str::trim).collect();
            let number = cells.get(1)?.parse().ok().filter(|number| *number > 5000)?;
            let again = cells.get(4)?.contains("`retry`");
            Some((number, cells.get(2)?.trim_matches('`').to_owned(), again))
        };
        let rows: Vec<(u16, String, bool)> = document.lines().filter_map(row).collect();
        let known = |(number, word, _): &(u16, String, bool)| (*number, word.clone());
        assert_eq!(
            rows.iter().map(known).collect::<Vec<_>>(),
            ErrorName::ALL.map(|name| (name.code(), name.as_str().to_owned()))
        );
        for (name, (_, word, again)) in ErrorName::ALL.into_iter().zip(&rows) {
            assert!(*again || !name.is_retryable(), "{word}");
        }
    }

    #[test]
    fn the_statement_stands_in_the_words() {
        let error = DeviceError::new(ErrorName::JointLimit, "too far").at_statement(3);
        assert_eq!(
            (error.to_string().as_str(), error.statement()),
            ("statement 3: too far", Some(3))
        );
    }
}
