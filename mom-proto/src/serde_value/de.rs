//! From values to `serde` types.

use std::fmt::Display;
use std::str::FromStr;

use serde::de::value::StrDeserializer;
use serde::de::{
    self, DeserializeSeed, Deserializer, EnumAccess, IntoDeserializer, MapAccess, SeqAccess, Unexpected,
    VariantAccess, Visitor,
};
use serde::forward_to_deserialize_any;

use crate::{Map, Value};

use super::TIME;
use super::depth::Depth;
use super::error::SerdeError;

// Up to here every whole number has a float of its own.
const F64_EXACT: u64 = 1 << f64::MANTISSA_DIGITS;
const F32_EXACT: u64 = 1 << f32::MANTISSA_DIGITS;

/// Reads one value.
pub(super) struct ValueDeserializer {
    value: Value,
    depth: Depth,
}

impl ValueDeserializer {
    pub(super) fn new(value: Value) -> ValueDeserializer {
        let depth = Depth::default();
        ValueDeserializer { value, depth }
    }

    fn deeper(self) -> Result<ValueDeserializer, SerdeError> {
        let depth = self.depth.step()?;
        Ok(ValueDeserializer { depth, ..self })
    }

    /// The value with an int made a double, if it is an int that doubles of this precision hold.
    fn widened(self, exact: u64) -> ValueDeserializer {
        let value = match self.value {
            // Exact: the guard bounds the number by the precision.
            Value::Int(number) if number.unsigned_abs() <= exact => Value::Double(number as f64),
            other => other,
        };
        ValueDeserializer { value, ..self }
    }
}

impl<'de> Deserializer<'de> for ValueDeserializer {
    type Error = SerdeError;

    fn is_human_readable(&self) -> bool {
        false
    }

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, SerdeError> {
        match self.value {
            Value::Null => visitor.visit_unit(),
            Value::Bool(flag) => visitor.visit_bool(flag),
            Value::Int(number) => visitor.visit_i64(number),
            Value::Double(number) => visitor.visit_f64(number),
            Value::String(text) => visitor.visit_string(text),
            // serde's own buffers keep newtypes, so a time is still one in flattened and untagged types.
            Value::Time(time) => visitor.visit_newtype_struct(ValueDeserializer {
                value: Value::Int(time.micros()),
                depth: self.depth.step()?,
            }),
            Value::Binary(bytes) => visitor.visit_byte_buf(bytes.into()),
            Value::List(list) => visit_list(list, self.depth, visitor),
            Value::Map(map) => visit_map(map, self.depth, visitor),
        }
    }

