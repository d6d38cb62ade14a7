//! Properties that hold for every parcel and every split of its bytes.

use bytes::BytesMut;
use proptest::collection::vec;
use proptest::prelude::*;

use super::{XmlDecoder, encode, encode_within, sniff};
use crate::arbitrary;
use crate::codec::Frame;
use crate::{Code, Content, Family, HARD_DEPTH, Limit, Limits, Map, Parcel, Value, WireError, msgpack};

/// All frames of `input` when it arrives in these pieces, and the error that ends them.
fn decode<'a>(pieces: impl IntoIterator<Item = &'a [u8]>) -> (Vec<Frame>, Option<WireError>) {
    let limits = Limits {
        depth: HARD_DEPTH,
        ..Limits::default()
    };
    let mut decoder = XmlDecoder::new(&limits);
    let mut buffer = BytesMut::new();
    let mut frames = Vec::new();
    for piece in pieces {
        buffer.extend_from_slice(piece);
        loop {
            match decoder.decode(&mut buffer) {
                Ok(Some(frame)) => frames.push(frame),
                Ok(None) => break,
                Err(error) => return (frames, Some(error)),
            }
        }
    }
    (frames, None)
}

fn encoded(parcel: &Parcel) -> Vec<u8> {
    encode(parcel).expect("it has a form").to_vec()
}

fn read_back(parcel: &Parcel) -> Frame {
    let (mut frames, error) = decode([&encoded(parcel)[..]]);
    assert_eq!((frames.len(), error), (1, None));
    frames.remove(0)
}

fn holding(content: impl Into<Content>) -> Parcel {
    Parcel::new(Family::Message, "x").content(content)
}

fn cut<'a>(bytes: &'a [u8], cuts: &[prop::sample::Index]) -> Vec<&'a [u8]> {
    let mut places: Vec<usize> = cuts.iter().map(|cut| cut.index(bytes.len() + 1)).collect();
    places.push(bytes.len());
    places.sort_unstable();
    let mut start = 0;
    let mut pieces = Vec::new();
    for place in places {
        pieces.push(&bytes[start..place]);
        start = place;
    }
    pieces
}

