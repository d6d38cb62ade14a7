//! Units as types of Rust, and values of elements as such types.

use mom_rsp::{Kind, Number, Payload};

use crate::model::{Model, ModelElement, Quantity, number_word};

/// The units of a model, each with the name of its type.
pub(super) struct Units(Vec<(String, String)>);

impl Units {
    pub(super) fn of(model: &Model) -> Units {
        let mut units: Vec<(String, String)> = Vec::new();
        let quantities = model.elements.iter().flat_map(|element| &element.quantities);
        for Quantity { unit, .. } in quantities {
            if unit.is_empty() || units.iter().any(|(known, _)| known == unit) {
                continue;
            }
            let mut name = type_name(unit);
            // `mm` and `Mm` are two units, whose names are one.
            while units.iter().any(|(_, known)| *known == name) {
                name.push_str("Other");
            }
            units.push((unit.clone(), name));
        }
        Units(units)
    }

    /// Each unit, and its type.
    pub(super) fn iter(&self) -> impl Iterator<Item = &(String, String)> {
        self.0.iter()
    }

    fn name(&self, unit: &str) -> &str {
        let found = self.0.iter().find(|(known, _)| known == unit);
        found.map_or("", |(_, name)| name)
    }
}

/// `MmPerS` of `mm/s`.
fn type_name(unit: &str) -> String {
    let mut name = String::new();
    let mut begins = true;
    for c in unit.strip_prefix('1').unwrap_or(unit).chars() {
        match c {
            '/' => name.push_str("Per"),
            '%' => name.push_str("Percent"),
            c if c.is_ascii_alphanumeric() => {
                name.push(if begins { c.to_ascii_uppercase() } else { c });
            }
            _ => {}
        }
        begins = !c.is_ascii_alphanumeric();
    }
    match name.starts_with(|c: char| c.is_ascii_uppercase()) {
        true => name,
        false => format!("Unit{name}"),
    }
}

/// The type of one number.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Scalar {
    /// A number with a unit: the name of its type.
    Unit(String),
    /// A number without a unit that is not the one on the wire.
    Float,
    /// The number on the wire.
    Raw(Number),
}

impl Scalar {
    fn of(quantity: &Quantity, number: Number, units: &Units) -> Scalar {
        match quantity.unit.as_str() {
            "" if quantity.scale == 1.0 => Scalar::Raw(number),
            "" => Scalar::Float,
            unit => Scalar::Unit(units.name(unit).to_owned()),
        }
    }

    /// The type, seen from a module of the generated file.
    pub(super) fn path(&self) -> String {
        match self {
            Scalar::Unit(name) => format!("super::units::{name}"),
            Scalar::Float => "f64".to_owned(),
            Scalar::Raw(number) => number_word(*number).to_owned(),
        }
    }

    /// The expression that makes a plain number of it.
    pub(super) fn number(&self, value: &str) -> String {
        match self {
            Scalar::Unit(_) => format!("{value}.0"),
            Scalar::Float => value.to_owned(),
            Scalar::Raw(_) => format!("f64::from({value})"),
        }
    }

    /// The expression that makes it of a plain number.
    pub(super) fn of_number(&self, number: &str) -> String {
        match self {
            Scalar::Unit(_) => format!("{}({number})", self.path()),
            Scalar::Float => number.to_owned(),
            Scalar::Raw(_) => format!("{number} as {}", self.path()),
        }
    }
}

/// The type of an element's values.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Shape {
    /// One number.
    One(Scalar),
    /// Numbers of one type.
    Array(Scalar, u16),
    /// Numbers with names: a structure of this name.
    Parts(String, Vec<(String, Scalar)>),
}

impl Shape {
    /// The shape of an element that has numbers. A monitor's is that of its effector.
    pub(super) fn of(model: &Model, element: &ModelElement, units: &Units) -> Option<Shape> {
        let Payload::Numbers(number, count) = element.payload else {
            return None;
        };
        let named = match (element.kind, element.of) {
            (Kind::Monitor, Some(of)) => model.elements.get(usize::from(of))?,
            _ => element,
        };
        let scalar = |quantity: &Quantity| Scalar::of(quantity, number, units);
        let parts: Vec<(String, Scalar)> = element
            .quantities
            .iter()
            .filter_map(|quantity| Some((quantity.part.clone()?, scalar(quantity))))
            .collect();
        if !parts.is_empty() {
            return Some(Shape::Parts(super::names::camel(&named.name), parts));
        }
        let first = element.quantities.first().map(scalar)?;
        let is_one_type = element.quantities.iter().all(|other| scalar(other) == first);
        Some(match count {
            1 => Shape::One(first),
            _ if is_one_type => Shape::Array(first, count),
            _ => Shape::Array(Scalar::Float, count),
        })
    }

    /// The type, seen from a module of the generated file.
    pub(super) fn path(&self) -> String {
        match self {
            Shape::One(scalar) => scalar.path(),
            Shape::Array(scalar, count) => format!("[{}; {count}]", scalar.path()),
            Shape::Parts(name, _) => format!("super::elements::{name}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_become_types() {
        for (unit, name) in [
            ("mm/s", "MmPerS"),
            ("m/s^2", "MPerS2"),
            ("%", "Percent"),
            ("1/s", "PerS"),
            ("kg*m", "KgM"),
            ("1", "Unit"),
            ("12", "Unit2"),
        ] {
            assert_eq!(type_name(unit), name);
        }
    }
}
