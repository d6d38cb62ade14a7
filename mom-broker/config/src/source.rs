//! The text of a file: what it holds, where that stands, and what was struck out of it.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use mom_toml_faults::Spot;
use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue, Deserializer};

use super::ConfigError;
use super::error::FaultPlace;

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

impl Location {
    /// The file's name without its folder, for those who do not sit at this machine.
    pub fn file_name(&self) -> String {
        let name = Path::new(&self.file).file_name();
        name.map(|name| name.to_string_lossy().into_owned())
            .unwrap_or_default()
    }
}

impl fmt::Display for Location {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}:{}", self.file, self.line)
    }
}

/// A file's name and text, for errors that come after it was read.
#[derive(Clone, Debug, Default)]
pub(super) struct SourceText {
    pub(super) name: String,
    pub(super) text: String,
    /// The keys at fault, and the words that were probably meant there. What they lead to is left out or replaced, so that
    /// the rest can be read.
    struck: BTreeMap<Vec<String>, Option<String>>,
}

impl SourceText {
    pub(super) fn new(name: impl Into<String>, text: impl Into<String>) -> SourceText {
        SourceText {
            name: name.into(),
            text: text.into(),
            struck: BTreeMap::new(),
        }
    }

    /// What is not TOML: the first of each line, in the parser's words.
    pub(super) fn syntax(&self) -> Vec<ConfigError> {
        let mut told: Vec<ConfigError> = Vec::new();
        for error in DeTable::parse_recoverable(&self.text).1 {
            let spot = error.span().map(|span| Spot::of(&self.text, span.start));
            let line = spot.map(|spot| spot.line);
            if told.iter().any(|told| told.line == line) {
                continue;
            }
            let text = line.and_then(|line| self.unquoted_on(line));
            let text = text.unwrap_or_else(|| error.message().lines().next().unwrap_or_default().to_owned());
            told.push(ConfigError {
                line,
                column: spot.map(|spot| spot.column),
                key: line.and_then(|line| self.key_on(line)),
                ..ConfigError::of_file(&self.name, text)
            });
        }
        told
    }

    /// A text without quotes, which the parser takes for the beginning of a number or time. It may be a secret.
    fn unquoted_on(&self, line: usize) -> Option<String> {
        let (key, value) = self.text.lines().nth(line - 1)?.split_once('=')?;
        let value = value.split('#').next().unwrap_or_default().trim();
        let word = value.starts_with(char::is_alphabetic) && !value.contains(['"', '\'']);
        word.then(|| format!("a text stands in quotes: {} = \"…\"", key.trim()))
    }

