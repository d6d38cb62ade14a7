//! Contexts and peers as the hub describes them, typed.

use std::time::Duration;

use mom_proto::{ContextKind, MAX_ID, Map, Parcel, Path, STOP, Value};

use crate::error::bad_reply;
use crate::{ClientError, StopState};

/// A context as lists and lookups show it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ContextInfo {
    /// Where it is.
    pub path: Path,
    /// Its kind.
    pub kind: ContextKind,
    /// The hub's number of it, never reused.
    pub number: u64,
    /// The number of its members, if the hub says so.
    pub members: Option<u64>,
    /// Of a channel in a list: the stop that holds there.
    pub stop: Option<StopState>,
}

/// A peer as events and member lists show it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Member {
    /// Its name at the hub, unique there.
    pub peer: String,
    /// The user that it logged in as.
    pub user: String,
    /// The user's level; higher goes first (M29).
    pub level: i32,
    /// In lists of a channel's members: whether it obeys stops there, and says so
    /// ([`Client::channel_as_device`](crate::Client::channel_as_device)).
    pub device: bool,
}

impl ContextInfo {
    /// Reads `{path, kind, number, members?}`.
    pub(crate) fn from_map(map: &Map) -> Option<ContextInfo> {
        Some(ContextInfo {
            path: Path::parse(text(map, "path")?).ok()?,
            kind: ContextKind::from_word(text(map, "kind")?)?,
            number: number(map, "number")?,
            members: number(map, "members"),
            stop: map.get(STOP).and_then(Value::as_map).map(StopState::from_map),
        })
    }

    /// Reads a reply.
    pub(crate) fn from_reply(reply: &Parcel) -> Result<ContextInfo, ClientError> {
        ContextInfo::from_map(&map_of(reply)).ok_or_else(|| bad_reply("path, kind and number"))
    }

    /// Reads a reply's list.
    pub(crate) fn list(reply: &Parcel, key: &str) -> Result<Vec<ContextInfo>, ClientError> {
        read_list(reply, key, ContextInfo::from_map)
    }
}

impl Member {
    /// Reads `{peer, user, level, device?}`.
    pub(crate) fn from_map(map: &Map) -> Option<Member> {
        Some(Member {
            peer: text(map, "peer")?.to_owned(),
            user: text(map, "user")?.to_owned(),
            level: level(map, "level")?,
            device: map.get("device") == Some(&Value::Bool(true)),
        })
    }

    /// Reads a reply's list.
    pub(crate) fn list(reply: &Parcel, key: &str) -> Result<Vec<Member>, ClientError> {
        read_list(reply, key, Member::from_map)
    }
}

/// The content as a map; empty if it is not a map.
pub(crate) fn map_of(parcel: &Parcel) -> Map {
    match parcel.value() {
        Value::Map(map) => map,
        _ => Map::new(),
    }
}

pub(crate) fn text<'a>(map: &'a Map, key: &str) -> Option<&'a str> {
    map.get(key).and_then(Value::as_str)
}

pub(crate) fn number(map: &Map, key: &str) -> Option<u64> {
    map.get(key)
        .and_then(Value::as_int)
        .and_then(|number| u64::try_from(number).ok())
}

/// A duration in ms.
pub(crate) fn millis_of(map: &Map, key: &str) -> Option<Duration> {
    number(map, key).map(Duration::from_millis)
}

/// Whole ms, rounded up: never less time than was asked for.
pub(crate) fn millis(duration: Duration) -> i64 {
    let millis = duration.as_micros().div_ceil(1000).min(u128::from(MAX_ID));
    i64::try_from(millis).unwrap_or(i64::MAX)
}

pub(crate) fn owned(map: &Map, key: &str) -> Option<String> {
    text(map, key).map(str::to_owned)
}

/// The strings of a list, and the names in it where it holds maps of peers.
pub(crate) fn name_list(map: &Map, key: &str) -> Vec<String> {
    let list = map.get(key).and_then(Value::as_list).unwrap_or_default();
    let name = |item: &Value| {
        let name = item.as_str().or_else(|| item.get("peer").and_then(Value::as_str));
        name.map(str::to_owned)
    };
    list.iter().filter_map(name).collect()
}

pub(crate) fn level(map: &Map, key: &str) -> Option<i32> {
    map.get(key)
        .and_then(Value::as_int)
        .and_then(|number| i32::try_from(number).ok())
}

pub(crate) fn read_list<T>(
    reply: &Parcel,
    key: &str,
    read: impl Fn(&Map) -> Option<T>,
) -> Result<Vec<T>, ClientError> {
    let map = map_of(reply);
    let list = map
        .get(key)
        .and_then(Value::as_list)
        .ok_or_else(|| bad_reply(key))?;
    list.iter()
        .map(|item| {
            item.as_map()
                .and_then(&read)
                .ok_or_else(|| bad_reply(&format!("proper {key}")))
        })
        .collect()
}
