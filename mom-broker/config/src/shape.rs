//! What does not have the shape that the schema gives it: unknown keys, wrong types, words that are none of those known.

use mom_toml_faults::{hint, nearest, unknown};
use serde_json::Value;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::ConfigError;
use super::faults::MOST;
use super::source::SourceText;

/// Longer lists of words are not told where one of them is near.
const WORDS: usize = 6;

/// Longer texts are not told again.
const TEXT: usize = 40;

/// All faults of shape.
pub(super) fn faults(schema: &Value, source: &SourceText) -> Vec<ConfigError> {
    let mut shape = Shape {
        schema,
        source,
        keys: Vec::new(),
        found: Vec::new(),
    };
    shape.table(schema, source.tree().get_ref());
    shape.found
}

/// An error of the parser in words, for what a schema cannot say: the numbers that a type holds.
pub(super) fn in_words(schema: &Value, error: ConfigError) -> ConfigError {
    let mut place = schema;
    for key in &error.at.keys {
        place = resolve(schema, place);
        place = match &place["properties"][key] {
            Value::Null => &place["items"],
            property => property,
        };
    }
    let expected = expected(schema, place);
    let text = match error.text.contains("integer") {
        true if !expected.is_empty() => format!("this number is too large or too small; must be {expected}"),
        _ => error.text.clone(),
    };
    ConfigError { text, ..error }
}

struct Shape<'a> {
    schema: &'a Value,
    source: &'a SourceText,
    keys: Vec<String>,
    found: Vec<ConfigError>,
}

