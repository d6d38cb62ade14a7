//! From `serde` types to values.

use std::fmt::Display;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use bytes::Bytes;
use serde::Serialize;
use serde::ser::{
    SerializeMap, SerializeSeq, SerializeStruct, SerializeStructVariant, SerializeTuple,
    SerializeTupleStruct, SerializeTupleVariant, Serializer,
};

use crate::{Map, Time, Value, xml_violation};

use super::depth::Depth;
use super::error::SerdeError;
use super::{BINARY, TIME};

/// Makes one value.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ValueSerializer {
    depth: Depth,
    /// The value becomes a map's key, which is text.
    key: bool,
}

/// Makes a list, or a tuple variant: the list in a map of one member.
pub(super) struct ListSerializer {
    depth: Depth,
    list: Vec<Value>,
    variant: Option<&'static str>,
}

/// Makes a map, or a struct variant: the map in a map of one member.
pub(super) struct MapSerializer {
    depth: Depth,
    map: Map,
    key: Option<String>,
    variant: Option<&'static str>,
}

impl ValueSerializer {
    fn at(depth: Depth) -> ValueSerializer {
        ValueSerializer { depth, key: false }
    }

    fn whole<N: Copy + Display>(self, number: N) -> Result<Value, SerdeError>
    where
        i64: TryFrom<N>,
    {
        match i64::try_from(number) {
            Ok(number) => Ok(Value::Int(number)),
            Err(_) if self.key => Ok(Value::String(number.to_string())),
            Err(_) => Err(SerdeError::not_encodable(format!(
                "an int is a number from -2^63 to 2^63-1, not {number}"
            ))),
        }
    }

    fn list(
        self,
        length: Option<usize>,
        variant: Option<&'static str>,
    ) -> Result<ListSerializer, SerdeError> {
        let depth = self.inside_variant(variant)?.level()?;
        // The length is what the type claims; memory follows what really comes.
        let list = Vec::with_capacity(length.unwrap_or(0).min(1024));
        Ok(ListSerializer { depth, list, variant })
    }

    fn map(self, variant: Option<&'static str>) -> Result<MapSerializer, SerdeError> {
        let depth = self.inside_variant(variant)?.level()?;
        Ok(MapSerializer {
            depth,
            map: Map::new(),
            key: None,
            variant,
        })
    }

    fn inside_variant(self, variant: Option<&'static str>) -> Result<Depth, SerdeError> {
        match variant {
            Some(_) => self.depth.level(),
            None => Ok(self.depth),
        }
    }
}

impl Serializer for ValueSerializer {
    type Ok = Value;
    type Error = SerdeError;
    type SerializeSeq = ListSerializer;
    type SerializeTuple = ListSerializer;
    type SerializeTupleStruct = ListSerializer;
    type SerializeTupleVariant = ListSerializer;
    type SerializeMap = MapSerializer;
    type SerializeStruct = MapSerializer;
    type SerializeStructVariant = MapSerializer;

    /// Keys are asked for in their text form, values in their compact one.
    fn is_human_readable(&self) -> bool {
        self.key
    }

    fn serialize_bool(self, flag: bool) -> Result<Value, SerdeError> {
        Ok(Value::Bool(flag))
    }

    fn serialize_i8(self, number: i8) -> Result<Value, SerdeError> {
        self.whole(number)
    }

    fn serialize_i16(self, number: i16) -> Result<Value, SerdeError> {
        self.whole(number)
    }

    fn serialize_i32(self, number: i32) -> Result<Value, SerdeError> {
        self.whole(number)
    }

    fn serialize_i64(self, number: i64) -> Result<Value, SerdeError> {
        self.whole(number)
    }

    fn serialize_i128(self, number: i128) -> Result<Value, SerdeError> {
        self.whole(number)
    }

    fn serialize_u8(self, number: u8) -> Result<Value, SerdeError> {
        self.whole(number)
    }

    fn serialize_u16(self, number: u16) -> Result<Value, SerdeError> {
        self.whole(number)
    }

    fn serialize_u32(self, number: u32) -> Result<Value, SerdeError> {
        self.whole(number)
    }

    fn serialize_u64(self, number: u64) -> Result<Value, SerdeError> {
        self.whole(number)
    }

    fn serialize_u128(self, number: u128) -> Result<Value, SerdeError> {
        self.whole(number)
    }

    fn serialize_f32(self, number: f32) -> Result<Value, SerdeError> {
        self.serialize_f64(number.into())
    }

    fn serialize_f64(self, number: f64) -> Result<Value, SerdeError> {
        match number.is_finite() {
            true => Ok(Value::Double(number)),
            false => Err(SerdeError::not_encodable(format!(
                "a double must be finite, not {number}"
            ))),
        }
    }

