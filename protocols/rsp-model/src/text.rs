//! The text of a file as sections with keys, whatever language it is written in: what is checked knows TOML and XMI alike.

use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::fault::{Fault, Found};

/// The most bytes of a model's text.
pub(crate) const LONGEST_TEXT: usize = 1 << 20;

/// Something, and the bytes of the text that say it.
#[derive(Clone, Debug)]
pub(crate) struct At<T> {
    pub(crate) value: T,
    pub(crate) span: Range<usize>,
}

/// The value of a key.
#[derive(Clone, Debug)]
pub(crate) enum Item {
    Text(String),
    Integer(i64),
    Float(f64),
    Flag(bool),
    List(Vec<At<Item>>),
    /// Of an XML attribute, which does not tell what it is: whoever reads it knows what to expect.
    Raw(String),
    /// A table or a date, which no key of a model has.
    Other(&'static str),
}

impl Item {
    /// What it is called in errors.
    pub(crate) fn is(&self) -> &'static str {
        match self {
            Item::Text(_) | Item::Raw(_) => "a text",
            Item::Integer(_) => "an integer",
            Item::Float(_) => "a number with a fraction",
            Item::Flag(_) => "true or false",
            Item::List(_) => "a list",
            Item::Other(name) => name,
        }
    }
}

/// Keys that stand together.
#[derive(Clone, Debug)]
pub(crate) struct Section {
    pub(crate) span: Range<usize>,
    pub(crate) entries: Vec<(At<String>, At<Item>)>,
}

/// A file.
#[derive(Clone, Debug)]
pub(crate) struct Source {
    pub(crate) root: Section,
    pub(crate) elements: Vec<Section>,
}

pub(crate) fn check_length(text: &str) -> Result<(), Found> {
    if text.len() > LONGEST_TEXT {
        let words = format!(
            "{} bytes are too many: a model has at most {LONGEST_TEXT}",
            text.len()
        );
        return Err(Found::new(Fault::TooLong, &(0..0), words));
    }
    Ok(())
}

/// The sections of a TOML file.
pub(crate) fn of_toml(text: &str) -> Result<Source, Found> {
    check_length(text)?;
    let table = DeTable::parse(text).map_err(|error| {
        let span = error.span().unwrap_or(0..0);
        Found::new(Fault::Syntax, &span, error.message())
    })?;
    let mut elements = Vec::new();
    let mut root = section(table.get_ref(), table.span());
    if let Some(listed) = table.get_ref().get("element") {
        root.entries.retain(|(key, _)| key.value != "element");
        let expected = |value: &Spanned<DeValue<'_>>, what: &str| {
            let words = format!(
                "{what} is expected here, and this is {}: write `[[element]]`",
                item(value).value.is()
            );
            Found::new(Fault::Type, &value.span(), words)
        };
        let list = listed.get_ref().as_array();
        for value in list.ok_or_else(|| expected(listed, "a list of tables"))? {
            let table = value.get_ref().as_table();
            let table = table.ok_or_else(|| expected(value, "a table"))?;
            elements.push(section(table, value.span()));
        }
    }
    Ok(Source { root, elements })
}

fn section(table: &DeTable<'_>, span: Range<usize>) -> Section {
    let entry = |(key, value): (&Spanned<std::borrow::Cow<'_, str>>, &Spanned<DeValue<'_>>)| {
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
    let item = match value.get_ref() {
        DeValue::String(text) => Item::Text(text.as_ref().to_owned()),
        DeValue::Integer(number) => {
            // What an i64 cannot hold is out of every range; which side is all that matters.
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
        DeValue::Datetime(_) => Item::Other("a date"),
        DeValue::Table(_) => Item::Other("a table"),
    };
    At {
        value: item,
        span: value.span(),
    }
}
