//! Elements in the types of a model: what code that is generated from one builds on.
//!
//! A generated type stands for each element and says its place, and how its values become bytes and come of them.

use crate::{Number, number};

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
    pub fn put(&self, value: f64, to: &mut [u8]) -> bool {
        // What came of a number of the wire must go back there, whatever its last digit.
        let slack = self.scale * 1e-6;
        if !(value >= self.min - slack && value <= self.max + slack) || to.len() != self.number.size() {
            return false;
        }
        let wire = value / self.scale;
        let wire = match self.number {
            Number::F32 => number::bits(wire as f32),
            // Away from zero at a half; core does not round.
            _ => number::saturate(self.number, (wire + if wire < 0.0 { -0.5 } else { 0.5 }) as i64),
        };
        number::store(wire, to);
        true
    }

    /// A value in its unit from bytes of the wire, of which there have to be as many as the number has.
    #[must_use]
    pub fn get(&self, from: &[u8]) -> Option<f64> {
        if from.len() != self.number.size() {
            return None;
        }
        let wire = number::load(self.number, from);
        let wire = match self.number {
            Number::F32 => f64::from(number::float(wire)),
            _ => wire as f64,
        };
        Some(wire * self.scale)
    }
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
        quantity_of(Self::QUANTITIES, index)
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

fn encode_list<N: Numbers + ?Sized>(list: N::List) -> Option<N::Bytes> {
    let mut bytes = N::BYTES;
    encode_all(N::QUANTITIES, list.as_ref(), bytes.as_mut()).then_some(bytes)
}

fn decode_list<N: Numbers + ?Sized>(bytes: &[u8]) -> Option<N::List> {
    let mut list = N::LIST;
    let fits = bytes.len() == N::BYTES.as_ref().len();
    (fits && decode_all(N::QUANTITIES, N::LIMITED, bytes, list.as_mut())).then_some(list)
}

/// What the number of this index means, of those of an element.
fn quantity_of(quantities: &[Quantity], index: usize) -> Option<&Quantity> {
    quantities.get(index).or_else(|| quantities.first())
}

fn size(quantities: &[Quantity]) -> usize {
    quantities.first().map_or(1, |first| first.number.size())
}

// Once for all elements: a copy for each would be a tenth of a robot's code.
fn encode_all(quantities: &[Quantity], list: &[f64], bytes: &mut [u8]) -> bool {
    let parts = bytes.chunks_exact_mut(size(quantities));
    let mut all = parts.zip(list).enumerate();
    all.all(|(index, (part, number))| {
        quantity_of(quantities, index).is_some_and(|quantity| quantity.put(*number, part))
    })
}

fn decode_all(quantities: &[Quantity], limited: bool, bytes: &[u8], list: &mut [f64]) -> bool {
    let parts = bytes.chunks_exact(size(quantities));
    for (index, (number, part)) in list.iter_mut().zip(parts).enumerate() {
        let Some((quantity, value)) = quantity_of(quantities, index).and_then(|of| Some((of, of.get(part)?)))
        else {
            return false;
        };
        *number = match limited {
            true => value.max(quantity.min).min(quantity.max),
            false => value,
        };
    }
    true
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
