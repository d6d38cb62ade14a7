//! Contexts and peers as the hub describes them, typed.

use mom_proto::{ContextKind, Map, Parcel, Path, STOP, Value};

use crate::error::bad_reply;
use crate::words::{level, map_of, number, read_list, text};
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
