//! What the hub is told.

use mom_proto::{Map, Parcel};

use crate::PeerId;

/// One input; all that the hub ever reacts to, besides time.
#[derive(Clone, Debug, PartialEq)]
pub enum Input {
    /// A peer proved who it is: for the first time, or again on a live connection (M13).
    Login {
        /// Its connection.
        peer: PeerId,
        /// Who it is.
        user: User,
        /// The name it wishes; absent = the user's.
        nickname: Option<String>,
        /// The id of the request, for the reply.
        id: Option<u64>,
    },
    /// A connection ended.
    Gone {
        /// Which.
        peer: PeerId,
    },
    /// A parcel of a peer that has logged in.
    Request {
        /// From whom.
        peer: PeerId,
        /// What.
        parcel: Box<Parcel>,
    },
    /// Time has passed.
    Tick,
}

/// A user as the login found it (M13).
#[derive(Clone, Debug, PartialEq)]
pub struct User {
    /// The name.
    pub name: String,
    /// The authority level; higher is more.
    pub level: i32,
    /// The groups.
    pub groups: Vec<String>,
    /// Preferences and personal information, for the login reply.
    pub details: Map,
}
