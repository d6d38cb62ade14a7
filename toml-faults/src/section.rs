//! A file as sections with keys, each with the bytes that say it.

use std::borrow::Cow;
use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::fault::{Found, Misfit, Shape};
use crate::words::unknown;

/// Something, and the bytes of the text that say it.
#[derive(Clone, Debug)]
pub struct At<T> {
    /// What it is.
    pub value: T,
    /// The bytes.
    pub span: Range<usize>,
}

/// The value of a key.
#[derive(Clone, Debug)]
pub enum Item {
    /// A text.
    Text(String),
    /// An integer; what an i64 cannot hold is its least or its greatest, and so out of every smaller range.
    Integer(i64),
    /// A number with a fraction, also one that is not finite.
    Float(f64),
    /// True or false.
    Flag(bool),
    /// A list, also one of tables.
    List(Vec<At<Item>>),
    /// A table.
    Table(Section),
    /// A date or a time.
    Date,
    /// A value that does not tell its type, as attributes of XML do not: it is whatever is expected, if it can be.
    Raw(String),
}

/// Keys that stand together: a table, or the whole file.
#[derive(Clone, Debug)]
pub struct Section {
    /// Where it is; of a table with a header, the header.
    pub span: Range<usize>,
    /// The keys and their values, in the order of the text.
    pub entries: Vec<(At<String>, At<Item>)>,
}

impl Item {
    /// What it is called in errors.
    #[must_use]
    pub const fn is(&self) -> &'static str {
        match self {
            Item::Text(_) | Item::Raw(_) => "a text",
            Item::Integer(_) => "an integer",
            Item::Float(_) => "a number with a fraction",
            Item::Flag(_) => "true or false",
            Item::List(_) => "a list",
            Item::Table(_) => "a table",
            Item::Date => "a date",
        }
    }
}

impl Section {
    /// Reads a TOML file.
    ///
    /// # Errors
    ///
    /// The first place that is not TOML, in the parser's words.
    pub fn parse(text: &str) -> Result<Section, Misfit> {
        let table = DeTable::parse(text).map_err(|error| {
            let span = error.span().unwrap_or(0..0);
            Misfit(Found::new(Shape::Syntax, &span, error.message()))
        })?;
        Ok(section(table.get_ref(), table.span()))
    }

    /// The section itself, if all its keys are among these.
    ///
    /// # Errors
    ///
    /// The first key that is not.
    pub fn only(&self, known: &[&str]) -> Result<&Section, Misfit> {
        let other = |(key, _): &&(At<String>, At<Item>)| !known.contains(&key.value.as_str());
        match self.entries.iter().find(other) {
            None => Ok(self),
            Some((key, _)) => {
                let words = unknown("key", &key.value, known);
                Err(Misfit(Found::new(Shape::UnknownKey, &key.span, words)))
            }
        }
    }

    fn entry(&self, key: &str) -> Option<&(At<String>, At<Item>)> {
        self.entries.iter().find(|(name, _)| name.value == key)
    }

    /// The value of a key.
    #[must_use]
    pub fn get(&self, key: &str) -> Option<&At<Item>> {
        self.entry(key).map(|(_, item)| item)
    }

    /// Where a key is written.
    #[must_use]
    pub fn key_span(&self, key: &str) -> Option<&Range<usize>> {
        self.entry(key).map(|(name, _)| &name.span)
    }

    /// The value of a key that has no default.
    ///
    /// # Errors
    ///
    /// The key is missing.
    pub fn required(&self, key: &str) -> Result<&At<Item>, Misfit> {
        let missing = || {
            let words = format!("`{key}` is missing");
            Misfit(Found::new(Shape::MissingKey, &self.span, words))
        };
        self.get(key).ok_or_else(missing)
    }

