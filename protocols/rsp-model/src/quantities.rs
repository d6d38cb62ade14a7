//! What the numbers of an element mean: units, scales, ranges and safe values.

use std::collections::HashSet;

use mom_rsp::{Kind, Number};
use mom_toml_faults::{At, Item, Section, quoted};

use crate::fault::{Fault, Found};
use crate::keys::{integer, list, number, word};
use crate::model::{Quantity, bounds, number_word, write_number};

/// The most characters of a unit.
const LONGEST_UNIT: usize = 16;

/// What is said once for all numbers of an element, or once for each.
enum Said<T> {
    Once(T),
    Each(Vec<T>),
}

impl<T: Clone> Said<T> {
    fn get(&self, index: usize) -> Option<&T> {
        match self {
            Said::Once(value) => Some(value),
            Said::Each(values) => values.get(index),
        }
    }

    fn is_each(&self) -> bool {
        matches!(self, Said::Each(_))
    }
}

/// How many numbers an element has: as `count` says, or as many as it names parts; 1 otherwise.
pub(crate) fn count(keys: &Section) -> Result<u16, Found> {
    let parts = keys.get("parts").and_then(list).map_or(1, |parts| parts.len());
    let default = u16::try_from(parts).unwrap_or(u16::MAX).max(1);
    integer(keys, "count", 1..=u16::MAX, Some(default))
}

/// The quantities of an element with so many numbers: one for all, or one for each.
pub(crate) fn read(
    keys: &Section,
    kind: Kind,
    of: Number,
    count: u16,
    incremental: bool,
) -> Result<Vec<Quantity>, Found> {
    let units = said(keys, "unit", count, unit)?.unwrap_or(Said::Once(String::new()));
    let scales = said(keys, "scale", count, scale)?.unwrap_or(Said::Once(1.0));
    let ranges = ranges(keys, count)?;
    let safes = said(keys, "safe", count, |item| Ok((number(item)?, item.span.clone())))?;
    let parts = parts(keys, count)?;
    let each = parts.is_some()
        || units.is_each()
        || scales.is_each()
        || ranges.as_ref().is_some_and(Said::is_each)
        || safes.as_ref().is_some_and(Said::is_each);
    let mut quantities = Vec::new();
    for index in 0..if each { usize::from(count) } else { 1 } {
        let scale = scales.get(index).copied().unwrap_or(1.0);
        let (lowest, highest) = bounds(of);
        let (min, max) = match ranges.as_ref().and_then(|ranges| ranges.get(index)) {
            Some(range) => within(range, of, scale)?,
            None => (lowest * scale, highest * scale),
        };
        let mut quantity = Quantity {
            part: parts.as_ref().and_then(|parts| parts.get(index).cloned()),
            unit: units.get(index).cloned().unwrap_or_default(),
            scale,
            min: min + 0.0,
            max: max + 0.0,
            safe: 0.0,
        };
        if kind == Kind::Effector {
            let safe = safes.as_ref().and_then(|safes| safes.get(index));
            quantity.safe = safe_value(keys, &quantity, safe, incremental)?;
        }
        quantities.push(quantity);
    }
    // What says the same of each says it of all, so that both ways to write it are one model.
    if let Some(first) = quantities.first().cloned()
        && quantities.iter().all(|other| *other == first)
    {
        quantities.truncate(1);
    }
    Ok(quantities)
}

/// The safe values as on the wire.
pub(crate) fn safe_bytes(quantities: &[Quantity], of: Number, count: u16) -> Vec<u8> {
    let mut bytes = Vec::new();
    for index in 0..usize::from(count) {
        if let Some(quantity) = quantities.get(index).or_else(|| quantities.first()) {
            write_number(of, quantity.safe / quantity.scale, &mut bytes);
        }
    }
    bytes
}

fn said<T>(
    keys: &Section,
    key: &str,
    count: u16,
    read: impl Fn(&At<Item>) -> Result<T, Found>,
) -> Result<Option<Said<T>>, Found> {
    let Some(item) = keys.get(key) else {
        return Ok(None);
    };
    let several = match &item.value {
        Item::List(_) => true,
        Item::Raw(raw) => raw.split_whitespace().nth(1).is_some(),
        _ => false,
    };
    match list(item) {
        Some(values) if several => {
            as_many(&values, key, count, item)?;
            Ok(Some(Said::Each(
                values.iter().map(read).collect::<Result<_, _>>()?,
            )))
        }
        _ => Ok(Some(Said::Once(read(item)?))),
    }
}

fn as_many<T>(values: &[T], key: &str, count: u16, item: &At<Item>) -> Result<(), Found> {
    if values.len() != usize::from(count) {
        let words = format!(
            "`{key}` has {} values for {count} numbers: give it once for all, or once for each",
            values.len()
        );
        return Err(Found::new(Fault::Count, &item.span, words));
    }
    Ok(())
}

