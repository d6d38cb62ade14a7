//! Writes parcels: one object on one line.

use std::collections::HashSet;
use std::io::Write as _;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use bytes::Bytes;

use crate::frame::Encoded;
use crate::msgpack::{self, Item, ItemReader, key_twice};
use crate::names::position_of;
use crate::slots::check_extra;
use crate::text_form::{deeper, not_encodable, too_large, within};
use crate::{
    Content, HARD_DEPTH, Limit, MAX_ID, Parcel, ReadSlots, SlotValue, Value, ValueKind, WireError,
    write_slots,
};

/// Encodes a parcel as one line.
///
/// The slots come in a fixed order, content last, without white space between them.
///
/// ```
/// use mom_proto::{Family, Parcel, json};
/// let encoded = json::encode(&Parcel::new(Family::Message, "chat").content("a \"b\"")).unwrap();
/// assert!(encoded.to_vec().ends_with(b"\"content\":\"a \\\"b\\\"\"}\n"));
/// ```
///
/// # Errors
/// `not-encodable` with its slot for a double that is not finite and for text outside XML's characters, `too-deep`
/// beyond [`HARD_DEPTH`], `bad-slot` for a known slot among the other ones, and what [`Content::to_value`] says
/// about encoded content.
pub fn encode(parcel: &Parcel) -> Result<Encoded, WireError> {
    encode_within(parcel, HARD_DEPTH, Limit::Unlimited)
}

/// As [`encode`], for content of so many levels at most and a line of so many bytes. The bounds hold while it is
/// written: what is refused needs no more memory than what is not.
///
/// # Errors
/// As [`encode`]; `too-deep` for encoded content beyond `depth`, `not-encodable` beyond `most`.
pub fn encode_within(parcel: &Parcel, depth: usize, most: Limit) -> Result<Encoded, WireError> {
    check_extra(&parcel.extra)?;
    let mut writer = JsonWriter {
        out: Vec::with_capacity(512),
        most: most.get(),
    };
    writer.parcel(parcel, depth)?;
    // The end of the line is not counted: the limit is of what stands in it.
    writer.check(0)?;
    writer.out.push(b'\n');
    Ok(Encoded {
        head: writer.out.into(),
        body: Bytes::new(),
    })
}

struct JsonWriter {
    out: Vec<u8>,
    most: usize,
}

impl JsonWriter {
    fn parcel(&mut self, parcel: &Parcel, depth: usize) -> Result<(), WireError> {
        self.out.push(b'{');
        let mut written = Ok(());
        write_slots(parcel, |key, value| {
            if written.is_ok() {
                written = self.slot(key, &value).map_err(|error| within(error, key));
            }
        });
        written?;
        if let Some(content) = &parcel.content {
            self.key("content")?;
            match content {
                Content::Value(value) => self
                    .value(value, HARD_DEPTH)
                    .map_err(|error| within(error, "content"))?,
                encoded => {
                    let bytes = encoded.to_msgpack()?;
                    let mut items = ItemReader::new(&bytes);
                    self.encoded(&mut items, depth)?;
                    items.end()?;
                }
            }
        }
        self.out.push(b'}');
        Ok(())
    }

    fn slot(&mut self, key: &str, value: &SlotValue<'_>) -> Result<(), WireError> {
        self.key(key)?;
        match value {
            SlotValue::Text(text) => self.leaf(Item::Text(text)),
            SlotValue::Value(value) => match **value {
                // The slot says what it is, so that its text needs no tag.
                Value::Time(time) if ReadSlots::kind_of(key) == Some(ValueKind::Time) => {
                    self.time(time);
                    Ok(())
                }
                ref value => self.value(value, HARD_DEPTH),
            },
        }
    }

    fn value(&mut self, value: &Value, depth: usize) -> Result<(), WireError> {
        let leaf = match value {
            Value::List(list) => {
                let depth = deeper(depth)?;
                self.out.push(b'[');
                list.iter().enumerate().try_for_each(|(index, item)| {
                    self.next()?;
                    self.value(item, depth)
                        .map_err(|error| within(error, &index.to_string()))
                })?;
                self.out.push(b']');
                return Ok(());
            }
            Value::Map(map) => {
                let depth = deeper(depth)?;
                let tagged = self.open_map(map.keys().next());
                map.iter().try_for_each(|(key, item)| {
                    self.key(key)
                        .and_then(|()| self.value(item, depth))
                        .map_err(|error| within(error, key))
                })?;
                self.close_map(tagged);
                return Ok(());
            }
            Value::Null => Item::Null,
            Value::Bool(flag) => Item::Bool(*flag),
            Value::Int(number) => Item::Int(*number),
            Value::Double(number) => Item::Double(*number),
            Value::String(text) => Item::Text(text),
            Value::Time(time) => Item::Time(*time),
            Value::Binary(bytes) => Item::Binary(bytes.clone()),
        };
        self.leaf(leaf)
    }

    /// The next value of encoded content, in which so many levels more may open.
    fn encoded(&mut self, items: &mut ItemReader<'_>, depth: usize) -> Result<(), WireError> {
        let start = items.position();
        match items.item()? {
            Item::List(length) => {
                let depth = msgpack::deeper(depth, start)?;
                self.out.push(b'[');
                for _ in 0..length {
                    self.next()?;
                    self.encoded(items, depth)?;
                }
                self.out.push(b']');
                Ok(())
            }
            Item::Map(length) => {
                let depth = msgpack::deeper(depth, start)?;
                self.encoded_map(length, items, depth)
            }
            leaf => self.leaf(leaf),
        }
    }

