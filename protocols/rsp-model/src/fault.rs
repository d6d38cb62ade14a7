//! What is wrong in a model's file, and where.

use mom_toml_faults::Shape;

/// What kind of fault it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Fault {
    /// It is not TOML, or no XML.
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
    /// A name is not a word, or a unit none.
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
pub type ModelError = mom_toml_faults::FileError<Fault>;

/// A fault at bytes of the text.
pub(crate) type Found = mom_toml_faults::Found<Fault>;

impl From<Shape> for Fault {
    fn from(shape: Shape) -> Fault {
        match shape {
            Shape::Syntax => Fault::Syntax,
            Shape::UnknownKey => Fault::UnknownKey,
            Shape::MissingKey => Fault::MissingKey,
            Shape::Type => Fault::Type,
        }
    }
}