fn unit(item: &At<Item>) -> Result<String, Found> {
    let unit = item.text()?;
    let known = |c: char| c.is_ascii_alphanumeric() || "/*^%".contains(c);
    let first = |c: char| c.is_ascii_alphabetic() || c == '%' || c == '1';
    let is_unit = unit.len() <= LONGEST_UNIT && unit.starts_with(first) && unit.chars().all(known);
    if !is_unit && !unit.is_empty() {
        let words = format!(
            "`{}` is not a unit: at most {LONGEST_UNIT} letters, digits, `/`, `*`, `^` and `%`, as in `mm/s` or `m/s^2`",
            quoted(unit)
        );
        return Err(Found::new(Fault::Name, &item.span, words));
    }
    Ok(unit.to_owned())
}

fn scale(item: &At<Item>) -> Result<f64, Found> {
    let scale = number(item)?;
    // Beyond these, what the type holds would not be numbers any more.
    if !(1e-12..=1e12).contains(&scale) {
        let words = format!(
            "a scale is 1e-12 to 1e12, and {scale} is not: the value in the unit is the wire's times it"
        );
        return Err(Found::new(Fault::Number, &item.span, words));
    }
    Ok(scale)
}

type Range = (At<Item>, f64, f64);

/// One range for all numbers, or a list of ranges.
fn ranges(keys: &Section, count: u16) -> Result<Option<Said<Range>>, Found> {
    let Some(item) = keys.get("range") else {
        return Ok(None);
    };
    let values = list(item).ok_or_else(|| item.wrong_type("a list of two numbers"))?;
    let pair = |item: &At<Item>, values: &[At<Item>]| match values {
        [min, max] => Ok((item.clone(), number(min)?, number(max)?)),
        _ => {
            let words = format!(
                "a range is the least and the greatest value, and these are {} values",
                values.len()
            );
            Err(Found::new(Fault::Count, &item.span, words))
        }
    };
    if !values.iter().any(|value| matches!(value.value, Item::List(_))) {
        // An attribute of XML has no lists in lists: two numbers for each.
        if matches!(item.value, Item::Raw(_)) && values.len() > 2 {
            let pairs: Vec<&[At<Item>]> = values.chunks(2).collect();
            as_many(&pairs, "range", count, item)?;
            let each = pairs.into_iter().map(|values| pair(item, values));
            return Ok(Some(Said::Each(each.collect::<Result<_, _>>()?)));
        }
        return Ok(Some(Said::Once(pair(item, &values)?)));
    }
    as_many(&values, "range", count, item)?;
    let each = values.iter().map(|value| {
        let values = list(value).ok_or_else(|| value.wrong_type("a list of two numbers"))?;
        pair(value, &values)
    });
    Ok(Some(Said::Each(each.collect::<Result<_, _>>()?)))
}

fn within((item, min, max): &Range, of: Number, scale: f64) -> Result<(f64, f64), Found> {
    if min > max {
        let words = format!("the range is reversed: {min} is more than {max}; the least value goes first");
        return Err(Found::new(Fault::Range, &item.span, words));
    }
    let (lowest, highest) = bounds(of);
    let (low, high) = match of {
        Number::F32 => (min / scale, max / scale),
        _ => ((min / scale).round(), (max / scale).round()),
    };
    if low < lowest || high > highest {
        let words = format!(
            "{min} to {max} does not fit: {} holds {} to {} at a scale of {scale}",
            number_word(of),
            lowest * scale,
            highest * scale
        );
        return Err(Found::new(Fault::Range, &item.span, words));
    }
    Ok((*min, *max))
}

fn safe_value(
    keys: &Section,
    quantity: &Quantity,
    safe: Option<&(f64, std::ops::Range<usize>)>,
    incremental: bool,
) -> Result<f64, Found> {
    let (value, span) = match safe {
        Some((value, span)) => (*value, span),
        None => (0.0, &keys.span),
    };
    if incremental && value != 0.0 {
        let words = format!("the safe step of an incremental effector must be 0, not {value}");
        return Err(Found::new(Fault::Safe, span, words));
    }
    if value < quantity.min || value > quantity.max {
        let words = match safe {
            Some(_) => format!(
                "the safe value {value} is outside the range, {} to {}",
                quantity.min, quantity.max
            ),
            None => format!(
                "0 is outside the range, {} to {}, so `safe` is required",
                quantity.min, quantity.max
            ),
        };
        return Err(Found::new(Fault::Safe, span, words));
    }
    Ok(value)
}

/// The names of the numbers.
fn parts(keys: &Section, count: u16) -> Result<Option<Vec<String>>, Found> {
    let Some(item) = keys.get("parts") else {
        return Ok(None);
    };
    let values = list(item).ok_or_else(|| item.wrong_type("a list of names"))?;
    as_many(&values, "parts", count, item)?;
    let mut known = HashSet::new();
    let mut parts: Vec<String> = Vec::new();
    for value in &values {
        let name = word(value)?;
        if !known.insert(in_code(&name.value)) {
            let words = format!(
                "two parts have the name `{}`, or one that is the same in generated code",
                name.value
            );
            return Err(Found::new(Fault::NameTwice, &name.span, words));
        }
        parts.push(name.value);
    }
    Ok(Some(parts))
}

/// A name as code tells it from others, where `-` is left out: `left-1` and `left1` are both `Left1`.
pub(crate) fn in_code(name: &str) -> String {
    name.replace('-', "")
}
