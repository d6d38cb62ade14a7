//! What the hub wants done.

use std::sync::Arc;

use mom_proto::{ContextNumber, Parcel, WireError};

use mom_managers::Rate;

use super::inquiry::Inquiry;
use crate::{Audit, PeerId, Receivers, Record, Route, StopRecord, Ticket};

/// One effect. Effects of one input are carried out in their order.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Swap in the route of a channel: from here on it holds for what is sent there.
    Route(Arc<Route>),
    /// A channel was deleted.
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
    /// Answer with the figures of these channels, which the broker has: the control lane.
    Stats {
        /// To whom.
        to: PeerId,
        /// The answer, to whose content the figures are added.
        parcel: Arc<Parcel>,
        /// Of which channels.
        channels: Vec<ContextNumber>,
        /// Whether it is one channel, told with the figures of each member.
        peers: bool,
    },
    /// Answer a question that may take long, from the files that the broker has: the control lane. That it may be asked is
    /// decided.
    Inquire {
        /// To whom.
        to: PeerId,
        /// The answer, to which the content is added.
        parcel: Arc<Parcel>,
        /// What is asked.
        inquiry: Box<Inquiry>,
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
        /// How much the sender may send there; the broker counts, on this path and on the fast one alike.
        rate: Option<Rate>,
    },
    /// Make a record durable. With a ticket the hub waits for [`Input::Stored`](crate::Input::Stored) before it
    /// changes the token.
    Store {
        /// What.
        record: Record,
        /// Whose durability is awaited; none = nobody's.
        ticket: Option<Ticket>,
    },
    /// Keep what is stopped in a channel over a restart. With a ticket the hub waits for
    /// [`Input::Stored`](crate::Input::Stored): before an unstop is handed out, and to say that a stop is kept.
    Keep {
        /// What; where nothing was ever stopped it may be forgotten.
        record: StopRecord,
        /// Whose keeping is awaited; none = nobody's.
        ticket: Option<Ticket>,
    },
    /// Write a fact into the audit log.
    Audit(Box<Audit>),
    /// End a connection, after an error that says why.
    Close {
        /// Which.
        peer: PeerId,
        /// Why; none for a peer that asked for it.
        error: Option<WireError>,
    },
}