    /// All that is not struck.
    pub(super) fn tree(&self) -> Spanned<DeTable<'_>> {
        let whole = self.whole();
        let span = whole.span();
        let rest = match self.struck.contains_key(&Vec::new()) {
            true => DeTable::new(),
            false => self.rest_of(whole.into_inner(), &mut Vec::new()),
        };
        Spanned::new(span, rest)
    }

    /// All that is not struck, typed.
    pub(super) fn read<T: DeserializeOwned>(&self) -> Result<T, ConfigError> {
        T::deserialize(Deserializer::from(self.tree())).map_err(|error| {
            let keys = error
                .span()
                .map(|span| self.keys_at(span.start))
                .unwrap_or_default();
            self.error_at(keys, error.message().to_owned())
        })
    }

    fn whole(&self) -> Spanned<DeTable<'_>> {
        DeTable::parse_recoverable(&self.text).0
    }

    fn rest_of<'i>(&self, table: DeTable<'i>, keys: &mut Vec<String>) -> DeTable<'i> {
        let entries = table.into_iter().filter_map(|(key, value)| {
            let value = self.rest_of_value(value, key.get_ref(), keys)?;
            Some((key, value))
        });
        entries.collect()
    }

    fn rest_of_value<'i>(
        &self,
        value: Spanned<DeValue<'i>>,
        key: &str,
        keys: &mut Vec<String>,
    ) -> Option<Spanned<DeValue<'i>>> {
        keys.push(key.to_owned());
        let span = value.span();
        let rest = match self.struck.get(keys) {
            Some(meant) => meant.clone().map(|meant| DeValue::String(Cow::Owned(meant))),
            None => Some(match value.into_inner() {
                DeValue::Table(table) => DeValue::Table(self.rest_of(table, keys)),
                DeValue::Array(array) => {
                    let items = array.into_iter().enumerate();
                    let items =
                        items.filter_map(|(index, item)| self.rest_of_value(item, &index.to_string(), keys));
                    DeValue::Array(items.collect::<DeArray<'_>>())
                }
                other => other,
            }),
        };
        keys.pop();
        rest.map(|rest| Spanned::new(span, rest))
    }

    /// An error about a key, at its line or at that of the nearest table above.
    pub(super) fn error(&self, keys: &[&str], text: String) -> ConfigError {
        self.error_at(self.written(keys), text)
    }

    fn error_at(&self, keys: Vec<String>, text: String) -> ConfigError {
        let spot = self.spot_of(&keys);
        ConfigError {
            line: spot.map(|spot| spot.line),
            column: spot.map(|spot| spot.column),
            key: Some(key_text(&keys)),
            at: Box::new(FaultPlace { keys, meant: None }),
            ..ConfigError::of_file(&self.name, text)
        }
    }

    /// The location of a key, or of the nearest table above it.
    pub(super) fn place(&self, keys: &[&str]) -> Option<Location> {
        let keys = self.written(keys);
        Some(Location {
            file: self.name.clone(),
            line: self.spot_of(&keys)?.line,
            key: key_text(&keys),
        })
    }

    /// The keys of the file for those of what was read of it: entries of lists before may have been struck, and a name
    /// may stand for a table.
    fn written(&self, keys: &[&str]) -> Vec<String> {
        let whole = DeValue::Table(self.whole().into_inner());
        let (mut value, mut written) = (Some(&whole), Vec::new());
        for key in keys {
            let key = match value {
                Some(DeValue::Array(array)) => {
                    let stays = |index: &usize| {
                        let at = |index: &usize| [&written[..], &[index.to_string()]].concat();
                        !matches!(self.struck.get(&at(index)), Some(None))
                    };
                    let read = key
                        .parse()
                        .ok()
                        .and_then(|number| (0..array.len()).filter(stays).nth(number));
                    read.map_or_else(|| (*key).to_owned(), |index| index.to_string())
                }
                Some(DeValue::Table(_)) | None => (*key).to_owned(),
                Some(_) => break,
            };
            value = value
                .and_then(|value| step(value, &key))
                .map(|(_, value)| value.get_ref());
            written.push(key);
        }
        written
    }

    /// The key, or the nearest above it that there is still.
    pub(super) fn nearest_to(&self, keys: &[String]) -> Vec<String> {
        let whole = DeValue::Table(self.whole().into_inner());
        let mut value = &whole;
        let mut known = Vec::new();
        for key in keys {
            known.push(key.clone());
            match step(value, key) {
                Some((_, found)) if !self.struck.contains_key(&known) => value = found.get_ref(),
                _ => {
                    known.pop();
                    break;
                }
            }
        }
        known
    }

    /// Strikes a key with all below it, and writes what was meant there. Gives whether it stood there until now.
    pub(super) fn strike(&mut self, keys: Vec<String>, meant: Option<String>) -> bool {
        self.struck.insert(keys, meant).is_none()
    }

    /// The keys that were struck.
    pub(super) fn struck(&self) -> impl Iterator<Item = &Vec<String>> {
        self.struck.keys()
    }

    /// Whether an error about these keys may come of what was struck.
    pub(super) fn follows(&self, keys: &[String]) -> bool {
        let mut struck = self.struck.keys();
        struck.any(|struck| struck.starts_with(keys) || keys.starts_with(struck))
    }

    /// Whether there is such a key.
    pub(super) fn has(&self, keys: &[&str]) -> bool {
        let whole = DeValue::Table(self.whole().into_inner());
        let mut keys = keys.iter();
        keys.try_fold(&whole, |value, key| Some(step(value, key)?.1.get_ref()))
            .is_some()
    }

    /// The text that stands at a key, struck or not.
    pub(super) fn text_at(&self, keys: &[String]) -> Option<String> {
        let whole = DeValue::Table(self.whole().into_inner());
        let found = keys
            .iter()
            .try_fold(&whole, |value, key| Some(step(value, key)?.1.get_ref()));
        found?.as_str().map(str::to_owned)
    }

    /// What others may name and is not there any more: paths of contexts that were struck, or whose guard was, and names
    /// of managers.
    pub(super) fn struck_names(&self) -> Vec<String> {
        let name = |keys: &Vec<String>| match keys.iter().map(String::as_str).collect::<Vec<_>>()[..] {
            ["contexts", index] | ["contexts", index, "guard", ..] => {
                self.text_at(&["contexts", index, "path"].map(str::to_owned))
            }
            ["managers", name] => Some(name.to_owned()),
            _ => None,
        };
        self.struck.keys().filter_map(name).collect()
    }

    /// The key on a line.
    fn key_on(&self, line: usize) -> Option<String> {
        let line = self.text.lines().nth(line - 1)?;
        let key = line.split_once('=').map_or(line, |(key, _)| key).trim();
        (!key.is_empty()).then(|| key.to_owned())
    }

    /// The keys of the innermost value that begins at an offset, or holds it.
    fn keys_at(&self, offset: usize) -> Vec<String> {
        let mut found = (usize::MAX, Vec::new());
        let whole = DeValue::Table(self.whole().into_inner());
        let mut next = vec![(Vec::new(), &whole)];
        while let Some((keys, value)) = next.pop() {
            for (key, at, value) in entries(value) {
                let keys = [&keys[..], &[key]].concat();
                for span in [at, value.span()] {
                    if span.contains(&offset) && span.len() <= found.0 {
                        found = (span.len(), keys.clone());
                    }
                }
                next.push((keys, value.get_ref()));
            }
        }
        found.1
    }

    /// Where the key is, or the nearest above it.
    fn spot_of(&self, keys: &[String]) -> Option<Spot> {
        let whole = DeValue::Table(self.whole().into_inner());
        let (mut value, mut offset) = (&whole, None);
        for key in keys {
            let Some((at, found)) = step(value, key) else {
                break;
            };
            (value, offset) = (found.get_ref(), Some(at));
        }
        Some(Spot::of(&self.text, offset?))
    }
}

