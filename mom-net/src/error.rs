//! What can go wrong on a connection.

use std::io;

use mom_proto::{Code, WireError};

/// A connection that cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum NetError {
    /// The link itself.
    #[error("the link failed: {0}")]
    Io(io::Error),
    /// The bytes on it, or a parcel that has no form on the wire.
    #[error(transparent)]
    Wire(#[from] WireError),
    /// No address, and what is wrong with it.
    #[error(
        "{text:?} is not the address of a hub: {why}; write bin://HOST:PORT (binary) or tcp://HOST:PORT (XML), bins:// or tcps:// with TLS"
    )]
    Address {
        /// What was written.
        text: String,
        /// What is wrong with it.
        why: String,
    },
}

impl NetError {
    /// The error in the words of the wire; a failed link is `disconnected`.
    pub fn to_wire(&self) -> WireError {
        match self {
            NetError::Wire(error) => error.clone(),
            other => WireError::new(Code::DISCONNECTED, other.to_string()),
        }
    }
}

impl From<io::Error> for NetError {
    fn from(error: io::Error) -> NetError {
        // A layer between the network and the form may have found what it carries to be at fault.
        match error.downcast::<WireError>() {
            Ok(error) => NetError::Wire(error),
            Err(error) => NetError::Io(error),
        }
    }
}

/// The error for a connection on which nothing can be answered any more.
impl From<NetError> for WireError {
    fn from(error: NetError) -> WireError {
        match error {
            NetError::Wire(error) => error,
            other => WireError::new(Code::DISCONNECTED, other.to_string()),
        }
    }
}
