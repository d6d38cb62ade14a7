//! Values as MessagePack: the content of the binary form (design §5).
//!
//! Times are the standard's timestamp extension (type −1) in its 96-bit layout with whole µs; all three
//! layouts are read. 32-bit floats are read as doubles. Other extension types are refused.

use bytes::Bytes;
use rmp::Marker;
use rmp::encode as put;

use crate::{Code, Map, Time, Value, WireError, xml_violation};

const TIMESTAMP: i8 = -1;

/// Appends a value.
///
/// # Errors
/// `not-encodable` for a double that is not finite, and for text outside XML's characters.
pub fn encode(value: &Value, out: &mut Vec<u8>) -> Result<(), WireError> {
    match value {
        Value::Null => put::write_nil(out).map_err(|_| too_long()),
        Value::Bool(flag) => put::write_bool(out, *flag).map_err(|_| too_long()),
        Value::Int(number) => put::write_sint(out, *number).map(|_| ()).map_err(|_| too_long()),
        Value::Double(number) if number.is_finite() => put::write_f64(out, *number).map_err(|_| too_long()),
        Value::Double(number) => Err(WireError::new(
            Code::NOT_ENCODABLE,
            format!("a double must be finite, not {number}"),
        )),
        Value::String(text) => encode_text(text, out),
        Value::Time(time) => encode_time(*time, out),
        Value::Binary(bytes) => put::write_bin(out, bytes).map_err(|_| too_long()),
        Value::List(list) => {
            put::write_array_len(out, length(list.len())?).map_err(|_| too_long())?;
            list.iter().try_for_each(|item| encode(item, out))
        }
        Value::Map(map) => {
            put::write_map_len(out, length(map.len())?).map_err(|_| too_long())?;
            map.iter().try_for_each(|(key, item)| {
                encode_text(key, out)?;
                encode(item, out)
            })
        }
    }
}

/// Reads exactly one value that fills `bytes`; binary values share its memory.
///
/// # Errors
/// `bad-content`, `bad-encoding` or `too-deep`, with the byte's position in `bytes`.
pub fn decode(bytes: &Bytes, depth: usize) -> Result<Value, WireError> {
    let mut reader = ItemReader::new(bytes);
    let value = reader.value(depth)?;
    reader.end().map(|()| value)
}

// The receiver would refuse it; here its author still learns of it.
fn encode_text(text: &str, out: &mut Vec<u8>) -> Result<(), WireError> {
    match xml_violation(text) {
        None => put::write_str(out, text).map_err(|_| too_long()),
        Some(at) => {
            let character = text[at..].chars().next().unwrap_or_default();
            let text = format!("the character {character:?} is not allowed in a string");
            Err(WireError::new(Code::NOT_ENCODABLE, text))
        }
    }
}

fn encode_time(time: Time, out: &mut Vec<u8>) -> Result<(), WireError> {
    let seconds = time.micros().div_euclid(1_000_000);
    let nanos = u32::try_from(time.micros().rem_euclid(1_000_000) * 1000).unwrap_or_default();
    put::write_ext_meta(out, 12, TIMESTAMP).map_err(|_| too_long())?;
    out.extend_from_slice(&nanos.to_be_bytes());
    out.extend_from_slice(&seconds.to_be_bytes());
    Ok(())
}

fn length(length: usize) -> Result<u32, WireError> {
    u32::try_from(length).map_err(|_| too_long())
}

fn too_long() -> WireError {
    WireError::new(
        Code::NOT_ENCODABLE,
        "more than 2^32 members or bytes in one value",
    )
}

/// A value without what is inside it.
pub(crate) enum Item<'a> {
    Null,
    Bool(bool),
    Int(i64),
    Double(f64),
    Text(&'a str),
    Time(Time),
    Binary(Bytes),
    /// So many values follow.
    List(usize),
    /// So many keys follow, each with its value.
    Map(usize),
}

/// Reads values item by item, so that passing them on needs no memory for all of them.
pub(crate) struct ItemReader<'a> {
    bytes: &'a Bytes,
    position: usize,
}

