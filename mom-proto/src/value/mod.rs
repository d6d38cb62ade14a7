//! The values that slots hold (design §5, M3, M11).

use bytes::Bytes;

use crate::Time;

mod map;

pub use map::Map;

/// A typed value: what a slot, a list member or a map member holds.
///
/// Every codec carries every value and gives back an equal one. Strings hold XML 1.0 characters only and
/// doubles are finite; the codecs refuse others with `bad-encoding` and `bad-content`.
///
/// ```
/// use mom_proto::Value;
/// assert_eq!(Value::from(3).as_int(), Some(3));
/// assert_eq!(Value::from("up").kind().word(), "string");
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Value {
    /// No value.
    #[default]
    Null,
    /// True or false.
    Bool(bool),
    /// A whole number of 64 bits. Ids, fences and counts stay below 2⁵³.
    Int(i64),
    /// A finite binary64 number.
    Double(f64),
    /// Text of XML 1.0 characters.
    String(String),
    /// An instant: µs since the Unix epoch, UTC.
    Time(Time),
    /// Bytes (M15).
    Binary(Bytes),
    /// Values in order.
    List(Vec<Value>),
    /// Members in order, keys without duplicates.
    Map(Map),
}

/// The type of a [`Value`], with its word on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ValueKind {
    /// `null`
    Null,
    /// `boolean`
    Bool,
    /// `int`
    Int,
    /// `double`
    Double,
    /// `string`
    String,
    /// `time`
    Time,
    /// `binary`
    Binary,
    /// `list`
    List,
    /// `map`
    Map,
}

impl ValueKind {
    /// All kinds, in the order of the design's list.
    pub const ALL: [ValueKind; 9] = [
        ValueKind::Null,
        ValueKind::Bool,
        ValueKind::Int,
        ValueKind::Double,
        ValueKind::String,
        ValueKind::Time,
        ValueKind::Binary,
        ValueKind::List,
        ValueKind::Map,
    ];

    /// The word used in XML's `type` attribute, in JSON and in error texts.
    pub fn word(self) -> &'static str {
        match self {
            ValueKind::Null => "null",
            ValueKind::Bool => "boolean",
            ValueKind::Int => "int",
            ValueKind::Double => "double",
            ValueKind::String => "string",
            ValueKind::Time => "time",
            ValueKind::Binary => "binary",
            ValueKind::List => "list",
            ValueKind::Map => "map",
        }
    }

    /// The kind with this word.
    pub fn from_word(word: &str) -> Option<ValueKind> {
        ValueKind::ALL.into_iter().find(|kind| kind.word() == word)
    }
}

impl Value {
    /// The type of this value.
    pub fn kind(&self) -> ValueKind {
        match self {
            Value::Null => ValueKind::Null,
            Value::Bool(_) => ValueKind::Bool,
            Value::Int(_) => ValueKind::Int,
            Value::Double(_) => ValueKind::Double,
            Value::String(_) => ValueKind::String,
            Value::Time(_) => ValueKind::Time,
            Value::Binary(_) => ValueKind::Binary,
            Value::List(_) => ValueKind::List,
            Value::Map(_) => ValueKind::Map,
        }
    }

    /// The number, if this is an int.
    pub fn as_int(&self) -> Option<i64> {
        match self {
            Value::Int(number) => Some(*number),
            _ => None,
        }
    }

    /// The text, if this is a string.
    pub fn as_str(&self) -> Option<&str> {
        match self {
            Value::String(text) => Some(text),
            _ => None,
        }
    }

    /// The instant, if this is a time.
    pub fn as_time(&self) -> Option<Time> {
        match self {
            Value::Time(time) => Some(*time),
            _ => None,
        }
    }

    /// True or false, if this is a boolean.
    pub fn as_bool(&self) -> Option<bool> {
        match self {
            Value::Bool(flag) => Some(*flag),
            _ => None,
        }
    }

    /// The members, if this is a map.
    pub fn as_map(&self) -> Option<&Map> {
        match self {
            Value::Map(map) => Some(map),
            _ => None,
        }
    }

    /// The members, if this is a list.
    pub fn as_list(&self) -> Option<&[Value]> {
        match self {
            Value::List(list) => Some(list),
            _ => None,
        }
    }

    /// The bytes, if this is binary.
    pub fn as_binary(&self) -> Option<&Bytes> {
        match self {
            Value::Binary(bytes) => Some(bytes),
            _ => None,
        }
    }

    /// The member of this name, if this is a map that has it.
    pub fn get(&self, key: &str) -> Option<&Value> {
        self.as_map().and_then(|map| map.get(key))
    }
}

impl From<bool> for Value {
    fn from(flag: bool) -> Value {
        Value::Bool(flag)
    }
}

impl From<i32> for Value {
    fn from(number: i32) -> Value {
        Value::Int(number.into())
    }
}

impl From<u32> for Value {
    fn from(number: u32) -> Value {
        Value::Int(number.into())
    }
}

impl From<i64> for Value {
    fn from(number: i64) -> Value {
        Value::Int(number)
    }
}

impl From<f64> for Value {
    /// A number that is not finite becomes null: no form can say it.
    fn from(number: f64) -> Value {
        match number.is_finite() {
            true => Value::Double(number),
            false => Value::Null,
        }
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Value {
        Value::String(text.to_owned())
    }
}

impl From<String> for Value {
    fn from(text: String) -> Value {
        Value::String(text)
    }
}

impl From<Time> for Value {
    fn from(time: Time) -> Value {
        Value::Time(time)
    }
}

impl From<Bytes> for Value {
    fn from(bytes: Bytes) -> Value {
        Value::Binary(bytes)
    }
}

impl From<Map> for Value {
    fn from(map: Map) -> Value {
        Value::Map(map)
    }
}

impl From<Vec<Value>> for Value {
    fn from(list: Vec<Value>) -> Value {
        Value::List(list)
    }
}
