//! Values without members, from their text.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use crate::{Code, Time, Value, ValueKind, WireError};

use super::brief;

/// Reads the text of a value; lists, maps and parts have no text form.
pub(crate) fn parse(kind: ValueKind, text: &str, position: usize) -> Result<Value, WireError> {
    let value = match kind {
        ValueKind::Null => text.is_empty().then_some(Value::Null),
        ValueKind::Bool => match text {
            "true" => Some(Value::Bool(true)),
            "false" => Some(Value::Bool(false)),
            _ => None,
        },
        ValueKind::Int => int(text).map(Value::Int),
        ValueKind::Double => double(text).map(Value::Double),
        ValueKind::String => Some(Value::String(text.to_owned())),
        ValueKind::Time => text.parse::<Time>().ok().map(Value::Time),
        ValueKind::Binary => base64(text).map(|bytes| Value::Binary(bytes.into())),
        ValueKind::List | ValueKind::Map => None,
    };
    value.ok_or_else(|| {
        let form = form(kind);
        let article = if kind == ValueKind::Int { "an" } else { "a" };
        let text = format!("{article} {} is {form}, not {:?}", kind.word(), brief(text));
        WireError::new(Code::BAD_SLOT, text).position(position)
    })
}

fn form(kind: ValueKind) -> &'static str {
    match kind {
        ValueKind::Null => "empty",
        ValueKind::Bool => "true or false",
        ValueKind::Int => "a decimal number of 64 bits without + and leading zeros",
        ValueKind::Double => "a finite decimal number, like -1.5e3",
        ValueKind::String => "text",
        ValueKind::Time => "written like 2026-11-21T10:00:00.000123Z",
        ValueKind::Binary => "standard base64 with its padding",
        ValueKind::List | ValueKind::Map => "made of elements",
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
    STANDARD.decode(text).ok().or_else(|| {
        let dense: Vec<u8> = text.bytes().filter(|byte| !byte.is_ascii_whitespace()).collect();
        STANDARD.decode(dense).ok()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(kind: ValueKind, text: &str, expected: impl Into<Option<Value>>) {
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
        check(ValueKind::Null, "", Some(Value::Null));
        check(ValueKind::Null, " ", None);
        check(ValueKind::Bool, "true", Some(true.into()));
        for bad in ["", "True", "1", " true"] {
            check(ValueKind::Bool, bad, None);
        }
        check(ValueKind::Int, "-9223372036854775808", Some(i64::MIN.into()));
        check(ValueKind::Int, "0", Some(0.into()));
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
            check(ValueKind::Int, bad, None);
        }
        check(ValueKind::Double, "-1.5E+3", Some(Value::Double(-1500.0)));
        check(ValueKind::Double, ".5", Some(Value::Double(0.5)));
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
            check(ValueKind::Double, bad, None);
        }
        let zero = parse(ValueKind::Double, "-0.0", 0).unwrap();
        assert!(matches!(zero, Value::Double(number) if number.is_sign_negative()));
        check(
            ValueKind::Time,
            "1970-01-01T00:00:00Z",
            Time::from_micros(0).map(Value::Time),
        );
        check(ValueKind::Time, "yesterday", None);
        check(
            ValueKind::Binary,
            " AQ\n ID ",
            Some(Value::Binary(vec![1, 2, 3].into())),
        );
        check(ValueKind::Binary, "", Some(Value::Binary(Vec::new().into())));
        for bad in ["AQI", "AR==", "AQ==AQ==", "A_-=", "AQ=", "=", "AQ I\u{a0}D"] {
            check(ValueKind::Binary, bad, None);
        }
    }
}
