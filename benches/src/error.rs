//! What can go wrong while measuring.

use std::io;
use std::time::Duration;

use mom_proto::WireError;

/// A measurement that gives no figure.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A socket, file or process failed.
    #[error("{what}: {error}")]
    Io {
        /// What was tried.
        what: String,
        /// What the system says.
        error: io::Error,
    },
    /// A parcel is missing, doubled or out of its place.
    #[error("parcel {got} came where {expected} was due: lost, doubled or out of order")]
    Order {
        /// The number that was due.
        expected: u32,
        /// The number that came.
        got: u32,
    },
    /// Nothing moved any more, as after a loss.
    #[error("{what} did not go on within {} s", after.as_secs())]
    Stalled {
        /// What was waited for.
        what: String,
        /// For how long.
        after: Duration,
    },
    /// The hub refused something or said what it should not.
    #[error("{what}: {error}")]
    Hub {
        /// What was asked or heard.
        what: String,
        /// What is wrong with it.
        error: WireError,
    },
    /// Something that a driver does not understand.
    #[error("unexpected from the hub: {0}")]
    Unexpected(String),
}

impl Error {
    /// For `map_err`: a failed operation of the system.
    pub fn io(what: impl Into<String>) -> impl FnOnce(io::Error) -> Error {
        let what = what.into();
        move |error| Error::Io { what, error }
    }

    /// For `map_err`: a refusal or an encoding that cannot be.
    pub(crate) fn hub(what: impl Into<String>) -> impl FnOnce(WireError) -> Error {
        let what = what.into();
        move |error| Error::Hub { what, error }
    }
}