impl<'a> ItemReader<'a> {
    pub(crate) fn new(bytes: &'a Bytes) -> ItemReader<'a> {
        ItemReader { bytes, position: 0 }
    }

    /// The position of the next item.
    pub(crate) fn position(&self) -> usize {
        self.position
    }

    /// Checks that nothing follows.
    pub(crate) fn end(&self) -> Result<(), WireError> {
        match self.position == self.bytes.len() {
            true => Ok(()),
            false => Err(bad_at(self.position, "bytes after the value")),
        }
    }

    pub(crate) fn item(&mut self) -> Result<Item<'a>, WireError> {
        let start = self.position;
        let marker = Marker::from_u8(self.byte()?);
        let item = match marker {
            Marker::Null => Item::Null,
            Marker::True => Item::Bool(true),
            Marker::False => Item::Bool(false),
            Marker::FixPos(number) => Item::Int(number.into()),
            Marker::FixNeg(number) => Item::Int(number.into()),
            Marker::U8 => Item::Int(self.array::<1>()?[0].into()),
            Marker::U16 => Item::Int(u16::from_be_bytes(self.array()?).into()),
            Marker::U32 => Item::Int(u32::from_be_bytes(self.array()?).into()),
            Marker::U64 => match i64::try_from(u64::from_be_bytes(self.array()?)) {
                Ok(number) => Item::Int(number),
                Err(_) => return Err(bad_at(start, "a whole number above 2^63-1")),
            },
            Marker::I8 => Item::Int(i8::from_be_bytes(self.array()?).into()),
            Marker::I16 => Item::Int(i16::from_be_bytes(self.array()?).into()),
            Marker::I32 => Item::Int(i32::from_be_bytes(self.array()?).into()),
            Marker::I64 => Item::Int(i64::from_be_bytes(self.array()?)),
            Marker::F32 => finite(f32::from_be_bytes(self.array()?).into(), start)?,
            Marker::F64 => finite(f64::from_be_bytes(self.array()?), start)?,
            Marker::Bin8 | Marker::Bin16 | Marker::Bin32 => {
                let length = self.length(marker)?;
                Item::Binary(self.take(length)?)
            }
            Marker::FixArray(_) | Marker::Array16 | Marker::Array32 => Item::List(self.length(marker)?),
            Marker::FixMap(_) | Marker::Map16 | Marker::Map32 => Item::Map(self.length(marker)?),
            Marker::FixStr(_) | Marker::Str8 | Marker::Str16 | Marker::Str32 => {
                let length = self.length(marker)?;
                Item::Text(self.text(length)?)
            }
            Marker::FixExt4 | Marker::FixExt8 | Marker::Ext8 => self.time(marker, start)?,
            _ => return Err(bad_at(start, "a type that values do not have")),
        };
        Ok(item)
    }

