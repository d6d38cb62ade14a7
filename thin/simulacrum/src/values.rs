//! Values in the units of a model, and on the wire.

use mom_rsp::{Number, Payload};
use mom_rsp_model::ModelElement;

/// Why values are not those of an element.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ValueFault {
    /// Another number of values than it has.
    #[error("{element} takes {wanted} values, {given} were given: {parts}")]
    Count {
        /// The element.
        element: String,
        /// How many it takes.
        wanted: usize,
        /// How many there were.
        given: usize,
        /// What they are, with their units.
        parts: String,
    },
    /// A value out of its range.
    #[error("{part} of {element} is {value}; it must be {min} to {max} {unit}")]
    Range {
        /// The element.
        element: String,
        /// Which of its values.
        part: String,
        /// What was given.
        value: f64,
        /// The least.
        min: f64,
        /// The most.
        max: f64,
        /// In which unit.
        unit: String,
    },
    /// Values of an element that has none, or whose values are bytes.
    #[error("{0} takes no numbers")]
    NoNumbers(String),
}

/// The values of an element in its units, from its bytes on the wire; none if it has no numbers.
#[must_use]
pub fn from_wire(element: &ModelElement, bytes: &[u8]) -> Vec<f64> {
    let Payload::Numbers(number, _) = element.payload else {
        return Vec::new();
    };
    let chunks = bytes.chunks_exact(number.size());
    let value = |(place, chunk): (usize, &[u8])| {
        let raw = read(number, chunk);
        element
            .quantity(place)
            .map_or(raw, |quantity| rounded(raw * quantity.scale))
    };
    chunks.enumerate().map(value).collect()
}

/// The bytes on the wire of values in an element's units.
///
/// # Errors
///
/// Another number of values, or one out of its range.
pub fn to_wire(element: &ModelElement, values: &[f64]) -> Result<Vec<u8>, ValueFault> {
    let name = || element.name.clone();
    let count = match element.payload {
        Payload::Numbers(_, count) => usize::from(count),
        Payload::Nothing => 0,
        Payload::Bytes(_) => return Err(ValueFault::NoNumbers(name())),
    };
    if values.len() != count {
        let parts = (0..count).filter_map(|place| element.quantity(place));
        let parts: Vec<String> = parts
            .map(|quantity| {
                let part = quantity.part.as_deref().unwrap_or("value");
                format!("{part} {}", quantity.unit).trim_end().to_owned()
            })
            .collect();
        return Err(ValueFault::Count {
            element: name(),
            wanted: count,
            given: values.len(),
            parts: parts.join(", "),
        });
    }
    let Payload::Numbers(number, _) = element.payload else {
        return Ok(Vec::new());
    };
    let mut bytes = Vec::with_capacity(number.size() * count);
    for (place, value) in values.iter().enumerate() {
        let Some(quantity) = element.quantity(place) else {
            return Err(ValueFault::NoNumbers(name()));
        };
        if !(quantity.min..=quantity.max).contains(value) {
            return Err(ValueFault::Range {
                element: name(),
                part: quantity.part.clone().unwrap_or_else(|| "the value".to_owned()),
                value: *value,
                min: quantity.min,
                max: quantity.max,
                unit: quantity.unit.clone(),
            });
        }
        write(number, value / quantity.scale, &mut bytes);
    }
    Ok(bytes)
}

fn read(number: Number, chunk: &[u8]) -> f64 {
    let mut wide = [0; 4];
    for (to, from) in wide.iter_mut().rev().zip(chunk.iter().rev()) {
        *to = *from;
    }
    let unsigned = u32::from_be_bytes(wide);
    match number {
        Number::U8 | Number::U16 | Number::U32 => f64::from(unsigned),
        Number::I8 => f64::from(unsigned as u8 as i8),
        Number::I16 => f64::from(unsigned as u16 as i16),
        Number::I32 => f64::from(unsigned as i32),
        Number::F32 => f64::from(f32::from_bits(unsigned)),
    }
}

/// Casts of floats saturate, so a value at the edge of its type stays there.
fn write(number: Number, value: f64, bytes: &mut Vec<u8>) {
    let whole = value.round();
    match number {
        Number::U8 => bytes.push(whole as u8),
        Number::I8 => bytes.extend((whole as i8).to_be_bytes()),
        Number::U16 => bytes.extend((whole as u16).to_be_bytes()),
        Number::I16 => bytes.extend((whole as i16).to_be_bytes()),
        Number::U32 => bytes.extend((whole as u32).to_be_bytes()),
        Number::I32 => bytes.extend((whole as i32).to_be_bytes()),
        Number::F32 => bytes.extend((value as f32).to_be_bytes()),
    }
}

/// Without what a scale such as 0.1 adds in its last digits.
fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}