impl Shape<'_> {
    fn tell(&mut self, text: String, meant: Option<&str>) {
        if self.found.len() >= MOST {
            return;
        }
        let keys: Vec<&str> = self.keys.iter().map(String::as_str).collect();
        let mut fault = self.source.error(&keys, text);
        fault.at.meant = meant.map(str::to_owned);
        self.found.push(fault);
    }

    fn tell_at(&mut self, key: &str, text: String, meant: Option<&str>) {
        self.keys.push(key.to_owned());
        self.tell(text, meant);
        self.keys.pop();
    }

    fn instead(&self, schema: &Value, value: &DeValue<'_>) -> String {
        format!(
            "must be {}, not {}",
            expected(self.schema, schema),
            given(schema, value)
        )
    }

    fn value(&mut self, schema: &Value, value: &DeValue<'_>) {
        let schema = resolve(self.schema, schema);
        if let Some(any) = schema["anyOf"].as_array() {
            return self.any(schema, any, value);
        }
        if !fits(schema, value) {
            let mut text = self.instead(schema, value);
            let words: Vec<&str> = schema["enum"]
                .as_array()
                .into_iter()
                .flatten()
                .filter_map(Value::as_str)
                .collect();
            let near = value
                .as_str()
                .and_then(|word| nearest(word, words.iter().copied()));
            if let Some(near) = near {
                // Of many words the near one says enough.
                if words.len() > WORDS {
                    text = format!("{} is not known here", shown(value));
                }
                text.push_str(&format!("; did you mean `{near}`?"));
            }
            return self.tell(text, near);
        }
        match value {
            DeValue::Table(table) => self.table(schema, table),
            DeValue::Array(array) => self.items(schema, array),
            _ => {}
        }
    }

    fn items(&mut self, schema: &Value, items: &[Spanned<DeValue<'_>>]) {
        for (index, item) in items.iter().enumerate().filter(|_| schema["items"].is_object()) {
            self.keys.push(index.to_string());
            self.value(&schema["items"], item.get_ref());
            self.keys.pop();
        }
    }

    fn table(&mut self, schema: &Value, table: &DeTable<'_>) {
        for key in schema["required"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(Value::as_str)
        {
            if !table.contains_key(key) {
                let what = expected(self.schema, &schema["properties"][key]);
                self.tell_at(key, format!("is missing: {key} must be {what}"), None);
            }
        }
        let empty = serde_json::Map::new();
        let known = schema["properties"].as_object().unwrap_or(&empty);
        for (key, value) in table {
            let key = key.get_ref().as_ref();
            match (known.get(key), &schema["additionalProperties"]) {
                (Some(schema), _) | (None, schema @ Value::Object(_)) => {
                    self.keys.push(key.to_owned());
                    self.value(schema, value.get_ref());
                    self.keys.pop();
                }
                (None, Value::Bool(false)) => {
                    let names: Vec<&str> = known.keys().map(String::as_str).collect();
                    self.tell_at(key, unknown("key", key, &names), None);
                }
                (None, _) => {}
            }
        }
    }

    /// One of several shapes: that of a manager goes by its kind.
    fn any(&mut self, schema: &Value, any: &[Value], value: &DeValue<'_>) {
        let shapes: Vec<&Value> = any.iter().map(|shape| resolve(self.schema, shape)).collect();
        if let DeValue::Table(table) = value {
            let kinds: Vec<&str> = shapes.iter().filter_map(|shape| kind_of(shape)).collect();
            let kind = table.get("kind").map(Spanned::get_ref);
            let word = kind.and_then(DeValue::as_str).unwrap_or_default();
            let named = |shape: &&&Value| kind_of(shape) == Some(word);
            if let Some(shape) = shapes.iter().find(named) {
                return self.table(shape, table);
            }
            if !kinds.is_empty() {
                let (near, hint) = (nearest(word, kinds.iter().copied()), hint(word, &kinds));
                let text = match kind {
                    None => format!("a manager needs its kind; {hint}"),
                    Some(kind) => format!("there is no kind of manager {}; {hint}", shown(kind)),
                };
                return self.tell_at("kind", text, near);
            }
        }
        match shapes.iter().find(|shape| fits(shape, value)) {
            Some(shape) => self.value(shape, value),
            None => self.tell(self.instead(schema, value), None),
        }
    }
}

/// The kind of the managers of this shape.
fn kind_of(shape: &Value) -> Option<&str> {
    shape["properties"]["kind"]["enum"][0].as_str()
}

fn resolve<'a>(root: &'a Value, schema: &'a Value) -> &'a Value {
    match schema["$ref"].as_str() {
        Some(definition) => root.pointer(definition.trim_start_matches('#')).unwrap_or(schema),
        None => schema,
    }
}

/// Whether a value itself is as it should be; what is inside of it is looked at apart.
fn fits(schema: &Value, value: &DeValue<'_>) -> bool {
    let right_type = match schema["type"].as_str() {
        Some("string") => value.is_str(),
        Some("integer") => value.is_integer(),
        Some("boolean") => value.is_bool(),
        Some("array") => value.is_array(),
        Some("object") => value.is_table(),
        _ => true,
    };
    let known = |words: &Vec<Value>| words.iter().any(|word| word.as_str() == value.as_str());
    let number = value.as_integer().and_then(|_| integer(value));
    let bound = |key: &str| schema[key].as_i64().zip(number);
    right_type
        && schema["enum"].as_array().is_none_or(known)
        && bound("minimum").is_none_or(|(least, number)| number >= least)
        && bound("maximum").is_none_or(|(most, number)| number <= most)
}

fn integer(value: &DeValue<'_>) -> Option<i64> {
    let integer = value.as_integer()?;
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}

/// What may stand there, in words.
fn expected(root: &Value, schema: &Value) -> String {
    let schema = resolve(root, schema);
    if let Some(any) = schema["anyOf"].as_array() {
        let manager = any.iter().any(|shape| shape["$ref"].is_string());
        return match manager {
            true => "the name of a manager, or a table with its kind".to_owned(),
            false => any
                .iter()
                .map(|shape| expected(root, shape))
                .collect::<Vec<_>>()
                .join(" or "),
        };
    }
    if let Some(words) = schema["enum"].as_array() {
        let words: Vec<String> = words.iter().map(Value::to_string).collect();
        return match &words[..] {
            [word] => word.clone(),
            words => format!("one of {}", words.join(", ")),
        };
    }
    let bound = |key: &str| schema[key].as_i64();
    match (schema["type"].as_str(), bound("minimum"), bound("maximum")) {
        (Some("integer"), Some(1), None) => "a whole number above 0".to_owned(),
        (Some("integer"), Some(least), None) => format!("a whole number from {least}"),
        (Some("integer"), Some(least), Some(most)) => format!("a whole number from {least} to {most}"),
        (Some("integer"), ..) => "a whole number".to_owned(),
        (Some("string"), ..) => "a text in quotes".to_owned(),
        (Some("boolean"), ..) => "true or false".to_owned(),
        (Some("array"), ..) => "a list in brackets".to_owned(),
        (Some("object"), ..) => "a table".to_owned(),
        _ => String::new(),
    }
}

/// What stands there instead.
fn given(schema: &Value, value: &DeValue<'_>) -> String {
    match (schema["type"].as_str(), value) {
        // Where a text belongs a secret may stand.
        (Some("string"), DeValue::Integer(_) | DeValue::Float(_)) => "a number without them".to_owned(),
        (Some("integer"), DeValue::String(text)) if text.parse::<u64>().is_ok() => {
            format!("{text:?}: write it without quotes")
        }
        _ => shown(value),
    }
}

fn shown(value: &DeValue<'_>) -> String {
    match value {
        DeValue::String(text) if text.chars().count() > TEXT => "this text".to_owned(),
        DeValue::String(text) => format!("{text:?}"),
        DeValue::Integer(number) => {
            integer(value).map_or_else(|| number.as_str().to_owned(), |number| number.to_string())
        }
        DeValue::Float(number) => number.as_str().to_owned(),
        DeValue::Boolean(flag) => flag.to_string(),
        DeValue::Datetime(time) => time.to_string(),
        DeValue::Array(_) => "a list".to_owned(),
        DeValue::Table(_) => "a table".to_owned(),
    }
}
