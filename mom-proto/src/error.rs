//! Errors as they stand on the wire.

use std::fmt;
use std::time::Duration;

use crate::{Code, Map, Value};

/// An error with its code, plain words, and the details that apply (design §5).
///
/// It is what the hub answers, what a codec reports about bad input, and what a client gets.
///
/// ```
/// use mom_proto::{Code, WireError};
/// let error = WireError::new(Code::UNKNOWN_PATH, "there is no context /robt").nearest("/robot");
/// assert_eq!(error.to_string(), "unknown-path: there is no context /robt (did you mean /robot?)");
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct WireError {
    /// What kind of error.
    pub code: Code,
    /// Plain words: what was wrong and what to do.
    pub text: String,
    // Boxed: errors travel in every Result of the codecs, details are rare.
    details: Option<Box<Map>>,
}

impl std::error::Error for WireError {}

impl WireError {
    /// An error of this code with plain words.
    pub fn new(code: Code, text: impl Into<String>) -> WireError {
        WireError {
            code,
            text: text.into(),
            details: None,
        }
    }

    /// Adds any detail.
    #[must_use]
    pub fn detail(mut self, key: &str, value: impl Into<Value>) -> WireError {
        self.details.get_or_insert_default().set(key, value);
        self
    }

    /// The rule that decided, by its name in the configuration.
    #[must_use]
    pub fn rule(self, rule: &str) -> WireError {
        self.detail("rule", rule)
    }

    /// The peer that owns the token, and its level.
    #[must_use]
    pub fn owner(self, name: &str, level: i32) -> WireError {
        self.detail("owner", name).detail("owner-level", level)
    }

    /// The level of the peer that was refused.
    #[must_use]
    pub fn level(self, level: i32) -> WireError {
        self.detail("level", level)
    }

    /// When to try again, from now; rounded up to whole ms.
    #[must_use]
    pub fn retry_after(self, wait: Duration) -> WireError {
        let millis = wait.as_micros().div_ceil(1000);
        self.detail("retry-after", i64::try_from(millis).unwrap_or(i64::MAX))
    }

    /// The slot at fault: a key, with a path inside content such as `content/manager/kind`.
    #[must_use]
    pub fn slot(self, slot: &str) -> WireError {
        self.detail("slot", slot)
    }

    /// The byte at fault, counted from the start of the frame's body.
    #[must_use]
    pub fn position(self, position: usize) -> WireError {
        self.detail("position", i64::try_from(position).unwrap_or(i64::MAX))
    }

    /// The nearest thing that exists.
    #[must_use]
    pub fn nearest(self, nearest: &str) -> WireError {
        self.detail("nearest", nearest)
    }

    /// Adds the nearest thing that exists, if there is one.
    #[must_use]
    pub fn nearest_opt(self, nearest: Option<&str>) -> WireError {
        match nearest {
            Some(nearest) => self.nearest(nearest),
            None => self,
        }
    }

    /// A detail by its key.
    pub fn get(&self, key: &str) -> Option<&Value> {
        self.details.as_ref().and_then(|details| details.get(key))
    }

    /// The details in order.
    pub fn details(&self) -> impl Iterator<Item = (&str, &Value)> {
        self.details.iter().flat_map(|details| details.iter())
    }

    /// How long to wait before trying again, if the error says so.
    pub fn retry_in(&self) -> Option<Duration> {
        let millis = self.get("retry-after")?.as_int()?;
        Some(Duration::from_millis(u64::try_from(millis).ok()?))
    }

    /// The error as a map, where it is a part of something else: `{name, code, text}` and the details.
    pub fn to_map(&self) -> Map {
        self.added_to(Map::new().with("name", self.code.word()))
    }

    pub(crate) fn added_to(&self, map: Map) -> Map {
        let mut map = map
            .with("code", u32::from(self.code.number()))
            .with("text", self.text.as_str());
        for (key, value) in self.details() {
            map.set(key, value.clone());
        }
        map
    }

    /// Reads what [`WireError::to_map`] has made, such as a device's refusal; another map has at least a code.
    pub fn from_map(map: &Map) -> WireError {
        let mut details = map.clone();
        match details.remove("name") {
            Some(Value::String(word)) => WireError::read(&word, details),
            _ => WireError::read(Code::DENIED.word(), details),
        }
    }

    pub(crate) fn read(word: &str, mut details: Map) -> WireError {
        let number = details
            .remove("code")
            .and_then(|code| u16::try_from(code.as_int()?).ok())
            .unwrap_or(Code::DENIED.number());
        let text = match details.remove("text") {
            Some(Value::String(text)) => text,
            _ => String::new(),
        };
        WireError {
            code: Code::from_wire(number, word),
            text,
            details: (!details.is_empty()).then(|| Box::new(details)),
        }
    }
}

impl fmt::Display for WireError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}: {}", self.code, self.text)?;
        if let Some(nearest) = self.get("nearest").and_then(Value::as_str) {
            write!(formatter, " (did you mean {nearest}?)")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_a_part_of_something_it_has_its_name_inside() {
        let error = WireError::new(Code::HELD, "alice drives").rule("lab-token");
        let map = error.to_map();
        let keys: Vec<&str> = map.iter().map(|(key, _)| key).collect();
        assert_eq!(keys, ["name", "code", "text", "rule"]);
        assert_eq!(map.get("name").and_then(Value::as_str), Some("held"));
        assert_eq!(map.get("code").and_then(Value::as_int), Some(101));
        assert_eq!(WireError::from_map(&map), error);
        assert_eq!(WireError::from_map(&Map::new()).code, Code::DENIED);
    }
}