    fn serialize_char(self, c: char) -> Result<Value, SerdeError> {
        self.serialize_str(c.encode_utf8(&mut [0; 4]))
    }

    fn serialize_str(self, text: &str) -> Result<Value, SerdeError> {
        check_text(text)?;
        Ok(Value::from(text))
    }

    fn serialize_bytes(self, bytes: &[u8]) -> Result<Value, SerdeError> {
        Ok(Value::Binary(Bytes::copy_from_slice(bytes)))
    }

    fn serialize_none(self) -> Result<Value, SerdeError> {
        Ok(Value::Null)
    }

    fn serialize_some<T: Serialize + ?Sized>(self, object: &T) -> Result<Value, SerdeError> {
        let depth = self.depth.step()?;
        object.serialize(ValueSerializer { depth, ..self })
    }

    fn serialize_unit(self) -> Result<Value, SerdeError> {
        Ok(Value::Null)
    }

    fn serialize_unit_struct(self, _name: &'static str) -> Result<Value, SerdeError> {
        Ok(Value::Null)
    }

    fn serialize_unit_variant(
        self,
        _name: &'static str,
        _index: u32,
        variant: &'static str,
    ) -> Result<Value, SerdeError> {
        self.serialize_str(variant)
    }

    fn serialize_newtype_struct<T: Serialize + ?Sized>(
        self,
        name: &'static str,
        object: &T,
    ) -> Result<Value, SerdeError> {
        let inner = self.serialize_some(object)?;
        match name {
            TIME if !self.key => time(&inner),
            BINARY if !self.key => binary(inner),
            _ => Ok(inner),
        }
    }

    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _name: &'static str,
        _index: u32,
        variant: &'static str,
        object: &T,
    ) -> Result<Value, SerdeError> {
        let inner = ValueSerializer::at(self.depth.level()?);
        let value = object.serialize(inner).map_err(|error| error.inside(variant))?;
        in_variant(Some(variant), value)
    }

    fn serialize_seq(self, length: Option<usize>) -> Result<ListSerializer, SerdeError> {
        self.list(length, None)
    }

    fn serialize_tuple(self, length: usize) -> Result<ListSerializer, SerdeError> {
        self.list(Some(length), None)
    }

    fn serialize_tuple_struct(
        self,
        _name: &'static str,
        length: usize,
    ) -> Result<ListSerializer, SerdeError> {
        self.list(Some(length), None)
    }

    fn serialize_tuple_variant(
        self,
        _name: &'static str,
        _index: u32,
        variant: &'static str,
        length: usize,
    ) -> Result<ListSerializer, SerdeError> {
        self.list(Some(length), Some(variant))
    }

    fn serialize_map(self, _length: Option<usize>) -> Result<MapSerializer, SerdeError> {
        self.map(None)
    }

    fn serialize_struct(self, _name: &'static str, _length: usize) -> Result<MapSerializer, SerdeError> {
        self.map(None)
    }

    fn serialize_struct_variant(
        self,
        _name: &'static str,
        _index: u32,
        variant: &'static str,
        _length: usize,
    ) -> Result<MapSerializer, SerdeError> {
        self.map(Some(variant))
    }
}

impl ListSerializer {
    fn push<T: Serialize + ?Sized>(&mut self, object: &T) -> Result<(), SerdeError> {
        let value = object
            .serialize(ValueSerializer::at(self.depth))
            .map_err(|error| in_place(error.inside(self.list.len()), self.variant))?;
        self.list.push(value);
        Ok(())
    }

    fn finish(self) -> Result<Value, SerdeError> {
        in_variant(self.variant, Value::List(self.list))
    }
}

impl SerializeSeq for ListSerializer {
    type Ok = Value;
    type Error = SerdeError;

    fn serialize_element<T: Serialize + ?Sized>(&mut self, object: &T) -> Result<(), SerdeError> {
        self.push(object)
    }

    fn end(self) -> Result<Value, SerdeError> {
        self.finish()
    }
}

impl SerializeTuple for ListSerializer {
    type Ok = Value;
    type Error = SerdeError;

    fn serialize_element<T: Serialize + ?Sized>(&mut self, object: &T) -> Result<(), SerdeError> {
        self.push(object)
    }

    fn end(self) -> Result<Value, SerdeError> {
        self.finish()
    }
}

impl SerializeTupleStruct for ListSerializer {
    type Ok = Value;
    type Error = SerdeError;

