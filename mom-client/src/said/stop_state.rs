//! How devices stand by the hub's books.

use mom_proto::{Map, STOP, Time, Value};

use crate::words::{name_list, number, owned};

/// How the devices of a channel stand by the hub's books, or how one of them does.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StopState {
    /// The number of the newest stop; 0 before the first. An unstop names it.
    pub number: u64,
    /// Whether a stop holds.
    pub stopped: bool,
    /// The peer that said it.
    pub by: Option<String>,
    /// That peer's user.
    pub user: Option<String>,
    /// Since when.
    pub since: Option<Time>,
    /// Why, in that peer's words.
    pub reason: Option<String>,
    /// The devices that are stopped, if it is not all of the channel.
    pub only: Vec<String>,
    /// Devices that were let go by name while all others are stopped.
    pub except: Vec<String>,
}

impl StopState {
    /// From the map that the hub tells of stops.
    pub(crate) fn from_map(map: &Map) -> StopState {
        StopState {
            number: number(map, "number").unwrap_or_default(),
            stopped: map.get("stopped").and_then(Value::as_bool) == Some(true),
            by: owned(map, "by"),
            user: owned(map, "user"),
            since: match map.get("since") {
                Some(Value::Time(since)) => Some(*since),
                _ => None,
            },
            reason: owned(map, "reason"),
            only: name_list(map, "only"),
            except: name_list(map, "except"),
        }
    }

    /// From a reply to `join` or `info`; where that says nothing, nothing was ever stopped.
    pub(crate) fn from_reply(reply: &Map) -> StopState {
        let stop = reply.get(STOP).and_then(Value::as_map);
        stop.map(StopState::from_map).unwrap_or_default()
    }
}
