//! From a listening socket to a connection that is served.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use mom_config::Network;
use mom_net::{Accepted, NetError, ServerTls, Takes};
use mom_proto::WireError;
use parking_lot::RwLock;
use tokio::net::{TcpListener, TcpSocket, TcpStream, lookup_host};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::JoinSet;
use tokio::time::{Instant, timeout_at};

use crate::connection::{
    AdmissionLimiter, Remote, Seated, Services, Serving, full, login_time, login_timeout, too_late,
};
use crate::web::{Visit, Web};

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
    pub(crate) doors: Arc<AdmissionLimiter>,
    pub(crate) tls: Arc<RwLock<Option<ServerTls>>>,
    pub(crate) web: Arc<Web>,
    pub(crate) takes: Takes,
    /// Where connections come from that begin with a PROXY protocol header; nobody else's is looked at.
    pub(crate) proxies: Vec<Network>,
    pub(crate) stop: watch::Receiver<bool>,
}

/// A connection that has just come.
struct Guest {
    services: Services,
    from: SocketAddr,
    tls: Option<ServerTls>,
    web: Arc<Web>,
    takes: Takes,
}

/// Whose part in the counts a connection is.
pub(super) enum Entry {
    Known(Seated),
    /// A proxy has yet to say so, which not too many may at a time.
    Untold(Arc<AdmissionLimiter>, OwnedSemaphorePermit),
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
                        let guest = Guest {
                            services: self.services.fresh(),
                            from,
                            tls: self.tls.read().clone(),
                            web: Arc::clone(&self.web),
                            takes: self.takes,
                        };
                        drop(served.spawn(guest.serve(stream, entry)));
                    }
                    Err(error) => {
                        self.services.note_full(from.ip());
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
            return self.services.seat(&self.doors, from.ip()).map(Entry::Known);
        }
        let place = Arc::clone(untold).try_acquire_owned();
        let place = place.map_err(|_| full("too many connections have no PROXY protocol header yet"))?;
        Ok(Entry::Untold(Arc::clone(&self.doors), place))
    }
}

impl Guest {
    /// Serves a connection from its first bytes on.
    fn serve(self, stream: TcpStream, entry: Entry) -> impl Future<Output = ()> {
        // Apart, so that the connection does not keep the memory that this needs.
        let begun = Box::pin(self.begin(stream, entry));
        async move {
            // By reference, or it would be kept twice.
            let mut begun = begun.await;
            if let Some(serving) = &mut begun {
                serving.run().await;
            }
        }
    }

    async fn begin(mut self, mut stream: TcpStream, entry: Entry) -> Option<Serving> {
        let login_by = Instant::now() + login_time(&self.services.limits);
        let relayed = matches!(entry, Entry::Untold(..));
        let seated = match entry {
            Entry::Known(seated) => Ok(seated),
            Entry::Untold(doors, place) => {
                let heard = self.hear_proxy(&mut stream, &doors, login_by).await;
                if let Err(NetError::Wire(error)) = &heard {
                    mom_net::refuse(stream, &self.services.answer(error)).await;
                    self.note_refused(error);
                    return None;
                }
                // It has kept its place until it was told why it is refused.
                drop(place);
                heard
            }
        };
        let greeted = match seated {
            Ok(seated) => self.greet(stream, seated, relayed, login_by).await,
            Err(error) => Err(error),
        };
        greeted.unwrap_or_else(|error| {
            self.note_refused(&error);
            None
        })
    }

    fn note_refused(&self, error: &dyn std::error::Error) {
        if self.services.is_first("refused", Some(self.from.ip()), None) {
            tracing::info!(from = %self.from, %error, "refused");
        }
    }

    /// Hears from a proxy whose connection this is, and takes it in as that one's.
    async fn hear_proxy(
        &mut self,
        stream: &mut TcpStream,
        doors: &Arc<AdmissionLimiter>,
        login_by: Instant,
    ) -> Result<Seated, NetError> {
        match timeout_at(login_by, mom_net::proxied(stream)).await {
            Ok(client) => self.from = client?.unwrap_or(self.from),
            Err(_) => return Err(login_timeout(self.services.limits.login_time).into()),
        }
        let seated = self.services.seat(doors, self.from.ip());
        seated
            .inspect_err(|_| self.services.note_full(self.from.ip()))
            .map_err(NetError::from)
    }

    /// Waits for the first bytes, which tell what speaks here; gives a peer, none if only requests of HTTP came.
    async fn greet(
        &self,
        stream: TcpStream,
        (seat, mut told): Seated,
        relayed: bool,
        login_by: Instant,
    ) -> Result<Option<Serving>, NetError> {
        let services = &self.services;
        let limits = services.limits.before_login();
        let local = stream.local_addr()?;
        let accepted = {
            let too_late = too_late(&services.limits, login_by, &mut told);
            let answer = |error: &WireError| services.answer(error);
            mom_net::accept(stream, self.tls.as_ref(), self.takes, &limits, too_late, answer).await?
        };
        let remote = Remote {
            from: Some(self.from.ip()),
            relayed,
            ..Remote::default()
        };
        let (transceiver, remote, seat) = match accepted {
            Accepted::Peer(transceiver) => (transceiver, remote, seat),
            Accepted::Http(stream) => {
                let visit = Visit {
                    services: services.clone(),
                    remote,
                    local,
                    takes: self.takes,
                    seated: (seat, told),
                    login_by,
                };
                match self.web.serve(stream, visit).await {
                    Some(upgraded) => upgraded,
                    None => return Ok(None),
                }
            }
        };
        let services = services.clone();
        let seat = Some(seat);
        Ok(Some(Serving::begin(
            services,
            transceiver,
            remote,
            seat,
            login_by,
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What `call` would give, unpolled: only its size is asked for.
    fn size_of_future<A, B, C, F: Future>(_: &impl Fn(A, B, C) -> F) -> usize {
        size_of::<F>()
    }

    /// Ten thousand idle peers cost what their tasks keep: what is rare is boxed while it lasts (docs/performance.md).
    #[test]
    fn an_idle_connection_is_small() {
        let connection = |guest: Guest, stream, entry| guest.serve(stream, entry);
        let all = [
            size_of_future(&connection),
            size_of::<crate::traffic::outbox::Outbox>(),
        ];
        assert!(all.iter().sum::<usize>() <= 1536, "{all:?}");
    }
}
