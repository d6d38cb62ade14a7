//! Finds the place of what the hub, managers and logins refuse.

use std::path::Path;

use mom_hub::SetupError;
use mom_proto::{Code, Value, WireError};

use super::source::key_text;
use super::{Config, ConfigError};

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

    /// What is wrong with one of the files of `[tls]`.
    pub fn tls_fault(&self, file: &Path, why: &str) -> ConfigError {
        let key = match self.tls.key.as_deref() == Some(file) {
            true => "key",
            false => "certificate",
        };
        let text = format!("{}: {why}", file.display());
        self.at(&["tls", key], &WireError::new(Code::BAD_CONTENT, text))
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
            .map(|nearest| format!(" (did you mean `{nearest}`?)"))
            .unwrap_or_default();
        let text = format!("{}{hint}", error.text);
        self.remark(&keys, text)
    }

    /// A remark about a key, with its position.
    pub(super) fn remark(&self, keys: &[&str], text: String) -> ConfigError {
        match &self.source {
            Some(source) => source.error(keys, text),
            None => ConfigError::of_program(Some(key_text(keys)), text),
        }
    }
}
