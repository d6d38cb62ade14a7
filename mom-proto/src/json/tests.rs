//! Properties that hold for every parcel and every split of its bytes.

use bytes::BytesMut;
use proptest::collection::vec;
use proptest::prelude::*;

use super::{JsonDecoder, encode, encode_within};
use crate::arbitrary;
use crate::binary::PREFACE;
use crate::codec::{Decoder, Form, Frame};
use crate::{Code, Content, Family, HARD_DEPTH, Limit, Limits, Map, Parcel, Value, WireError, msgpack};

fn deep_limits() -> Limits {
    Limits {
        depth: HARD_DEPTH,
        ..Limits::default()
    }
}

/// All frames of `input` when it arrives in these pieces, and the error that ends them.
fn decode<'a>(pieces: impl IntoIterator<Item = &'a [u8]>) -> (Vec<Frame>, Option<WireError>) {
    let mut decoder = JsonDecoder::new(&deep_limits());
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

fn parcel_of(frame: Frame) -> Parcel {
    match frame {
        Frame::Parcel(parcel) => *parcel,
        Frame::Malformed { error, .. } => panic!("{error}"),
    }
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

/// A parcel as it is after it went through this form.
fn through(form: Form, parcel: &Parcel) -> Parcel {
    let preface: &[u8] = match form {
        Form::Binary | Form::Packed => &PREFACE,
        Form::Xml | Form::Json => &[],
    };
    let bytes = [preface, &form.encode(parcel).expect("it has a form").to_vec()].concat();
    let frame = Decoder::new(form, &deep_limits()).decode(&mut BytesMut::from(&bytes[..]));
    parcel_of(frame.expect("healthy").expect("whole"))
}

proptest! {
    /// Threat 13, the part of this codec.
    #[test]
    fn every_parcel_comes_back(parcel in arbitrary::parcel()) {
        prop_assert_eq!(read_back(&parcel), Frame::Parcel(Box::new(parcel)));
    }

    /// Passing a parcel on from one form into another changes nothing.
    #[test]
    fn every_parcel_goes_through_all_forms(parcel in arbitrary::parcel()) {
        for forms in [[Form::Json, Form::Xml], [Form::Json, Form::Binary], [Form::Binary, Form::Json], [Form::Xml, Form::Json]] {
            let there = forms.into_iter().fold(parcel.clone(), |parcel, form| through(form, &parcel));
            prop_assert_eq!(&there, &parcel, "{:?}", forms);
        }
    }

    /// What is written is one line of JSON, for every other reader of JSON too.
    #[test]
    fn every_line_is_json(parcel in arbitrary::parcel()) {
        let line = encoded(&parcel);
        prop_assert_eq!(line.iter().position(|byte| *byte == b'\n'), Some(line.len() - 1));
        let read: serde_json::Value = serde_json::from_slice(&line).expect("JSON");
        prop_assert_eq!(read.get("name").and_then(serde_json::Value::as_str), Some(parcel.name()));
    }

    #[test]
    fn every_double_keeps_its_bits(number in any::<f64>().prop_filter("finite", |number| number.is_finite())) {
        let back = parcel_of(read_back(&holding(Value::Double(number))));
        prop_assert!(matches!(back.value(), Value::Double(read) if read.to_bits() == number.to_bits()));
    }

    #[test]
    fn every_int_stays_an_int(number in any::<i64>(), shift in 0..64_u32) {
        let number = Value::Int(number >> shift);
        prop_assert_eq!(parcel_of(read_back(&holding(number.clone()))).value(), number);
    }

    #[test]
    fn any_split_gives_the_same_frames(
        parcels in vec(arbitrary::parcel(), 1..4),
        cuts in vec(any::<prop::sample::Index>(), 0..12),
    ) {
        let bytes = parcels.iter().map(encoded).collect::<Vec<_>>().join(&b"\r\n \n"[..]);
        let (frames, error) = decode(cut(&bytes, &cuts));
        prop_assert_eq!(error, None);
        let parcels: Vec<Frame> = parcels.into_iter().map(|parcel| Frame::Parcel(Box::new(parcel))).collect();
        prop_assert_eq!(frames, parcels);
    }

    #[test]
    fn random_bytes_never_panic(bytes in vec(any::<u8>(), 0..300)) {
        let line = [&bytes[..], b"\n"].concat();
        let (frames, error) = decode([&line[..]]);
        prop_assert_eq!(error, None);
        prop_assert!(frames.iter().all(|frame| matches!(frame, Frame::Malformed { .. })), "{:?}", frames);
    }

    #[test]
    fn random_markup_never_panics(pieces in vec(prop::sample::select(MARKUP.to_vec()), 0..40)) {
        let line = format!("{{\"family\":\"message\",\"name\":\"x\",{}\n", pieces.concat());
        let (frames, error) = decode([line.as_bytes()]);
        prop_assert_eq!((frames.len(), error), (1, None));
    }

    #[test]
    fn mutated_lines_never_panic(
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
        prop_assert_eq!(decode([&bytes[..]]), decode(cut(&bytes, &cuts)));
    }

    /// What is passed on item by item is what is opened and written.
    #[test]
    fn encoded_content_is_written_like_the_value(value in arbitrary::value(4)) {
        let mut bytes = Vec::new();
        msgpack::encode(&value, &mut bytes).expect("a form");
        let packed = holding(Content::Encoded(bytes.into()));
        prop_assert_eq!(encoded(&packed), encoded(&holding(value)));
    }
}

const MARKUP: [&str; 26] = [
    "\"content\":",
    "\"id\":7",
    "{",
    "}",
    "[",
    "]",
    ",",
    ":",
    "\"",
    "\"a\"",
    "\"a\":",
    "\"$int\":",
    "\"$map\":",
    "\"$time\":",
    "\"$binary\":\"AAEC\"",
    "{\"$map\":{\"$int\":",
    "null",
    "true",
    "-0",
    "1e5",
    "9223372036854775808",
    "\\u0000",
    "\\ud800",
    "\u{FFFE}",
    "\r",
    " ",
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

/// However a map looks, it is not taken for a tag.
#[test]
fn maps_like_tags_stay_maps() {
    let inner = Map::new().with("$map", Map::new().with("$time", "now"));
    for map in [
        Map::new().with("$int", "5"),
        Map::new().with("$map", Map::new()),
        Map::new().with("$map", inner.clone()).with("$int", 1),
        Map::new().with("$", Value::Null).with("b", inner.clone()),
        Map::new().with("b", inner).with("$binary", "AAEC"),
        Map::new().with("$nothing", vec![Value::from(Map::new().with("$double", 1))]),
    ] {
        let parcel = holding(map);
        assert_eq!(read_back(&parcel), Frame::Parcel(Box::new(parcel.clone())));
        let packed = holding(Content::Encoded(
            parcel.content.unwrap().to_msgpack().expect("a form"),
        ));
        assert_eq!(parcel_of(read_back(&packed)), packed);
    }
}

#[test]
fn what_has_no_form_is_refused_with_its_slot() {
    let deep = |levels| (0..levels).fold(Value::Null, |inner, _| Value::List(vec![inner]));
    let tagged = |levels| (0..levels).fold(Value::Null, |inner, _| Map::new().with("$", inner).into());
    let check = |content: Value, code: Code, slot: &str| {
        let error = encode(&holding(content)).map(|_| ()).expect_err(slot);
        let given = error.get("slot").and_then(Value::as_str).unwrap_or_default();
        assert_eq!((&error.code, &given[..slot.len()]), (&code, slot));
    };
    check(Value::Double(f64::NAN), Code::NOT_ENCODABLE, "content");
    let infinite = Map::new().with("a", vec![Value::Double(f64::INFINITY)]);
    check(infinite.into(), Code::NOT_ENCODABLE, "content/a/0");
    let escape = Map::new().with("a", "\u{1b}");
    check(escape.into(), Code::NOT_ENCODABLE, "content/a");
    check("a\u{FFFF}".into(), Code::NOT_ENCODABLE, "content");
    check(Map::new().with("\0", 1).into(), Code::NOT_ENCODABLE, "content/");
    check(deep(HARD_DEPTH + 1), Code::TOO_DEEP, "content/0/0");
    for deepest in [deep(HARD_DEPTH), tagged(HARD_DEPTH)] {
        let deepest = holding(deepest);
        assert_eq!(read_back(&deepest), Frame::Parcel(Box::new(deepest)));
    }
    let mut forged = holding(1);
    forged.extra.set("sender", "root");
    let error = encode(&forged).map(|_| ()).expect_err("known slot");
    assert_eq!(error.code, Code::BAD_SLOT);
}

/// A list of nothing costs one byte for each item in MessagePack and five in JSON.
#[test]
fn bounds_hold_while_content_is_written() {
    let nils = |count: u32| {
        let mut bytes = vec![0xdd];
        bytes.extend_from_slice(&count.to_be_bytes());
        bytes.resize(bytes.len() + count as usize, 0xc0);
        holding(Content::Encoded(bytes.into()))
    };
    let within = |parcel: &Parcel| encode_within(parcel, 32, Limit::At(64 * 1024));
    let written = within(&nils(10_000)).expect("it fits");
    assert!((50_000..64 * 1024).contains(&written.len()), "{}", written.len());
    let error = within(&nils(4_000_000)).expect_err("it would have 20 MB");
    assert_eq!(error.code, Code::NOT_ENCODABLE);
    assert!(error.text.contains("more than 65536 bytes"), "{error}");
    let quotes = holding("\"".repeat(60_000));
    assert_eq!(within(&quotes).expect_err("120 kB").code, Code::NOT_ENCODABLE);
    let bytes = holding(bytes::Bytes::from(vec![1; 50_000]));
    assert_eq!(within(&bytes).expect_err("67 kB").code, Code::NOT_ENCODABLE);
    let deep = holding(Content::Encoded([&[0x91; 33][..], &[0xc0]].concat().into()));
    assert_eq!(within(&deep).expect_err("33 levels").code, Code::TOO_DEEP);
    assert!(encode(&holding(Content::Encoded(vec![0xC1].into()))).is_err());
}

#[test]
fn a_large_line_is_left_for_whoever_has_the_time() {
    let large = holding("x".repeat(5000));
    let all = [encoded(&large), b"\r\n".to_vec(), encoded(&holding("small"))].concat();
    let mut decoder = JsonDecoder::new(&Limits::default());
    decoder.defer_above(4096);
    let mut buffer = BytesMut::from(&all[..]);
    assert_eq!(decoder.decode(&mut buffer), Ok(None));
    assert_eq!(decoder.decode(&mut buffer), Ok(None), "nothing goes past it");
    let deferred = decoder.take_deferred().expect("the large one");
    assert!(deferred.size() > 5000);
    assert_eq!(deferred.open(), Frame::Parcel(Box::new(large)));
    assert_eq!(
        decoder.decode(&mut buffer),
        Ok(Some(Frame::Parcel(Box::new(holding("small")))))
    );
    let rest = (decoder.decode(&mut buffer), decoder.take_deferred());
    assert_eq!(rest, (Ok(None), None));
}

#[test]
fn a_line_is_too_large_before_it_ends() {
    let limits = Limits {
        parcel: Limit::At(100),
        ..Limits::default()
    };
    let decode = |bytes: &[u8]| JsonDecoder::new(&limits).decode(&mut BytesMut::from(bytes));
    assert_eq!(decode(&[b'{'; 100]), Ok(None));
    for line in [vec![b' '; 101], [&[b' '; 101][..], b"\n"].concat()] {
        let error = decode(&line).expect_err("101 bytes");
        assert_eq!(error.code, Code::TOO_LARGE);
    }
    assert_eq!(decode(&[&[b' '; 100][..], b"\n"].concat()), Ok(None));
}

#[test]
fn slots_have_a_bound_of_their_own() {
    let limits = Limits {
        slots: 1000,
        ..Limits::default()
    };
    let read = |parcel: &Parcel| {
        let mut decoder = JsonDecoder::new(&limits);
        let frame = decoder.decode(&mut BytesMut::from(&encoded(parcel)[..]));
        frame.expect("healthy").expect("whole")
    };
    let mut parcel = holding("x".repeat(5000)).id(7);
    parcel.extra.set("colour", "y".repeat(500));
    assert_eq!(parcel_of(read(&parcel)), parcel, "content is apart");
    parcel.extra.set("colour", "y".repeat(1000));
    let Frame::Malformed { reference, error } = read(&parcel) else {
        panic!("too long");
    };
    assert_eq!((reference, &error.code), (Some(7), &Code::TOO_LONG), "{error}");
    assert_eq!(error.get("slot"), Some(&"colour".into()));
}
