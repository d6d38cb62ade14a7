//! Errors of the configuration, with their positions.

use std::fmt;

use mom_login::SettingError;

/// An error of the configuration with file, line and key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConfigError {
    /// The file; none for a configuration that was made in a program.
    pub file: Option<String>,
    /// The line, from 1.
    pub line: Option<usize>,
    /// The key, such as `contexts[2].manager`.
    pub key: Option<String>,
    /// What is wrong and what to do.
    pub text: String,
    /// Nothing need be wrong: this process had no descriptor left to read the file with.
    pub busy: bool,
}

impl ConfigError {
    pub(crate) fn of_file(file: &str, text: impl Into<String>) -> ConfigError {
        ConfigError {
            file: Some(file.to_owned()),
            line: None,
            key: None,
            text: text.into(),
            busy: false,
        }
    }
}

impl std::error::Error for ConfigError {}

impl From<SettingError> for ConfigError {
    /// Of a configuration that was made in a program.
    fn from(error: SettingError) -> ConfigError {
        ConfigError {
            file: None,
            line: None,
            key: Some(error.keys().join(".")),
            text: error.text,
            busy: false,
        }
    }
}

impl fmt::Display for ConfigError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(file) = &self.file {
            formatter.write_str(file)?;
            if let Some(line) = self.line {
                write!(formatter, ":{line}")?;
            }
            formatter.write_str(": ")?;
        }
        if let Some(key) = &self.key {
            write!(formatter, "{key}: ")?;
        }
        formatter.write_str(&self.text)
    }
}
