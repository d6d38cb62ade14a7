//! From a listening socket to a connection that is served.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use mom_net::{Accepted, ServerTls};
use mom_proto::WireError;
use parking_lot::RwLock;
use tokio::net::{TcpListener, TcpSocket, TcpStream, lookup_host};
use tokio::sync::{Semaphore, oneshot, watch};
use tokio::task::JoinSet;
use tokio::time::Instant;

use crate::connection::{Doors, Seat, Services, Serving, login_time, too_late};
use crate::web::{Visit, Web};

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
    pub(crate) web: Arc<Web>,
    pub(crate) stop: watch::Receiver<bool>,
}

/// A connection that has a place.
struct Guest {
    services: Services,
    from: SocketAddr,
    tls: Option<ServerTls>,
    web: Arc<Web>,
    seat: Seat,
    /// Told if it has to go before it has begun.
    told: oneshot::Receiver<WireError>,
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
                        let guest = Guest {
                            services: self.services.fresh(),
                            from,
                            tls: self.tls.read().clone(),
                            web: Arc::clone(&self.web),
                            seat,
                            told,
                        };
                        drop(served.spawn(guest.serve(stream)));
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

impl Guest {
    /// Serves a connection from its first bytes on.
    fn serve(self, stream: TcpStream) -> impl Future<Output = ()> {
        // Apart, so that the connection does not keep the memory that this needs.
        let begun = Box::pin(self.begin(stream));
        async move {
            // By reference, or it would be kept twice.
            let mut begun = begun.await;
            if let Some(serving) = &mut begun {
                serving.run().await;
            }
        }
    }

    async fn begin(mut self, stream: TcpStream) -> Option<Serving> {
        let limits = Arc::clone(&self.services.limits);
        let login_by = Instant::now() + login_time(&limits);
        let port = stream.local_addr().map_or(0, |local| local.port());
        let accepted = {
            let too_late = too_late(&limits, login_by, &mut self.told);
            let answer = |error: &WireError| self.services.answer(error);
            mom_net::accept(
                stream,
                self.tls.as_ref(),
                &limits.before_login(),
                too_late,
                answer,
            )
            .await
        };
        let from = self.from;
        let (transceiver, seat) = match accepted {
            Ok(Accepted::Peer(transceiver)) => (transceiver, self.seat),
            Ok(Accepted::Http(stream)) => {
                let visit = Visit {
                    services: self.services.clone(),
                    from,
                    port,
                    told: self.told,
                    seat: self.seat,
                };
                self.web.serve(stream, visit).await?
            }
            Err(error) => {
                if self.services.is_first("refused", Some(from.ip()), None) {
                    tracing::info!(%from, %error, "refused");
                }
                return None;
            }
        };
        let from = Some(from.ip());
        Some(Serving::begin(
            self.services,
            transceiver,
            from,
            Some(seat),
            login_by,
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What `call` would give, unpolled: only its size is asked for.
    fn size_of_future<A, B, F: Future>(_: &impl Fn(A, B) -> F) -> usize {
        size_of::<F>()
    }

    /// Ten thousand idle peers cost what their tasks keep: what is rare is boxed while it lasts (docs/performance.md).
    #[test]
    fn an_idle_connection_is_small() {
        let connection = |guest: Guest, stream| guest.serve(stream);
        let all = [
            size_of_future(&connection),
            size_of::<crate::traffic::outbox::Outbox>(),
        ];
        assert!(all.iter().sum::<usize>() <= 1560, "{all:?}");
    }
}