    /// The key of a map's next member.
    pub(crate) fn key(&mut self) -> Result<&'a str, WireError> {
        let at = self.position;
        match self.item()? {
            Item::Text(key) => Ok(key),
            _ => Err(bad_at(at, "a key that is not a string")),
        }
    }

    fn value(&mut self, depth: usize) -> Result<Value, WireError> {
        let start = self.position;
        Ok(match self.item()? {
            Item::Null => Value::Null,
            Item::Bool(flag) => Value::Bool(flag),
            Item::Int(number) => Value::Int(number),
            Item::Double(number) => Value::Double(number),
            Item::Text(text) => Value::String(text.to_owned()),
            Item::Time(time) => Value::Time(time),
            Item::Binary(bytes) => Value::Binary(bytes),
            Item::List(length) => self.list(length, deeper(depth, start)?)?,
            Item::Map(length) => self.map(length, deeper(depth, start)?)?,
        })
    }

    fn list(&mut self, length: usize, depth: usize) -> Result<Value, WireError> {
        // The announced length is not trusted: memory grows with the bytes that are there, at least one per item.
        let mut list = Vec::with_capacity(length.min(self.rest()).min(1024));
        for _ in 0..length {
            list.push(self.value(depth)?);
        }
        Ok(Value::List(list))
    }

    fn map(&mut self, length: usize, depth: usize) -> Result<Value, WireError> {
        let mut map = Map::new();
        for _ in 0..length {
            let at = self.position;
            let key = self.key()?;
            let value = self.value(depth)?;
            map.insert_new(key.to_owned(), value)
                .map_err(|key| key_twice(&key, at))?;
        }
        Ok(Value::Map(map))
    }

    fn time(&mut self, marker: Marker, start: usize) -> Result<Item<'a>, WireError> {
        let length = match marker {
            Marker::FixExt4 => 4,
            Marker::FixExt8 => 8,
            _ => usize::from(self.array::<1>()?[0]),
        };
        let kind = i8::from_be_bytes(self.array()?);
        let (seconds, nanos) = match (kind, length) {
            (TIMESTAMP, 4) => (i64::from(u32::from_be_bytes(self.array()?)), 0),
            (TIMESTAMP, 8) => {
                let both = u64::from_be_bytes(self.array()?);
                (
                    i64::try_from(both & 0x3_FFFF_FFFF).unwrap_or_default(),
                    both >> 34,
                )
            }
            (TIMESTAMP, 12) => {
                let nanos = u32::from_be_bytes(self.array()?);
                (i64::from_be_bytes(self.array()?), nanos.into())
            }
            _ => return Err(bad_at(start, "an extension type that values do not have")),
        };
        let micros = seconds
            .checked_mul(1_000_000)
            .and_then(|micros| micros.checked_add(i64::try_from(nanos / 1000).ok()?))
            .filter(|_| nanos < 1_000_000_000);
        micros
            .and_then(Time::from_micros)
            .map(Item::Time)
            .ok_or_else(|| bad_at(start, "a time outside the years 0 to 9999"))
    }

    fn length(&mut self, marker: Marker) -> Result<usize, WireError> {
        Ok(match marker {
            Marker::FixStr(length) | Marker::FixArray(length) | Marker::FixMap(length) => length.into(),
            Marker::Str8 | Marker::Bin8 => self.array::<1>()?[0].into(),
            Marker::Str16 | Marker::Bin16 | Marker::Array16 | Marker::Map16 => {
                u16::from_be_bytes(self.array()?).into()
            }
            _ => u32::from_be_bytes(self.array()?) as usize,
        })
    }

    fn text(&mut self, length: usize) -> Result<&'a str, WireError> {
        let start = self.position;
        let bytes = self.take_slice(length)?;
        let text = std::str::from_utf8(bytes).map_err(|error| encoding(start + error.valid_up_to()))?;
        match xml_violation(text) {
            None => Ok(text),
            Some(at) => Err(encoding(start + at)),
        }
    }

    fn take(&mut self, length: usize) -> Result<Bytes, WireError> {
        let start = self.position;
        self.take_slice(length)?;
        Ok(self.bytes.slice(start..start + length))
    }

    fn take_slice(&mut self, length: usize) -> Result<&'a [u8], WireError> {
        if length > self.rest() {
            return Err(bad_at(self.bytes.len(), "the value ends too early"));
        }
        self.position += length;
        Ok(&self.bytes[self.position - length..self.position])
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], WireError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take_slice(N)?);
        Ok(array)
    }

    fn byte(&mut self) -> Result<u8, WireError> {
        Ok(self.array::<1>()?[0])
    }

    fn rest(&self) -> usize {
        self.bytes.len() - self.position
    }
}

fn finite<'a>(number: f64, position: usize) -> Result<Item<'a>, WireError> {
    match number.is_finite() {
        true => Ok(Item::Double(number)),
        false => Err(bad_at(position, "a double that is not finite")),
    }
}

/// The error for a key that stands twice in a map; `position` is where its member begins.
pub(crate) fn key_twice(key: &str, position: usize) -> WireError {
    bad_at(position, &format!("the key {key:?} twice in one map"))
}

/// So many levels more may open inside a list or map at this position.
pub(crate) fn deeper(depth: usize, position: usize) -> Result<usize, WireError> {
    match depth {
        0 => Err(WireError::new(Code::TOO_DEEP, "lists and maps are nested too deep").position(position)),
        _ => Ok(depth - 1),
    }
}

