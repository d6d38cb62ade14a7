//! Values without members, from their text.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use crate::{Code, Kind, Time, Value, WireError};

use super::name::brief;

/// Reads the text of a value; lists, maps and parts have no text form.
pub(super) fn parse(kind: Kind, text: &str, position: usize) -> Result<Value, WireError> {
    let value = match kind {
        Kind::Null => text.is_empty().then_some(Value::Null),
        Kind::Bool => match text {
            "true" => Some(Value::Bool(true)),
            "false" => Some(Value::Bool(false)),
            _ => None,
        },
        Kind::Int => int(text).map(Value::Int),
        Kind::Double => double(text).map(Value::Double),
        Kind::String => Some(Value::String(text.to_owned())),
        Kind::Time => text.parse::<Time>().ok().map(Value::Time),
        Kind::Binary => base64(text).map(|bytes| Value::Binary(bytes.into())),
        Kind::List | Kind::Map => None,
    };
    value.ok_or_else(|| {
        let form = form(kind);
        let text = format!("a {} is {form}, not {:?}", kind.word(), brief(text));
        WireError::new(Code::BAD_SLOT, text).position(position)
    })
}

fn form(kind: Kind) -> &'static str {
    match kind {
        Kind::Null => "empty",
        Kind::Bool => "true or false",
        Kind::Int => "a decimal number of 64 bits without + and leading zeros",
        Kind::Double => "a finite decimal number, like -1.5e3",
        Kind::String => "text",
        Kind::Time => "written like 2026-11-21T10:00:00.000123Z",
        Kind::Binary => "standard base64 with its padding",
        Kind::List | Kind::Map => "made of elements",
    }
}

fn int(text: &str) -> Option<i64> {
    let digits = text.strip_prefix('-').unwrap_or(text);
    let canonical = match digits.as_bytes() {
        [b'0'] => text == "0",
        [b'1'..=b'9', rest @ ..] => rest.iter().all(u8::is_ascii_digit),
        _ => false,
    };
    if canonical { text.parse().ok() } else { None }
}

// The lexical form of XML Schema's double; Rust's own reading takes "inf" and "nan" as well.
fn double(text: &str) -> Option<f64> {
    let digits = text.bytes().any(|byte| byte.is_ascii_digit());
    let decimal = |byte: u8| byte.is_ascii_digit() || matches!(byte, b'+' | b'-' | b'.' | b'e' | b'E');
    if !digits || !text.bytes().all(decimal) {
        return None;
    }
    text.parse().ok().filter(|number: &f64| number.is_finite())
}

fn base64(text: &str) -> Option<Vec<u8>> {
    if !text.bytes().any(|byte| byte.is_ascii_whitespace()) {
        return STANDARD.decode(text).ok();
    }
    let dense: Vec<u8> = text.bytes().filter(|byte| !byte.is_ascii_whitespace()).collect();
    STANDARD.decode(dense).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(kind: Kind, text: &str, expected: impl Into<Option<Value>>) {
        let read = parse(kind, text, 3);
        if let Err(error) = &read {
            assert_eq!(
                (&error.code, error.get("position")),
                (&Code::BAD_SLOT, Some(&Value::Int(3)))
            );
        }
        assert_eq!(read.ok(), expected.into(), "{kind:?} {text:?}");
    }

    #[test]
    fn one_form_per_type() {
        check(Kind::Null, "", Some(Value::Null));
        check(Kind::Null, " ", None);
        check(Kind::Bool, "true", Some(true.into()));
        for bad in ["", "True", "1", " true"] {
            check(Kind::Bool, bad, None);
        }
        check(Kind::Int, "-9223372036854775808", Some(i64::MIN.into()));
        check(Kind::Int, "0", Some(0.into()));
        for bad in [
            "",
            "-",
            "-0",
            "+1",
            "01",
            "1.0",
            "0x1",
            "9223372036854775808",
            " 1",
            "１",
        ] {
            check(Kind::Int, bad, None);
        }
        check(Kind::Double, "-1.5E+3", Some(Value::Double(-1500.0)));
        check(Kind::Double, ".5", Some(Value::Double(0.5)));
        for bad in [
            "",
            ".",
            "inf",
            "NaN",
            "-infinity",
            "1e999",
            "0x1p3",
            "1,5",
            "1e",
            "1 ",
            "--1",
            "e5",
        ] {
            check(Kind::Double, bad, None);
        }
        let zero = parse(Kind::Double, "-0.0", 0).unwrap();
        assert!(matches!(zero, Value::Double(number) if number.is_sign_negative()));
        check(
            Kind::Time,
            "1970-01-01T00:00:00Z",
            Time::from_micros(0).map(Value::Time),
        );
        check(Kind::Time, "yesterday", None);
        check(
            Kind::Binary,
            " AQ\n ID ",
            Some(Value::Binary(vec![1, 2, 3].into())),
        );
        check(Kind::Binary, "", Some(Value::Binary(Vec::new().into())));
        for bad in ["AQI", "AR==", "AQ==AQ==", "A_-=", "AQ=", "=", "AQ I\u{a0}D"] {
            check(Kind::Binary, bad, None);
        }
    }
}
