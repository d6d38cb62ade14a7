//! What is wrong in a text, and where.

use std::fmt;
use std::ops::Range;

/// A line and a column of a text, in characters, from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Spot {
    /// The line.
    pub line: usize,
    /// The column.
    pub column: usize,
}

impl Spot {
    /// The spot of a byte of a text; of one behind the text, its end.
    #[must_use]
    pub fn of(text: &str, at: usize) -> Spot {
        let before = text.get(..at).unwrap_or(text);
        let line = before.rsplit('\n').next().unwrap_or_default();
        Spot {
            line: before.matches('\n').count() + 1,
            column: line.chars().count() + 1,
        }
    }
}

impl fmt::Display for Spot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}, column {}", self.line, self.column)
    }
}

/// What can be wrong in a file of any format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// It is not TOML.
    Syntax,
    /// Nobody knows this key.
    UnknownKey,
    /// A key is missing.
    MissingKey,
    /// A value is of another type than its key's.
    Type,
}

/// Where nobody tells one kind of fault from another.
impl From<Shape> for () {
    fn from(_: Shape) {}
}

/// A fault of any format at a byte of the text.
#[derive(Debug)]
pub struct Misfit(pub(crate) Found<Shape>);

/// A fault of a format, of one of its kinds `F`, at a byte of the text.
#[derive(Debug)]
pub struct Found<F> {
    /// What kind of fault it is.
    pub fault: F,
    /// The byte at which it is.
    pub start: usize,
    /// What is wrong, and what to do.
    pub text: String,
}

impl<F> Found<F> {
    /// A fault where something begins.
    pub fn new(fault: F, span: &Range<usize>, text: impl Into<String>) -> Found<F> {
        Found {
            fault,
            start: span.start,
            text: text.into(),
        }
    }

    /// The same with its line and column.
    #[must_use]
    pub fn at(self, text: &str) -> FileError<F> {
        FileError {
            fault: self.fault,
            spot: Spot::of(text, self.start),
            text: self.text,
        }
    }
}

impl<F: From<Shape>> From<Misfit> for Found<F> {
    fn from(Misfit(found): Misfit) -> Found<F> {
        Found {
            fault: found.fault.into(),
            start: found.start,
            text: found.text,
        }
    }
}

/// What is wrong in a file, and where: a fault of one of the kinds `F`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileError<F> {
    fault: F,
    spot: Spot,
    text: String,
}

impl<F: Copy> FileError<F> {
    /// What kind of fault it is.
    #[must_use]
    pub const fn fault(&self) -> F {
        self.fault
    }

    /// The line and the column, in characters, at which it is; 1 for the first.
    #[must_use]
    pub const fn place(&self) -> (usize, usize) {
        (self.spot.line, self.spot.column)
    }

    /// What is wrong, without its place.
    #[must_use]
    pub fn words(&self) -> &str {
        &self.text
    }
}

impl<F> fmt::Display for FileError<F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.spot, self.text)
    }
}

impl<F: fmt::Debug> std::error::Error for FileError<F> {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spot_counts_lines_and_characters_from_1() {
        let text = "ä b\nc";
        assert_eq!(Spot::of(text, 0), Spot { line: 1, column: 1 });
        assert_eq!(Spot::of(text, 3), Spot { line: 1, column: 3 });
        assert_eq!(Spot::of(text, 5), Spot { line: 2, column: 1 });
        assert_eq!(Spot::of(text, 99), Spot { line: 2, column: 2 });
    }
}
