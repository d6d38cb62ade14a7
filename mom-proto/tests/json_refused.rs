//! JSON that is not a parcel: the code, the slot and the byte at which reading stopped (threats 2 and 5).

use bytes::BytesMut;
use mom_proto::codec::Frame;
use mom_proto::json::JsonDecoder;
use mom_proto::{Limits, Value, WireError};

/// The error that a line gives, with the id it names; the next line is read.
fn refuse(line: &[u8], limits: &Limits) -> (WireError, Option<u64>) {
    let next = b"\n{\"family\":\"reply\",\"name\":\"ok\"}\n";
    let mut input = BytesMut::from(&[line, next].concat()[..]);
    let mut decoder = JsonDecoder::new(limits);
    let Ok(Some(Frame::Malformed { reference, error })) = decoder.decode(&mut input) else {
        panic!("not refused: {}", String::from_utf8_lossy(line));
    };
    let next = decoder.decode(&mut input);
    assert!(
        matches!(next, Ok(Some(Frame::Parcel(_)))),
        "after {error}: {next:?}"
    );
    (error, reference)
}

/// Checks a line in which `¦` stands before the byte that the error names.
fn check(marked: &str, code: &str, slot: &str) -> Option<u64> {
    let line = marked.replace('¦', "");
    let (error, reference) = refuse(line.as_bytes(), &Limits::default());
    let position = marked.find('¦').and_then(|at| i64::try_from(at).ok());
    let given = error.get("slot").and_then(Value::as_str).unwrap_or_default();
    assert_eq!((error.code.word(), given), (code, slot), "{marked}: {error}");
    assert_eq!(
        error.get("position").and_then(Value::as_int),
        position,
        "{marked}: {error}"
    );
    reference
}

/// Whole lines: the line, its code and slot.
const LINES: &[(&str, &str, &str)] = &[
    ("¦[]", "bad-json", ""),
    ("¦7", "bad-json", ""),
    ("¦\"{}\"", "bad-json", ""),
    ("¦null", "bad-json", ""),
    (" \t¦<parcel/>", "bad-json", ""),
    ("¦'a'", "bad-json", ""),
    ("¦\u{FEFF}{}", "bad-encoding", ""),
    ("{¦", "bad-json", ""),
    ("{¦a:1}", "bad-json", ""),
    ("{¦'a':1}", "bad-json", ""),
    ("{¦,}", "bad-json", ""),
    ("{¦1:2}", "bad-json", ""),
    ("{\"a\"¦}", "bad-json", "a"),
    ("{\"a\":¦}", "bad-json", "a"),
    ("{\"a\":1¦", "bad-json", ""),
    ("{\"a\":1,¦}", "bad-json", ""),
    ("{\"a\":1 ¦\"b\":2}", "bad-json", ""),
    ("{\"¦\u{0}\":1}", "bad-encoding", ""),
];

/// What follows in a line after its id.
const ENDS: &[(&str, &str)] = &[
    ("}¦{}", "bad-json"),
    ("} ¦x", "bad-json"),
    ("}¦}", "bad-json"),
    (",\"a\":1¦", "bad-json"),
    (",¦// a comment", "bad-json"),
    (",\"a\":\"¦\u{1}\"}", "bad-encoding"),
    (",\"a\":\"¦\u{FFFE}\"}", "bad-encoding"),
];

