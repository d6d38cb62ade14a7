//! What is wrong in a model's file, and where.

use std::fmt;
use std::ops::Range;

/// What kind of fault it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Fault {
    /// It is no TOML, or no XML.
    Syntax,
    /// The text, or a text in it, is longer than models are.
    TooLong,
    /// Nobody knows this key.
    UnknownKey,
    /// A key is missing.
    MissingKey,
    /// Elements of this kind have no such key.
    NotOfKind,
    /// A value is of another type than its key's.
    Type,
    /// A number is not within what its key allows.
    Number,
    /// A name is no word, or a unit none.
    Name,
    /// Two elements have this name, or names that are the same in code.
    NameTwice,
    /// Nobody knows this kind of element, type or way of motion.
    UnknownWord,
    /// A range is upside down, or goes beyond what the type holds.
    Range,
    /// A safe value is outside the range.
    Safe,
    /// There are not as many values as the element has numbers.
    Count,
    /// A name refers to no element, or to one of the wrong kind.
    Reference,
    /// There are more than 256 elements, or none.
    Elements,
    /// A packet with everything in it is larger than the largest.
    Packet,
    /// An XMI file is outside the subset that is read.
    Xmi,
}

/// What is wrong in a file, and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelError {
    fault: Fault,
    line: usize,
    column: usize,
    text: String,
}

impl ModelError {
    /// What kind of fault it is.
    #[must_use]
    pub const fn fault(&self) -> Fault {
        self.fault
    }

    /// The line and the column, in characters, at which it is; 1 for the first.
    #[must_use]
    pub const fn place(&self) -> (usize, usize) {
        (self.line, self.column)
    }
}

impl fmt::Display for ModelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}, column {}: {}", self.line, self.column, self.text)
    }
}

impl std::error::Error for ModelError {}

/// A fault at bytes of the text.
#[derive(Debug)]
pub(crate) struct Found {
    pub(crate) fault: Fault,
    pub(crate) start: usize,
    text: String,
}

impl Found {
    pub(crate) fn new(fault: Fault, span: &Range<usize>, text: impl Into<String>) -> Found {
        Found {
            fault,
            start: span.start,
            text: text.into(),
        }
    }

    pub(crate) fn at(self, text: &str) -> ModelError {
        let before = text.get(..self.start).unwrap_or(text);
        let line_start = before.rfind('\n').map_or(0, |end| end + 1);
        ModelError {
            fault: self.fault,
            line: before.matches('\n').count() + 1,
            column: before
                .get(line_start..)
                .map_or(1, |start| start.chars().count() + 1),
            text: self.text,
        }
    }
}
