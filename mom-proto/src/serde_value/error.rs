//! Mismatches between values and `serde` types, with their positions.

use std::fmt::Display;

use serde::de::{self, Expected, Unexpected};
use serde::ser;

use crate::nearest::nearest;
use crate::{Code, WireError, is_xml_char};

// Keys and texts come from outside; an error quotes what people can read, not megabytes.
const STEP_CHARS: usize = 64;
const TEXT_CHARS: usize = 512;

/// A [`WireError`] being built: its position grows while the recursion returns.
#[derive(Debug, thiserror::Error)]
#[error("{}", .0.text)]
pub(super) struct SerdeError(Box<ValueFault>);

#[derive(Debug)]
struct ValueFault {
    code: Code,
    text: String,
    /// From the innermost step outwards.
    place: Vec<String>,
    nearest: Option<String>,
}

impl SerdeError {
    /// `not-encodable`
    pub(super) fn not_encodable(text: impl Display) -> SerdeError {
        SerdeError::new(Code::NOT_ENCODABLE, text)
    }

    /// `bad-content`
    pub(super) fn bad_content(text: impl Display) -> SerdeError {
        SerdeError::new(Code::BAD_CONTENT, text)
    }

    /// `too-deep`
    pub(super) fn too_deep(text: impl Display) -> SerdeError {
        SerdeError::new(Code::TOO_DEEP, text)
    }

    /// The same error seen from one level further out: it happened in this member.
    pub(super) fn inside(mut self, step: impl Display) -> SerdeError {
        self.0.place.push(brief(&step.to_string(), STEP_CHARS));
        self
    }

    fn new(code: Code, text: impl Display) -> SerdeError {
        SerdeError(Box::new(ValueFault {
            code,
            text: brief(&text.to_string(), TEXT_CHARS),
            place: Vec::new(),
            nearest: None,
        }))
    }

    fn unknown(what: &str, known: &'static [&'static str]) -> SerdeError {
        let quoted = brief(what, STEP_CHARS);
        let mut error = SerdeError::bad_content(match known {
            [] => format!("{quoted:?} is not known; nothing may stand here"),
            _ => format!("{quoted:?} is not known; known are {}", known.join(", ")),
        });
        error.0.nearest = nearest(what, known.iter().copied()).map(str::to_owned);
        error
    }
}

impl From<SerdeError> for WireError {
    fn from(error: SerdeError) -> WireError {
        let fault = *error.0;
        let mut slot = "content".to_owned();
        for step in fault.place.iter().rev() {
            slot.push('/');
            slot.push_str(step);
        }
        WireError::new(fault.code, format!("{slot}: {}", fault.text))
            .slot(&slot)
            .nearest_opt(fault.nearest.as_deref())
    }
}

impl ser::Error for SerdeError {
    fn custom<T: Display>(text: T) -> SerdeError {
        SerdeError::not_encodable(text)
    }
}

impl de::Error for SerdeError {
    fn custom<T: Display>(text: T) -> SerdeError {
        SerdeError::bad_content(text)
    }

    fn invalid_type(given: Unexpected<'_>, wanted: &dyn Expected) -> SerdeError {
        SerdeError::bad_content(format!("{} stands where {wanted} is wanted", words(given)))
    }

    fn invalid_value(given: Unexpected<'_>, wanted: &dyn Expected) -> SerdeError {
        de::Error::invalid_type(given, wanted)
    }

    fn invalid_length(length: usize, wanted: &dyn Expected) -> SerdeError {
        SerdeError::bad_content(format!("{length} members stand where {wanted} is wanted"))
    }

    fn unknown_variant(variant: &str, known: &'static [&'static str]) -> SerdeError {
        SerdeError::unknown(variant, known)
    }

    fn unknown_field(field: &str, known: &'static [&'static str]) -> SerdeError {
        // Derived types say this while they read the key, whose place is known.
        SerdeError::unknown(field, known)
    }

    fn missing_field(field: &'static str) -> SerdeError {
        SerdeError::bad_content("it is missing").inside(field)
    }

    fn duplicate_field(field: &'static str) -> SerdeError {
        SerdeError::bad_content("it occurs twice").inside(field)
    }
}

/// What was found, in the words for values.
fn words(given: Unexpected<'_>) -> String {
    match given {
        Unexpected::Bool(flag) => format!("boolean {flag}"),
        Unexpected::Unsigned(number) => format!("int {number}"),
        Unexpected::Signed(number) => format!("int {number}"),
        Unexpected::Float(number) => format!("double {number:?}"),
        Unexpected::Char(c) => format!("string {:?}", c.to_string()),
        Unexpected::Str(text) => format!("string {:?}", brief(text, STEP_CHARS)),
        Unexpected::Bytes(_) => "binary".to_owned(),
        Unexpected::Unit | Unexpected::Option => "null".to_owned(),
        // The only thing that our deserializer shows so unasked.
        Unexpected::NewtypeStruct => "a time".to_owned(),
        Unexpected::Seq => "a list".to_owned(),
        Unexpected::Map => "a map".to_owned(),
        other => other.to_string(),
    }
}

/// The start of a text; an error has to be encodable itself, so other characters become U+FFFD.
fn brief(text: &str, most: usize) -> String {
    let mut brief: String = text
        .chars()
        .take(most)
        .map(|c| {
            if is_xml_char(c) {
                c
            } else {
                char::REPLACEMENT_CHARACTER
            }
        })
        .collect();
    if text.chars().nth(most).is_some() {
        brief.push('…');
    }
    brief
}
