//! The small types: words, accessors, sizes, conversions.

use bytes::{Bytes, BytesMut};

use crate::binary::PREFACE;
use crate::codec::{Decoder, Encoded, Form, Frame, Scratch};
use crate::names::is_segment_char;
use crate::{
    ClockOffset, Content, ContextKind, Delivery, Family, Limit, Limits, Map, Overflow, Parcel, Path, Time,
    Value, ValueKind, looks_of,
};

#[test]
fn words_lead_back_to_what_they_stand_for() {
    let words: Vec<_> = ContextKind::ALL.map(ContextKind::word).into();
    assert_eq!(words, ["session", "channel", "token"]);
    for kind in ContextKind::ALL {
        assert_eq!(ContextKind::from_word(kind.word()), Some(kind));
        assert_eq!(kind.to_string(), kind.word());
    }
    let words: Vec<_> = Delivery::ALL.map(Delivery::word).into();
    assert_eq!(words, ["reliable", "latest", "fleeting"]);
    for class in Delivery::ALL {
        assert_eq!(Delivery::from_word(class.word()), Some(class));
    }
    let words: Vec<_> = Overflow::ALL.map(Overflow::word).into();
    assert_eq!(words, ["close", "wait"]);
    for overflow in Overflow::ALL {
        assert_eq!(Overflow::from_word(overflow.word()), Some(overflow));
    }
    for kind in ValueKind::ALL {
        assert_eq!(ValueKind::from_word(kind.word()), Some(kind));
    }
    assert_eq!(
        (
            ContextKind::from_word("box"),
            Delivery::from_word("box"),
            Overflow::from_word("box"),
            ValueKind::from_word("box")
        ),
        (None, None, None, None)
    );
}

#[test]
fn a_value_is_what_its_kind_says_and_nothing_else() {
    let time = Time::from_micros(7).unwrap();
    let (list, map) = (vec![Value::Null], Map::new().with("a", 1));
    let binary = Bytes::from_static(b"abc");
    let values = [
        Value::Null,
        true.into(),
        Value::Int(-3),
        Value::Double(0.5),
        "text".into(),
        time.into(),
        Value::Binary(binary.clone()),
        Value::List(list.clone()),
        Value::Map(map.clone()),
    ];
    for (value, kind) in values.iter().zip(ValueKind::ALL) {
        assert_eq!(value.kind(), kind);
        let only = |wanted: ValueKind| wanted == kind;
        assert_eq!(value.as_bool(), only(ValueKind::Bool).then_some(true), "{kind:?}");
        assert_eq!(value.as_int(), only(ValueKind::Int).then_some(-3), "{kind:?}");
        assert_eq!(
            value.as_str(),
            only(ValueKind::String).then_some("text"),
            "{kind:?}"
        );
        assert_eq!(value.as_time(), only(ValueKind::Time).then_some(time), "{kind:?}");
        assert_eq!(
            value.as_binary(),
            only(ValueKind::Binary).then_some(&binary),
            "{kind:?}"
        );
        assert_eq!(
            value.as_list(),
            only(ValueKind::List).then_some(&list[..]),
            "{kind:?}"
        );
        assert_eq!(value.as_map(), only(ValueKind::Map).then_some(&map), "{kind:?}");
        assert_eq!(
            value.get("a"),
            only(ValueKind::Map).then_some(&Value::Int(1)),
            "{kind:?}"
        );
    }
}

#[test]
fn a_map_is_made_of_its_members_in_order() {
    let members = [("b".to_owned(), Value::Int(2)), ("a".to_owned(), Value::Int(1))];
    let map: Map = members.into_iter().collect();
    assert_eq!(map, Map::new().with("b", 2).with("a", 1));
    assert_eq!(map.keys().collect::<Vec<_>>(), ["b", "a"]);
    assert!(map.contains_key("a") && !map.contains_key("c") && !map.is_empty());
    assert!(Map::new().is_empty());
}

/// Limits hold for it, so it is never below what content takes as MessagePack.
#[test]
fn the_size_of_content_is_counted_without_encoding_it() {
    let binary = Value::Binary(Bytes::from_static(b"abcd"));
    for (value, size) in [
        (Value::Null, 9),
        (Value::Int(1), 9),
        ("xy".into(), 7),
        (binary, 9),
        (vec![Value::from("x"), Value::from("yz")].into(), 5 + 6 + 7),
        (
            Map::new().with("key", "xy").with("k", 1).into(),
            5 + (8 + 7) + (6 + 9),
        ),
    ] {
        let content = Content::Value(value);
        assert_eq!(content.size(), size, "{content:?}");
        let encoded = content.to_msgpack().unwrap();
        assert!(encoded.len() <= size, "{content:?}");
        assert_eq!(Content::Encoded(encoded.clone()).size(), encoded.len());
    }
}