    fn deserialize_f32<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, SerdeError> {
        match self.widened(F32_EXACT) {
            ValueDeserializer {
                value: Value::Double(number),
                ..
            } if (number as f32).is_finite() => visitor.visit_f64(number),
            other => Err(no_float(&other.value, &visitor)),
        }
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, SerdeError> {
        match self.widened(F64_EXACT).value {
            Value::Double(number) => visitor.visit_f64(number),
            other => Err(no_float(&other, &visitor)),
        }
    }

    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, SerdeError> {
        match self.value {
            // Other crates' types of instants read text.
            Value::Time(time) => visitor.visit_string(time.to_string()),
            _ => self.deserialize_any(visitor),
        }
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, SerdeError> {
        self.deserialize_str(visitor)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, SerdeError> {
        match self.value {
            Value::Null => visitor.visit_none(),
            _ => visitor.visit_some(self.deeper()?),
        }
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        visitor: V,
    ) -> Result<V::Value, SerdeError> {
        match (name, &self.value) {
            (TIME, Value::Time(_)) => self.deserialize_any(visitor),
            (TIME, value) if value.as_str().is_none() => Err(mismatch(value, &visitor)),
            _ => visitor.visit_newtype_struct(self.deeper()?),
        }
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        _fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, SerdeError> {
        match self.value {
            Value::Map(map) => visit_map(map, self.depth, visitor),
            // Derived types would take a list's members by their order, which no sender can have meant.
            other => Err(mismatch(&other, &visitor)),
        }
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &'static str,
        _variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, SerdeError> {
        let (variant, content, depth) = match self.value {
            Value::String(variant) => (variant, None, self.depth),
            Value::Map(map) if map.len() == 1 => match map.into_iter().next() {
                Some((variant, content)) => (variant, Some(content), self.depth.level()?),
                None => return Err(mismatch(&Value::Null, &VARIANT)),
            },
            other => return Err(mismatch(&other, &VARIANT)),
        };
        visitor.visit_enum(Variant {
            variant,
            content,
            depth,
        })
    }

    fn deserialize_ignored_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, SerdeError> {
        visitor.visit_unit()
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 char bytes byte_buf unit unit_struct
        seq tuple tuple_struct map identifier
    }
}

const VARIANT: &str = "a variant's name, or a map of one member named by it,";

struct List {
    items: std::vec::IntoIter<Value>,
    position: usize,
    depth: Depth,
}

impl<'de> SeqAccess<'de> for List {
    type Error = SerdeError;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, SerdeError> {
        let Some(value) = self.items.next() else {
            return Ok(None);
        };
        let position = self.position;
        self.position += 1;
        let depth = self.depth;
        seed.deserialize(ValueDeserializer { value, depth })
            .map(Some)
            .map_err(|error| error.inside(position))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.items.len())
    }
}

struct Members {
    members: indexmap::map::IntoIter<String, Value>,
    current: Option<(String, Value)>,
    depth: Depth,
}

impl<'de> MapAccess<'de> for Members {
    type Error = SerdeError;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, SerdeError> {
        self.current = self.members.next();
        let Some((key, _)) = &self.current else {
            return Ok(None);
        };
        let depth = self.depth;
        seed.deserialize(MapKey { key, depth })
            .map(Some)
            .map_err(|error| error.inside(key))
    }

    fn next_value_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<T::Value, SerdeError> {
        let Some((key, value)) = self.current.take() else {
            return Err(SerdeError::bad_content(
                "the type reads a map's member without its key",
            ));
        };
        let depth = self.depth;
        seed.deserialize(ValueDeserializer { value, depth })
            .map_err(|error| error.inside(key))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.members.len())
    }
}

/// A map's key: text, which may stand for a whole number, a boolean or a unit variant.
struct MapKey<'a> {
    key: &'a str,
    depth: Depth,
}

impl MapKey<'_> {
    fn number<'de, V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, SerdeError> {
        if let Some(number) = canonical(self.key) {
            visitor.visit_i64(number)
        } else if let Some(number) = canonical(self.key) {
            visitor.visit_u64(number)
        } else if let Some(number) = canonical(self.key) {
            visitor.visit_i128(number)
        } else if let Some(number) = canonical(self.key) {
            visitor.visit_u128(number)
        } else {
            visitor.visit_str(self.key)
        }
    }

    fn deeper(self) -> Result<Self, SerdeError> {
        let depth = self.depth.step()?;
        Ok(MapKey { depth, ..self })
    }
}

macro_rules! deserialize_numbers {
    ($($method:ident)*) => {
        $(fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, SerdeError> {
            self.number(visitor)
        })*
    };
}

