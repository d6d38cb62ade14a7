//! What connections share of their broker.

use std::net::IpAddr;
use std::ops::Deref;
use std::sync::Arc;

use mom_login::{Logins, network};
use mom_proto::{Limits, Parcel, WireError};
use parking_lot::RwLock;
use tokio::sync::{Semaphore, oneshot};

use super::doors::{AdmissionLimiter, Seat};
use super::links::Links;
use crate::traffic::channel::stamped;
use crate::traffic::switchboard::Switchboard;

/// What a connection has to know of its broker.
#[derive(Clone, Debug)]
pub(crate) struct Services {
    shared: Arc<SharedServices>,
    /// What holds for this connection as long as it lasts: it was told so.
    pub(crate) limits: Arc<Limits>,
}

/// What is one for all connections.
#[derive(Debug)]
pub(crate) struct SharedServices {
    pub(crate) board: Arc<Switchboard>,
    pub(crate) logins: Arc<Logins>,
    pub(super) links: Links,
    /// Whose turn it is of those that come and go.
    crowd: Semaphore,
    /// What holds for the next connection.
    pub(crate) next_limits: RwLock<Arc<Limits>>,
}

impl Deref for Services {
    type Target = SharedServices;

    fn deref(&self) -> &SharedServices {
        &self.shared
    }
}

/// A place for a connection, and what it is told if it has to go before it has begun.
pub(crate) type Seated = (Seat, oneshot::Receiver<WireError>);

impl Services {
    pub(crate) fn new(board: Switchboard, logins: Logins, limits: Limits) -> Services {
        let limits = Arc::new(limits);
        let shared = SharedServices {
            board: Arc::new(board),
            logins: Arc::new(logins),
            links: Links::default(),
            crowd: Semaphore::new(1),
            next_limits: RwLock::new(Arc::clone(&limits)),
        };
        Services {
            shared: Arc::new(shared),
            limits,
        }
    }

    /// Lets all that can go on do so, before the next one of a crowd that comes or goes at once: ten thousand of them in a row
    /// would hold up a stop for a tenth of a second.
    pub(crate) async fn turn(&self) {
        let turn = self.crowd.acquire().await;
        tokio::task::yield_now().await;
        drop(turn);
    }

    /// Takes in a connection, for which another may have to go.
    pub(crate) fn seat(&self, doors: &Arc<AdmissionLimiter>, from: IpAddr) -> Result<Seated, WireError> {
        let (seat, told, evicted) = doors.enter(from)?;
        if let Some(evicted) = evicted {
            evicted.tell(|outbox, error| self.board.close(outbox, Some(error)));
        }
        Ok((seat, told))
    }

    /// Logs that there was no place for a peer.
    pub(crate) fn note_full(&self, from: IpAddr) {
        let event = "too many connections";
        if self.is_first(event, Some(from), None) {
            tracing::warn!(%from, "{event}");
        }
    }

    /// An error to a peer that is not even one.
    pub(crate) fn answer(&self, error: &WireError) -> Parcel {
        stamped(error.to_parcel(None), self.board.clock.wall())
    }

    /// Whether a log line is the first of its kind from an address for a while; otherwise it is counted.
    pub(crate) fn is_first(&self, event: &'static str, from: Option<IpAddr>, detail: Option<&str>) -> bool {
        let lines = &self.board.tap.lines;
        lines.first(event, from.map(network), detail, self.board.clock.now())
    }

    /// For a new connection.
    pub(crate) fn fresh(&self) -> Services {
        let limits = Arc::clone(&self.next_limits.read());
        Services {
            limits,
            ..self.clone()
        }
    }
}
