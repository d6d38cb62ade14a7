//! What the hub wants done.

use std::sync::Arc;

use mom_proto::{ContextNumber, Parcel, WireError};

use crate::{PeerId, Receivers, Route};

/// One effect. Effects of one input are carried out in their order.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Swap in the route of a channel: from here on it holds for what is sent there.
    Route(Arc<Route>),
    /// A channel is no more.
    RouteGone(ContextNumber),
    /// Give an event or a safe state to these peers: the control lane.
    Deliver {
        /// To whom, in the order of their numbers.
        to: Vec<PeerId>,
        /// What.
        parcel: Arc<Parcel>,
    },
    /// Answer a request: the control lane.
    Reply {
        /// To whom.
        to: PeerId,
        /// What.
        parcel: Arc<Parcel>,
    },
    /// Carry a message that was admitted here because no verdict stood for it. Answer its sender if it
    /// asked for a receipt.
    Send {
        /// The sender.
        from: PeerId,
        /// The message, stamped.
        parcel: Box<Parcel>,
        /// Members of the route.
        receivers: Receivers,
        /// The channel as it stands.
        route: Arc<Route>,
    },
    /// End a connection, after an error that says why.
    Close {
        /// Which.
        peer: PeerId,
        /// Why; none for a peer that asked for it.
        error: Option<WireError>,
    },
}
