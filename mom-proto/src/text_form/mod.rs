//! What the text forms, XML and JSON, have in common: text in bytes, values in text, and how errors show both.

pub(crate) mod scalar;

use crate::{Code, HARD_DEPTH, Value, WireError, xml_violation};

// A slot's path names where to look; it does not repeat a kilobyte of keys.
const PATH_BYTES: usize = 256;
const SHOWN_BYTES: usize = 64;

/// The text of a document, or its valid beginning and the error after it.
pub(crate) fn decode(bytes: &[u8], base: usize) -> Result<&str, (&str, WireError)> {
    let bad =
        |position: usize, why: String| WireError::new(Code::BAD_ENCODING, why).position(base + position);
    if bytes.starts_with(&[0xEF, 0xBB, 0xBF])
        || bytes.starts_with(&[0xFE, 0xFF])
        || bytes.starts_with(&[0xFF, 0xFE])
    {
        let why = "text is in UTF-8 here, without a byte order mark".to_owned();
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
                format!("the byte 0x{:02X} is not UTF-8 here", bytes[position]),
            ),
        )),
    }
}

/// The beginning of a text, for errors: what is echoed stays small.
pub(crate) fn brief(text: &str) -> &str {
    let mut end = text.len().min(SHOWN_BYTES);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    &text[..end]
}

/// Puts a key or an index before the error's slot.
pub(crate) fn within(error: WireError, key: &str) -> WireError {
    let key = brief(key);
    let path = match error.get("slot").and_then(Value::as_str) {
        None => key.to_owned(),
        Some(inner) if inner.len() > PATH_BYTES => format!("{key}/…"),
        Some(inner) => format!("{key}/{inner}"),
    };
    error.slot(&path)
}

/// So many levels more may open inside a list or map.
pub(crate) fn deeper(depth: usize) -> Result<usize, WireError> {
    depth.checked_sub(1).ok_or_else(|| {
        WireError::new(
            Code::TOO_DEEP,
            format!("lists and maps are nested deeper than {HARD_DEPTH}"),
        )
    })
}

/// The error for a parcel that is larger in this form than its receivers take.
pub(crate) fn too_large(form: &str, most: usize) -> WireError {
    not_encodable(format!(
        "in {form} this parcel has more than {most} bytes, the limit"
    ))
}

/// The error for a value without a form on the wire.
pub(crate) fn not_encodable(text: String) -> WireError {
    WireError::new(Code::NOT_ENCODABLE, text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn brief_keeps_whole_characters() {
        assert_eq!(brief(&"ü".repeat(50)), "ü".repeat(32));
        assert_eq!(brief(&format!("a{}", "ü".repeat(50))).len(), 63);
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
