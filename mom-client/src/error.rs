//! Errors of requests.

use std::time::Duration;

use mom_net::NetError;
use mom_proto::{Code, WireError};

use crate::Refusal;

/// Why a request failed.
///
/// ```
/// use mom_client::{ClientError, Code, ErrorKind, WireError};
/// let error = ClientError::Refused(WireError::new(Code::HELD, "alice drives"));
/// assert_eq!(error.kind(), ErrorKind::Refused);
/// assert_eq!(error.code(), Some(&Code::HELD));
/// ```
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClientError {
    /// The hub answered with an error: code, plain words, details.
    #[error("refused: {0}")]
    Refused(WireError),
    /// The link is down or cannot be established.
    #[error("no connection: {0}")]
    Connection(String),
    /// No answer came in time. It is unknown whether the request was carried out.
    #[error("no answer to {what} within {after:?}")]
    TimedOut {
        /// The request: family, name and context.
        what: String,
        /// The time waited.
        after: Duration,
    },
    /// The connection was lost after it had left, and it is not sent again: it moves a device, lets it move or changes who
    /// drives it. It is unknown whether it was carried out.
    #[error("it is unknown whether the request was carried out: {0}")]
    Unknown(WireError),
    /// The client is closed for good: it logged out, or the hub closed with a code of 400–499 or gave it up.
    #[error("closed{}", .0.as_ref().map(|error| format!(": {error}")).unwrap_or_default())]
    Closed(Option<WireError>),
    /// What was given as the address of a hub is none.
    #[error("wrong address: {0}")]
    Address(String),
    /// An error on this side: a bad path, content without a form on the wire, a malformed reply.
    #[error("{0}")]
    Local(WireError),
}

/// The kind of a [`ClientError`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The hub said no.
    Refused,
    /// No link now.
    Connection,
    /// No answer in time.
    TimedOut,
    /// The answer is lost with the connection, and it may have been carried out.
    Unknown,
    /// No link ever again.
    Closed,
    /// Wrong on this side.
    Local,
}

impl ClientError {
    /// Its kind.
    pub fn kind(&self) -> ErrorKind {
        match self {
            ClientError::Refused(_) => ErrorKind::Refused,
            ClientError::Connection(_) => ErrorKind::Connection,
            ClientError::TimedOut { .. } => ErrorKind::TimedOut,
            ClientError::Unknown(_) => ErrorKind::Unknown,
            ClientError::Closed(_) => ErrorKind::Closed,
            ClientError::Local(_) | ClientError::Address(_) => ErrorKind::Local,
        }
    }

    /// The error in the words of the wire, if there is one.
    pub fn wire(&self) -> Option<&WireError> {
        match self {
            ClientError::Refused(error) | ClientError::Local(error) | ClientError::Unknown(error) => {
                Some(error)
            }
            ClientError::Closed(error) => error.as_ref(),
            ClientError::Connection(_) | ClientError::TimedOut { .. } | ClientError::Address(_) => None,
        }
    }

    /// The hub's refusal, typed and as text for people; none if it is not a refusal.
    pub fn refusal(&self) -> Option<Refusal<'_>> {
        match self {
            ClientError::Refused(error) => Some(Refusal::of(error)),
            _ => None,
        }
    }

    /// The code of [`ClientError::wire`].
    pub fn code(&self) -> Option<&Code> {
        self.wire().map(|error| &error.code)
    }
}

/// Errors of `mom-proto` arise on this side; those of the hub come as parcels.
impl From<WireError> for ClientError {
    fn from(error: WireError) -> ClientError {
        ClientError::Local(error)
    }
}

impl From<NetError> for ClientError {
    fn from(error: NetError) -> ClientError {
        match error {
            NetError::Address { .. } => ClientError::Address(error.to_string()),
            other => ClientError::Connection(other.to_string()),
        }
    }
}

/// A reply of the hub without a required part.
pub(crate) fn bad_reply(what: &str) -> ClientError {
    ClientError::Local(WireError::new(
        Code::BAD_CONTENT,
        format!("the hub's reply has no {what}"),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_and_codes() {
        let wire = || WireError::new(Code::HELD, "alice drives");
        let timed_out = ClientError::TimedOut {
            what: "token grab /t".to_owned(),
            after: Duration::from_secs(1),
        };
        for (error, kind, code, text) in [
            (
                ClientError::Refused(wire()),
                ErrorKind::Refused,
                Some(Code::HELD),
                "refused: held: alice drives",
            ),
            (
                ClientError::Local(wire()),
                ErrorKind::Local,
                Some(Code::HELD),
                "held: alice drives",
            ),
            (
                ClientError::Unknown(WireError::new(Code::DISCONNECTED, "it had left")),
                ErrorKind::Unknown,
                Some(Code::DISCONNECTED),
                "it is unknown whether the request was carried out: disconnected: it had left",
            ),
            (
                ClientError::Closed(Some(wire())),
                ErrorKind::Closed,
                Some(Code::HELD),
                "closed: held: alice drives",
            ),
            (ClientError::Closed(None), ErrorKind::Closed, None, "closed"),
            (
                ClientError::Connection("x".to_owned()),
                ErrorKind::Connection,
                None,
                "no connection: x",
            ),
            (
                ClientError::Address("x".to_owned()),
                ErrorKind::Local,
                None,
                "wrong address: x",
            ),
            (
                timed_out,
                ErrorKind::TimedOut,
                None,
                "no answer to token grab /t within 1s",
            ),
        ] {
            assert_eq!((error.kind(), error.code().cloned()), (kind, code), "{error}");
            assert_eq!(error.to_string(), text);
        }
    }
}
