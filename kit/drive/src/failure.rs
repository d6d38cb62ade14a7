//! Why something did not come about, as the command line tells it.

use std::io;

use mom_client::{ClientError, WireError};

/// Why the verb did not do its work.
#[derive(Debug, thiserror::Error)]
pub enum VerbFailure {
    /// The hub refused, or is out of reach.
    #[error("{what}: {error}")]
    Hub {
        /// What was asked for.
        what: String,
        /// The client's error.
        error: ClientError,
    },
    /// A device refused.
    #[error("{what}: {error}")]
    Refused {
        /// What was asked for.
        what: String,
        /// The device's answer.
        error: WireError,
    },
    /// It did not work.
    #[error("{text}")]
    Failed {
        /// What went wrong.
        text: String,
        /// What to do, where something can be done.
        hint: Option<String>,
    },
    /// Nobody reads the output any more.
    #[error(transparent)]
    Io(#[from] io::Error),
}

impl VerbFailure {
    /// What went wrong, and what to do.
    pub fn new(text: impl Into<String>, hint: impl Into<String>) -> VerbFailure {
        VerbFailure::Failed {
            text: text.into(),
            hint: Some(hint.into()),
        }
    }

    /// What went wrong, where nothing can be done.
    pub fn plain(text: impl Into<String>) -> VerbFailure {
        VerbFailure::Failed {
            text: text.into(),
            hint: None,
        }
    }

    /// What to do, where something can be done.
    #[must_use]
    pub fn hint(&self) -> Option<&str> {
        match self {
            VerbFailure::Failed { hint, .. } => hint.as_deref(),
            _ => None,
        }
    }

    /// This one, and in its words another that came after it.
    #[must_use]
    pub fn and(self, other: &VerbFailure) -> VerbFailure {
        let text = format!("{self}; {other}");
        match self {
            VerbFailure::Io(_) => self,
            VerbFailure::Failed { hint, .. } => VerbFailure::Failed {
                text,
                hint: hint.or_else(|| other.hint().map(str::to_owned)),
            },
            VerbFailure::Hub { .. } | VerbFailure::Refused { .. } => VerbFailure::Failed {
                text,
                hint: other.hint().map(str::to_owned),
            },
        }
    }
}

/// Says what was being done when a client's request failed.
pub trait Doing<T> {
    /// Names it: `grab /robot/token`.
    ///
    /// # Errors
    /// The client's, with that.
    fn doing(self, what: impl Into<String>) -> Result<T, VerbFailure>;
}

impl<T> Doing<T> for Result<T, ClientError> {
    fn doing(self, what: impl Into<String>) -> Result<T, VerbFailure> {
        self.map_err(|error| VerbFailure::Hub {
            what: what.into(),
            error,
        })
    }
}

/// How one result of a verb is told: as JSON, and for people.
pub type Tell<'a> = &'a mut (dyn FnMut(serde_json::Value, String) -> io::Result<()> + Send);

/// The failure of either, or of both.
///
/// # Errors
/// One of them failed.
pub fn both(first: Result<(), VerbFailure>, second: Result<(), VerbFailure>) -> Result<(), VerbFailure> {
    match (first, second) {
        (Err(first), Err(second)) => Err(first.and(&second)),
        (first, second) => first.and(second),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_failures_are_both_told() {
        let failure = || Err(VerbFailure::new("the robot is stopped", "let it go"));
        let release = || Err(VerbFailure::plain("release /robot/token: timed out"));
        let VerbFailure::Failed { text, hint } = both(failure(), release()).expect_err("both") else {
            panic!("in words");
        };
        assert_eq!(text, "the robot is stopped; release /robot/token: timed out");
        assert_eq!(hint.as_deref(), Some("let it go"));
        let alone = both(Ok(()), release()).expect_err("one").to_string();
        assert_eq!(alone, "release /robot/token: timed out");
        assert!(both(Ok(()), Ok(())).is_ok());
    }
}
