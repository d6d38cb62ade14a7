//! Durations, sizes and foreign text as people read them.

use std::time::Duration;

use mom_client::{Content, HISTORY, Map, Parcel, StopState, Value};

/// Beyond this a line is cut where a person reads it; JSON is never cut.
const LONGEST: usize = 200;

pub(crate) use mom_client::{plain_duration as duration, visible};

/// A duration in ms, for JSON.
pub(crate) fn in_millis(duration: Duration) -> u64 {
    u64::try_from(duration.as_millis()).unwrap_or(u64::MAX)
}

/// A duration that was measured: `0.04 ms`, `12 ms`, `3.5 s`.
pub(crate) fn measured(time: Duration) -> String {
    let micros = time.as_micros();
    match micros {
        0..10_000 => format!("{}.{:02} ms", micros / 1000, micros % 1000 / 10),
        10_000..1_000_000 => format!("{} ms", micros / 1000),
        _ => format!("{}.{} s", micros / 1_000_000, micros % 1_000_000 / 100_000),
    }
}

/// `stopped by bob (smoke)`
pub(crate) fn stopped_by(stop: &StopState) -> String {
    let by = visible(stop.by.as_deref().unwrap_or("somebody"));
    match &stop.reason {
        Some(reason) => format!("stopped by {by} ({})", visible(reason)),
        None => format!("stopped by {by}"),
    }
}

/// How far a token is given: ` for 2 min or 5 commands`; nothing for good.
pub(crate) fn extent(time: Option<Duration>, commands: Option<u64>) -> String {
    let time = time.map(|time| format!(" for {}", duration(time)));
    match (time, commands.map(|commands| count(commands, "command"))) {
        (Some(time), Some(commands)) => format!("{time} or {commands}"),
        (Some(time), None) => time,
        (None, Some(commands)) => format!(" for {commands}"),
        (None, None) => String::new(),
    }
}

/// A number of ms in a reply, as a duration.
pub(crate) fn millis(value: Option<&Value>) -> Option<Duration> {
    let millis = value?.as_int()?;
    Some(Duration::from_millis(u64::try_from(millis).ok()?))
}

/// `812 B`, `12.3 KiB`, `1.5 MiB`.
pub(crate) fn size(bytes: usize) -> String {
    const KIB: usize = 1024;
    let tenths = |unit: usize| format!("{}.{}", bytes / unit, bytes % unit * 10 / unit);
    match bytes {
        0..KIB => format!("{bytes} B"),
        KIB..1_048_576 => format!("{} KiB", tenths(KIB)),
        _ => format!("{} MiB", tenths(KIB * KIB)),
    }
}

/// `1 member`, `3 members`.
pub(crate) fn count(number: u64, one: &str) -> String {
    match number {
        1 => format!("1 {one}"),
        _ => format!("{number} {one}s"),
    }
}

/// The age of a message from a channel's history: `history, 12 s old`; none for a new message.
pub(crate) fn history(parcel: &Parcel) -> Option<String> {
    if parcel.extra.get(HISTORY).and_then(Value::as_bool) != Some(true) {
        return None;
    }
    let old = match age(parcel) {
        Some(old) => old,
        // Without a known clock of its sender the age counts from when the hub got it.
        None => format!("at least {} old", short(micros_of(parcel))),
    };
    Some(format!("history, {old}"))
}

/// How old a message was when the hub passed it on: `12 ms old`, with the error where it is a part of that that
/// matters: `3 ms ± 2 ms old`. None where the hub does not know its sender's clock.
pub(crate) fn age(parcel: &Parcel) -> Option<String> {
    let error = parcel.age_error?;
    let micros = micros_of(parcel);
    Some(match error {
        1000.. if error > micros / 10 => format!("{} ± {} ms old", short(micros), error.div_ceil(1000)),
        _ if micros < 1000 => "under 1 ms old".to_owned(),
        _ => format!("{} old", short(micros)),
    })
}

/// An age in µs; one below 0 lies within its error.
fn micros_of(parcel: &Parcel) -> u64 {
    let age = parcel.age.and_then(|age| u64::try_from(age).ok());
    age.unwrap_or_default()
}

fn short(micros: u64) -> String {
    match micros {
        0..1_000_000 => format!("{} ms", micros / 1000),
        _ => duration(Duration::from_secs(micros / 1_000_000)),
    }
}