proptest! {
    /// Threat 13, the part of this codec.
    #[test]
    fn every_parcel_comes_back(parcel in arbitrary::parcel()) {
        prop_assert_eq!(read_back(&parcel), Frame::Parcel(Box::new(parcel)));
    }

    #[test]
    fn every_double_keeps_its_bits(number in any::<f64>().prop_filter("finite", |number| number.is_finite())) {
        let Frame::Parcel(back) = read_back(&holding(Value::Double(number))) else { panic!("malformed") };
        prop_assert!(matches!(back.value(), Value::Double(read) if read.to_bits() == number.to_bits()));
    }

    #[test]
    fn any_split_gives_the_same_frames(
        parcels in vec(arbitrary::parcel(), 1..4),
        cuts in vec(any::<prop::sample::Index>(), 0..12),
    ) {
        let bytes = parcels.iter().map(encoded).collect::<Vec<_>>().join(&b"\r\n\n"[..]);
        let (frames, error) = decode(cut(&bytes, &cuts));
        prop_assert_eq!(error, None);
        let parcels: Vec<Frame> = parcels.into_iter().map(|parcel| Frame::Parcel(Box::new(parcel))).collect();
        prop_assert_eq!(frames, parcels);
    }

    #[test]
    fn random_bytes_never_panic(bytes in vec(any::<u8>(), 0..300)) {
        let (_, error) = decode([&bytes[..]]);
        prop_assert!(error.is_none_or(|error| error.code.closes()));
        let entity = [format!("content-type:application/xml\ncontent-length:{}\n\n", bytes.len()).as_bytes(), &bytes].concat();
        let (frames, error) = decode([&entity[..]]);
        prop_assert!(error.is_some() || matches!(&frames[..], [Frame::Malformed { .. }]), "{frames:?}");
        let _ = sniff(&bytes);
    }

    #[test]
    fn random_markup_never_panics(pieces in vec(prop::sample::select(MARKUP.to_vec()), 0..40)) {
        let body = pieces.concat();
        let head = format!("Content-Type: {}\nContent-Length: {}\n\n", RELATED, body.len());
        let plain = format!("Content-Type: application/xml\nContent-Length: {}\n\n", body.len());
        for head in [head, plain] {
            let (frames, error) = decode([head.as_bytes(), body.as_bytes()]);
            prop_assert_eq!(frames.len() + usize::from(error.is_some()), 1);
        }
    }

    #[test]
    fn mutated_frames_never_panic(
        parcel in arbitrary::parcel(),
        changes in vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cuts in vec(any::<prop::sample::Index>(), 0..4),
    ) {
        let mut bytes = encoded(&parcel);
        for (place, byte) in changes {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        // Whatever it is now, how it was cut does not matter.
        let (whole, error) = decode([&bytes[..]]);
        let (split, split_error) = decode(cut(&bytes, &cuts));
        prop_assert_eq!(whole, split);
        prop_assert_eq!(error.map(|error| error.code), split_error.map(|error| error.code));
    }
}

const RELATED: &str = "multipart/related; type=\"application/xml\"; boundary=b";

const MARKUP: [&str; 30] = [
    "<parcel>",
    "</parcel>",
    "<family>message</family>",
    "<name>x</name>",
    "<content type=\"map\">",
    "</content>",
    "<item>",
    "</item>",
    "<a type=\"list\">",
    "</a>",
    "<cid>",
    "</cid>",
    "p",
    "<a type=\"binary\">",
    "&lt;",
    "&#10;",
    "&",
    "<",
    ">",
    "/>",
    " ",
    "\"",
    "<slot key=\"a\">",
    "</slot>",
    "--b\r\n",
    "\r\n--b--",
    "\r\n--b\r\n",
    "Content-ID: <p>\r\n\r\n",
    "Content-Type: application/xml\r\n\r\n",
    "<?xml version=\"1.0\"?>",
];

#[test]
fn byte_by_byte() {
    let parcels = [
        holding("a\r\nb"),
        holding(Value::Binary(vec![7; 100].into())),
        holding(Map::new().with("a", 1).with("", 2)),
    ];
    let bytes: Vec<u8> = parcels.iter().flat_map(encoded).collect();
    let (frames, error) = decode(bytes.chunks(1));
    assert_eq!(error, None);
    assert_eq!(frames, parcels.map(|parcel| Frame::Parcel(Box::new(parcel))));
}

/// Threat 7: however the data looks, the boundary does not stand in it.
#[test]
fn the_boundary_stands_in_no_part() {
    let crafted: String = (0..2000)
        .map(|number| format!("\r\n--mom-{number}\r\n"))
        .collect();
    let long = format!("\r\n--mom-{}{}", "1234567890".repeat(4), "x".repeat(100));
    for data in [
        crafted,
        long,
        format!("mom-{}", "0".repeat(100)),
        "mom-1 mom-10 mom-2 mom-0".repeat(4),
    ] {
        let parcel = holding(Value::Binary(data.clone().into()));
        let bytes = encoded(&parcel);
        let text = String::from_utf8_lossy(&bytes);
        let boundary = text
            .split("boundary=")
            .nth(1)
            .and_then(|rest| rest.lines().next())
            .unwrap();
        assert!(!data.contains(boundary), "{boundary}");
        assert_eq!(read_back(&parcel), Frame::Parcel(Box::new(parcel)));
    }
}

#[test]
fn what_has_no_form_is_refused_with_its_slot() {
    let deep = |levels| (0..levels).fold(Value::Null, |inner, _| Value::List(vec![inner]));
    let hollow = (1..=HARD_DEPTH).fold(Value::List(vec![]), |inner, _| Value::List(vec![inner]));
    let check = |content: Value, code: Code, slot: &str| {
        let error = encode(&holding(content)).map(|_| ()).expect_err(slot);
        let given = error.get("slot").and_then(Value::as_str).unwrap_or_default();
        assert_eq!((&error.code, &given[..slot.len()]), (&code, slot));
    };
    check(Value::Double(f64::NAN), Code::NOT_ENCODABLE, "content");
    check(
        Map::new()
            .with("a", Value::List(vec![Value::Double(f64::INFINITY)]))
            .into(),
        Code::NOT_ENCODABLE,
        "content/a/0",
    );
    check(
        Map::new().with("a", "\u{1b}").into(),
        Code::NOT_ENCODABLE,
        "content/a",
    );
    check("a\u{FFFF}".into(), Code::NOT_ENCODABLE, "content");
    check(Map::new().with("\0", 1).into(), Code::NOT_ENCODABLE, "content/");
    check(deep(HARD_DEPTH + 1), Code::TOO_DEEP, "content/0/0");
    check(hollow, Code::TOO_DEEP, "content/0/0");
    let deepest = holding(deep(HARD_DEPTH));
    assert_eq!(read_back(&deepest), Frame::Parcel(Box::new(deepest)));
    let mut forged = holding(1);
    forged.extra.set("sender", "root");
    assert_eq!(
        encode(&forged).map(|_| ()).expect_err("known slot").code,
        Code::BAD_SLOT
    );
}

#[test]
fn encoded_content_is_opened() {
    let value = Value::from(Map::new().with("x", 1).with("y", Value::Double(0.5)));
    let mut bytes = Vec::new();
    msgpack::encode(&value, &mut bytes).unwrap();
    let packed = holding(Content::Encoded(bytes.into()));
    assert_eq!(encoded(&packed), encoded(&holding(value)));
    assert!(encode(&holding(Content::Encoded(vec![0xC1].into()))).is_err());
}

#[test]
fn more_parts_than_the_limit_go_inline() {
    let list: Vec<Value> = (0..300_u32)
        .map(|n| Value::Binary(vec![n as u8; 65].into()))
        .collect();
    let parcel = holding(Value::List(list));
    assert_eq!(read_back(&parcel), Frame::Parcel(Box::new(parcel)));
}

#[test]
fn the_first_bytes() {
    for (first, expected) in [
        (&b""[..], Some(false)),
        (b"C", Some(false)),
        (b"content", Some(false)),
        (b"CONTENT-", Some(true)),
        (b"Content-Type: x", Some(true)),
        (b"\r\n\nCon", Some(false)),
        (b"\r\n\nConte", Some(true)),
        (b"\n\n\n\n\n\n\n\n", Some(true)),
        (b"\n\r", Some(false)),
        (b"GET / HT", None),
        (b"\rC", None),
        (b" Content", None),
        (b"Contempt", None),
        (b"\x16\x03\x01", None),
    ] {
        let sure = sniff(first);
        assert!(
            sure.as_ref()
                .err()
                .is_none_or(|error| error.code == Code::BAD_FRAME)
        );
        assert_eq!(sure.ok(), expected, "{first:?}");
    }
}

/// A list of nothing costs one byte for each item in MessagePack and nineteen in XML.
#[test]
fn bounds_hold_while_content_is_written() {
    let nils = |count: u32| {
        let mut bytes = vec![0xdd];
        bytes.extend_from_slice(&count.to_be_bytes());
        bytes.resize(bytes.len() + count as usize, 0xc0);
        holding(Content::Encoded(bytes.into()))
    };
    let within = |parcel: &Parcel| encode_within(parcel, 32, Limit::At(64 * 1024));
    let written = within(&nils(1000)).expect("it fits");
    assert!((18_000..64 * 1024).contains(&written.len()), "{}", written.len());
    let error = within(&nils(4_000_000)).expect_err("it would have 76 MB");
    assert_eq!(error.code, Code::NOT_ENCODABLE);
    assert!(error.text.contains("more than 65536 bytes"), "{error}");
    let quotes = holding("\"".repeat(60_000));
    assert_eq!(within(&quotes).expect_err("360 kB").code, Code::NOT_ENCODABLE);
    let parts = holding(vec![Value::Binary(bytes::Bytes::from(vec![1; 40_000])); 2]);
    assert_eq!(
        within(&parts).expect_err("80 kB in parts").code,
        Code::NOT_ENCODABLE
    );
    let deep = holding(Content::Encoded([&[0x91; 33][..], &[0xc0]].concat().into()));
    assert_eq!(within(&deep).expect_err("33 levels").code, Code::TOO_DEEP);
}

#[test]
fn a_large_entity_is_left_for_whoever_has_the_time() {
    let large = holding("x".repeat(5000));
    let picture = holding(bytes::Bytes::from(vec![7; 5000]));
    let all = [encoded(&large), encoded(&holding("small")), encoded(&picture)].concat();
    let mut decoder = XmlDecoder::new(&Limits::default());
    decoder.defer_above(4096);
    let mut buffer = BytesMut::from(&all[..]);
    assert_eq!(decoder.decode(&mut buffer), Ok(None));
    assert_eq!(decoder.decode(&mut buffer), Ok(None), "nothing goes past it");
    let deferred = decoder.take_deferred().expect("the large one");
    assert!(deferred.size() > 5000);
    assert_eq!(deferred.open(), Ok(Frame::Parcel(Box::new(large))));
    assert_eq!(
        decoder.decode(&mut buffer),
        Ok(Some(Frame::Parcel(Box::new(holding("small")))))
    );
    assert_eq!(decoder.decode(&mut buffer), Ok(None));
    let deferred = decoder.take_deferred().expect("the one with a part");
    assert_eq!(deferred.open(), Ok(Frame::Parcel(Box::new(picture))));
    assert_eq!(
        (decoder.decode(&mut buffer), decoder.take_deferred()),
        (Ok(None), None)
    );
}

#[test]
fn slots_have_a_bound_of_their_own() {
    let limits = Limits {
        slots: 1000,
        ..Limits::default()
    };
    let read = |parcel: &Parcel| {
        let mut decoder = XmlDecoder::new(&limits);
        let frame = decoder.decode(&mut BytesMut::from(&encoded(parcel)[..]));
        frame.expect("healthy").expect("whole")
    };
    let mut parcel = holding("x".repeat(5000)).id(7);
    parcel.extra.set("colour", "y".repeat(500));
    assert_eq!(
        read(&parcel),
        Frame::Parcel(Box::new(parcel.clone())),
        "content is apart"
    );
    parcel.extra.set("colour", "y".repeat(1000));
    let Frame::Malformed { reference, error } = read(&parcel) else {
        panic!("too long");
    };
    assert_eq!((reference, &error.code), (Some(7), &Code::TOO_LONG), "{error}");
    assert_eq!(error.get("slot"), Some(&"colour".into()));
}

proptest! {
    /// What is passed on token by token is what is opened and written.
    #[test]
    fn encoded_content_is_written_like_the_value(value in arbitrary::value(4)) {
        let mut bytes = Vec::new();
        msgpack::encode(&value, &mut bytes).expect("a form");
        let packed = holding(Content::Encoded(bytes.into()));
        prop_assert_eq!(encoded(&packed), encoded(&holding(value)));
    }
}
