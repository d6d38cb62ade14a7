//! Statistics of channels.

use std::collections::BTreeMap;
use std::time::Duration;

use mom_proto::{Map, Parcel, Path, Time, Value};

use crate::ClientError;
use crate::error::bad_reply;
use crate::words::{map_of, number, owned, read_list, text};

/// The statistics of a channel, or of the channels of a session, at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Stats {
    /// When, by the hub's clock.
    pub time: Time,
    /// The channel, or those of the session that this peer may see.
    pub channels: Vec<ChannelStats>,
    /// Whether there are more channels than fit into one reply.
    pub more: bool,
    /// The memory of the hub; only where `/` was asked about.
    pub memory: Option<MemoryStats>,
    /// Who has logged in, the first of them in the order of their arrival; only where `/` was asked about.
    pub peers: Vec<ConnectedPeer>,
    /// How many more have.
    pub more_peers: u64,
}

/// What waits in the hub or is kept there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MemoryStats {
    /// Bytes now.
    pub used: u64,
    /// The most there may be, if there is a bound.
    pub bound: Option<u64>,
    /// Those to whom the most is charged, and how much.
    pub users: Vec<(String, u64)>,
}

/// A peer that has logged in, and its connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConnectedPeer {
    /// Its name at the hub.
    pub peer: String,
    /// The user that it logged in as.
    pub user: String,
    /// Its wire form: `xml`, `binary`, `json`, `none`.
    pub form: String,
    /// What carries it: `tcp`, `websocket`, `tunnel`, `local`.
    pub door: String,
    /// Whether its connection is encrypted.
    pub tls: bool,
    /// The address that it comes from, none inside the hub's process.
    pub from: Option<String>,
    /// When it logged in, by the hub's clock.
    pub since: Time,
    /// The time since anything was heard of it.
    pub heard: Duration,
    /// From the hub's last answered ping to its answer.
    pub round_trip: Option<Duration>,
    /// Bytes waiting for it.
    pub queued: u64,
    /// Bytes that its connection took.
    pub sent: u64,
    /// Bytes that its connection brought.
    pub received: u64,
    /// Parcels dropped on their way to it.
    pub dropped: u64,
}

/// The statistics of one channel since it was created.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelStats {
    /// Where it is.
    pub path: Path,
    /// How many have joined it.
    pub members: u64,
    /// Of all who were ever in it.
    pub all: Counts,
    /// Of each who is in it now; only where one channel was asked about.
    pub peers: Vec<PeerStats>,
}

/// The statistics of one member since it joined.
#[derive(Clone, Debug, PartialEq)]
pub struct PeerStats {
    /// Its name at the hub.
    pub peer: String,
    /// The user that it logged in as.
    pub user: String,
    /// Its sent and received messages.
    pub counts: Counts,
}

/// The counts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Counts {
    /// Messages sent.
    pub sent: u64,
    /// The bytes of their content.
    pub bytes: u64,
    /// Messages that the receivers' outboxes accepted.
    pub delivered: u64,
    /// Messages dropped for receivers, by reason.
    pub dropped: BTreeMap<String, u64>,
    /// The same by delivery class: `reliable`, `latest`, `fleeting`.
    pub dropped_classes: BTreeMap<String, u64>,
    /// Bytes waiting for the receivers now, from all contexts.
    pub queued: u64,
    /// How old the messages sent were when the hub took them in; none where no age is known.
    pub age: Option<AgeStats>,
}

/// The distribution of ages; percentiles are at most a quarter too high.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AgeStats {
    /// Messages of known age.
    pub count: u64,
    /// The median.
    pub p50: Duration,
    /// The 99th percentile.
    pub p99: Duration,
    /// The greatest.
    pub most: Duration,
}

