//! Finds the line of a configuration key.

use std::fmt;

use mom_hub::SetupError;
use mom_proto::{Value, WireError};
use serde::Serialize;
use toml::de::{DeTable, DeValue};

use super::{Config, ConfigError};

/// A position in the configuration.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Location {
    /// The file.
    pub file: String,
    /// The line, from 1.
    pub line: usize,
    /// The key, such as `managers.lab.rules[2]`.
    pub key: String,
}

impl fmt::Display for Location {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}:{}", self.file, self.line)
    }
}

/// A file's name and text, for errors that come after it was read.
#[derive(Clone, Debug)]
pub(super) struct SourceText {
    pub(super) name: String,
    pub(super) text: String,
}

impl SourceText {
    /// An error of the parser.
    pub(super) fn syntax(&self, error: &toml::de::Error) -> ConfigError {
        let line = error.span().map(|span| self.line_at(span.start));
        let key = error.span().and_then(|span| self.key_at(span.start));
        let text = error.message().lines().next().unwrap_or_default().to_owned();
        ConfigError {
            file: Some(self.name.clone()),
            line,
            key,
            text,
            busy: false,
        }
    }

    /// An error about a key, at its line or at that of the nearest table above.
    pub(super) fn error(&self, keys: &[&str], text: String) -> ConfigError {
        let line = self.offset_of(keys).map(|offset| self.line_at(offset));
        ConfigError {
            file: Some(self.name.clone()),
            line,
            key: Some(key_text(keys)),
            text,
            busy: false,
        }
    }

    /// The location of a key, or of the nearest table above it.
    pub(super) fn place(&self, keys: &[&str]) -> Option<Location> {
        Some(Location {
            file: self.name.clone(),
            line: self.line_at(self.offset_of(keys)?),
            key: key_text(keys),
        })
    }

    fn line_at(&self, offset: usize) -> usize {
        self.text
            .as_bytes()
            .iter()
            .take(offset)
            .filter(|byte| **byte == b'\n')
            .count()
            + 1
    }

    /// The key on the line of an offset.
    fn key_at(&self, offset: usize) -> Option<String> {
        let line = self.text.lines().nth(self.line_at(offset) - 1)?;
        let key = line.split_once('=').map_or(line, |(key, _)| key).trim();
        (!key.is_empty()).then(|| key.to_owned())
    }

    fn offset_of(&self, keys: &[&str]) -> Option<usize> {
        let table = DeTable::parse(&self.text).ok()?;
        let (first, rest) = keys.split_first()?;
        let (key, value) = table.get_ref().iter().find(|(key, _)| key.get_ref() == first)?;
        let mut offset = key.span().start;
        let mut value = value;
        for key in rest {
            let found = match value.get_ref() {
                DeValue::Table(table) => {
                    table
                        .iter()
                        .find(|(known, _)| known.get_ref() == key)
                        .map(|(key, value)| {
                            offset = key.span().start;
                            value
                        })
                }
                DeValue::Array(array) => key
                    .parse()
                    .ok()
                    .and_then(|index: usize| array.get(index))
                    .inspect(|value| {
                        offset = value.span().start;
                    }),
                _ => None,
            };
            match found {
                Some(found) => value = found,
                None => break,
            }
        }
        Some(offset)
    }
}

/// `["contexts", "2", "manager"]` as `contexts[2].manager`.
fn key_text(keys: &[&str]) -> String {
    let mut text = String::new();
    for key in keys {
        if key.bytes().all(|byte| byte.is_ascii_digit()) && !text.is_empty() {
            text.push_str(&format!("[{key}]"));
        } else {
            if !text.is_empty() {
                text.push('.');
            }
            text.push_str(key);
        }
    }
    text
}

impl Config {
    /// An error that the hub found, with its position in the file.
    pub(crate) fn locate(&self, error: &SetupError) -> ConfigError {
        match error.entry {
            Some(entry) => self.at(&["contexts", &entry.to_string()], &error.error),
            None => self.at(&["root"], &error.error),
        }
    }

    /// An error of a named manager.
    pub(crate) fn locate_manager(&self, name: &str, error: &WireError) -> ConfigError {
        self.at(&["managers", name], error)
    }

    pub(super) fn at(&self, keys: &[&str], error: &WireError) -> ConfigError {
        let slot = error.get("slot").and_then(Value::as_str).unwrap_or_default();
        // A request names the path in the slot `context`, a file in the key `path`.
        let slot = if slot == "context" {
            "path"
        } else {
            slot.trim_start_matches("content/")
        };
        let mut keys = keys.to_vec();
        keys.extend(slot.split('/').filter(|key| !key.is_empty()));
        let nearest = error.get("nearest").and_then(Value::as_str);
        let hint = nearest
            .map(|nearest| format!(" (did you mean {nearest}?)"))
            .unwrap_or_default();
        let text = format!("{}{hint}", error.text);
        self.remark(&keys, text)
    }

    /// A remark about a key, with its position.
    pub(super) fn remark(&self, keys: &[&str], text: String) -> ConfigError {
        match &self.source {
            Some(source) => source.error(keys, text),
            None => ConfigError {
                file: None,
                line: None,
                key: Some(key_text(keys)),
                text,
                busy: false,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_found() {
        let text = "a = 1\n[managers.lab]\nkind = \"roles\"\n[[contexts]]\npath = \"/a\"\n[[contexts]]\nkind = 'x'\n";
        let source = SourceText {
            name: "mom.toml".into(),
            text: text.into(),
        };
        for (keys, line, key) in [
            (&["a"][..], 1, "a"),
            (&["managers", "lab", "kind"], 3, "managers.lab.kind"),
            (&["contexts", "0", "path"], 5, "contexts[0].path"),
            (&["contexts", "1", "kind"], 7, "contexts[1].kind"),
            (&["contexts", "1", "missing"], 6, "contexts[1].missing"),
        ] {
            let error = source.error(keys, String::new());
            assert_eq!((error.line, error.key.as_deref()), (Some(line), Some(key)));
        }
    }
}
