//! From an address to a peer: connecting and logging in (M12, M13).

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use mom_net::{Address, Transceiver};
use mom_proto::codec::{Form, Frame};
use mom_proto::{Compression, Family, Map, Parcel, Value, WireError};
use tokio::time::timeout;

use crate::ClientError;
use crate::link::doors::Doors;
use crate::wire::link_secret::{Counted, Resumption};
use crate::wire::proof::{Credentials, is_challenge};
use crate::wire::welcome::{PeerLimits, Welcome};
use crate::words::map_of;

/// Gives one more end of an in-process pair whose other end the hub has.
pub(crate) type Local = Arc<dyn Fn() -> Transceiver + Send + Sync>;

/// Where the hub is.
#[derive(Clone)]
pub(crate) enum Connector {
    Remote(Doors),
    /// In this process, in a form where it carries bytes.
    Local(Local, Option<Form>),
}

/// A link on which this peer is logged in.
#[derive(Debug)]
pub(crate) struct Connected {
    pub(crate) transceiver: Transceiver,
    pub(crate) welcome: Welcome,
}

impl Connector {
    /// The address of the door in use, if the hub is not in this process.
    pub(crate) fn address(&self) -> Option<Address> {
        match self {
            Connector::Remote(doors) => Some(doors.current().clone()),
            Connector::Local(..) => None,
        }
    }

    pub(crate) fn form(&self) -> Option<Form> {
        match self {
            Connector::Remote(doors) => Some(doors.current().form),
            Connector::Local(_, form) => *form,
        }
    }

    /// Connects and logs in; its parcels take their ids from `ids`.
    pub(crate) async fn connect(
        &self,
        credentials: &Credentials,
        ids: &AtomicU64,
        after: Duration,
    ) -> Result<Connected, ClientError> {
        // Nobody is even connected to for what is not said.
        credentials.check()?;
        let login = async {
            let doors = match self {
                Connector::Remote(doors) => doors,
                Connector::Local(connect, _) => return log_in(connect(), credentials, ids).await,
            };
            through(doors, |opened| log_in(opened, credentials, ids)).await
        };
        timeout(after, login).await.unwrap_or_else(|_| {
            Err(ClientError::TimedOut {
                what: "login".to_owned(),
                after,
            })
        })
    }
}

impl Connector {
    /// Connects and goes on with a link.
    pub(crate) async fn resume(
        &self,
        counted: &Counted,
        ids: &AtomicU64,
        after: Duration,
    ) -> Result<(Transceiver, Resumption), ClientError> {
        let Connector::Remote(doors) = self else {
            return Err(ClientError::Connection(
                "this hub is in the same process".to_owned(),
            ));
        };
        let resume = through(doors, |opened| resume(opened, counted, ids));
        timeout(after, resume).await.unwrap_or_else(|_| {
            Err(ClientError::TimedOut {
                what: "resume".to_owned(),
                after,
            })
        })
    }
}

/// Does this over the first door where it does not come to nothing.
async fn through<T, F: Future<Output = Result<T, ClientError>>>(
    doors: &Doors,
    attempt: impl Fn(Transceiver) -> F,
) -> Result<T, ClientError> {
    let mut opening = doors.open();
    loop {
        let error = match attempt(opening.next().await?).await {
            Ok(done) => return Ok(done),
            Err(error) => error,
        };
        if !opening.came_to_nothing(error) {
            return Err(opening.failed());
        }
    }
}

async fn resume(
    mut transceiver: Transceiver,
    counted: &Counted,
    ids: &AtomicU64,
) -> Result<(Transceiver, Resumption), ClientError> {
    if let Some(stream) = counted.secret.stream {
        // What follows the reply may be read together with it.
        transceiver.reader.take_compressed(stream);
    }
    let answer = |challenge: &Parcel| counted.secret.answer(challenge, counted.read);
    let reply = prove(&mut transceiver, counted.secret.resume(), answer, ids).await?;
    let resumption = Resumption::read(reply)?;
    let limits = resumption.content.get("limits").and_then(Value::as_map);
    let limits = PeerLimits::read(limits).for_decoder();
    transceiver.reader.set_limits(&limits);
    // What was not agreed on does not come.
    transceiver.reader.take_packed();
    if let Some(stream) = counted.secret.stream {
        transceiver.writer.compress(stream);
    }
    Ok((transceiver, resumption))
}

async fn log_in(
    mut transceiver: Transceiver,
    credentials: &Credentials,
    ids: &AtomicU64,
) -> Result<Connected, ClientError> {
    if credentials.compress && transceiver.reader.form().is_some_and(|form| !form.is_binary()) {
        // As a rule the reply comes as it is, but it need not.
        transceiver.reader.take_compressed(Compression::StreamZstd);
    }
    let answer = |challenge: &Parcel| credentials.answer(challenge);
    let reply = prove(&mut transceiver, credentials.login().await?, answer, ids).await?;
    let welcome = Welcome::read(reply)?;
    let limits = welcome.limits.for_decoder();
    transceiver.reader.set_limits(&limits);
    match welcome.compression {
        None => {}
        Some(Compression::Zstd) => transceiver.reader.take_packed(),
        Some(stream) => {
            transceiver.reader.take_compressed(stream);
            transceiver.writer.compress(stream);
        }
    }
    Ok(Connected { transceiver, welcome })
}

/// Asks, answers a challenge if the hub has one, and gives the content of its reply.
async fn prove(
    transceiver: &mut Transceiver,
    asked: Parcel,
    answer: impl Fn(&Parcel) -> Result<Parcel, ClientError>,
    ids: &AtomicU64,
) -> Result<Map, ClientError> {
    let next = || ids.fetch_add(1, Ordering::Relaxed);
    let mut id = next();
    let mut challenged = false;
    // A hub that refuses may close before it has read everything; its error is more useful than the write error.
    let mut sent = transceiver.writer.send(asked.id(id)).await;
    loop {
        let frame = match transceiver.reader.next().await? {
            Some(frame) => frame,
            None => {
                sent?;
                return Err(ClientError::Connection(
                    "the hub closed the link at login".to_owned(),
                ));
            }
        };
        let parcel = match frame {
            Frame::Parcel(parcel) => parcel,
            Frame::Malformed { error, .. } => return Err(ClientError::Local(error)),
        };
        match parcel.family {
            Family::Reply if parcel.reference == Some(id) && is_challenge(&parcel) && !challenged => {
                (id, challenged) = (next(), true);
                sent = transceiver.writer.send(answer(&parcel)?.id(id)).await;
            }
            Family::Reply if parcel.reference == Some(id) => return Ok(map_of(&parcel)),
            Family::Error => return Err(ClientError::Refused(WireError::from_parcel(&parcel))),
            _ => {
                tracing::debug!(family = %parcel.family, name = parcel.name(), "before the login was answered");
            }
        }
    }
}
