//! Durations, sizes and foreign text as people read them.

use std::borrow::Cow;
use std::time::Duration;

use mom_client::{Content, HISTORY, Map, Parcel, StopState, Value};

/// Beyond this a line is cut where a person reads it; JSON is never cut.
const LONGEST: usize = 200;

pub(crate) use mom_client::plain_duration as duration;

/// Text of others on one line, without anything that would act on the terminal.
pub(crate) fn visible(text: &str) -> String {
    shown(&mom_client::visible(text)).into_owned()
}

/// A line of ours as it goes to the terminal: whatever text of others has got into it, nothing but our own colours acts there.
pub(crate) fn shown(line: &str) -> Cow<'_, str> {
    if !line.chars().any(acts_in_a_line) {
        return Cow::Borrowed(line);
    }
    let mut shown = String::with_capacity(line.len());
    let mut rest = line;
    while let Some(c) = rest.chars().next() {
        let colour = colour(rest);
        let (taken, after) = rest.split_at(colour.unwrap_or(c.len_utf8()));
        match colour.is_none() && acts_in_a_line(c) {
            true => shown.extend(c.escape_default()),
            false => shown.push_str(taken),
        }
        rest = after;
    }
    Cow::Owned(shown)
}

/// The same for a line of JSON, whose strings stay what they are to a program.
pub(crate) fn shown_json(json: &str) -> String {
    let mut shown = String::with_capacity(json.len());
    for c in json.chars() {
        match acts(c) {
            true => {
                let mut units = [0; 2];
                let units = c.encode_utf16(&mut units).iter();
                shown.extend(units.map(|unit| format!("\\u{unit:04x}")));
            }
            false => shown.push(c),
        }
    }
    shown
}

/// The bytes of a change of colour at the beginning of a text.
fn colour(text: &str) -> Option<usize> {
    let codes = text.strip_prefix("\u{1b}[")?;
    let end = codes.find(|c: char| !c.is_ascii_digit() && c != ';')?;
    codes[end..]
        .starts_with('m')
        .then_some(text.len() - codes.len() + end + 1)
}

/// The same, but for what ends or parts our own lines.
fn acts_in_a_line(c: char) -> bool {
    acts(c) && !matches!(c, '\n' | '\t')
}

/// Whether a character moves the cursor, turns the direction of text, or is not seen. Those that join letters and pictures are text.
fn acts(c: char) -> bool {
    c.is_control()
        || matches!(
            c,
            '\u{AD}'
                | '\u{61C}'
                | '\u{180E}'
                | '\u{200B}'
                | '\u{200E}'
                | '\u{200F}'
                | '\u{2028}'..='\u{202E}'
                | '\u{2060}'..='\u{206F}'
                | '\u{FEFF}'
                | '\u{FFF9}'..='\u{FFFB}'
                | '\u{E0000}'..='\u{E007F}'
        )
}

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
    let by = visible(stop.by.as_deref().unwrap_or("a peer"));
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
    fn nothing_but_our_colours_acts_on_the_terminal() {
        for (line, shown_as) in [
            ("two\nlines", "two\nlines"),
            (
                "\u{1b}[1;31mrefused:\u{1b}[0m no",
                "\u{1b}[1;31mrefused:\u{1b}[0m no",
            ),
            ("a\u{1b}[2Jb\u{1b}]0;x\u{7}", "a\\u{1b}[2Jb\\u{1b}]0;x\\u{7}"),
            ("\u{1b}[31", "\\u{1b}[31"),
            ("al\u{202e}eci\u{2069}", "al\\u{202e}eci\\u{2069}"),
            ("bob\u{200b}\u{61c}\u{feff}", "bob\\u{200b}\\u{61c}\\u{feff}"),
            (
                "\u{1f468}\u{200d}\u{1f469} \u{645}\u{200c}",
                "\u{1f468}\u{200d}\u{1f469} \u{645}\u{200c}",
            ),
        ] {
            assert_eq!(shown(line), shown_as);
        }
        assert_eq!(visible("bob\u{61c}\n"), "bob\\u{61c}\\n");
        let json = r#"{"text":"a\u{202e}b\u{e0041}"}"#.replace("\\u{202e}", "\u{202e}");
        let json = json.replace("\\u{e0041}", "\u{e0041}");
        assert_eq!(shown_json(&json), r#"{"text":"a\u202eb\udb40\udc41"}"#);
        let read = serde_json::from_str::<serde_json::Value>(&shown_json(&json)).unwrap();
        assert_eq!(read["text"], "a\u{202e}b\u{e0041}");
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
