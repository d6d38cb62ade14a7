//! A parcel's content, opened only where needed (design §5).

use bytes::Bytes;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::{HARD_DEPTH, Map, Packed, Value, WireError, from_value, msgpack, to_value};

/// What a parcel carries: a value, or a value still encoded as MessagePack.
///
/// A parcel that arrives in binary and leaves in binary is never opened; [`Content::to_value`] opens it.
#[derive(Clone, Debug)]
pub enum Content {
    /// A value in memory.
    Value(Value),
    /// One value as MessagePack, unchecked until it is opened.
    Encoded(Bytes),
    /// The same, compressed: in the binary form only, where both ends have agreed on it.
    Packed(Packed),
}

impl Content {
    /// The content for any `serde` type: the papers' registry of writers (M14).
    ///
    /// # Errors
    /// `not-encodable` for what has no form on the wire, with its place.
    pub fn of<T: Serialize + ?Sized>(object: &T) -> Result<Content, WireError> {
        to_value(object).map(Content::Value)
    }

    /// Opens the content.
    ///
    /// # Errors
    /// `bad-content`, `bad-encoding` or `too-deep` for encoded content that is not a value.
    pub fn to_value(&self) -> Result<Value, WireError> {
        match self {
            Content::Value(value) => Ok(value.clone()),
            Content::Encoded(bytes) => msgpack::decode(bytes, HARD_DEPTH),
            Content::Packed(packed) => msgpack::decode(&packed.unpack()?, HARD_DEPTH),
        }
    }

    /// Opens the content and gives the value away.
    ///
    /// # Errors
    /// As [`Content::to_value`].
    pub fn into_value(self) -> Result<Value, WireError> {
        match self {
            Content::Value(value) => Ok(value),
            Content::Encoded(bytes) => msgpack::decode(&bytes, HARD_DEPTH),
            Content::Packed(packed) => msgpack::decode(&packed.unpack()?, HARD_DEPTH),
        }
    }

    /// Its size in bytes: exact where it is encoded, else about what MessagePack would take. Compressed content counts what it
    /// unpacks to, for some receiver has to take all of that.
    pub fn size(&self) -> usize {
        match self {
            Content::Encoded(bytes) => bytes.len(),
            Content::Packed(packed) => packed.length(),
            Content::Value(value) => size(value),
        }
    }

    /// Reads the content as any `serde` type.
    ///
    /// # Errors
    /// `bad-content` naming the place inside that does not fit.
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, WireError> {
        self.to_value().and_then(from_value)
    }

    /// The content as MessagePack; no copy if it is encoded already.
    ///
    /// # Errors
    /// `not-encodable` for a double that is not finite; `bad-content` for what cannot be decompressed.
    pub fn to_msgpack(&self) -> Result<Bytes, WireError> {
        match self {
            Content::Encoded(bytes) => Ok(bytes.clone()),
            Content::Packed(packed) => packed.unpack(),
            Content::Value(value) => {
                let mut out = Vec::with_capacity(64);
                msgpack::encode(value, &mut out)?;
                Ok(out.into())
            }
        }
    }
}

pub(crate) fn size(value: &Value) -> usize {
    match value {
        Value::String(text) => 5 + text.len(),
        Value::Binary(bytes) => 5 + bytes.len(),
        Value::List(list) => 5 + list.iter().map(size).sum::<usize>(),
        Value::Map(map) => map_size(map),
        _ => 9,
    }
}

pub(crate) fn map_size(map: &Map) -> usize {
    let member = |(key, item): (&str, &Value)| 5 + key.len() + size(item);
    5 + map.iter().map(member).sum::<usize>()
}

impl<T: Into<Value>> From<T> for Content {
    fn from(value: T) -> Content {
        Content::Value(value.into())
    }
}

/// Contents are equal if they hold equal values, encoded or not.
impl PartialEq for Content {
    fn eq(&self, other: &Content) -> bool {
        match (self, other) {
            (Content::Value(one), Content::Value(two)) => one == two,
            (Content::Encoded(one), Content::Encoded(two)) if one == two => true,
            (Content::Packed(one), Content::Packed(two)) if one == two => true,
            _ => matches!((self.to_value(), other.to_value()), (Ok(one), Ok(two)) if one == two),
        }
    }
}