impl Stats {
    pub(crate) fn from_reply(reply: &Parcel) -> Result<Stats, ClientError> {
        let map = map_of(reply);
        let time = map.get("time").and_then(Value::as_time);
        let of_session = map.get("channels").is_some();
        let channels = match of_session {
            true => read_list(reply, "channels", ChannelStats::from_map)?,
            false => vec![ChannelStats::from_map(&map).ok_or_else(|| bad_reply("figures"))?],
        };
        // Only the root has them; those of a channel are its own, and older hubs do not report them.
        let peers = match of_session && map.get("peers").is_some() {
            true => read_list(reply, "peers", ConnectedPeer::from_map)?,
            false => Vec::new(),
        };
        Ok(Stats {
            time: time.ok_or_else(|| bad_reply("time"))?,
            channels,
            more: map.get("more").and_then(Value::as_bool).unwrap_or_default(),
            memory: map
                .get("memory")
                .and_then(Value::as_map)
                .and_then(MemoryStats::from_map),
            peers,
            more_peers: number(&map, "more-peers").unwrap_or_default(),
        })
    }
}

impl MemoryStats {
    fn from_map(map: &Map) -> Option<MemoryStats> {
        let users = map.get("users").and_then(Value::as_list).unwrap_or_default();
        let user = |user: &Value| {
            let user = user.as_map()?;
            Some((text(user, "user")?.to_owned(), number(user, "bytes")?))
        };
        Some(MemoryStats {
            used: number(map, "used")?,
            bound: number(map, "bound"),
            users: users.iter().filter_map(user).collect(),
        })
    }
}

impl ConnectedPeer {
    fn from_map(map: &Map) -> Option<ConnectedPeer> {
        let micros = |key| number(map, key).map(Duration::from_micros);
        Some(ConnectedPeer {
            peer: text(map, "peer")?.to_owned(),
            user: text(map, "user")?.to_owned(),
            form: text(map, "form")?.to_owned(),
            door: text(map, "door")?.to_owned(),
            tls: map.get("tls").and_then(Value::as_bool)?,
            from: owned(map, "from"),
            since: map.get("since").and_then(Value::as_time)?,
            heard: micros("heard")?,
            round_trip: micros("round-trip"),
            queued: number(map, "queued")?,
            sent: number(map, "sent")?,
            received: number(map, "received")?,
            dropped: number(map, "dropped")?,
        })
    }
}

impl ChannelStats {
    fn from_map(map: &Map) -> Option<ChannelStats> {
        let peers = map.get("peers").and_then(Value::as_list).unwrap_or_default();
        Some(ChannelStats {
            path: Path::parse(text(map, "path")?).ok()?,
            members: number(map, "members")?,
            all: Counts::from_map(map)?,
            peers: peers
                .iter()
                .map(|peer| peer.as_map().and_then(PeerStats::from_map))
                .collect::<Option<_>>()?,
        })
    }
}

impl PeerStats {
    fn from_map(map: &Map) -> Option<PeerStats> {
        Some(PeerStats {
            peer: text(map, "peer")?.to_owned(),
            user: text(map, "user")?.to_owned(),
            counts: Counts::from_map(map)?,
        })
    }
}

impl Counts {
    /// How many were dropped, for whatever reason.
    pub fn lost(&self) -> u64 {
        self.dropped.values().sum()
    }

    fn from_map(map: &Map) -> Option<Counts> {
        Some(Counts {
            sent: number(map, "sent")?,
            bytes: number(map, "bytes")?,
            delivered: number(map, "delivered")?,
            dropped: numbers(map.get("dropped").and_then(Value::as_map)?)?,
            // Older hubs do not report it.
            dropped_classes: match map.get("dropped-classes").and_then(Value::as_map) {
                Some(classes) => numbers(classes)?,
                None => BTreeMap::new(),
            },
            queued: number(map, "queued")?,
            age: map
                .get("age")
                .and_then(Value::as_map)
                .and_then(AgeStats::from_map),
        })
    }
}

fn numbers(map: &Map) -> Option<BTreeMap<String, u64>> {
    map.iter()
        .map(|(word, _)| Some((word.to_string(), number(map, word)?)))
        .collect()
}

impl AgeStats {
    fn from_map(map: &Map) -> Option<AgeStats> {
        let age = |key| number(map, key).map(Duration::from_micros);
        Some(AgeStats {
            count: number(map, "count")?,
            p50: age("p50")?,
            p99: age("p99")?,
            most: age("most")?,
        })
    }
}
