//! Text between bytes and characters: the encoding, references, line ends.

use std::borrow::Cow;

use crate::{Code, WireError, is_xml_char, xml_violation};

use super::name::brief;

// `&#x10FFFF;` and a few zeros: no reference needs more.
const REFERENCE_BYTES: usize = 12;

/// Where a raw text stands: the rules of XML for line ends differ.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum TextKind {
    Element,
    Attribute,
}

/// The text of an XML document, or its valid beginning and the error after it.
pub(super) fn decode(bytes: &[u8], base: usize) -> Result<&str, (&str, WireError)> {
    let bad =
        |position: usize, why: String| WireError::new(Code::BAD_ENCODING, why).position(base + position);
    if bytes.starts_with(&[0xEF, 0xBB, 0xBF])
        || bytes.starts_with(&[0xFE, 0xFF])
        || bytes.starts_with(&[0xFF, 0xFE])
    {
        let why = "XML is in UTF-8 without a byte order mark".to_owned();
        return Err(("", bad(0, why)));
    }
    let (text, end) = match std::str::from_utf8(bytes) {
        Ok(text) => (text, None),
        Err(error) => {
            let (good, _) = bytes.split_at(error.valid_up_to());
            (std::str::from_utf8(good).unwrap_or_default(), Some(good.len()))
        }
    };
    if let Some(position) = xml_violation(text) {
        let c = text[position..].chars().next().unwrap_or_default();
        let why = format!("the character {c:?} does not exist in XML");
        return Err((&text[..position], bad(position, why)));
    }
    match end {
        None => Ok(text),
        Some(position) => Err((
            text,
            bad(
                position,
                format!("the byte 0x{:02X} is no UTF-8 here", bytes[position]),
            ),
        )),
    }
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
                return Err(bad(base + at - 2, "]]> may not stand in text"));
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

/// The position of the first character that is no white space.
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

    #[test]
    fn only_utf8_of_xml_characters() {
        for (bytes, position) in [
            (&b"ab\xff"[..], 2),
            (b"a\0", 1),
            (b"\xed\xa0\x80", 0),
            (b"a\xef\xbf\xbe", 1),
            (b"\xef\xbb\xbf<parcel/>", 0),
            (b"\xff\xfe<\0", 0),
            (b"\xfe\xff\0<", 0),
            (b"\xc3", 0),
            (b"a\x1b\xff", 1),
        ] {
            let (good, error) = decode(bytes, 7).expect_err("bad");
            assert_eq!(error.code, Code::BAD_ENCODING);
            assert_eq!(error.get("position"), Some(&crate::Value::Int(7 + position)));
            assert!(bytes.starts_with(good.as_bytes()) && good.len() as i64 <= position);
        }
        assert_eq!(decode("ü\r\n\t".as_bytes(), 0), Ok("ü\r\n\t"));
    }
}
