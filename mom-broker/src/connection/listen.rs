//! From a listening socket to a connection that is served.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use mom_net::{NetError, ServerTls, Transceiver};
use mom_proto::{Limits, Parcel, WireError};
use parking_lot::RwLock;
use tokio::net::{TcpListener, TcpSocket, TcpStream, lookup_host};
use tokio::sync::{Semaphore, oneshot, watch};
use tokio::task::JoinSet;
use tokio::time::Instant;

use super::doors::{Doors, Seat};
use super::{Services, Serving, login_timeout};
use crate::traffic::channel::stamped;

/// Connections that may wait to be taken in; the system may allow less. When a crowd comes back at once and more
/// wait than that, Linux turns to SYN cookies, and a connection whose cookie has grown old is reset.
const BACKLOG: u32 = 16 * 1024;

/// Refused peers that are told so at the same time.
const FAREWELLS: usize = 64;

/// Listens at the first address of a name that can be had.
pub(crate) async fn listen(address: &str) -> std::io::Result<TcpListener> {
    let mut failure = std::io::Error::from(std::io::ErrorKind::AddrNotAvailable);
    for address in lookup_host(address).await? {
        let bind = || {
            let socket = match address.is_ipv4() {
                true => TcpSocket::new_v4(),
                false => TcpSocket::new_v6(),
            }?;
            // What is left of connections of the last start must not keep this one from its address.
            socket.set_reuseaddr(true)?;
            socket.bind(address)?;
            socket.listen(BACKLOG)
        };
        match bind() {
            Ok(listener) => return Ok(listener),
            Err(error) => failure = error,
        }
    }
    Err(failure)
}

/// One listener with all its connections.
pub(crate) struct Listener {
    pub(crate) services: Services,
    pub(crate) doors: Arc<Doors>,
    pub(crate) tls: Arc<RwLock<Option<ServerTls>>>,
    pub(crate) stop: watch::Receiver<bool>,
}

impl Listener {
    pub(crate) async fn run(mut self, listener: TcpListener) {
        let mut served = JoinSet::new();
        let farewells = Arc::new(Semaphore::new(FAREWELLS));
        loop {
            let accepted = tokio::select! {
                _ = self.stop.changed() => break,
                Some(_) = served.join_next() => continue,
                accepted = listener.accept() => accepted,
            };
            match accepted {
                Ok((stream, from)) => match self.doors.enter(from.ip()) {
                    Ok((seat, told, evicted)) => {
                        if let Some(evicted) = evicted {
                            evicted.tell(|outbox, error| self.services.board.close(outbox, Some(error)));
                        }
                        let services = self.services.fresh();
                        let tls = self.tls.read().clone();
                        drop(served.spawn(services.take_in(stream, from, tls, (seat, told))));
                    }
                    Err(error) => {
                        self.note_refused(from);
                        // The others are closed without a word: to tell them all takes connections, too.
                        if let Ok(place) = Arc::clone(&farewells).try_acquire_owned() {
                            let answer = self.services.answer(&error);
                            drop(served.spawn(async move {
                                mom_net::refuse(stream, &answer).await;
                                drop(place);
                            }));
                        }
                    }
                },
                Err(error) => {
                    // Mostly no descriptors left: existing connections go on, new ones wait a moment.
                    if self.services.is_first("cannot accept", None, None) {
                        tracing::warn!(%error, "cannot accept");
                    }
                    tokio::time::sleep(Duration::from_millis(100)).await;
                }
            }
        }
        drop(listener);
        while served.join_next().await.is_some() {}
    }

    /// Logs that there was no place for a peer.
    fn note_refused(&self, from: SocketAddr) {
        let event = "too many connections";
        if self.services.is_first(event, Some(from.ip()), None) {
            tracing::warn!(%from, "{event}");
        }
    }
}

impl Services {
    /// Waits for the first bytes of a peer, which tell its form.
    async fn greet(
        &self,
        stream: TcpStream,
        tls: Option<ServerTls>,
        login_by: Instant,
        told: oneshot::Receiver<WireError>,
    ) -> Result<Transceiver, NetError> {
        let before_login = self.limits.before_login();
        let too_late = async {
            tokio::select! {
                Ok(error) = told => error,
                () = tokio::time::sleep_until(login_by) => login_timeout(self.limits.login_time),
            }
        };
        let answer = |error: &WireError| self.answer(error);
        mom_net::accept(stream, tls.as_ref(), &before_login, too_late, answer).await
    }

    /// An error to a peer that is not even one.
    fn answer(&self, error: &WireError) -> Parcel {
        stamped(error.to_parcel(None), self.board.clock.wall())
    }

    /// Serves a connection from its first bytes on.
    pub(crate) fn take_in(
        self,
        stream: TcpStream,
        from: SocketAddr,
        tls: Option<ServerTls>,
        seat: (Seat, oneshot::Receiver<WireError>),
    ) -> impl Future<Output = ()> {
        // Apart, so that the connection does not keep the memory that this needs.
        let begun = Box::pin(self.begin(stream, from, tls, seat));
        async move {
            // By reference, or it would be kept twice.
            let mut begun = begun.await;
            if let Some(serving) = &mut begun {
                serving.run().await;
            }
        }
    }

    async fn begin(
        self,
        stream: TcpStream,
        from: SocketAddr,
        tls: Option<ServerTls>,
        (seat, told): (Seat, oneshot::Receiver<WireError>),
    ) -> Option<Serving> {
        let login_by = Instant::now() + login_time(&self.limits);
        match self.greet(stream, tls, login_by, told).await {
            Ok(transceiver) => {
                let from = Some(from.ip());
                Some(Serving::begin(self, transceiver, from, Some(seat), login_by))
            }
            Err(error) => {
                if self.is_first("refused", Some(from.ip()), None) {
                    tracing::info!(%from, %error, "refused");
                }
                None
            }
        }
    }
}

pub(crate) fn login_time(limits: &Limits) -> Duration {
    Duration::from_millis(limits.login_time)
}