/// What a parcel carries, on one line.
pub(crate) fn said(parcel: &Parcel) -> String {
    match parcel.content.as_ref().map(Content::to_value) {
        None => String::new(),
        Some(Ok(value)) => content(&value),
        // Encoded by its sender, and forwarded unopened.
        Some(Err(error)) => format!("(content that cannot be read: {})", visible(&error.to_string())),
    }
}

/// Content on one line: text as it is, maps as `key=value`, and what is inside of them in short.
pub(crate) fn content(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => visible(text),
        Value::Map(map) => members(map),
        Value::List(list) => list.iter().map(inner).collect::<Vec<_>>().join(", "),
        other => inner(other),
    }
}

/// A map's members as `key=value`.
fn members(map: &Map) -> String {
    let members: Vec<String> = map
        .iter()
        .map(|(key, value)| format!("{}={}", visible(key), inner(value)))
        .collect();
    members.join(" ")
}

fn inner(value: &Value) -> String {
    match value {
        Value::Null => "null".to_owned(),
        Value::Bool(flag) => flag.to_string(),
        Value::Int(number) => number.to_string(),
        Value::Double(number) => decimals(*number),
        Value::String(text) if text.contains(' ') => format!("\"{}\"", visible(text)),
        Value::String(text) => visible(text),
        Value::Time(time) => time.to_string(),
        Value::Binary(bytes) => format!("<{}>", size(bytes.len())),
        Value::List(list) if list.len() > 6 => format!("[{}]", count(list.len() as u64, "item")),
        Value::List(list) => match list.iter().all(is_plain) {
            true => format!("[{}]", list.iter().map(inner).collect::<Vec<_>>().join(" ")),
            false => format!("[{}]", count(list.len() as u64, "item")),
        },
        Value::Map(map) => match map.iter().all(|(_, value)| is_plain(value)) {
            true => format!("{{{}}}", members(map)),
            false => "{…}".to_owned(),
        },
    }
}

fn is_plain(value: &Value) -> bool {
    !matches!(value, Value::List(_) | Value::Map(_))
}

/// At most three digits after the point: a thousandth of a millimetre is enough to read.
fn decimals(number: f64) -> String {
    let rounded = (number * 1000.0).round() / 1000.0;
    match rounded.is_finite() {
        // Adding zero makes 0 of -0.
        true => (rounded + 0.0).to_string(),
        false => number.to_string(),
    }
}

/// The text, cut where it grows too long to read.
pub(crate) fn shorten(text: &str) -> String {
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn how_far_a_token_is_given() {
        let minutes = Some(Duration::from_secs(120));
        for (time, commands, words) in [
            (minutes, Some(5), " for 2 min or 5 commands"),
            (minutes, None, " for 2 min"),
            (None, Some(1), " for 1 command"),
            (None, None, ""),
        ] {
            assert_eq!(extent(time, commands), words);
        }
    }

    #[test]
    fn sizes() {
        for (bytes, words) in [
            (0, "0 B"),
            (1023, "1023 B"),
            (1024, "1.0 KiB"),
            (12_646, "12.3 KiB"),
            (1_572_864, "1.5 MiB"),
        ] {
            assert_eq!(size(bytes), words);
        }
    }

    #[test]
    fn content_on_one_line() {
        let map = |members: Map| Value::Map(members);
        for (value, shown) in [
            (Value::Null, ""),
            ("move 1 2 3 4 5; grip close".into(), "move 1 2 3 4 5; grip close"),
            (
                map(Map::new()
                    .with("id", 3)
                    .with("state", "executing")
                    .with("why", "it is so")),
                "id=3 state=executing why=\"it is so\"",
            ),
            (
                map(Map::new()
                    .with("x", Value::Double(-0.0))
                    .with("y", Value::Double(1.23456))
                    .with("image", Value::Binary(vec![0; 2048].into()))),
                "x=0 y=1.235 image=<2.0 KiB>",
            ),
            (
                map(Map::new()
                    .with("pose", Map::new().with("x", 1).with("y", true))
                    .with("blocks", vec![Map::new().into()])
                    .with("deep", Map::new().with("deeper", Map::new()))),
                "pose={x=1 y=true} blocks=[1 item] deep={…}",
            ),
            (Value::List(vec![1.into(), "a".into()]), "1, a"),
        ] {
            assert_eq!(content(&value), shown);
        }
        let long = "ä".repeat(LONGEST + 1);
        assert_eq!(shorten(&long), format!("{}…", "ä".repeat(LONGEST)));
    }
}
