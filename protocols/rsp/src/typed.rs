//! Elements in the types of a model: what code that is generated from one builds on.
//!
//! A generated type stands for each element and says its place, and how its values become bytes and come of them.

use crate::Number;

/// What one number of an element means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantity {
    /// Its type on the wire.
    pub number: Number,
    /// The value in its unit is the number on the wire times this.
    pub scale: f64,
    /// The least value, in its unit.
    pub min: f64,
    /// The greatest value, in its unit.
    pub max: f64,
}

impl Quantity {
    /// Writes a value in its unit as on the wire, or says that it is outside the range. `to` has the number's size.
    #[must_use]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a model's range lies within its type, and casts saturate"
    )]
    pub fn put(&self, value: f64, to: &mut [u8]) -> bool {
        // What came of a number of the wire must go back there, whatever its last digit.
        let slack = self.scale * 1e-6;
        if !(value >= self.min - slack && value <= self.max + slack) {
            return false;
        }
        let wire = value / self.scale;
        // Away from zero at a half; core does not round.
        let whole = (wire + if wire < 0.0 { -0.5 } else { 0.5 }) as i64;
        let bytes = match self.number {
            Number::U8 => [whole as u8, 0, 0, 0],
            Number::I8 => [whole as i8 as u8, 0, 0, 0],
            Number::U16 => wide((whole as u16).to_be_bytes()),
            Number::I16 => wide((whole as i16).to_be_bytes()),
            Number::U32 => (whole as u32).to_be_bytes(),
            Number::I32 => (whole as i32).to_be_bytes(),
            Number::F32 => (wire as f32).to_be_bytes(),
        };
        match bytes.get(..self.number.size()) {
            Some(bytes) if bytes.len() == to.len() => {
                to.copy_from_slice(bytes);
                true
            }
            _ => false,
        }
    }

    /// A value in its unit from bytes of the wire, of which there have to be as many as the number has.
    #[must_use]
    pub fn get(&self, from: &[u8]) -> Option<f64> {
        let wire = match (self.number, from) {
            (Number::U8, &[byte]) => f64::from(byte),
            (Number::I8, &[byte]) => f64::from(i8::from_be_bytes([byte])),
            (Number::U16, &[a, b]) => f64::from(u16::from_be_bytes([a, b])),
            (Number::I16, &[a, b]) => f64::from(i16::from_be_bytes([a, b])),
            (Number::U32, &[a, b, c, d]) => f64::from(u32::from_be_bytes([a, b, c, d])),
            (Number::I32, &[a, b, c, d]) => f64::from(i32::from_be_bytes([a, b, c, d])),
            (Number::F32, &[a, b, c, d]) => f64::from(f32::from_be_bytes([a, b, c, d])),
            _ => return None,
        };
        Some(wire * self.scale)
    }
}

const fn wide([a, b]: [u8; 2]) -> [u8; 4] {
    [a, b, 0, 0]
}

/// Stands for an element of a model.
pub trait Named {
    /// Its place among the elements.
    const PLACE: u8;
    /// Its name.
    const NAME: &'static str;
}

/// Stands for an element that has numbers.
pub trait Numbers: Named {
    /// Its values in a program: numbers with their units.
    type Value: Copy;
    /// Its values as numbers, each in its unit.
    type List: AsRef<[f64]> + AsMut<[f64]> + Copy;
    /// Its values on the wire.
    type Bytes: AsRef<[u8]> + AsMut<[u8]> + Copy;
    /// As many zeros as it has numbers.
    const LIST: Self::List;
    /// As many zeros as it has bytes.
    const BYTES: Self::Bytes;
    /// What its numbers mean: one for each, or one for all.
    const QUANTITIES: &'static [Quantity];
    /// Whether a value from the wire is brought into its range, as those of absolute effectors are: a robot never moves
    /// beyond it, whatever it is told.
    const LIMITED: bool;

    /// The numbers of a value.
    fn list(value: Self::Value) -> Self::List;

    /// The value of numbers; all of them are there.
    fn value(list: Self::List) -> Self::Value;

    /// What the number of this index means.
    #[must_use]
    fn quantity(index: usize) -> Option<&'static Quantity> {
        Self::QUANTITIES.get(index).or_else(|| Self::QUANTITIES.first())
    }

    /// The bytes of a value, `None` if a number of it is outside its range.
    #[must_use]
    fn encode(value: Self::Value) -> Option<Self::Bytes> {
        encode_list::<Self>(Self::list(value))
    }

    /// The value of bytes, `None` if these are not as many as it has.
    #[must_use]
    fn decode(bytes: &[u8]) -> Option<Self::Value> {
        decode_list::<Self>(bytes).map(Self::value)
    }
}

fn size<N: Numbers + ?Sized>() -> usize {
    N::QUANTITIES.first().map_or(1, |first| first.number.size())
}

fn encode_list<N: Numbers + ?Sized>(list: N::List) -> Option<N::Bytes> {
    let mut bytes = N::BYTES;
    let parts = bytes.as_mut().chunks_exact_mut(size::<N>());
    for (index, (part, number)) in parts.zip(list.as_ref()).enumerate() {
        if !N::quantity(index)?.put(*number, part) {
            return None;
        }
    }
    Some(bytes)
}

fn decode_list<N: Numbers + ?Sized>(bytes: &[u8]) -> Option<N::List> {
    let mut list = N::LIST;
    if bytes.len() != N::BYTES.as_ref().len() {
        return None;
    }
    let parts = bytes.chunks_exact(size::<N>());
    for (index, (number, part)) in list.as_mut().iter_mut().zip(parts).enumerate() {
        let quantity = N::quantity(index)?;
        let value = quantity.get(part)?;
        *number = match N::LIMITED {
            true => value.max(quantity.min).min(quantity.max),
            false => value,
        };
    }
    Some(list)
}

/// Stands for an element of type bytes.
pub trait Bytes: Named {}

/// Stands for a command or event without data.
pub trait Plain: Named {}

/// Stands for an effector.
pub trait Effector: Named {}

/// Stands for a sensor or a monitor.
pub trait Sensor: Named {}

/// Stands for a command or a memory command.
pub trait Command: Named {}

#[cfg(feature = "middle")]
mod handle;

#[cfg(feature = "middle")]
pub use handle::{Handle, Known};

/// Why a value did not go out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unsent {
    /// It is outside the range that the model gives.
    Range,
    /// The end of the protocol refused it.
    Refused(crate::Refused),
}

impl core::fmt::Display for Unsent {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Unsent::Range => f.write_str("the value is outside the range of the model"),
            Unsent::Refused(refused) => refused.fmt(f),
        }
    }
}

impl core::error::Error for Unsent {}

impl From<crate::Refused> for Unsent {
    fn from(refused: crate::Refused) -> Unsent {
        Unsent::Refused(refused)
    }
}