impl<'de> Deserializer<'de> for MapKey<'_> {
    type Error = SerdeError;

    fn is_human_readable(&self) -> bool {
        true
    }

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, SerdeError> {
        visitor.visit_str(self.key)
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, SerdeError> {
        match self.key.parse() {
            Ok(flag) => visitor.visit_bool(flag),
            Err(_) => visitor.visit_str(self.key),
        }
    }

    deserialize_numbers! {
        deserialize_i8 deserialize_i16 deserialize_i32 deserialize_i64 deserialize_i128
        deserialize_u8 deserialize_u16 deserialize_u32 deserialize_u64 deserialize_u128
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, SerdeError> {
        visitor.visit_some(self.deeper()?)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        visitor: V,
    ) -> Result<V::Value, SerdeError> {
        visitor.visit_newtype_struct(self.deeper()?)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &'static str,
        _variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, SerdeError> {
        visitor.visit_enum(text(self.key))
    }

    forward_to_deserialize_any! {
        f32 f64 char str string bytes byte_buf unit unit_struct seq tuple tuple_struct map struct
        identifier ignored_any
    }
}

struct Variant {
    variant: String,
    content: Option<Value>,
    depth: Depth,
}

impl<'de> EnumAccess<'de> for Variant {
    type Error = SerdeError;
    type Variant = Variant;

    fn variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<(T::Value, Variant), SerdeError> {
        let variant = seed.deserialize(text(&self.variant))?;
        Ok((variant, self))
    }
}

impl Variant {
    /// Hands the content on; errors in it get the variant's name as their place.
    fn content<T>(
        self,
        read: impl FnOnce(ValueDeserializer) -> Result<T, SerdeError>,
    ) -> Result<T, SerdeError> {
        let Some(value) = self.content else {
            let text = format!(
                "the variant needs content: a map of one member {:?}",
                self.variant
            );
            return Err(SerdeError::bad_content(text));
        };
        let depth = self.depth;
        read(ValueDeserializer { value, depth }).map_err(|error| error.inside(self.variant))
    }
}

impl<'de> VariantAccess<'de> for Variant {
    type Error = SerdeError;

    fn unit_variant(self) -> Result<(), SerdeError> {
        match self.content {
            None | Some(Value::Null) => Ok(()),
            Some(other) => Err(mismatch(&other, &"nothing").inside(self.variant)),
        }
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<T::Value, SerdeError> {
        self.content(|content| seed.deserialize(content))
    }

    fn tuple_variant<V: Visitor<'de>>(self, length: usize, visitor: V) -> Result<V::Value, SerdeError> {
        self.content(|content| content.deserialize_tuple(length, visitor))
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, SerdeError> {
        self.content(|content| content.deserialize_struct("", fields, visitor))
    }
}

fn visit_list<'de, V: Visitor<'de>>(
    list: Vec<Value>,
    depth: Depth,
    visitor: V,
) -> Result<V::Value, SerdeError> {
    let length = list.len();
    let mut list = List {
        items: list.into_iter(),
        position: 0,
        depth: depth.level()?,
    };
    let object = visitor.visit_seq(&mut list)?;
    match list.items.len() {
        0 => Ok(object),
        left => Err(SerdeError::bad_content(format!(
            "{length} members stand where {} are wanted",
            length - left
        ))),
    }
}

fn visit_map<'de, V: Visitor<'de>>(map: Map, depth: Depth, visitor: V) -> Result<V::Value, SerdeError> {
    let mut members = Members {
        members: map.into_iter(),
        current: None,
        depth: depth.level()?,
    };
    let object = visitor.visit_map(&mut members)?;
    match members.members.next() {
        None => Ok(object),
        Some((key, _)) => Err(SerdeError::bad_content("nothing more may stand here").inside(key)),
    }
}

fn mismatch(value: &Value, wanted: &dyn de::Expected) -> SerdeError {
    let given = match value {
        Value::Null => Unexpected::Unit,
        Value::Bool(flag) => Unexpected::Bool(*flag),
        Value::Int(number) => Unexpected::Signed(*number),
        Value::Double(number) => Unexpected::Float(*number),
        Value::String(text) => Unexpected::Str(text),
        Value::Time(_) => Unexpected::NewtypeStruct,
        Value::Binary(bytes) => Unexpected::Bytes(bytes),
        Value::List(_) => Unexpected::Seq,
        Value::Map(_) => Unexpected::Map,
    };
    de::Error::invalid_type(given, wanted)
}

fn no_float(value: &Value, wanted: &dyn de::Expected) -> SerdeError {
    match value {
        Value::Int(number) => SerdeError::bad_content(format!("int {number} has no exact form as {wanted}")),
        _ => mismatch(value, wanted),
    }
}

fn text(text: &str) -> StrDeserializer<'_, SerdeError> {
    text.into_deserializer()
}

/// Reads a number in the one form in which it is written: two keys never stand for the same number.
fn canonical<N: FromStr + Display>(text: &str) -> Option<N> {
    text.parse().ok().filter(|number: &N| number.to_string() == text)
}
