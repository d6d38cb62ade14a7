//! Attributes of XML: quick-xml finds names and values, this module says which are allowed.

use std::borrow::Cow;

use quick_xml::events::attributes::{AttrError, Attributes as Pairs};

use crate::nearest::nearest;
use crate::text_form::brief;
use crate::{Code, Limits, ValueKind, WireError};

use super::lexeme::{Tag, misnamed};
use super::name::is_name;
use super::text::{TextKind, bad, first_ink, is_blank, unescape};

/// One attribute, its value resolved.
pub(super) struct Attribute<'a> {
    pub(super) name: &'a str,
    pub(super) value: Cow<'a, str>,
    pub(super) position: usize,
}

/// Reads `name="value"` one after the other.
pub(super) struct Attributes<'a, 'l> {
    raw: &'a str,
    pairs: Pairs<'a>,
    /// The end of what is read.
    at: usize,
    base: usize,
    count: usize,
    limits: &'l Limits,
}

impl<'a, 'l> Attributes<'a, 'l> {
    /// The attributes from byte `at` of `raw`, which lies at `base` in the body.
    pub(super) fn new(raw: &'a str, at: usize, base: usize, limits: &'l Limits) -> Attributes<'a, 'l> {
        let mut pairs = Pairs::new(raw, at);
        // The grammar has three attributes, each a field.
        pairs.with_checks(false);
        Attributes {
            raw,
            pairs,
            at,
            base,
            count: 0,
            limits,
        }
    }

    /// Sets all of them in `tag`.
    pub(super) fn set_all(&mut self, tag: &mut Tag<'a>) -> Result<(), WireError> {
        while let Some(attribute) = self.next()? {
            tag.set(attribute)?;
        }
        Ok(())
    }

    /// The next one.
    pub(super) fn next(&mut self) -> Result<Option<Attribute<'a>>, WireError> {
        let pair = match self.pairs.next() {
            None => return Ok(None),
            Some(Ok(pair)) => pair,
            Some(Err(error)) => return Err(self.unpaired(&error)),
        };
        let name = pair.key.0;
        let position = self.begin(name, place_in(self.raw, name))?;
        let start = place_in(self.raw, &pair.value);
        let raw = &self.raw[start..][..pair.value.len()];
        // Behind the quote.
        self.at = start + raw.len() + 1;
        if raw.len() > self.limits.attribute_size {
            let why = format!("an attribute has at most {} bytes", self.limits.attribute_size);
            return Err(bad(position, why));
        }
        let value = resolved(raw, self.base + start)?;
        Ok(Some(Attribute {
            name,
            value,
            position,
        }))
    }

    /// Checks what comes before the value of an attribute; gives its position in the body.
    fn begin(&mut self, name: &str, start: usize) -> Result<usize, WireError> {
        let position = self.base + start;
        if start == self.at {
            return Err(bad(position, "attributes are separated by blanks"));
        }
        self.count += 1;
        if self.count > self.limits.attributes {
            let why = format!("an element has at most {} attributes", self.limits.attributes);
            return Err(bad(position, why));
        }
        match is_name(name) {
            true => Ok(position),
            false => Err(misnamed(self.name_at(start), position)),
        }
    }

    /// What stands at `start` instead of a name; for the iterator it may begin with =.
    fn name_at(&self, start: usize) -> &'a str {
        let rest = &self.raw[start..];
        let end = rest.bytes().position(|byte| byte == b'=' || is_blank(byte));
        &rest[..end.unwrap_or(rest.len())]
    }

    /// The first fault of what is not a pair.
    #[cold]
    fn unpaired(&mut self, error: &AttrError) -> WireError {
        let rest = &self.raw[self.at..];
        let start = self.at + first_ink(rest).unwrap_or(rest.len());
        let name = self.name_at(start);
        if let Err(error) = self.begin(name, start) {
            return error;
        }
        let at = match *error {
            AttrError::ExpectedEq(at) => {
                return bad(self.base + at, "an attribute is written name=\"value\"");
            }
            // A name has no quotes, so the first one begins the value.
            AttrError::ExpectedQuote(_, quote) => {
                let before = memchr::memchr(quote, &self.raw.as_bytes()[start..]);
                start + before.unwrap_or_default()
            }
            AttrError::ExpectedValue(at) | AttrError::UnquotedValue(at) | AttrError::Duplicated(at, _) => at,
        };
        bad(self.base + at, "an attribute's value stands between quotes")
    }
}

/// Where `part` begins in `whole`, of which it is a part.
fn place_in(whole: &str, part: &str) -> usize {
    part.as_ptr().addr() - whole.as_ptr().addr()
}

/// The value that is written so at `position` of the body.
fn resolved(raw: &str, position: usize) -> Result<Cow<'_, str>, WireError> {
    // Words of the grammar, mostly: one look says that there is nothing to do.
    if !raw
        .bytes()
        .any(|byte| matches!(byte, b'<' | b'&' | b'\r' | b'\n' | b'\t'))
    {
        return Ok(Cow::Borrowed(raw));
    }
    if let Some(at) = memchr::memchr(b'<', raw.as_bytes()) {
        return Err(bad(position + at, "an attribute may not contain <: write &lt;"));
    }
    unescape(raw, position, TextKind::Attribute)
}

impl<'a> Tag<'a> {
    fn set(&mut self, attribute: Attribute<'a>) -> Result<(), WireError> {
        let Attribute {
            name,
            value,
            position,
        } = attribute;
        let before = match name {
            "type" => {
                let kind = ValueKind::from_word(&value).ok_or_else(|| unknown_type(&value, position))?;
                self.kind.replace(kind).is_some()
            }
            "key" => self.key.replace(value).is_some(),
            "encoding" if value == "base64" => std::mem::replace(&mut self.base64, true),
            "encoding" => return Err(bad(position, "the only encoding is base64")),
            "xmlns" => return Err(bad(position, "a parcel has no namespaces")),
            _ => {
                return Err(bad(
                    position,
                    format!("the attribute {:?} is unknown", brief(name)),
                ));
            }
        };
        match before {
            false => Ok(()),
            true => Err(bad(position, format!("the attribute {name} occurs twice"))),
        }
    }
}

fn unknown_type(word: &str, position: usize) -> WireError {
    let near = nearest(word, ValueKind::ALL.map(ValueKind::word));
    WireError::new(Code::BAD_SLOT, format!("the type {:?} is unknown", brief(word)))
        .position(position)
        .nearest_opt(near)
}