    /// The tables `[[key]]`, in the order of the text.
    ///
    /// # Errors
    ///
    /// The first that is not a table, or the value that is not a list of them.
    pub fn tables(&self, key: &str) -> Result<Vec<&Section>, Misfit> {
        let Some(item) = self.get(key) else {
            return Ok(Vec::new());
        };
        let tables = item
            .list("a list of tables")
            .and_then(|list| list.iter().map(At::table).collect());
        tables.map_err(|Misfit(found)| {
            let text = format!("{}: write `[[{key}]]`", found.text);
            Misfit(Found { text, ..found })
        })
    }
}

/// # Errors
///
/// Each of these fails where the value is of another type, and says what it is.
impl At<Item> {
    /// That something else is expected here.
    #[must_use]
    pub fn wrong_type(&self, expected: &str) -> Misfit {
        let words = format!("expected {expected}, found {}", self.value.is());
        Misfit(Found::new(Shape::Type, &self.span, words))
    }

    /// A text.
    pub fn text(&self) -> Result<&str, Misfit> {
        match &self.value {
            Item::Text(text) | Item::Raw(text) => Ok(text),
            _ => Err(self.wrong_type("a text")),
        }
    }

    /// An integer.
    pub fn integer(&self) -> Result<i64, Misfit> {
        let number = match &self.value {
            Item::Integer(number) => Some(*number),
            Item::Raw(raw) => match raw.strip_prefix("0x") {
                Some(digits) => i64::from_str_radix(digits, 16).ok(),
                None => raw.parse().ok(),
            },
            _ => None,
        };
        number.ok_or_else(|| self.wrong_type("an integer"))
    }

    /// A number with a fraction or without, also one that is not finite.
    pub fn number(&self) -> Result<f64, Misfit> {
        let number = match &self.value {
            Item::Integer(number) => Some(*number as f64),
            Item::Float(number) => Some(*number),
            Item::Raw(raw) => raw.parse().ok(),
            _ => None,
        };
        number.ok_or_else(|| self.wrong_type("a number"))
    }

    /// True or false.
    pub fn flag(&self) -> Result<bool, Misfit> {
        let flag = match &self.value {
            Item::Flag(flag) => Some(*flag),
            Item::Raw(raw) => raw.parse().ok(),
            _ => None,
        };
        flag.ok_or_else(|| self.wrong_type("true or false"))
    }

    /// The values of a list; `expected` says of what.
    pub fn list(&self, expected: &str) -> Result<&[At<Item>], Misfit> {
        match &self.value {
            Item::List(list) => Ok(list),
            _ => Err(self.wrong_type(expected)),
        }
    }

    /// A table.
    pub fn table(&self) -> Result<&Section, Misfit> {
        match &self.value {
            Item::Table(section) => Ok(section),
            _ => Err(self.wrong_type("a table")),
        }
    }
}

fn section(table: &DeTable<'_>, span: Range<usize>) -> Section {
    let entry = |(key, value): (&Spanned<Cow<'_, str>>, &Spanned<DeValue<'_>>)| {
        let name = At {
            value: key.get_ref().as_ref().to_owned(),
            span: key.span(),
        };
        (name, item(value))
    };
    Section {
        span,
        entries: table.iter().map(entry).collect(),
    }
}

fn item(value: &Spanned<DeValue<'_>>) -> At<Item> {
    let span = value.span();
    let value = match value.get_ref() {
        DeValue::String(text) => Item::Text(text.as_ref().to_owned()),
        DeValue::Integer(number) => {
            let end = if number.as_str().starts_with('-') {
                i64::MIN
            } else {
                i64::MAX
            };
            Item::Integer(i64::from_str_radix(number.as_str(), number.radix()).unwrap_or(end))
        }
        DeValue::Float(number) => Item::Float(number.as_str().parse().unwrap_or(f64::NAN)),
        DeValue::Boolean(flag) => Item::Flag(*flag),
        DeValue::Array(list) => Item::List(list.iter().map(self::item).collect()),
        DeValue::Datetime(_) => Item::Date,
        DeValue::Table(table) => Item::Table(section(table, span.clone())),
    };
    At { value, span }
}