    fn encoded_map(
        &mut self,
        length: usize,
        items: &mut ItemReader<'_>,
        depth: usize,
    ) -> Result<(), WireError> {
        let mut keys = HashSet::new();
        let mut tagged = false;
        for index in 0..length {
            let at = items.position();
            let key = items.key()?;
            if index == 0 {
                tagged = self.open_map(Some(key));
            }
            if !keys.insert(key) {
                return Err(key_twice(key, at));
            }
            self.key(key)?;
            self.encoded(items, depth)?;
        }
        if length == 0 {
            self.open_map(None);
        }
        self.close_map(tagged);
        Ok(())
    }

    /// Begins a map with this first key, in a tag of its own where it could be taken for a tag; whether it has one.
    fn open_map(&mut self, first: Option<&str>) -> bool {
        let tagged = first.is_some_and(|key| key.starts_with('$'));
        self.put(if tagged { b"{\"$map\":{" } else { b"{" });
        tagged
    }

    fn close_map(&mut self, tagged: bool) {
        self.put(if tagged { b"}}" } else { b"}" });
    }

    /// A value that holds no others.
    fn leaf(&mut self, value: Item<'_>) -> Result<(), WireError> {
        match value {
            Item::Null => self.put(b"null"),
            Item::Bool(flag) => self.put(if flag { b"true" } else { b"false" }),
            Item::Int(number) => {
                // Beyond it a double, which is what most languages make of a number, does not hold every int.
                let exact = number.unsigned_abs() <= MAX_ID;
                self.put(if exact { b"" } else { b"{\"$int\":\"" });
                self.put(itoa::Buffer::new().format(number).as_bytes());
                self.put(if exact { b"" } else { b"\"}" });
            }
            Item::Double(number) if number.is_finite() => {
                // The Debug form is the shortest that reads back equal, and always has a point or an exponent.
                write!(self.out, "{number:?}").map_err(|error| not_encodable(error.to_string()))?;
            }
            Item::Double(number) => {
                return Err(not_encodable(format!("a double must be finite, not {number}")));
            }
            Item::Text(text) => self.text(text)?,
            Item::Time(time) => {
                self.put(b"{\"$time\":");
                self.time(time);
                self.put(b"}");
            }
            Item::Binary(bytes) => self.binary(&bytes)?,
            Item::List(_) | Item::Map(_) => {}
        }
        Ok(())
    }

    fn time(&mut self, time: crate::Time) {
        self.out.push(b'"');
        time.write(&mut self.out);
        self.out.push(b'"');
    }

    fn binary(&mut self, bytes: &[u8]) -> Result<(), WireError> {
        let size = bytes.len().div_ceil(3) * 4;
        self.check(size)?;
        self.put(b"{\"$binary\":\"");
        let start = self.out.len();
        self.out.resize(start + size, 0);
        STANDARD
            .encode_slice(bytes, &mut self.out[start..])
            .map_err(|error| not_encodable(error.to_string()))?;
        self.put(b"\"}");
        Ok(())
    }

    fn key(&mut self, key: &str) -> Result<(), WireError> {
        self.next()?;
        self.text(key)?;
        self.out.push(b':');
        Ok(())
    }

    /// Goes on to the next member of a list or map.
    fn next(&mut self) -> Result<(), WireError> {
        self.check(0)?;
        if !matches!(self.out.last(), Some(b'[' | b'{')) {
            self.out.push(b',');
        }
        Ok(())
    }

    fn text(&mut self, text: &str) -> Result<(), WireError> {
        self.check(text.len())?;
        self.out.push(b'"');
        let bytes = text.as_bytes();
        let mut copied = 0;
        let mut at = 0;
        while let Some(found) = position_of(&bytes[at..], is_special) {
            at += found + 1;
            let special = at - 1;
            let escaped: &[u8] = match bytes[special] {
                b'"' => b"\\\"",
                b'\\' => b"\\\\",
                b'\n' => b"\\n",
                b'\r' => b"\\r",
                b'\t' => b"\\t",
                0xEF if !matches!(bytes[at..], [0xBF, 0xBE | 0xBF, ..]) => continue,
                _ => {
                    let c = text[special..].chars().next().unwrap_or_default();
                    return Err(not_encodable(format!(
                        "the character {c:?} is not allowed in a string"
                    )));
                }
            };
            self.put(&bytes[copied..special]);
            self.put(escaped);
            copied = at;
            self.check(0)?;
        }
        self.put(&bytes[copied..]);
        self.out.push(b'"');
        Ok(())
    }

    /// Checks that so many bytes more fit.
    fn check(&self, more: usize) -> Result<(), WireError> {
        match self.out.len().saturating_add(more) <= self.most {
            true => Ok(()),
            false => Err(too_large("JSON", self.most)),
        }
    }

    fn put(&mut self, bytes: &[u8]) {
        self.out.extend_from_slice(bytes);
    }
}

// What has to be looked at: what JSON escapes, what strings do not have, and 0xEF, with which U+FFFE and U+FFFF begin.
fn is_special(byte: u8) -> bool {
    (byte < 0x20) | (byte == b'"') | (byte == b'\\') | (byte == 0xEF)
}
