//! A wrong setting: which and why.

/// What is wrong with a setting or a user, and the keys that lead to it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}: {text}", keys.join("."))]
pub struct SettingError {
    keys: Vec<String>,
    /// What is wrong and what to do.
    pub text: String,
}

impl SettingError {
    pub(crate) fn new(keys: &[&str], text: impl Into<String>) -> SettingError {
        SettingError {
            keys: keys.iter().map(|&key| key.to_owned()).collect(),
            text: text.into(),
        }
    }

    /// The keys from the outermost table on.
    pub fn keys(&self) -> Vec<&str> {
        self.keys.iter().map(String::as_str).collect()
    }

    /// The same error of a table inside another one.
    #[must_use]
    pub fn below(self, tables: &[&str]) -> SettingError {
        let tables = tables.iter().map(|&table| table.to_owned());
        SettingError {
            keys: tables.chain(self.keys).collect(),
            ..self
        }
    }
}