/// Slots of a parcel: members, code and slot.
const SLOTS: &[(&str, &str, &str)] = &[
    ("\"id\":8¦", "bad-slot", "id"),
    ("\"name\":\"y\"¦", "bad-slot", "name"),
    ("\"fence\":\"8\"¦", "bad-slot", "fence"),
    ("\"fence\":-1¦", "bad-slot", "fence"),
    ("\"fence\":1.0¦", "bad-slot", "fence"),
    ("\"fence\":9007199254740992¦", "bad-slot", "fence"),
    ("\"priority\":null¦", "bad-slot", "priority"),
    ("\"echo\":1¦", "bad-slot", "echo"),
    ("\"context\":\"/a/../b\"¦", "bad-path", "context"),
    ("\"address\":[]¦", "bad-slot", "address"),
    ("\"address\":[7]¦", "bad-slot", "address"),
    ("\"timestamp\":\"now¦\"", "bad-slot", "timestamp"),
    ("\"timestamp\":1¦", "bad-slot", "timestamp"),
    ("\"a\":1,\"a\":2¦", "bad-slot", "a"),
    // Of JSON.
    ("\"a\":0¦1", "bad-json", "a"),
    ("\"a\":¦+1", "bad-json", "a"),
    ("\"a\":¦.5", "bad-json", "a"),
    ("\"a\":1.¦", "bad-json", "a"),
    ("\"a\":1e¦", "bad-json", "a"),
    ("\"a\":-¦", "bad-json", "a"),
    ("\"a\":1e99¦9", "bad-json", "a"),
    ("\"a\":¦NaN", "bad-json", "a"),
    ("\"a\":¦Infinity", "bad-json", "a"),
    ("\"a\":tru¦", "bad-json", "a"),
    ("\"a\":¦undefined", "bad-json", "a"),
    ("\"a\":[1,¦]", "bad-json", "a/1"),
    ("\"a\":[1¦;2]", "bad-json", "a/1"),
    ("\"a\":\"¦\t\"", "bad-json", "a"),
    ("\"a\":\"\\¦x\"", "bad-json", "a"),
    ("\"a\":\"\\u00g¦0\"", "bad-json", "a"),
    ("\"a\":\"\\ud83d¦\"", "bad-json", "a"),
    ("\"a\":\"\\ude0¦0\"", "bad-json", "a"),
    ("\"a\":\"\\ud83d\\u004¦1\"", "bad-json", "a"),
    // Characters that no string has.
    ("\"a\":\"\\u0000¦\"", "bad-encoding", "a"),
    ("\"a\":\"\\u001b¦\"", "bad-encoding", "a"),
    ("\"a\":\"\\ufffe¦\"", "bad-encoding", "a"),
    ("\"\\u0000¦\":1", "bad-encoding", ""),
    ("\"content\":{\"\\u0000¦\":1}", "bad-encoding", "content"),
    // Of tags.
    ("\"a\":{\"$int\":1¦}", "bad-slot", "a"),
    ("\"a\":{\"$int\":\"01\"¦}", "bad-slot", "a"),
    ("\"a\":{\"$int\":\"9223372036854775808\"¦}", "bad-slot", "a"),
    ("\"a\":{\"$int\":¦[\"1\"]}", "bad-slot", "a"),
    ("\"a\":{\"$int\":¦{\"$int\":\"1\"}}", "bad-slot", "a"),
    ("\"a\":{\"$double\":\"1\"¦}", "bad-slot", "a"),
    ("\"a\":{\"$time\":\"today\"¦}", "bad-slot", "a"),
    ("\"a\":{\"$binary\":\"AAE\"¦}", "bad-slot", "a"),
    ("\"a\":{\"$binary\":null¦}", "bad-slot", "a"),
    ("\"a\":{\"$map\":¦1}", "bad-slot", "a"),
    ("\"a\":{\"$map\":[¦]}", "bad-slot", "a"),
    ("\"a\":{\"$list¦\":[]}", "bad-slot", "a"),
    ("\"a\":{\"$¦\":1}", "bad-slot", "a"),
    ("\"a\":{\"$int\":\"1\",\"b¦\":2}", "bad-slot", "a"),
    ("\"a\":{\"$map\":{},\"b¦\":2}", "bad-slot", "a"),
    // Inside content.
    ("\"content\":{\"a\":1,\"a\":2¦}", "bad-slot", "content/a"),
    (
        "\"content\":{\"$map\":{\"$a\":1,\"$a\":2¦}}",
        "bad-slot",
        "content/$a",
    ),
    ("\"content\":{\"a\":[0,{\"b\":¦x}]}", "bad-json", "content/a/1/b"),
    (
        "\"content\":{\"a\":[0,{\"$time\":\"x\"¦}]}",
        "bad-slot",
        "content/a/1",
    ),
];

