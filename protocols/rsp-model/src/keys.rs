//! The keys of a section, read as what they should be.

use std::ops::{Range, RangeInclusive};

use crate::fault::{Fault, Found};
use crate::model::LONGEST_NAME;
use crate::text::{At, Item, Section};

/// A section whose keys are all known.
pub(crate) struct Keys<'s> {
    section: &'s Section,
}

impl<'s> Keys<'s> {
    pub(crate) fn new(section: &'s Section, known: &[&str]) -> Result<Keys<'s>, Found> {
        for (key, _) in &section.entries {
            if !known.contains(&key.value.as_str()) {
                let words = unknown("key", &key.value, known);
                return Err(Found::new(Fault::UnknownKey, &key.span, words));
            }
        }
        Ok(Keys { section })
    }

    /// The section's place in the text.
    pub(crate) fn span(&self) -> &'s Range<usize> {
        &self.section.span
    }

    pub(crate) fn get(&self, key: &str) -> Option<&'s At<Item>> {
        let found = self.section.entries.iter().find(|(name, _)| name.value == key);
        found.map(|(_, item)| item)
    }

    /// Where a key is written.
    pub(crate) fn key_span(&self, key: &str) -> Option<&'s Range<usize>> {
        let found = self.section.entries.iter().find(|(name, _)| name.value == key);
        found.map(|(name, _)| &name.span)
    }

    pub(crate) fn required(&self, key: &str) -> Result<&'s At<Item>, Found> {
        self.get(key)
            .ok_or_else(|| Found::new(Fault::MissingKey, self.span(), format!("`{key}` is missing")))
    }

    pub(crate) fn word(&self, key: &str) -> Result<At<String>, Found> {
        word(self.required(key)?)
    }

    pub(crate) fn integer(
        &self,
        key: &str,
        within: RangeInclusive<u16>,
        default: Option<u16>,
    ) -> Result<u16, Found> {
        let item = match (self.get(key), default) {
            (None, Some(default)) => return Ok(default),
            (Some(item), _) => item,
            (None, None) => self.required(key)?,
        };
        let number = match &item.value {
            Item::Integer(number) => Some(*number),
            Item::Raw(raw) => integer_of(raw),
            _ => None,
        };
        let number = number.ok_or_else(|| wrong_type(item, "an integer"))?;
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

    pub(crate) fn flag(&self, key: &str) -> Result<bool, Found> {
        let Some(item) = self.get(key) else {
            return Ok(false);
        };
        match &item.value {
            Item::Flag(flag) => Ok(*flag),
            Item::Raw(raw) if raw == "true" => Ok(true),
            Item::Raw(raw) if raw == "false" => Ok(false),
            _ => Err(wrong_type(item, "true or false")),
        }
    }
}

/// An integer as TOML writes it in decimal or hexadecimal.
fn integer_of(raw: &str) -> Option<i64> {
    match raw.strip_prefix("0x") {
        Some(digits) => i64::from_str_radix(digits, 16).ok(),
        None => raw.parse().ok(),
    }
}

/// A finite number.
pub(crate) fn number(item: &At<Item>) -> Result<f64, Found> {
    let number = match &item.value {
        #[expect(
            clippy::cast_precision_loss,
            reason = "beyond 2^53 it is out of every range anyway"
        )]
        Item::Integer(number) => Some(*number as f64),
        Item::Float(number) => Some(*number),
        Item::Raw(raw) => raw.parse().ok(),
        _ => None,
    };
    let number = number.ok_or_else(|| wrong_type(item, "a number"))?;
    if !number.is_finite() {
        return Err(Found::new(
            Fault::Number,
            &item.span,
            "a finite number is expected here",
        ));
    }
    // There is one zero.
    Ok(number + 0.0)
}

pub(crate) fn string(item: &At<Item>) -> Result<&str, Found> {
    match &item.value {
        Item::Text(text) | Item::Raw(text) => Ok(text),
        _ => Err(wrong_type(item, "a text")),
    }
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
    let text = string(item)?;
    if !is_word(text) {
        let words = format!(
            "{} is no name: lower-case letters and digits, a letter first, `-` between them, at most {LONGEST_NAME}",
            shown(text)
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
    let text = string(item)?;
    if let Some((_, chosen)) = choices.iter().find(|(word, _)| *word == text) {
        return Ok(*chosen);
    }
    let known: Vec<&str> = choices.iter().map(|(word, _)| *word).collect();
    let words = unknown(what, text, &known);
    Err(Found::new(Fault::UnknownWord, &item.span, words))
}

pub(crate) fn wrong_type(item: &At<Item>, expected: &str) -> Found {
    let words = format!("{expected} is expected here, and this is {}", item.value.is());
    Found::new(Fault::Type, &item.span, words)
}

pub(crate) fn unknown(what: &str, word: &str, known: &[&str]) -> String {
    let hint = match nearest(word, known) {
        Some(nearest) => format!("did you mean `{nearest}`?"),
        None if known.is_empty() => "there is none here".to_owned(),
        None => format!("there are `{}`", known.join("`, `")),
    };
    format!("there is no {what} {}; {hint}", shown(word))
}

/// A text of the file as an error shows it: in one line, and not longer than one looks at.
pub(crate) fn shown(text: &str) -> String {
    let most = 64;
    let mut shown: String = text.chars().take(most).flat_map(char::escape_debug).collect();
    if text.chars().nth(most).is_some() {
        shown.push('…');
    }
    format!("`{shown}`")
}

/// The known word that is similar enough to be meant.
fn nearest<'a>(word: &str, known: &[&'a str]) -> Option<&'a str> {
    // The cost grows with the square of the length.
    const LONGEST_WORD: usize = 64;
    if word.len() > LONGEST_WORD {
        return None;
    }
    let allowed = (word.chars().count() / 3).max(1);
    known
        .iter()
        .map(|known| (strsim::osa_distance(word, known), *known))
        .filter(|(distance, _)| *distance <= allowed)
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, known)| known)
}