fn bad_at(position: usize, what: &str) -> WireError {
    WireError::new(
        Code::BAD_CONTENT,
        format!("content that is not a MessagePack value: {what}"),
    )
    .position(position)
}

fn encoding(position: usize) -> WireError {
    WireError::new(Code::BAD_ENCODING, "text that is not UTF-8 of XML characters").position(position)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round(value: &Value) {
        let mut out = Vec::new();
        encode(value, &mut out).unwrap();
        assert_eq!(decode(&out.into(), 32).as_ref(), Ok(value));
    }

    #[test]
    fn values_come_back() {
        for number in [
            0,
            1,
            -1,
            127,
            128,
            -32,
            -33,
            255,
            65536,
            i64::MAX,
            i64::MIN,
            1 << 32,
        ] {
            round(&Value::Int(number));
        }
        let nested = Map::new()
            .with("list", vec![Value::Null, Value::Bool(true)])
            .with("x", Value::Double(-0.5));
        round(&nested.into());
        round(&"tab\t and 😀".into());
        round(&Value::Binary(Bytes::from(vec![0; 70_000])));
        for micros in [
            0,
            -1,
            1_795_255_200_000_123,
            Time::MIN.micros(),
            Time::MAX.micros(),
        ] {
            round(&Time::from_micros(micros).unwrap().into());
        }
    }

    #[test]
    fn what_no_receiver_would_take_is_not_written() {
        let key = Map::new().with("\u{1b}", 1);
        for value in [
            Value::Double(f64::NAN),
            Value::Double(f64::INFINITY),
            "a\0".into(),
            key.into(),
        ] {
            let error = encode(&value, &mut Vec::new()).expect_err("refused");
            assert_eq!(error.code, Code::NOT_ENCODABLE, "{value:?}");
        }
    }

    fn check(bytes: &[u8], code: &Code, position: i64) {
        let error = decode(&Bytes::copy_from_slice(bytes), 32).expect_err("refused");
        assert_eq!(
            (&error.code, error.get("position")),
            (code, Some(&Value::Int(position))),
            "{bytes:02x?}"
        );
    }

    #[test]
    fn what_is_no_value_is_refused_with_its_place() {
        let bad = Code::BAD_CONTENT;
        check(&[], &bad, 0);
        check(&[0xc1], &bad, 0);
        check(&[0xc0, 0xc0], &bad, 1);
        check(&[0xcf, 0xff, 0, 0, 0, 0, 0, 0, 0], &bad, 0);
        check(&[0xcb, 0x7f, 0xf0, 0, 0, 0, 0, 0, 0], &bad, 0);
        check(&[0xca, 0x7f, 0xc0, 0, 0], &bad, 0);
        check(&[0x81, 0x01, 0x02], &bad, 1);
        check(&[0x82, 0xa1, b'a', 1, 0xa1, b'a', 2], &bad, 4);
        check(&[0xdd, 0xff, 0xff, 0xff, 0xff], &bad, 5);
        check(&[0xdf, 0xff, 0xff, 0xff, 0xff], &bad, 5);
        check(&[0xc6, 0xff, 0xff, 0xff, 0xff, 1], &bad, 6);
        check(&[0xd4, 1, 1], &bad, 0);
        check(&[0xd6, 1, 0, 0, 0, 0], &bad, 0);
        check(&[0xa2, b'a', 0xff], &Code::BAD_ENCODING, 2);
        check(&[0xa1, 0], &Code::BAD_ENCODING, 1);
        check(&[0xa3, 0xef, 0xbf, 0xbe], &Code::BAD_ENCODING, 1);
    }

    /// Threat 2: a million levels cost neither stack nor memory.
    #[test]
    fn nesting_ends_at_the_limit() {
        check(&[0x91; 1_000_000], &Code::TOO_DEEP, 32);
        let mut most = vec![0x91; 32];
        most.push(0xc0);
        assert!(decode(&most.into(), 32).is_ok());
    }
}
