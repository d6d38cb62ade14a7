//! From an address to a peer: connecting and logging in (M12, M13).

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use mom_net::{Address, Transceiver};
use mom_proto::codec::{Form, Frame};
use mom_proto::{Compression, Family, Limit, Limits, Map, Parcel, Value, WireError};
use tokio::time::timeout;

use crate::ClientError;
use crate::error::bad_reply;
use crate::link::doors::Doors;
use crate::link::survive::{Counted, Resumption};
use crate::said::info::{level, map_of, number, text};
use crate::wire::proof::{Credentials, is_challenge};

/// Gives one more end of an in-process pair whose other end the hub has.
pub(crate) type Local = Arc<dyn Fn() -> Transceiver + Send + Sync>;

/// Where the hub is.
#[derive(Clone)]
pub(crate) enum Connector {
    Remote(Doors),
    Local(Local),
}

/// What the hub said at login.
#[derive(Debug)]
pub(crate) struct Welcome {
    pub(crate) peer: String,
    pub(crate) user: String,
    pub(crate) level: i32,
    pub(crate) limits: PeerLimits,
    /// What was agreed on for this connection.
    pub(crate) compression: Option<Compression>,
    pub(crate) content: Map,
}

/// The hub's limits that this end keeps.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct PeerLimits {
    pub(crate) parcel: Limit,
    pub(crate) depth: usize,
    pub(crate) heartbeat: Duration,
    pub(crate) gone: Duration,
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
            Connector::Local(_) => None,
        }
    }

    pub(crate) fn form(&self) -> Option<Form> {
        match self {
            Connector::Remote(doors) => Some(doors.current().form),
            Connector::Local(_) => None,
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
                Connector::Local(connect) => return log_in(connect(), credentials, ids).await,
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
            _ => tracing::debug!(family = %parcel.family, name = parcel.name(), "before the login's reply"),
        }
    }
}

impl Welcome {
    pub(crate) fn read(content: Map) -> Result<Welcome, ClientError> {
        let limits = content.get("limits").and_then(Value::as_map);
        Ok(Welcome {
            peer: text(&content, "peer")
                .ok_or_else(|| bad_reply("peer"))?
                .to_owned(),
            user: text(&content, "user")
                .ok_or_else(|| bad_reply("user"))?
                .to_owned(),
            level: level(&content, "level").unwrap_or_default(),
            limits: PeerLimits::read(limits),
            compression: text(&content, "compress").and_then(Compression::of),
            content,
        })
    }
}

impl PeerLimits {
    /// Limits that the hub does not report have the protocol's defaults.
    fn read(map: Option<&Map>) -> PeerLimits {
        let known = Limits::default();
        let read = |key: &str| map.and_then(|map| number(map, key)).filter(|number| *number > 0);
        let word = map.and_then(|map| text(map, "parcel"));
        PeerLimits {
            parcel: match (word, read("parcel")) {
                (Some("unlimited"), _) => Limit::Unlimited,
                (_, Some(most)) => Limit::At(most),
                _ => known.parcel,
            },
            depth: read("depth")
                .and_then(|depth| usize::try_from(depth).ok())
                .unwrap_or(known.depth),
            heartbeat: Duration::from_millis(read("heartbeat").unwrap_or(known.heartbeat)),
            gone: Duration::from_millis(read("gone").unwrap_or(known.gone)),
        }
    }

    /// What this end takes. The other limits are of what peers send; stamped and in another form it may be longer.
    fn for_decoder(&self) -> Limits {
        Limits {
            parcel: self.parcel,
            depth: self.depth,
            slots: usize::MAX,
            attribute_size: usize::MAX,
            ..Limits::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_read_and_default() {
        let known = PeerLimits::read(None);
        assert_eq!(
            known,
            PeerLimits::read(Some(&Map::new().with("heartbeat", 0).with("parcel", "many")))
        );
        assert_eq!(known.heartbeat, Duration::from_secs(10));
        let told = Map::new()
            .with("parcel", "unlimited")
            .with("depth", 7)
            .with("heartbeat", 5)
            .with("gone", 15);
        let read = PeerLimits::read(Some(&told));
        let expected = PeerLimits {
            parcel: Limit::Unlimited,
            depth: 7,
            heartbeat: Duration::from_millis(5),
            gone: Duration::from_millis(15),
        };
        assert_eq!(read, expected);
        assert_eq!(
            PeerLimits::read(Some(&Map::new().with("parcel", 99))).parcel,
            Limit::At(99)
        );
    }
}
