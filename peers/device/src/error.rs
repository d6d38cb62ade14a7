//! Errors of devices, in the shape and with the names and numbers of the lab's arm (M53), so that whoever drives one reads them
//! of all.

use mom_client::Value;
use serde::Serialize;

/// The code words of a device's errors; each has the number that the lab's arm gives it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum ErrorName {
    /// The script cannot be read.
    Syntax,
    /// A place lies outside of where the device can be.
    WorkspaceBoundary,
    /// The link to the device itself failed, so that nothing is known of it.
    Link,
    /// A joint or an axis would have to turn further than it can.
    JointLimit,
    /// The command was ended before its end, or never begun, because the device was halted.
    Halted,
    /// The device is stopped and takes no command until it is released.
    Stopped,
    /// Too many commands are waiting.
    QueueFull,
    /// A command of this id is still waiting or executing.
    DuplicateId,
    /// The command is older than it may be when it begins.
    TooOld,
    /// A relative command does not name the state that it is based on.
    NoState,
    /// The device still moves as its old owner had it move.
    ChangingHands,
    /// Something is in the way.
    Obstacle,
    /// The device has no energy left to do it.
    Battery,
}

impl ErrorName {
    /// Its number.
    #[must_use]
    pub const fn code(self) -> u16 {
        match self {
            Self::Syntax => 5001,
            Self::WorkspaceBoundary => 5002,
            Self::Link => 5003,
            Self::JointLimit => 5005,
            Self::Halted => 5101,
            Self::Stopped => 5102,
            Self::QueueFull => 5103,
            Self::DuplicateId => 5104,
            Self::TooOld => 5107,
            Self::NoState => 5108,
            Self::ChangingHands => 5105,
            Self::Obstacle => 5110,
            Self::Battery => 5111,
        }
    }

    /// Whether the same command may be taken a little later. A new owner's has been waited with already.
    const fn is_retryable(self) -> bool {
        matches!(self, Self::QueueFull)
    }
}

/// An error of a device: plain words, with the code kept beside them.
///
/// As content it is a map of `name`, `code`, `text` and, where they apply, `retry`, `statement` (1 for the first), `position` (byte in
/// the script) with its `line` and `column` (1 for the first), `nearest` (the known word meant) and `reachable` (the nearest position
/// that the device can reach).
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

    /// Plain words, with the statement's number in front where there is one.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
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
    pub(crate) fn with_nearest(mut self, nearest: &'static str) -> Self {
        self.nearest = Some(nearest);
        self
    }
}
