//! What a device says of itself and of commands, as far as who commands it has to know.

use mom_client::{Map, Parcel, Value, WireError, from_value, visible};
use serde::Deserialize;

/// What of a device's state matters to who commands it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StateNews {
    /// The id of the message, which a relative command is based on.
    pub id: Option<u64>,
    /// Whether it moves, or may do so.
    pub moving: bool,
    /// Whether it is stopped.
    pub stopped: bool,
    /// Whether its mechanism is in reach.
    pub linked: bool,
    /// The newest fence that it has heard of; none of one that says nothing of fences.
    pub fence: Option<u64>,
}

#[derive(Deserialize)]
struct StateContent {
    #[serde(default)]
    moving: bool,
    #[serde(default)]
    stopped: bool,
    #[serde(default = "yes")]
    linked: bool,
    #[serde(default = "yes")]
    reached: bool,
    #[serde(default)]
    fence: Option<u64>,
}

const fn yes() -> bool {
    true
}

impl StateNews {
    /// Reads a message `state`; none if it is none.
    pub(crate) fn read(parcel: &Parcel) -> Option<StateNews> {
        let content: StateContent = from_value(parcel.value()).ok()?;
        Some(StateNews {
            id: parcel.id,
            moving: content.moving,
            stopped: content.stopped,
            linked: content.linked && content.reached,
            fence: content.fence,
        })
    }

    /// Whether it rests, and has heard that the token's owner has this fence.
    #[must_use]
    pub fn stands_for(&self, fence: u64) -> bool {
        !self.moving && self.fence.is_none_or(|known| known >= fence)
    }
}

/// A report about a command: a message `status`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Report {
    /// The command's id.
    #[serde(default)]
    pub id: Option<u64>,
    /// Whose it is.
    pub peer: String,
    /// Under which it came.
    #[serde(default)]
    pub fence: Option<u64>,
    /// `waiting`, `sending`, `executing`, `finished` or `error`.
    pub state: String,
    /// The statement that is carried out, 0 before the first.
    #[serde(default)]
    pub statement: u32,
    /// How many there are.
    #[serde(default)]
    pub of: u32,
    /// `{name, code, text}`, where the state is `error`.
    #[serde(default)]
    pub error: Option<Value>,
}

impl Report {
    /// Reads a message `status`; none if it is none.
    #[must_use]
    pub fn read(parcel: &Parcel) -> Option<Report> {
        from_value(parcel.value()).ok()
    }

    /// Whether it is the last one.
    #[must_use]
    pub fn is_end(&self) -> bool {
        matches!(self.state.as_str(), "finished" | "error")
    }

    /// A detail of its error.
    fn detail(&self, key: &str) -> Option<&Value> {
        self.error.as_ref()?.get(key)
    }

    /// What its error is called.
    #[must_use]
    pub fn error_name(&self) -> Option<&str> {
        self.detail("name").and_then(Value::as_str)
    }

    /// Whether the device has begun the command by it.
    pub(crate) fn has_begun(&self) -> bool {
        self.statement > 0 || self.state == "executing"
    }

    /// Whether the device has not begun it, as it came or waited too long.
    pub(crate) fn was_too_late(&self) -> bool {
        matches!(self.error_name(), Some("expired" | "too-old"))
    }

    /// Whether the command may be sent again.
    pub(crate) fn may_retry(&self) -> bool {
        self.detail("retry").and_then(Value::as_bool) == Some(true)
    }

    /// The device's words for its error.
    pub(crate) fn error_text(&self) -> String {
        text_of(self.error.as_ref().unwrap_or(&Value::Null))
    }

    /// The same with the statement, the name and the number (M53): `statement 2: too far [joint-limit 5005]`.
    #[must_use]
    pub fn error_words(&self) -> String {
        words(self.error.as_ref().unwrap_or(&Value::Null), self.statement)
    }

    /// Its error.
    #[must_use]
    pub fn wire_error(&self) -> WireError {
        let error = self.error.as_ref().and_then(Value::as_map);
        WireError::from_map(error.unwrap_or(&Map::new()))
    }
}

fn text_of(error: &Value) -> String {
    let text = error.get("text").and_then(Value::as_str);
    visible(text.unwrap_or("it failed, and the device does not say why"))
}

/// A device's words for what went wrong, with the statement, the name and the number (M53).
#[must_use]
pub fn error_words(error: &Value) -> String {
    words(error, 0)
}

fn words(error: &Value, statement: u32) -> String {
    let text = text_of(error);
    let said = error.get("statement").and_then(Value::as_int);
    let statement = said.unwrap_or(i64::from(statement));
    let place = match statement > 0 && !text.starts_with("statement ") {
        true => format!("statement {statement}: "),
        false => String::new(),
    };
    let name = error.get("name").and_then(Value::as_str).map(visible);
    let code = error.get("code").and_then(Value::as_int);
    let known: Vec<String> = name
        .into_iter()
        .chain(code.map(|code| code.to_string()))
        .collect();
    match known.is_empty() {
        true => format!("{place}{text}"),
        false => format!("{place}{text} [{}]", known.join(" ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_without_words_is_still_told() {
        assert_eq!(
            error_words(&Value::Null),
            "it failed, and the device does not say why"
        );
        let twice = Map::new().with("text", "statement 1: no").with("statement", 1);
        assert_eq!(error_words(&twice.into()), "statement 1: no");
        let turned = Map::new().with("text", "\u{1b}[2J");
        assert_eq!(error_words(&turned.into()), "\\u{1b}[2J");
    }
}
