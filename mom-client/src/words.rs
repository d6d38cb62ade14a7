//! Reading the contents of parcels, and writing times into them.

use std::time::Duration;

use mom_proto::{MAX_ID, Map, Parcel, Value};

use crate::ClientError;
use crate::error::bad_reply;

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
