//! Text as it stands in XML: references, line ends.

use std::borrow::Cow;

use crate::text_form::brief;
use crate::{Code, WireError, is_xml_char};

// `&#x10FFFF;` and a few zeros: no reference needs more.
const REFERENCE_BYTES: usize = 12;

/// Where a raw text stands: the rules of XML for line ends differ.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum TextKind {
    Element,
    Attribute,
}

/// Resolves references and line ends; `base` is the raw text's position in the body.
pub(super) fn unescape(raw: &str, base: usize, place: TextKind) -> Result<Cow<'_, str>, WireError> {
    let Some(first) = find_special(raw.as_bytes(), 0, place) else {
        return Ok(Cow::Borrowed(raw));
    };
    let bytes = raw.as_bytes();
    let mut out = String::with_capacity(raw.len());
    let mut copied = 0;
    let mut special = Some(first);
    while let Some(at) = special {
        out.push_str(&raw[copied..at]);
        copied = at + 1;
        match (bytes[at], place) {
            (b'&', _) => {
                let (c, length) = reference(&raw[at..], base + at)?;
                out.push(c);
                copied = at + length;
            }
            (b'>', TextKind::Element) if raw[..at].ends_with("]]") => {
                return Err(bad(base + at - 2, "]]> is not allowed in text"));
            }
            (b'>', _) => out.push('>'),
            (b'\r', _) if bytes.get(at + 1) == Some(&b'\n') => {}
            (b'\r', TextKind::Element) => out.push('\n'),
            (_, TextKind::Attribute) => out.push(' '),
            (byte, TextKind::Element) => out.push(char::from(byte)),
        }
        special = find_special(bytes, copied, place);
    }
    out.push_str(&raw[copied..]);
    Ok(Cow::Owned(out))
}

/// The position of the first character that is not white space.
pub(super) fn first_ink(raw: &str) -> Option<usize> {
    raw.bytes().position(|byte| !is_blank(byte))
}

/// White space of XML.
pub(super) fn is_blank(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t' | b'\r' | b'\n')
}

/// A `bad-xml` error at a byte of the body.
pub(super) fn bad(position: usize, text: impl Into<String>) -> WireError {
    WireError::new(Code::BAD_XML, text).position(position)
}

fn find_special(bytes: &[u8], from: usize, place: TextKind) -> Option<usize> {
    let rest = &bytes[from..];
    let found = match place {
        TextKind::Element => memchr::memchr3(b'&', b'\r', b'>', rest),
        TextKind::Attribute => rest
            .iter()
            .position(|byte| matches!(byte, b'&' | b'\r' | b'\n' | b'\t')),
    };
    found.map(|at| from + at)
}

/// The character of the reference that `text` begins with, and the reference's length.
fn reference(text: &str, position: usize) -> Result<(char, usize), WireError> {
    let wrong = || {
        let shown: String = text.chars().take(REFERENCE_BYTES).collect();
        let why = format!("{shown:?} is none of &amp; &lt; &gt; &quot; &apos; and no character by number");
        bad(position, why)
    };
    let window = &text.as_bytes()[..text.len().min(REFERENCE_BYTES)];
    let end = memchr::memchr(b';', window).ok_or_else(wrong)?;
    let c = match &text[1..end] {
        "amp" => '&',
        "lt" => '<',
        "gt" => '>',
        "quot" => '"',
        "apos" => '\'',
        name => {
            let number = name.strip_prefix('#').ok_or_else(wrong)?;
            numbered(number).ok_or_else(wrong)?
        }
    };
    if !is_xml_char(c) {
        let why = format!("{} is a character that XML does not have", brief(&text[..=end]));
        return Err(bad(position, why));
    }
    Ok((c, end + 1))
}

fn numbered(number: &str) -> Option<char> {
    let (digits, radix) = match number.strip_prefix('x') {
        Some(digits) => (digits, 16),
        None => (number, 10),
    };
    // from_str_radix would take a sign.
    if !digits.chars().all(|digit| digit.is_digit(radix)) {
        return None;
    }
    char::from_u32(u32::from_str_radix(digits, radix).ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(raw: &str, place: TextKind, expected: Result<&str, i64>) {
        let read = unescape(raw, 100, place);
        let read = read.as_deref().map_err(|error| {
            assert_eq!(error.code, Code::BAD_XML);
            error.get("position").and_then(crate::Value::as_int).unwrap_or(-1) - 100
        });
        assert_eq!(read, expected, "{raw:?}");
    }

    #[test]
    fn references_and_line_ends() {
        check("plain ü", TextKind::Element, Ok("plain ü"));
        check(
            "&lt;a&gt; &amp;amp; &quot;&apos;",
            TextKind::Element,
            Ok("<a> &amp; \"'"),
        );
        check("&#65;&#x41;&#x1F600;&#0065;", TextKind::Element, Ok("AA😀A"));
        check("a\r\nb\rc\nd&#13;", TextKind::Element, Ok("a\nb\nc\nd\r"));
        check(
            "a\r\nb\rc\nd\te&#9;&#10;",
            TextKind::Attribute,
            Ok("a b c d e\t\n"),
        );
        check("a > b ]> ]] >", TextKind::Element, Ok("a > b ]> ]] >"));
        check("]]>", TextKind::Attribute, Ok("]]>"));
        check("ab]]>", TextKind::Element, Err(2));
        for (raw, position) in [
            ("&", 0),
            ("a &b c", 2),
            ("&nbsp;", 0),
            ("&;", 0),
            ("&#;", 0),
            ("&#x;", 0),
            ("&#X41;", 0),
            ("&#+65;", 0),
            ("&#0;", 0),
            ("&#xFFFE;", 0),
            ("&#xD800;", 0),
            ("&#x110000;", 0),
            ("&#27;", 0),
            ("&#99999999999;", 0),
            ("&#000000000000065;", 0),
            ("&amp", 0),
            ("&ü;", 0),
        ] {
            check(raw, TextKind::Element, Err(position));
            check(raw, TextKind::Attribute, Err(position));
        }
    }
}
