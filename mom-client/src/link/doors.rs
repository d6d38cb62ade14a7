//! The doors of a hub: each is tried a moment after the one before (RFC 8305 does so with addresses), and what has worked is tried
//! first the next time.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use mom_net::{Address, ClientTls, NetError, Transceiver};
use mom_proto::{Code, Limits};
use tokio::task::JoinSet;
use tokio::time::sleep;

use crate::ClientError;

/// How long a door has before the next one is tried, too.
const STAGGER: Duration = Duration::from_millis(250);

/// All doors that a client may use, the best first.
#[derive(Clone, Debug)]
pub(crate) struct Doors {
    addresses: Arc<[Address]>,
    tls: Option<ClientTls>,
    /// The place of the one that has worked last.
    worked: Arc<AtomicUsize>,
}

/// The attempts to get through one of the doors.
#[derive(Debug)]
pub(crate) struct Opening<'a> {
    doors: &'a Doors,
    /// Those that were tried; none of them is tried again.
    tried: BTreeSet<usize>,
    failed: Option<ClientError>,
}

impl Doors {
    /// `tls` is for those that need it.
    pub(crate) fn new(addresses: Vec<Address>, tls: Option<ClientTls>) -> Doors {
        Doors {
            addresses: addresses.into(),
            tls,
            worked: Arc::default(),
        }
    }

    /// The one that has worked last, at first the best.
    pub(crate) fn current(&self) -> &Address {
        &self.addresses[self.worked.load(Ordering::Relaxed)]
    }

    pub(crate) fn open(&self) -> Opening<'_> {
        Opening {
            doors: self,
            tried: BTreeSet::new(),
            failed: None,
        }
    }
}

impl Opening<'_> {
    /// A connection through the first door that opens. To be asked again if that connection comes to nothing.
    ///
    /// # Errors
    /// Why none opens: of the first that was tried, with the number of the others.
    pub(crate) async fn next(&mut self) -> Result<Transceiver, ClientError> {
        let first = self.doors.worked.load(Ordering::Relaxed);
        let all = std::iter::once(first).chain((0..self.doors.addresses.len()).filter(|door| *door != first));
        let mut left: Vec<usize> = all.filter(|door| !self.tried.contains(door)).collect();
        left.reverse();
        let mut opening: JoinSet<(usize, Result<Transceiver, NetError>)> = JoinSet::new();
        loop {
            match left.pop() {
                Some(door) => {
                    let (address, tls) = (self.doors.addresses[door].clone(), self.doors.tls.clone());
                    opening.spawn(async move {
                        let opened = mom_net::connect(&address, &Limits::default(), tls.as_ref()).await;
                        (door, opened)
                    });
                }
                None if opening.is_empty() => return Err(self.failed()),
                None => {}
            }
            let opened = tokio::select! {
                opened = opening.join_next() => opened,
                () = sleep(STAGGER), if !left.is_empty() => continue,
            };
            match opened {
                Some(Ok((door, Ok(transceiver)))) => {
                    self.tried.insert(door);
                    self.doors.worked.store(door, Ordering::Relaxed);
                    return Ok(transceiver);
                }
                Some(Ok((door, Err(error)))) => {
                    self.tried.insert(door);
                    self.note(error.into());
                }
                Some(Err(failed)) => self.note(ClientError::Connection(failed.to_string())),
                None => {}
            }
        }
    }

    /// Notes why a connection came to nothing; whether another door may be tried for that.
    pub(crate) fn came_to_nothing(&mut self, error: ClientError) -> bool {
        let another = match &error {
            ClientError::Connection(_) | ClientError::TimedOut { .. } => true,
            // Something else answers there, or a hub that takes this door elsewhere.
            ClientError::Refused(error) => [Code::NOT_TAKEN, Code::BAD_FRAME].contains(&error.code),
            _ => false,
        };
        self.note(error);
        another && self.tried.len() < self.doors.addresses.len()
    }

    fn note(&mut self, error: ClientError) {
        self.failed.get_or_insert(error);
    }

    /// Why no door has let it through.
    pub(crate) fn failed(&mut self) -> ClientError {
        let none = || ClientError::Connection("no address is left to try".to_owned());
        let error = self.failed.take().unwrap_or_else(none);
        let others = self.tried.len().saturating_sub(1);
        match error {
            ClientError::Connection(why) if others > 0 => {
                let doors = self.doors.addresses.iter().map(Address::to_string);
                let doors: Vec<String> = doors.collect();
                ClientError::Connection(format!("{why}; tried {}", doors.join(", ")))
            }
            error => error,
        }
    }
}
