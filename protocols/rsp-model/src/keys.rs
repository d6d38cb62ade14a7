//! What the values of a model's keys should be.

use std::ops::RangeInclusive;

use mom_toml_faults::{At, Item, Section, quoted, unknown};

use crate::fault::{Fault, Found};
use crate::model::LONGEST_NAME;

pub(crate) fn integer(
    keys: &Section,
    key: &str,
    within: RangeInclusive<u16>,
    default: Option<u16>,
) -> Result<u16, Found> {
    let item = match (keys.get(key), default) {
        (None, Some(default)) => return Ok(default),
        _ => keys.required(key)?,
    };
    let number = item.integer()?;
    match u16::try_from(number) {
        Ok(number) if within.contains(&number) => Ok(number),
        _ => {
            let words = format!(
                "`{key}` is {} to {}, and {number} is not",
                within.start(),
                within.end()
            );
            Err(Found::new(Fault::Number, &item.span, words))
        }
    }
}

/// A finite number.
pub(crate) fn number(item: &At<Item>) -> Result<f64, Found> {
    let number = item.number()?;
    if !number.is_finite() {
        return Err(Found::new(Fault::Number, &item.span, "expected a finite number"));
    }
    // There is one zero.
    Ok(number + 0.0)
}

/// The values of a list; of an attribute of XML, what white space separates.
pub(crate) fn list(item: &At<Item>) -> Option<Vec<At<Item>>> {
    match &item.value {
        Item::List(list) => Some(list.clone()),
        Item::Raw(raw) => {
            let part = |part: &str| At {
                value: Item::Raw(part.to_owned()),
                span: item.span.clone(),
            };
            Some(raw.split_whitespace().map(part).collect())
        }
        _ => None,
    }
}

pub(crate) fn word(item: &At<Item>) -> Result<At<String>, Found> {
    let text = item.text()?;
    if !is_word(text) {
        let words = format!(
            "`{}` is not a name: lower-case letters and digits, a letter first, `-` between them, at most {LONGEST_NAME}",
            quoted(text)
        );
        return Err(Found::new(Fault::Name, &item.span, words));
    }
    Ok(At {
        value: text.to_owned(),
        span: item.span.clone(),
    })
}

fn is_word(text: &str) -> bool {
    let part = |part: &str| {
        !part.is_empty()
            && part
                .bytes()
                .all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit())
    };
    text.len() <= LONGEST_NAME
        && text.starts_with(|first: char| first.is_ascii_lowercase())
        && text.split('-').all(part)
}

/// One of the words that stand for something.
pub(crate) fn choice<T: Copy>(item: &At<Item>, what: &str, choices: &[(&str, T)]) -> Result<T, Found> {
    let text = item.text()?;
    if let Some((_, chosen)) = choices.iter().find(|(word, _)| *word == text) {
        return Ok(*chosen);
    }
    let known: Vec<&str> = choices.iter().map(|(word, _)| *word).collect();
    let words = unknown(what, text, &known);
    Err(Found::new(Fault::UnknownWord, &item.span, words))
}
