//! What the hub says at login.

use std::time::Duration;

use mom_proto::{Compression, Limit, Limits, Map, Value};

use crate::ClientError;
use crate::error::bad_reply;
use crate::words::{level, number, text};

/// What the hub said at login.
#[derive(Debug)]
pub(crate) struct Welcome {
    pub(crate) peer: String,
    pub(crate) user: String,
    pub(crate) level: i32,
    pub(crate) limits: PeerLimits,
    /// What was agreed on for this connection.
    pub(crate) compression: Option<Compression>,
    /// Whether the hub takes cards of devices; one of an earlier version refuses what it does not know.
    pub(crate) takes_cards: bool,
    pub(crate) content: Map,
}

/// The minor version of the protocol from which on a hub takes cards.
const CARDS: u64 = 4;

/// The hub's limits that this end keeps.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct PeerLimits {
    pub(crate) parcel: Limit,
    pub(crate) depth: usize,
    pub(crate) heartbeat: Duration,
    pub(crate) gone: Duration,
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
            takes_cards: minor_of(&content).is_some_and(|minor| minor >= CARDS),
            content,
        })
    }
}

/// The minor version of the hub's protocol, by what it says at login.
pub(crate) fn minor_of(welcome: &Map) -> Option<u64> {
    number(welcome.get("protocol")?.as_map()?, "minor")
}

impl PeerLimits {
    /// Limits that the hub does not report have the protocol's defaults.
    pub(crate) fn read(map: Option<&Map>) -> PeerLimits {
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
    pub(crate) fn for_decoder(&self) -> Limits {
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