#[test]
fn times_of_two_clocks_are_an_offset_apart() {
    let hour = 3_600_000_000;
    let ahead = ClockOffset {
        micros: hour,
        error: 7,
    };
    let time = |micros| Time::from_micros(micros).unwrap();
    assert_eq!(ahead.own(time(hour + 5)), 5);
    assert_eq!(ahead.other(time(5)), hour + 5);
    let later = ahead.later(1_000_000);
    assert_eq!(later.micros, hour);
    assert_eq!(later.error, 7 + 100, "clocks part by 100 µs each second");
    assert_eq!(ahead.later(0), ahead);
}

#[test]
fn a_frame_in_two_pieces_is_as_long_as_both() {
    let frame = Encoded {
        head: Bytes::from_static(b"head"),
        body: Bytes::from_static(b"body!"),
    };
    assert_eq!((frame.len(), frame.is_empty()), (9, false));
    assert_eq!(frame.to_vec(), b"headbody!");
    assert!(Encoded::default().is_empty());
}

#[test]
fn pooled_memory_is_taken_by_the_block() {
    assert!(Scratch::pooled().room(10).capacity() >= 16 * 1024);
    assert!(Scratch::default().room(10).capacity() < 1024);
    assert!(Scratch::pooled().room(1 << 20).capacity() >= 1 << 20);
}

#[test]
fn limits_change_under_a_decoder() {
    let text = "x".repeat(1000);
    let parcel = Parcel::new(Family::Message, "say")
        .context(Path::parse("/chat").unwrap())
        .content(text.as_str());
    let narrow = Limits {
        parcel: Limit::At(300),
        ..Limits::default()
    };
    for form in Form::ALL {
        let preface: &[u8] = match form {
            Form::Xml | Form::Json => &[],
            Form::Binary | Form::Packed => &PREFACE,
        };
        let bytes = [preface, &form.encode(&parcel).unwrap().to_vec()].concat();
        let read = |first: &Limits, then: &Limits| {
            let mut decoder = Decoder::new(form, first);
            decoder.set_limits(then);
            let mut input = BytesMut::from(&bytes[..]);
            decoder.decode(&mut input)
        };
        let wide = Limits::default();
        assert!(
            matches!(read(&narrow, &wide), Ok(Some(Frame::Parcel(_)))),
            "{form:?}"
        );
        let refused = !matches!(read(&wide, &narrow), Ok(Some(Frame::Parcel(_))));
        assert!(refused, "{form:?}: as soon as they are narrow");
    }
}

#[test]
fn before_login_a_parcel_is_small() {
    let limits = Limits {
        before_login: 500,
        ..Limits::default()
    };
    assert_eq!(limits.before_login().parcel, Limit::At(500));
    let narrow = Limits {
        parcel: Limit::At(100),
        ..limits.clone()
    };
    assert_eq!(
        narrow.before_login().parcel,
        Limit::At(100),
        "never above the limit of later"
    );
    let others = Limits {
        parcel: limits.parcel,
        ..limits.before_login()
    };
    assert_eq!(others, limits);
}

#[test]
fn names_are_looked_at_by_letter() {
    assert_eq!(looks_of("\u{430}\u{441}\u{435}"), looks_of("ace"));
    assert_ne!(looks_of("Ace"), looks_of("ace"));
    for (letter, allowed) in [
        ('a', true),
        ('~', true),
        ('/', false),
        ('ä', true),
        ('\u{301}', true),
        // A letter, but one that has another form.
        ('\u{fb01}', false),
        // Good for identifiers, and no letter.
        ('\u{b7}', false),
    ] {
        assert_eq!(is_segment_char(letter), allowed, "{letter:?}");
    }
}

#[test]
fn a_path_shows_itself() {
    let path = Path::parse("/robot/arm").unwrap();
    assert_eq!(
        (format!("{path}"), format!("{path:?}")),
        ("/robot/arm".into(), "Path(/robot/arm)".into())
    );
}
