//! Failures of commands, and their exit codes.

use std::io;

use mom_client::{Client, ClientError, Code, WireError};
use mom_drive::{CommandEnd, VerbFailure};

/// Where the robots of a fleet are.
const FLEET: &str = "/fleet";

/// The detail of a refusal that says what to do.
pub(crate) const HINT: &str = "hint";

/// Why a command did not do its work.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    /// The command line cannot be carried out as it stands.
    #[error("{text}")]
    Usage {
        /// What is wrong.
        text: String,
        /// What to do.
        hint: String,
    },
    /// The hub refused.
    #[error("{what}: {error}")]
    Refused {
        /// What was asked for: `grab /robot/token`.
        what: String,
        /// The hub's answer.
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
    /// Input or output failed.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// It failed, and the reason has been printed.
    #[error("told already")]
    Told,
}

impl Failure {
    /// A failure with what to do about it.
    pub(crate) fn new(text: impl Into<String>, hint: impl Into<String>) -> Failure {
        Failure::Failed {
            text: text.into(),
            hint: Some(hint.into()),
        }
    }

    /// A failure without advice.
    pub(crate) fn plain(text: impl Into<String>) -> Failure {
        Failure::Failed {
            text: text.into(),
            hint: None,
        }
    }

    /// A command line that cannot be carried out.
    pub(crate) fn usage(text: impl Into<String>, hint: impl Into<String>) -> Failure {
        Failure::Usage {
            text: text.into(),
            hint: hint.into(),
        }
    }

    /// The same with what follows from it.
    pub(crate) fn with(self, more: &str) -> Failure {
        match self {
            Failure::Failed { text, hint } => Failure::Failed {
                text: format!("{text}; {more}"),
                hint,
            },
            other => other,
        }
    }

    /// The failure of `what` by a client's error.
    pub(crate) fn of_client(what: impl Into<String>, error: ClientError) -> Failure {
        match error {
            ClientError::Refused(error) | ClientError::Closed(Some(error)) => Failure::Refused {
                what: what.into(),
                error,
            },
            ClientError::Local(error) => Failure::usage(
                format!("{}: {}", what.into(), error.text),
                "paths look like /robot/arm; `mom tree` shows those that exist, and of which kind they are",
            ),
            other => Failure::plain(format!("{}: {other}", what.into())),
        }
    }

    /// The same with a hint, if the hub has a fleet where an arm or a camera was looked for in vain.
    pub(crate) async fn at_a_fleet(self, client: &Client) -> Failure {
        match self {
            Failure::Refused { what, error } if error.code == Code::UNKNOWN_PATH => {
                let error = match client.list(FLEET).await {
                    Ok(_) => error.detail(HINT, "this hub has a fleet: mom fleet list"),
                    Err(_) => error,
                };
                Failure::Refused { what, error }
            }
            other => other,
        }
    }

    /// 2 for a command line that makes no sense, 1 for what failed or was refused.
    pub(crate) fn exit_code(&self) -> u8 {
        match self {
            Failure::Usage { .. } => 2,
            // The reader of our output has closed it.
            Failure::Io(error) if error.kind() == io::ErrorKind::BrokenPipe => 0,
            _ => 1,
        }
    }
}

impl From<VerbFailure> for Failure {
    fn from(failure: VerbFailure) -> Failure {
        match failure {
            VerbFailure::Hub { what, error } => Failure::of_client(what, error),
            VerbFailure::Refused { what, error } => Failure::Refused { what, error },
            VerbFailure::Failed { text, hint } => Failure::Failed { text, hint },
            VerbFailure::Io(error) => Failure::Io(error),
        }
    }
}

impl From<CommandEnd> for Failure {
    fn from(end: CommandEnd) -> Failure {
        Failure::Failed {
            text: end.text,
            hint: end.hint,
        }
    }
}

/// Says what was being done when a client's request failed.
pub(crate) trait Doing<T> {
    /// `what` as one would type it: `grab /robot/token`.
    fn doing(self, what: impl Into<String>) -> Result<T, Failure>;
}

impl<T> Doing<T> for Result<T, ClientError> {
    fn doing(self, what: impl Into<String>) -> Result<T, Failure> {
        self.map_err(|error| Failure::of_client(what, error))
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use mom_client::Code;

    use super::*;

    #[test]
    fn exit_codes() {
        let wire = || WireError::new(Code::HELD, "held by bob");
        for (failure, code) in [
            (Failure::usage("no user", "name one"), 2),
            (Failure::plain("lost"), 1),
            (Failure::Told, 1),
            (Failure::of_client("grab /x", ClientError::Refused(wire())), 1),
            (
                Failure::of_client(
                    "join x",
                    ClientError::Local(WireError::new(Code::BAD_PATH, "no slash")),
                ),
                2,
            ),
            (
                Failure::of_client(
                    "list /",
                    ClientError::TimedOut {
                        what: "list".to_owned(),
                        after: Duration::from_secs(10),
                    },
                ),
                1,
            ),
            (Failure::from(io::Error::from(io::ErrorKind::BrokenPipe)), 0),
            (Failure::from(io::Error::from(io::ErrorKind::NotFound)), 1),
        ] {
            assert_eq!(failure.exit_code(), code, "{failure}");
        }
    }
}
