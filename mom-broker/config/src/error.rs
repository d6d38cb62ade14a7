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
    /// The character in that line, from 1.
    pub column: Option<usize>,
    /// The key, such as `contexts[2].manager`.
    pub key: Option<String>,
    /// What is wrong and what to do.
    pub text: String,
    /// Nothing need be wrong: this process had no descriptor left to read the file with.
    pub busy: bool,
    pub(crate) at: Box<FaultPlace>,
}

/// Where a fault is, for reading on without it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct FaultPlace {
    /// The keys of `key`, one by one.
    pub(crate) keys: Vec<String>,
    /// The word that was probably meant there.
    pub(crate) meant: Option<String>,
}

/// All that is wrong with a configuration: at least one error, in the order of the files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConfigErrors(pub(crate) Vec<ConfigError>);

impl ConfigErrors {
    /// One by one.
    pub fn iter(&self) -> impl Iterator<Item = &ConfigError> {
        self.0.iter()
    }

    /// Nothing need be wrong: this process had no descriptor left to read a file with.
    pub fn busy(&self) -> bool {
        self.0.iter().any(|error| error.busy)
    }
}

impl std::error::Error for ConfigErrors {}

impl From<ConfigError> for ConfigErrors {
    fn from(error: ConfigError) -> ConfigErrors {
        ConfigErrors(vec![error])
    }
}

/// One as it is; more with their number, and a line for each.
impl fmt::Display for ConfigErrors {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let [error] = &self.0[..] {
            return error.fmt(formatter);
        }
        write!(formatter, "{} faults:", self.0.len())?;
        self.0
            .iter()
            .try_for_each(|error| write!(formatter, "\n  {error}"))
    }
}

impl ConfigError {
    pub(crate) fn of_file(file: &str, text: impl Into<String>) -> ConfigError {
        ConfigError {
            file: Some(file.to_owned()),
            line: None,
            column: None,
            key: None,
            text: text.into(),
            busy: false,
            at: Box::default(),
        }
    }

    /// Of a configuration that was made in a program.
    pub(crate) fn of_program(key: Option<String>, text: String) -> ConfigError {
        ConfigError {
            file: None,
            line: None,
            column: None,
            key,
            text,
            busy: false,
            at: Box::default(),
        }
    }
}

impl std::error::Error for ConfigError {}

impl From<SettingError> for ConfigError {
    /// Of a configuration that was made in a program.
    fn from(error: SettingError) -> ConfigError {
        ConfigError::of_program(Some(error.keys().join(".")), error.text)
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
