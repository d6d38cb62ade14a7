//! What the hub is told.

use mom_managers::Registry;
use mom_proto::{Limits, Micros, Parcel, Value};

use crate::{ContextSpec, PeerClock, PeerId, Ticket, User};

/// One input; all that the hub ever reacts to, besides time.
#[derive(Clone, Debug)]
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
    /// The connection of a peer was lost that may come back. Until then its devices are safe and its places are kept.
    Lost {
        /// Whose.
        peer: PeerId,
        /// For so long.
        grace: Micros,
    },
    /// It has come back.
    Resumed {
        /// Who.
        peer: PeerId,
    },
    /// A parcel of a peer that has logged in.
    Request {
        /// From whom.
        peer: PeerId,
        /// What.
        parcel: Box<Parcel>,
        /// The clock by which it stamps; none = not known.
        clock: Option<PeerClock>,
    },
    /// A record is durable, or will never be.
    Stored {
        /// Of which [`Effect::Store`](crate::Effect::Store).
        ticket: Ticket,
        /// Whether it is.
        ok: bool,
    },
    /// The configuration was changed; it has been checked with [`Hub::new`](crate::Hub::new) before.
    Configure(Box<Configuration>),
    /// Time has passed.
    Tick,
    /// The wall clock is so many µs ahead of the hub's time from now on: it was set, or the machine has slept.
    Wall {
        /// Negative if it is behind.
        ahead: i64,
    },
}

/// A new configuration.
#[derive(Clone, Debug)]
pub struct Configuration {
    /// The kinds of manager and those with names.
    pub registry: Registry,
    /// The manager of the root.
    pub root: Value,
    /// The contexts that are always there, parents first. One that was there before and is there no longer is deleted.
    pub contexts: Vec<ContextSpec>,
    /// What the hub takes from now on.
    pub limits: Limits,
    /// The peers whose user has changed, as it is now; none = there is no such user any more.
    pub users: Vec<(PeerId, Option<User>)>,
}