/// The entry of a table or list, and where it begins.
fn step<'a, 'i>(value: &'a DeValue<'i>, key: &str) -> Option<(usize, &'a Spanned<DeValue<'i>>)> {
    match value {
        DeValue::Table(table) => {
            let found = table.iter().find(|(known, _)| known.get_ref() == key);
            found.map(|(key, value)| (key.span().start, value))
        }
        DeValue::Array(array) => {
            let found = key.parse().ok().and_then(|index: usize| array.get(index));
            found.map(|value| (value.span().start, value))
        }
        _ => None,
    }
}

/// All entries of a table or list, with the span of their key.
fn entries<'a, 'i>(
    value: &'a DeValue<'i>,
) -> Vec<(String, std::ops::Range<usize>, &'a Spanned<DeValue<'i>>)> {
    match value {
        DeValue::Table(table) => {
            let entry = |(key, value): (&Spanned<_>, &'a Spanned<_>)| {
                (ToString::to_string(key.get_ref()), key.span(), value)
            };
            table.iter().map(entry).collect()
        }
        DeValue::Array(array) => {
            let items = array.iter().enumerate();
            items
                .map(|(index, item)| (index.to_string(), item.span(), item))
                .collect()
        }
        _ => Vec::new(),
    }
}

/// `["contexts", "2", "manager"]` as `contexts[2].manager`.
pub(super) fn key_text(keys: &[impl AsRef<str>]) -> String {
    let mut text = String::new();
    for key in keys {
        let key = key.as_ref();
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

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(keys: &[&str]) -> Vec<String> {
        keys.iter().map(|&key| key.to_owned()).collect()
    }

    #[test]
    fn keys_are_found() {
        let text = "a = 1\n[managers.lab]\nkind = \"roles\"\n[[contexts]]\npath = \"/a\"\n[[contexts]]\nkind = 'x'\n";
        let mut source = SourceText::new("mom.toml", text);
        for (keys, line, key) in [
            (&["a"][..], 1, "a"),
            (&["managers", "lab", "kind"], 3, "managers.lab.kind"),
            (&["managers", "lab", "kind", "of"], 3, "managers.lab.kind"),
            (&["contexts", "0", "path"], 5, "contexts[0].path"),
            (&["contexts", "1", "kind"], 7, "contexts[1].kind"),
            (&["contexts", "1", "missing"], 6, "contexts[1].missing"),
        ] {
            let error = source.error(keys, String::new());
            assert_eq!((error.line, error.key.as_deref()), (Some(line), Some(key)));
        }
        source.strike(keys(&["contexts", "0"]), None);
        let error = source.error(&["contexts", "0", "kind"], String::new());
        assert_eq!(
            (error.line, error.key.as_deref()),
            (Some(7), Some("contexts[1].kind"))
        );
        assert_eq!(source.struck_names(), ["/a"]);
        assert!(source.follows(&keys(&["contexts", "0", "path"])) && source.follows(&keys(&["contexts"])));
        assert!(!source.follows(&keys(&["contexts", "1"])));
    }

    #[test]
    fn what_is_struck_is_not_read() {
        let mut source = SourceText::new("mom.toml", "a = 1\nb = [{ c = 1, d = 2 }, 3]\n");
        assert_eq!(
            source.nearest_to(&keys(&["b", "0", "c", "deeper"])),
            ["b", "0", "c"]
        );
        source.strike(keys(&["b", "0", "c"]), None);
        assert_eq!(
            source.nearest_to(&keys(&["b", "0", "c"])),
            ["b", "0"],
            "it is gone"
        );
        source.strike(keys(&["a"]), Some("2".to_owned()));
        let rest: toml::Table = source.read().expect("TOML");
        assert_eq!(rest.to_string(), "a = \"2\"\nb = [{ d = 2 }, 3]\n");
        source.strike(Vec::new(), None);
        assert!(source.read::<toml::Table>().expect("TOML").is_empty());
    }
}
