//! The state of a peer behind the lock of [`Shared`](super::shared::Shared).

use std::collections::BTreeMap;
use std::sync::Arc;

use mom_proto::codec::Form;
use mom_proto::{Parcel, Path, WireError, outlives_loss};

use crate::ClientError;
use crate::peer::guards::Guards;
use crate::peer::handover::Handovers;
use crate::peer::pending::OpenRequests;
use crate::peer::subscribers::Subscribers;
use crate::peer::waits::Waits;
use crate::peer::wanted::WantedContexts;
use crate::wire::link_secret::Counted;
use crate::wire::outbox::Outbox;
use crate::wire::welcome::Welcome;

#[derive(Debug)]
pub(crate) struct State {
    pub(crate) status: Status,
    pub(crate) me: Arc<Welcome>,
    pub(crate) outbox: Outbox,
    /// Messages that newer ones have replaced, by context: told when the link takes something again, all at once.
    pub(crate) replaced: BTreeMap<Path, u64>,
    pub(crate) pending: OpenRequests,
    pub(crate) places: WantedContexts,
    pub(crate) subscribers: Subscribers,
    pub(crate) guards: Guards,
    /// Parts in shared holds.
    pub(crate) inhibits: Guards,
    pub(crate) waits: Waits,
    pub(crate) handovers: Handovers,
    /// Joins after a lost link that are not answered yet.
    pub(crate) rejoining: usize,
    /// What the hub said before it closed the link.
    pub(crate) closing: Option<WireError>,
    /// What both ends have counted, where a lost connection may be resumed.
    pub(crate) counted: Option<Box<Counted>>,
}

#[derive(Clone, Debug)]
pub(crate) enum Status {
    Up,
    /// The connection is lost, and another one is to go on with all that waits.
    Resuming,
    Down,
    Closed(Option<WireError>),
}

impl State {
    /// Of a peer that has just logged in.
    pub(crate) fn new(form: Option<Form>, me: Welcome) -> State {
        State {
            status: Status::Up,
            me: Arc::new(me),
            outbox: Outbox::new(form),
            replaced: BTreeMap::new(),
            pending: OpenRequests::default(),
            places: WantedContexts::default(),
            subscribers: Subscribers::default(),
            guards: Guards::default(),
            inhibits: Guards::default(),
            waits: Waits::default(),
            handovers: Handovers::default(),
            rejoining: 0,
            closing: None,
            counted: None,
        }
    }

    /// The token that a message needs, as far as this peer knows.
    fn guard_of(&self, parcel: &Parcel) -> Option<Path> {
        self.places
            .gate(parcel.context.as_ref()?)
            .token_for(parcel.name())
    }

    /// Whether a message that was said while the outbox wrote to this link can be sent now; the token that it needs.
    pub(crate) fn check_message(&self, parcel: &Parcel, link: u64) -> Result<Option<Path>, ClientError> {
        self.check_up()?;
        let guard = self.guard_of(parcel);
        let lost = self.is_resuming() || self.outbox.mark().link != link;
        match lost && !outlives_loss(parcel, guard.is_some()) {
            true => Err(too_late()),
            false => Ok(guard),
        }
    }

    /// Whether the connection is lost, and another one is to go on.
    pub(crate) fn is_resuming(&self) -> bool {
        matches!(self.status, Status::Resuming)
    }

    /// Whether anything can be sent now.
    pub(crate) fn check_up(&self) -> Result<(), ClientError> {
        match &self.status {
            Status::Up | Status::Resuming => Ok(()),
            Status::Down => Err(ClientError::Connection("the link is down".to_owned())),
            Status::Closed(error) => Err(ClientError::Closed(error.clone())),
        }
    }
}

/// What moves a device, lets it move or changes who drives it is of its moment.
pub(crate) fn too_late() -> ClientError {
    let text = "the connection is lost, and the message would arrive too late: it is not sent";
    ClientError::Connection(text.to_owned())
}