#[test]
fn lines() {
    for (marked, code, slot) in LINES.iter().copied() {
        check(marked, code, slot);
    }
    for (rest, code) in ENDS.iter().copied() {
        let marked = format!("{{\"id\":7,\"family\":\"message\",\"name\":\"x\"{rest}");
        let (error, reference) = refuse(marked.replace('¦', "").as_bytes(), &Limits::default());
        let position = marked.find('¦').and_then(|at| i64::try_from(at).ok());
        let told = error.get("position").and_then(Value::as_int);
        assert_eq!(
            (error.code.word(), told, reference),
            (code, position, Some(7)),
            "{marked}"
        );
    }
    let missing = [("¦{}", "family"), ("¦{\"family\":\"time\"}", "name")];
    for (marked, slot) in missing {
        check(marked, "bad-slot", slot);
    }
    let (error, reference) = refuse(
        b"{\"id\":7,\"name\":\"\xff\",\"family\":\"message\"}",
        &Limits::default(),
    );
    let told = error.get("position").and_then(Value::as_int);
    assert_eq!(
        (error.code.word(), told, reference),
        ("bad-encoding", Some(16), Some(7))
    );
}

#[test]
fn slots() {
    for (marked, code, slot) in SLOTS.iter().copied() {
        let marked = format!("{{\"id\":7,\"family\":\"message\",\"name\":\"x\",{marked}}}");
        assert_eq!(check(&marked, code, slot), Some(7), "{marked}");
    }
}

/// Threat 2: however deep it goes, it is read to the limit and no further.
#[test]
fn too_deep() {
    let limits = Limits::default();
    let endless = Limits {
        depth: usize::MAX,
        ..Limits::default()
    };
    let check = |inside: &str, count: usize, limits: &Limits, slot: &str| {
        let line = format!("{{\"id\":7,\"content\":{}", inside.repeat(count));
        let (error, reference) = refuse(line.as_bytes(), limits);
        let given = error.get("slot").and_then(Value::as_str).unwrap_or_default();
        assert_eq!((error.code.word(), reference), ("too-deep", Some(7)), "{error}");
        assert!(given.starts_with(slot) && given.len() < 1000, "{given}");
        let position = error.get("position").and_then(Value::as_int);
        assert!(position < Some(4000), "the rest is not read: {position:?}");
    };
    for limits in [&limits, &endless] {
        check("[", 1_000_000, limits, "content/0/0/");
        check("{\"a\":", 500_000, limits, "content/a/a/");
        check("{\"$map\":{\"$a\":", 300_000, limits, "content/$a/$a/");
    }
    check("[", limits.depth + 1, &limits, "content/0/0/");
    let fits = "[".repeat(limits.depth) + &"]".repeat(limits.depth);
    let line = format!("{{\"family\":\"message\",\"name\":\"x\",\"content\":{fits}}}\n");
    let frame = JsonDecoder::new(&limits).decode(&mut BytesMut::from(line.as_bytes()));
    assert!(matches!(frame, Ok(Some(Frame::Parcel(_)))), "{frame:?}");
}

/// What is told about a line stays small, whatever stands in it.
#[test]
fn little_is_repeated() {
    let long = "a".repeat(100_000);
    for line in [
        format!("\"{long}\""),
        format!("{{\"{long}\":x}}"),
        format!("{{\"a\":{{\"${long}\":1}}}}"),
        format!("{{\"a\":{{\"$int\":\"{long}\"}}}}"),
        format!("{{\"content\":{{\"{long}\":{{\"{long}\":[x]}}}}}}"),
    ] {
        let (error, _) = refuse(line.as_bytes(), &Limits::default());
        let slot = error.get("slot").and_then(Value::as_str).unwrap_or_default();
        assert!(error.text.len() < 300 && slot.len() < 400, "{error} {slot}");
    }
}
