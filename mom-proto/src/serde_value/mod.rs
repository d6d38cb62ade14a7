//! Any `serde` type as a parcel's content: the papers' registry of writers (M14).
//!
//! | `serde` | [`Value`] |
//! |---|---|
//! | bool | boolean |
//! | whole numbers up to 2⁶³−1 | int |
//! | finite floats | double |
//! | char, string of XML characters | string |
//! | bytes (a plain `Vec<u8>` is a sequence of whole numbers) | binary |
//! | [`Time`](crate::Time) | time |
//! | `None`, unit | null |
//! | `Some(x)`, newtype struct | as what is inside |
//! | sequence, tuple, array, tuple struct | list |
//! | map with keys of text, whole numbers or booleans; struct | map |
//! | unit variant | string |
//! | any other variant | map of one member, named by the variant |
//!
//! Reading is strict: a double is never read as a whole number, an int only as a double that holds it
//! exactly, a time as an instant or its text. What does not fit is told with its place.
//!
//! The format is a compact one: types with two forms, such as `IpAddr`, use the one that is not for people,
//! except as keys. `serde`'s buffers (flattened, untagged and internally tagged types) always ask for the
//! other, so such a type cannot be read back from inside them.
//!
//! [`Value`], [`Map`](crate::Map) and [`Time`](crate::Time) are `serde` types themselves: they stand inside
//! others, and other formats read and write them. Text formats get a time as its text and binary as base64,
//! and give both back as strings; a date with a time in TOML becomes a time.

mod de;
mod depth;
mod error;
mod impls;
mod ser;
#[cfg(test)]
mod tests;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::{Value, WireError};

// Names of newtype structs: how values without a type in serde's model announce themselves to our serializer.
const TIME: &str = "$mom::time";
const BINARY: &str = "$mom::binary";

/// The value for an object of any `serde` type.
///
/// ```
/// use mom_proto::{Map, Value, to_value};
/// use serde::Serialize;
///
/// #[derive(Serialize)]
/// struct Goal {
///     joint: u8,
///     angle: f64,
/// }
///
/// let value = to_value(&Goal { joint: 2, angle: 0.5 }).unwrap();
/// assert_eq!(value, Map::new().with("joint", 2).with("angle", Value::Double(0.5)).into());
///
/// let error = to_value(&[0.5, f64::NAN]).unwrap_err();
/// assert_eq!(error.get("slot").and_then(Value::as_str), Some("content/1"));
/// ```
///
/// # Errors
/// `not-encodable` for what has no form on the wire (a number that is not finite or too large, a character
/// outside XML, a key that is not text), `too-deep` beyond [`HARD_DEPTH`](crate::HARD_DEPTH); both name the
/// place as their slot: `content/blocks/2/x`.
pub fn to_value<T: Serialize + ?Sized>(object: &T) -> Result<Value, WireError> {
    Ok(object.serialize(ser::ValueSerializer::default())?)
}

/// The object of any `serde` type that a value stands for.
///
/// ```
/// use mom_proto::{Map, Value, from_value};
/// use serde::Deserialize;
///
/// #[derive(Debug, Deserialize)]
/// struct Goal {
///     joint: u8,
///     angle: f64,
/// }
///
/// let goal: Goal = from_value(Map::new().with("joint", 2).with("angle", 1).into()).unwrap();
/// assert_eq!((goal.joint, goal.angle), (2, 1.0));
///
/// let error = from_value::<Goal>(Map::new().with("joint", 300).with("angle", 1).into()).unwrap_err();
/// assert_eq!(error.get("slot").and_then(Value::as_str), Some("content/joint"));
/// assert_eq!(error.text, "content/joint: int 300 stands where u8 is wanted");
/// ```
///
/// # Errors
/// `bad-content` for what does not fit the type, `too-deep` beyond [`HARD_DEPTH`](crate::HARD_DEPTH); both
/// name the place as their slot: `content/blocks/2/x`. Inside types that `serde` buffers (flattened, untagged
/// and internally tagged ones) the place is that of the buffered whole.
pub fn from_value<T: DeserializeOwned>(value: Value) -> Result<T, WireError> {
    Ok(T::deserialize(de::ValueDeserializer::new(value))?)
}