    fn serialize_field<T: Serialize + ?Sized>(&mut self, object: &T) -> Result<(), SerdeError> {
        self.push(object)
    }

    fn end(self) -> Result<Value, SerdeError> {
        self.finish()
    }
}

impl SerializeTupleVariant for ListSerializer {
    type Ok = Value;
    type Error = SerdeError;

    fn serialize_field<T: Serialize + ?Sized>(&mut self, object: &T) -> Result<(), SerdeError> {
        self.push(object)
    }

    fn end(self) -> Result<Value, SerdeError> {
        self.finish()
    }
}

impl MapSerializer {
    fn member<T: Serialize + ?Sized>(&mut self, key: String, object: &T) -> Result<(), SerdeError> {
        check_text(&key).map_err(|error| in_place(error, self.variant))?;
        match object.serialize(ValueSerializer::at(self.depth)) {
            Ok(value) => self.map.insert_new(key, value).map_err(|key| {
                let twice = SerdeError::not_encodable("it occurs twice");
                in_place(twice.inside(key), self.variant)
            }),
            Err(error) => Err(in_place(error.inside(key), self.variant)),
        }
    }

    fn finish(self) -> Result<Value, SerdeError> {
        in_variant(self.variant, Value::Map(self.map))
    }
}

impl SerializeMap for MapSerializer {
    type Ok = Value;
    type Error = SerdeError;

    fn serialize_key<T: Serialize + ?Sized>(&mut self, key: &T) -> Result<(), SerdeError> {
        let depth = self.depth;
        self.key = Some(key_text(key.serialize(ValueSerializer { depth, key: true })?)?);
        Ok(())
    }

    fn serialize_value<T: Serialize + ?Sized>(&mut self, object: &T) -> Result<(), SerdeError> {
        match self.key.take() {
            Some(key) => self.member(key, object),
            None => Err(SerdeError::not_encodable("a map's member has no key")),
        }
    }

    fn end(self) -> Result<Value, SerdeError> {
        self.finish()
    }
}

impl SerializeStruct for MapSerializer {
    type Ok = Value;
    type Error = SerdeError;

    fn serialize_field<T: Serialize + ?Sized>(
        &mut self,
        key: &'static str,
        object: &T,
    ) -> Result<(), SerdeError> {
        self.member(key.to_owned(), object)
    }

    fn end(self) -> Result<Value, SerdeError> {
        self.finish()
    }
}

impl SerializeStructVariant for MapSerializer {
    type Ok = Value;
    type Error = SerdeError;

    fn serialize_field<T: Serialize + ?Sized>(
        &mut self,
        key: &'static str,
        object: &T,
    ) -> Result<(), SerdeError> {
        self.member(key.to_owned(), object)
    }

    fn end(self) -> Result<Value, SerdeError> {
        self.finish()
    }
}

fn in_variant(variant: Option<&'static str>, value: Value) -> Result<Value, SerdeError> {
    let Some(variant) = variant else {
        return Ok(value);
    };
    check_text(variant)?;
    Ok(Map::new().with(variant, value).into())
}

fn in_place(error: SerdeError, variant: Option<&'static str>) -> SerdeError {
    match variant {
        Some(variant) => error.inside(variant),
        None => error,
    }
}

fn key_text(key: Value) -> Result<String, SerdeError> {
    match key {
        Value::String(text) => Ok(text),
        Value::Int(number) => Ok(number.to_string()),
        Value::Bool(flag) => Ok(flag.to_string()),
        other => Err(SerdeError::not_encodable(format!(
            "a map's key is text, a whole number or a boolean, not {}",
            other.kind().word()
        ))),
    }
}

fn check_text(text: &str) -> Result<(), SerdeError> {
    match xml_violation(text).and_then(|position| text[position..].chars().next()) {
        None => Ok(()),
        Some(c) => Err(SerdeError::not_encodable(format!(
            "character {c:?} is not allowed in a string; send it as binary"
        ))),
    }
}

// serde buffers some types on their way, and its buffers ask for text forms: both forms arrive here.
fn time(inner: &Value) -> Result<Value, SerdeError> {
    match inner {
        Value::Int(micros) => Time::from_micros(*micros),
        Value::String(text) => text.parse().ok(),
        _ => None,
    }
    .map(Value::Time)
    .ok_or_else(|| SerdeError::not_encodable("a time outside the years 0 to 9999"))
}

fn binary(inner: Value) -> Result<Value, SerdeError> {
    match inner {
        Value::String(text) => STANDARD
            .decode(text)
            .map(|bytes| Value::Binary(bytes.into()))
            .map_err(SerdeError::not_encodable),
        other => Ok(other),
    }
}
