//! Any value and any parcel, for the property tests of all codecs.

use std::sync::Arc;

use bytes::Bytes;
use proptest::collection::vec;
use proptest::option::of;
use proptest::prelude::*;
use proptest::sample::select;

use crate::{
    Content, Delivery, Family, MAX_ID, Map, Parcel, Path, Time, Value, check_message_name, is_xml_char,
};

/// Any text of XML characters, rich in those that need escaping.
pub(crate) fn text() -> impl Strategy<Value = String> {
    let any_char = any::<char>().prop_filter("a character of XML", |c| is_xml_char(*c));
    let markup = select(
        "&<>\"'\\]\r\n\t \u{85}\u{2028}\u{FEFF}\u{FFFD}ü;#"
            .chars()
            .collect::<Vec<_>>(),
    );
    let piece = prop_oneof![
        any_char.prop_map(String::from),
        markup.prop_map(String::from),
        "[a-z]{1,6}",
        select(vec!["]]>", "<!--", "&amp;", "\r\n", "<![CDATA["]).prop_map(String::from),
    ];
    vec(piece, 0..12).prop_map(|pieces| pieces.concat())
}

/// Any key of a map, plain names and others.
pub(crate) fn key() -> impl Strategy<Value = String> {
    prop_oneof![
        4 => "[a-zA-Z_][a-zA-Z0-9._-]{0,8}",
        1 => select(vec!["item", "cid", "slot", "parcel", "xml", "XMLish", "a:b", "", "1st", "Größe", "$int", "$map", "$"])
            .prop_map(String::from),
        1 => text(),
    ]
}

/// Any bytes, short and long, some of them like a MIME delimiter.
pub(crate) fn binary() -> impl Strategy<Value = Bytes> {
    let delimiter = select(vec![
        &b"\r\n--mom-0"[..],
        b"--mom-0--\r\n",
        b"mom-1",
        b"\r\n\r\n",
        b"\r\n--",
    ]);
    let piece = prop_oneof![vec(any::<u8>(), 0..90), delimiter.prop_map(<[u8]>::to_vec)];
    vec(piece, 0..4).prop_map(|pieces| Bytes::from(pieces.concat()))
}

/// Any instant with a text form.
pub(crate) fn time() -> impl Strategy<Value = Time> {
    (Time::MIN.micros()..=Time::MAX.micros()).prop_map(|micros| Time::from_micros(micros).unwrap_or_default())
}

/// Any value, at most `depth` lists and maps inside each other.
pub(crate) fn value(depth: u32) -> impl Strategy<Value = Value> {
    let double = any::<f64>().prop_filter("a finite double", |number| number.is_finite());
    let leaf = prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::Bool),
        any::<i64>().prop_map(Value::Int),
        double.prop_map(Value::Double),
        text().prop_map(Value::String),
        time().prop_map(Value::Time),
        binary().prop_map(Value::Binary),
    ];
    leaf.prop_recursive(depth, 24, 5, |inner| {
        prop_oneof![
            vec(inner.clone(), 0..5).prop_map(Value::List),
            vec((key(), inner), 0..5).prop_map(|members| Value::Map(members.into_iter().collect())),
        ]
    })
}

/// Any parcel, without the hub's number of its context.
pub(crate) fn parcel() -> impl Strategy<Value = Parcel> {
    let names = (
        select(Family::ALL.to_vec()),
        message_name(),
        of(message_name()),
        of(vec(message_name(), 1..4)),
    );
    let context = select(vec!["/", "/robot", "/robot/arm", "/home/alice~2", "/名/前"]);
    let numbers = (
        of(id()),
        of(id()),
        of(any::<i32>()),
        of(id()),
        of(id()),
        of(any::<i64>()),
        of(id()),
    );
    let rest = (
        of(time()),
        of(time()),
        of(select(Delivery::ALL.to_vec())),
        of(any::<bool>()),
        of(any::<bool>()),
        of(context),
    );
    (names, numbers, rest, of(value(5)), extra()).prop_map(|(names, numbers, rest, content, extra)| {
        let (family, name, sender, address) = names;
        let (id, reference, priority, expires, fence, age, age_error) = numbers;
        let (timestamp, received, delivery, echo, receipt, context) = rest;
        Parcel {
            address: address.map(|names| names.into_iter().map(Arc::from).collect()),
            sender: sender.map(Arc::from),
            id,
            reference,
            priority,
            expires,
            fence,
            age,
            age_error,
            timestamp,
            received,
            delivery,
            echo,
            receipt,
            context: context.and_then(|path| Path::parse(path).ok()),
            content: content.map(Content::Value),
            extra,
            ..Parcel::new(family, name)
        }
    })
}

/// Slots that are none of the known ones.
fn extra() -> impl Strategy<Value = Map> {
    let unknown = key().prop_filter("no known slot", |key| {
        key != "content" && crate::ReadSlots::kind_of(key).is_none()
    });
    vec((unknown, value(2)), 0..3).prop_map(|slots| slots.into_iter().collect())
}

fn message_name() -> impl Strategy<Value = String> {
    text().prop_map(|name| match check_message_name(&name) {
        Ok(()) => name,
        Err(_) => "state".to_owned(),
    })
}

fn id() -> impl Strategy<Value = u64> {
    prop_oneof![0..300_u64, 0..=MAX_ID]
}
