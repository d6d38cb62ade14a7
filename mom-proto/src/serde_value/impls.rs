//! Values, maps and times as `serde` types, for every format.

use std::fmt;

use base64::display::Base64Display;
use base64::engine::general_purpose::STANDARD;
use bytes::Bytes;
use serde::de::{self, Deserialize, Deserializer, MapAccess, SeqAccess, Unexpected, Visitor};
use serde::ser::{Serialize, SerializeMap, Serializer};

use crate::{Map, Time, Value, check_text};

use super::{BINARY, TIME};

// How the toml crate shows a date with a time to those who ask for anything.
const TOML_DATETIME: &str = "$__toml_private_datetime";

impl Serialize for Time {
    /// Its text in text formats, µs since the epoch in others, a time in a [`Value`].
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        struct TimeForm(Time);

        impl Serialize for TimeForm {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                match serializer.is_human_readable() {
                    true => serializer.collect_str(&self.0),
                    false => serializer.serialize_i64(self.0.micros()),
                }
            }
        }

        serializer.serialize_newtype_struct(TIME, &TimeForm(*self))
    }
}

impl<'de> Deserialize<'de> for Time {
    /// From its text, from µs since the epoch where the format has no times, from a time in a [`Value`].
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Time, D::Error> {
        deserializer.deserialize_newtype_struct(TIME, TimeVisitor)
    }
}

impl Serialize for Value {
    /// Binary is base64 in text formats.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Value::Null => serializer.serialize_unit(),
            Value::Bool(flag) => serializer.serialize_bool(*flag),
            Value::Int(number) => serializer.serialize_i64(*number),
            Value::Double(number) => serializer.serialize_f64(*number),
            Value::String(text) => serializer.serialize_str(text),
            Value::Time(time) => time.serialize(serializer),
            Value::Binary(bytes) => serializer.serialize_newtype_struct(BINARY, &BinaryForm(bytes)),
            Value::List(list) => serializer.collect_seq(list),
            Value::Map(map) => map.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Value {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Value, D::Error> {
        let text_format = deserializer.is_human_readable();
        deserializer.deserialize_any(ValueVisitor { text_format })
    }
}

impl Serialize for Map {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.len()))?;
        for (key, value) in self.iter() {
            map.serialize_entry(key, value)?;
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for Map {
    /// In the format's order; a key that occurs twice is refused.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Map, D::Error> {
        deserializer.deserialize_map(MapVisitor)
    }
}

struct BinaryForm<'a>(&'a Bytes);

impl Serialize for BinaryForm<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match serializer.is_human_readable() {
            true => serializer.collect_str(&Base64Display::new(self.0, &STANDARD)),
            false => serializer.serialize_bytes(self.0),
        }
    }
}

struct TimeVisitor;

impl<'de> Visitor<'de> for TimeVisitor {
    type Value = Time;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a time like 2026-11-21T10:00:00.000123Z")
    }

    fn visit_newtype_struct<D: Deserializer<'de>>(self, deserializer: D) -> Result<Time, D::Error> {
        match deserializer.is_human_readable() {
            true => deserializer.deserialize_any(self),
            false => deserializer.deserialize_i64(self),
        }
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<Time, E> {
        text.parse()
            .map_err(|_| E::invalid_value(Unexpected::Str(text), &self))
    }

    fn visit_i64<E: de::Error>(self, micros: i64) -> Result<Time, E> {
        Time::from_micros(micros).ok_or_else(|| E::invalid_value(Unexpected::Signed(micros), &self))
    }

    fn visit_u64<E: de::Error>(self, micros: u64) -> Result<Time, E> {
        i64::try_from(micros)
            .ok()
            .and_then(Time::from_micros)
            .ok_or_else(|| E::invalid_value(Unexpected::Unsigned(micros), &self))
    }

    /// A date with a time in TOML.
    fn visit_map<A: MapAccess<'de>>(self, mut members: A) -> Result<Time, A::Error> {
        match members.next_key::<String>()? {
            Some(key) if key == TOML_DATETIME => self.visit_str(&members.next_value::<String>()?),
            _ => Err(de::Error::invalid_type(Unexpected::Map, &self)),
        }
    }
}

struct ValueVisitor {
    text_format: bool,
}

impl<'de> Visitor<'de> for ValueVisitor {
    type Value = Value;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a value: null, boolean, int, double, string, time, binary, list or map")
    }

    fn visit_unit<E: de::Error>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_none<E: de::Error>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_some<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        deserializer.deserialize_any(self)
    }

    fn visit_bool<E: de::Error>(self, flag: bool) -> Result<Value, E> {
        Ok(Value::Bool(flag))
    }

    fn visit_i64<E: de::Error>(self, number: i64) -> Result<Value, E> {
        Ok(Value::Int(number))
    }

    fn visit_u64<E: de::Error>(self, number: u64) -> Result<Value, E> {
        i64::try_from(number)
            .map(Value::Int)
            .map_err(|_| E::invalid_value(Unexpected::Unsigned(number), &"a whole number up to 2^63-1"))
    }

    fn visit_f64<E: de::Error>(self, number: f64) -> Result<Value, E> {
        match number.is_finite() {
            true => Ok(Value::Double(number)),
            false => Err(E::invalid_value(Unexpected::Float(number), &"a finite double")),
        }
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<Value, E> {
        self.visit_string(text.to_owned())
    }

    fn visit_string<E: de::Error>(self, text: String) -> Result<Value, E> {
        checked(text).map(Value::String)
    }

    fn visit_bytes<E: de::Error>(self, bytes: &[u8]) -> Result<Value, E> {
        Ok(Value::Binary(Bytes::copy_from_slice(bytes)))
    }

    fn visit_byte_buf<E: de::Error>(self, bytes: Vec<u8>) -> Result<Value, E> {
        Ok(Value::Binary(bytes.into()))
    }

    /// A time in a [`Value`]: nothing else comes as a newtype unasked.
    fn visit_newtype_struct<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        TimeVisitor.visit_newtype_struct(deserializer).map(Value::Time)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Value, A::Error> {
        // The announced length is a claim: memory follows what really comes.
        let mut list = Vec::with_capacity(items.size_hint().unwrap_or(0).min(1024));
        while let Some(item) = items.next_element()? {
            list.push(item);
        }
        Ok(Value::List(list))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut members: A) -> Result<Value, A::Error> {
        let mut map = Map::new();
        let Some(key) = members.next_key::<String>()? else {
            return Ok(map.into());
        };
        if self.text_format && key == TOML_DATETIME {
            let text: String = members.next_value()?;
            return TimeVisitor.visit_str(&text).map(Value::Time);
        }
        map.set(&checked(key)?, members.next_value::<Value>()?);
        read_members(map, members).map(Value::Map)
    }
}

struct MapVisitor;

impl<'de> Visitor<'de> for MapVisitor {
    type Value = Map;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a map")
    }

    fn visit_map<A: MapAccess<'de>>(self, members: A) -> Result<Map, A::Error> {
        read_members(Map::new(), members)
    }
}

fn read_members<'de, A: MapAccess<'de>>(mut map: Map, mut members: A) -> Result<Map, A::Error> {
    while let Some(key) = members.next_key()? {
        map.insert_new(checked(key)?, members.next_value()?)
            .map_err(|key| de::Error::custom(format_args!("the key {key:?} occurs twice")))?;
    }
    Ok(map)
}

/// Strings hold XML characters only, whatever format they come from.
fn checked<E: de::Error>(text: String) -> Result<String, E> {
    match check_text(&text) {
        Ok(()) => Ok(text),
        Err(error) => Err(E::custom(error.text)),
    }
}
