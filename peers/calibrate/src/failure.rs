//! Why a calibration did not come about, as the command line tells it.

use std::io;

use mom_client::{ClientError, WireError};

use crate::CalibrationError;

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
    pub(crate) fn new(text: impl Into<String>, hint: impl Into<String>) -> VerbFailure {
        VerbFailure::Failed {
            text: text.into(),
            hint: Some(hint.into()),
        }
    }

    pub(crate) fn plain(text: impl Into<String>) -> VerbFailure {
        VerbFailure::Failed {
            text: text.into(),
            hint: None,
        }
    }

    /// This one, and in its words another that came after it.
    pub(crate) fn and(self, other: &VerbFailure) -> VerbFailure {
        let text = format!("{self}; {other}");
        match self {
            VerbFailure::Io(_) => self,
            VerbFailure::Failed { hint, .. } => VerbFailure::Failed { text, hint },
            VerbFailure::Hub { .. } | VerbFailure::Refused { .. } => VerbFailure::plain(text),
        }
    }
}

impl From<CalibrationError> for VerbFailure {
    fn from(error: CalibrationError) -> VerbFailure {
        VerbFailure::new(
            format!("no calibration: {error}; nothing was told to the camera"),
            error.hint(),
        )
    }
}

/// Says what was being done when a client's request failed.
pub(crate) trait Doing<T> {
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
