//! From a listening socket to a connection that is served.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use mom_config::Network;
use mom_net::{NetError, ServerTls, Takes, Transceiver};
use mom_proto::{Limits, Parcel, WireError};
use parking_lot::RwLock;
use tokio::net::{TcpListener, TcpSocket, TcpStream, lookup_host};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot, watch};
use tokio::task::JoinSet;
use tokio::time::{Instant, timeout_at};

use super::doors::{Doors, Seat, full};
use super::{Origin, Services, Serving, login_timeout};
use crate::traffic::channel::stamped;

/// Connections that may wait to be taken in; the system may allow less. When a crowd comes back at once and more
/// wait than that, Linux turns to SYN cookies, and a connection whose cookie has grown old is reset.
const BACKLOG: u32 = 16 * 1024;

/// Refused peers that are told so at the same time.
const FAREWELLS: usize = 64;

/// Connections of proxies that have not said yet whose they are. They have no seat, because seats are counted by the address that is
/// said then; a proxy says it at once.
const UNTOLD: usize = 1024;

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
    pub(crate) takes: Takes,
    /// Where connections come from that begin with a PROXY protocol header; nobody else's is looked at.
    pub(crate) proxies: Vec<Network>,
    pub(crate) stop: watch::Receiver<bool>,
}

/// A connection from a listener.
pub(crate) struct Arriving {
    stream: TcpStream,
    from: SocketAddr,
    tls: Option<ServerTls>,
    takes: Takes,
    entry: Entry,
}

/// A place for a connection, and what it is told if it has to go before it has begun.
pub(super) type Seated = (Seat, oneshot::Receiver<WireError>);

/// Whose part in the counts a connection is.
pub(super) enum Entry {
    Known(Seated),
    /// A proxy has yet to say so, which not too many may at a time.
    Untold(Arc<Doors>, OwnedSemaphorePermit),
}

impl Listener {
    pub(crate) async fn run(mut self, listener: TcpListener) {
        let mut served = JoinSet::new();
        let farewells = Arc::new(Semaphore::new(FAREWELLS));
        let untold = Arc::new(Semaphore::new(UNTOLD));
        loop {
            let accepted = tokio::select! {
                _ = self.stop.changed() => break,
                Some(_) = served.join_next() => continue,
                accepted = listener.accept() => accepted,
            };
            match accepted {
                Ok((stream, from)) => match self.enter(from, &untold) {
                    Ok(entry) => {
                        let services = self.services.fresh();
                        let tls = self.tls.read().clone();
                        let takes = self.takes;
                        drop(served.spawn(services.take_in(Arriving {
                            stream,
                            from,
                            tls,
                            takes,
                            entry,
                        })));
                    }
                    Err(error) => {
                        self.services.note_refused(from);
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

    /// Finds a place for a connection, or one where it says first whose it is.
    pub(super) fn enter(&self, from: SocketAddr, untold: &Arc<Semaphore>) -> Result<Entry, WireError> {
        if !self.proxies.iter().any(|proxy| proxy.contains(from.ip())) {
            return self.services.seat(&self.doors, from).map(Entry::Known);
        }
        let place = Arc::clone(untold).try_acquire_owned();
        let place = place.map_err(|_| full("too many connections have no PROXY protocol header yet"))?;
        Ok(Entry::Untold(Arc::clone(&self.doors), place))
    }
}

impl Services {
    /// Takes in a connection, for which another may have to go.
    fn seat(&self, doors: &Arc<Doors>, from: SocketAddr) -> Result<Seated, WireError> {
        let (seat, told, evicted) = doors.enter(from.ip())?;
        if let Some(evicted) = evicted {
            evicted.tell(|outbox, error| self.board.close(outbox, Some(error)));
        }
        Ok((seat, told))
    }

    /// Logs that there was no place for a peer.
    fn note_refused(&self, from: SocketAddr) {
        let event = "too many connections";
        if self.is_first(event, Some(from.ip()), None) {
            tracing::warn!(%from, "{event}");
        }
    }

    /// Hears from a proxy whose connection this is, and takes it in as that one's.
    async fn hear_proxy(
        &self,
        stream: &mut TcpStream,
        from: &mut SocketAddr,
        doors: &Arc<Doors>,
        login_by: Instant,
    ) -> Result<Seated, NetError> {
        match timeout_at(login_by, mom_net::proxied(stream)).await {
            Ok(client) => *from = client?.unwrap_or(*from),
            Err(_) => return Err(login_timeout(self.limits.login_time).into()),
        }
        let seated = self.seat(doors, *from);
        seated
            .inspect_err(|_| self.note_refused(*from))
            .map_err(NetError::from)
    }

    /// Waits for the first bytes of a peer, which tell its form.
    async fn greet(
        &self,
        stream: TcpStream,
        tls: Option<ServerTls>,
        takes: Takes,
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
        mom_net::accept(stream, tls.as_ref(), takes, &before_login, too_late, answer).await
    }

    /// An error to a peer that is not even one.
    fn answer(&self, error: &WireError) -> Parcel {
        stamped(error.to_parcel(None), self.board.clock.wall())
    }

    /// Serves a connection from its first bytes on.
    pub(crate) fn take_in(self, arriving: Arriving) -> impl Future<Output = ()> {
        // Apart, so that the connection does not keep the memory that this needs.
        let begun = Box::pin(self.begin(arriving));
        async move {
            // By reference, or it would be kept twice.
            let mut begun = begun.await;
            if let Some(serving) = &mut begun {
                serving.run().await;
            }
        }
    }

    async fn begin(self, arriving: Arriving) -> Option<Serving> {
        let login_by = Instant::now() + login_time(&self.limits);
        let Arriving {
            mut stream,
            mut from,
            tls,
            takes,
            entry,
        } = arriving;
        let relayed = matches!(entry, Entry::Untold(..));
        let seated = match entry {
            Entry::Known(seated) => Ok(seated),
            Entry::Untold(doors, place) => {
                let heard = self.hear_proxy(&mut stream, &mut from, &doors, login_by).await;
                // It keeps its place while it is told why it is refused.
                heard.map_err(|error| (error, place))
            }
        };
        let error = match seated {
            Ok((seat, told)) => match self.greet(stream, tls, takes, login_by, told).await {
                Ok(transceiver) => {
                    let origin = Origin {
                        from: Some(from.ip()),
                        relayed,
                    };
                    return Some(Serving::begin(self, transceiver, origin, Some(seat), login_by));
                }
                Err(error) => error,
            },
            Err((error, place)) => {
                if let NetError::Wire(error) = &error {
                    mom_net::refuse(stream, &self.answer(error)).await;
                }
                drop(place);
                error
            }
        };
        if self.is_first("refused", Some(from.ip()), None) {
            tracing::info!(%from, %error, "refused");
        }
        None
    }
}

pub(crate) fn login_time(limits: &Limits) -> Duration {
    Duration::from_millis(limits.login_time)
}
