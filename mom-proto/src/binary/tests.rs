//! The binary form as a whole: round trips, splits, refusals, growth.

use bytes::{Bytes, BytesMut};
use proptest::prelude::*;

use super::wire::put_varint;
use super::{BinaryDecoder, PREFACE, chunks, encode};
use crate::arbitrary;
use crate::codec::{Encoded, Form, Frame};
use crate::{Code, Content, ContextNumber, Family, Limit, Limits, Packed, Parcel, Path, Value, WireError};

fn decoder() -> BinaryDecoder {
    let mut decoder = BinaryDecoder::new(&Limits::default());
    assert_eq!(decoder.decode(&mut BytesMut::from(&PREFACE[..])), Ok(None));
    decoder.set_limits(&Limits::default());
    decoder
}

fn decode_one(bytes: &[u8]) -> Result<Option<Frame>, WireError> {
    decoder().decode(&mut BytesMut::from(bytes))
}

fn parcel_of(bytes: &[u8]) -> Parcel {
    match decode_one(bytes) {
        Ok(Some(Frame::Parcel(parcel))) => *parcel,
        other => panic!("no parcel: {other:?}"),
    }
}

/// A frame of this kind around this body.
fn frame(kind: u8, body: &[u8]) -> Vec<u8> {
    let length = u32::try_from(body.len() + 1).unwrap();
    [&length.to_be_bytes()[..], &[kind], body].concat()
}

/// A parcel named `x` with further bits set, and what stands after the name.
fn with_bits(bits: u64, rest: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    put_varint(&mut body, bits | 1 << 1);
    if bits & 1 != 0 {
        body.push(9);
    }
    body.extend_from_slice(&[2, b'x']);
    body.extend_from_slice(rest);
    frame(0, &body)
}

fn numbered(mut parcel: Parcel, number: Option<u64>) -> Parcel {
    parcel.number = number.map(ContextNumber);
    // Messages with a number travel without their path; others and stops carry both.
    if parcel.number.is_some() && parcel.family == Family::Message && parcel.name() != "stop" {
        parcel.context = None;
    }
    parcel
}

proptest! {
    #[test]
    fn parcels_come_back(parcel in arbitrary::parcel(), number in proptest::option::of(1..u64::MAX)) {
        let parcel = numbered(parcel, number);
        prop_assert_eq!(parcel_of(&encode(&parcel).unwrap().to_vec()), parcel);
    }

    #[test]
    fn parcels_come_back_packed(parcel in arbitrary::parcel(), fill in 0_usize..4000, unpacks in any::<bool>()) {
        let mut parcel = numbered(parcel, Some(7));
        parcel.content = Some(Value::from("robot ".repeat(fill)).into());
        let frame = Form::Packed.encode(&parcel).unwrap().to_vec();
        let mut decoder = decoder();
        decoder.take_packed();
        let Ok(Some(Frame::Parcel(read))) = decoder.decode(&mut BytesMut::from(&frame[..])) else {
            panic!("{frame:?}");
        };
        // MessagePack has 3 bytes before a text of this length, and less than 512 in all are left as they are.
        let pays = parcel.may_be_packed() && 6 * fill + 3 >= 512;
        prop_assert_eq!(matches!(read.content, Some(Content::Packed(_))), pays);
        prop_assert_eq!(&*read, &parcel);
        // And plain again, or as it came.
        let form = if unpacks { Form::Binary } else { Form::Packed };
        let again = form.encode(&read).unwrap().to_vec();
        match unpacks {
            true => prop_assert_eq!(parcel_of(&again), parcel),
            false => prop_assert_eq!(again, frame),
        }
    }

    #[test]
    fn a_change_of_codec_changes_nothing(parcel in arbitrary::parcel()) {
        let binary = parcel_of(&encode(&parcel).unwrap().to_vec());
        prop_assert!(matches!(binary.content, None | Some(Content::Encoded(_))), "never opened in passing");
        let xml = Form::Xml.encode(&binary).unwrap().to_vec();
        let frame = crate::xml::XmlDecoder::new(&Limits::default()).decode(&mut BytesMut::from(&xml[..]));
        prop_assert_eq!(frame, Ok(Some(Frame::Parcel(Box::new(parcel)))));
    }

    #[test]
    fn any_split_gives_the_same_parcels(
        parcels in proptest::collection::vec(arbitrary::parcel(), 1..5),
        cuts in proptest::collection::vec(any::<prop::sample::Index>(), 0..20),
    ) {
        let mut stream = PREFACE.to_vec();
        parcels.iter().for_each(|parcel| stream.extend(encode(parcel).unwrap().to_vec()));
        let mut cuts: Vec<usize> = cuts.iter().map(|cut| cut.index(stream.len())).collect();
        cuts.extend([0, stream.len()]);
        cuts.sort_unstable();
        let (mut decoder, mut input, mut found) = (BinaryDecoder::new(&Limits::default()), BytesMut::new(), vec![]);
        for pair in cuts.windows(2) {
            input.extend_from_slice(&stream[pair[0]..pair[1]]);
            while let Some(frame) = decoder.decode(&mut input).unwrap() {
                match frame {
                    Frame::Parcel(parcel) => found.push(*parcel),
                    Frame::Malformed { error, .. } => panic!("{error}"),
                }
            }
        }
        prop_assert_eq!(found, parcels);
    }

    #[test]
    fn chunks_join_to_the_whole(parcel in arbitrary::parcel(), size in 1_usize..200) {
        let encoded = encode(&parcel).unwrap();
        let mut input = BytesMut::new();
        chunks(&encoded, 77, size).iter().for_each(|chunk| input.extend_from_slice(chunk));
        prop_assert_eq!(decoder().decode(&mut input), Ok(Some(Frame::Parcel(Box::new(parcel)))));
    }

    #[test]
    fn no_bytes_panic(parcel in arbitrary::parcel(), flips in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4)) {
        let mut bytes = encode(&parcel).unwrap().to_vec();
        for (place, byte) in flips {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        if let Ok(Some(Frame::Parcel(parcel))) = decode_one(&bytes) {
            // Content is opened late; that must not panic either.
            let _ = parcel.content.map(|content| content.to_value());
        }
    }
}

fn check_malformed(bytes: &[u8], code: &Code, slot: Option<&str>, position: i64) {
    match decode_one(bytes) {
        Ok(Some(Frame::Malformed { error, .. })) => {
            let named = error.get("slot").and_then(Value::as_str);
            let at = error.get("position").and_then(Value::as_int);
            assert_eq!(
                (&error.code, named, at),
                (code, slot, Some(position)),
                "{error} in {bytes:02x?}"
            );
        }
        other => panic!("not malformed: {other:?} in {bytes:02x?}"),
    }
}

/// A hub opens what is not a message, and content that unpacks to more than a parcel may have costs nobody memory.
#[test]
fn compressed_content_is_a_message_s_and_within_the_limit() {
    let mut parcel = Parcel::new(Family::Message, "m").content("robot ".repeat(1000));
    let refused = |parcel: &Parcel, most: Option<u64>| {
        let packed = Packed::pack(&parcel.content.as_ref().unwrap().to_msgpack().unwrap()).unwrap();
        let mut header = Vec::new();
        super::header::write(parcel, Some(&packed), &mut header).unwrap();
        let mut decoder = decoder();
        if let Some(most) = most {
            decoder.take_packed();
            decoder.set_limits(&Limits {
                parcel: Limit::At(most),
                ..Limits::default()
            });
        }
        let bytes = frame(0, &[&header[..], packed.bytes()].concat());
        match decoder.decode(&mut BytesMut::from(&bytes[..])) {
            Ok(Some(Frame::Malformed { error, .. })) => Some(error.code),
            Ok(Some(Frame::Parcel(_))) => None,
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(refused(&parcel, Some(6003)), None);
    assert_eq!(refused(&parcel, Some(6002)), Some(Code::TOO_LONG));
    assert_eq!(refused(&parcel, None), Some(Code::BAD_SLOT), "not agreed on");
    for family in [Family::Context, Family::Login, Family::Reply, Family::Time] {
        parcel.family = family;
        assert_eq!(refused(&parcel, Some(6003)), Some(Code::BAD_SLOT), "{family}");
    }
}

#[test]
fn a_malformed_header_on_a_healthy_frame() {
    let slot = Code::BAD_SLOT;
    check_malformed(&frame(0, &[]), &slot, None, 1);
    check_malformed(&frame(0, &[0]), &slot, Some("name"), 1);
    check_malformed(&frame(0, &[2, 0]), &Code::BAD_NAME, Some("name"), 2);
    check_malformed(&frame(0, &[2, 0xff, 1]), &slot, None, 2);
    check_malformed(&with_bits(1 << 4, &[0xff; 11]), &slot, None, 4);
    check_malformed(
        &with_bits(1 << 4, &[0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x10]),
        &slot,
        Some("id"),
        4,
    );
    check_malformed(&with_bits(1 << 3, &[1, 2, 3]), &slot, None, 7);
    check_malformed(&with_bits(1 << 10, &[99]), &slot, Some("family"), 5);
    check_malformed(
        &with_bits(1 << 12, &[0x80, 0x80, 0x80, 0x80, 0x20]),
        &slot,
        Some("priority"),
        5,
    );
    check_malformed(&with_bits(1 << 13, &[0]), &slot, Some("address"), 5);
    check_malformed(
        &with_bits(1 << 13, &[0xff, 0xff, 0xff, 0xff, 0x0f, 0]),
        &slot,
        None,
        11,
    );
    check_malformed(&with_bits(1 << 15, &[3]), &slot, Some("delivery"), 6);
    check_malformed(&with_bits(1 << 16, &[2]), &slot, Some("echo"), 6);
    check_malformed(
        &with_bits(1 << 18, &[2, b'/', b'/']),
        &Code::BAD_PATH,
        Some("context"),
        6,
    );
    check_malformed(&with_bits(1 << 2, &[4, 0xff, 0xff]), &Code::BAD_ENCODING, None, 5);
    check_malformed(&with_bits(1 << 19, &[1, 0xc0]), &slot, None, 6);
    check_malformed(
        &with_bits(1 << 19, &[4, 0x81, 0xa2, b'i', b'd']),
        &Code::BAD_CONTENT,
        None,
        11,
    );
}

/// Threat 13: what the known slots say cannot be said again among the others.
#[test]
fn other_slots_cannot_hide_known_ones() {
    let hidden = with_bits(1 << 19, &[5, 0x81, 0xa2, b'i', b'd', 0x01]);
    match decode_one(&hidden) {
        Ok(Some(Frame::Malformed { error, .. })) => assert_eq!(error.get("slot"), Some(&"id".into())),
        other => panic!("{other:?}"),
    }
}

#[test]
fn what_comes_later_can_be_skipped() {
    let mut bytes = frame(200, b"from the future");
    bytes.extend(with_bits(
        1 << 21 | 1 << 62 | 1 << 5,
        &[3, 1, 2, 3, 0, 0xa1, b'y'],
    ));
    let parcel = parcel_of(&bytes);
    assert_eq!((parcel.name(), parcel.value()), ("x", Value::from("y")));
}

fn check_broken(decoder: &mut BinaryDecoder, bytes: &[u8], code: &Code) {
    let error = decoder.decode(&mut BytesMut::from(bytes)).expect_err("broken");
    assert_eq!(&error.code, code, "{error}");
}

/// Threat 6.
#[test]
fn a_broken_frame_ends_the_stream() {
    check_broken(&mut decoder(), &frame(3, &[]), &Code::BAD_FRAME);
    check_broken(&mut decoder(), &[0, 0, 0, 0], &Code::BAD_FRAME);
    check_broken(&mut decoder(), &[0xff; 4], &Code::TOO_LARGE);
    check_broken(
        &mut BinaryDecoder::new(&Limits::default()),
        b"\x8fMOM\x02\x00",
        &Code::BAD_VERSION,
    );
    check_broken(
        &mut BinaryDecoder::new(&Limits::default()),
        b"GET ",
        &Code::BAD_FRAME,
    );
    let small = Limits {
        parcel: Limit::At(10),
        ..Limits::default()
    };
    let mut decoder = decoder();
    decoder.set_limits(&small);
    check_broken(&mut decoder, &[0, 0, 0, 11], &Code::TOO_LARGE);
}

#[test]
fn slots_have_a_bound_of_their_own() {
    let mut narrow = decoder();
    narrow.set_limits(&Limits {
        slots: 1000,
        ..Limits::default()
    });
    let mut read = |parcel: &Parcel| {
        let frame = narrow.decode(&mut BytesMut::from(&encode(parcel).expect("a form").to_vec()[..]));
        frame.expect("healthy").expect("whole")
    };
    let base = Parcel::new(Family::Message, "x").id(7).content("x".repeat(5000));
    let mut coloured = base.clone();
    coloured.extra.set("colour", "y".repeat(900));
    assert!(matches!(read(&coloured), Frame::Parcel(_)), "content is apart");
    coloured.extra.set("colour", "y".repeat(1000));
    let mut addressed = base;
    addressed.address = Some((0..200).map(|number| format!("peer{number}").into()).collect());
    for parcel in [coloured, addressed] {
        let Frame::Malformed { reference, error } = read(&parcel) else {
            panic!("too long");
        };
        assert_eq!((reference, error.code), (Some(7), Code::TOO_LONG));
    }
}

#[test]
fn broken_chunks_end_the_stream() {
    let encoded = Encoded {
        head: frame(0, &[2, 1]).into(),
        body: Bytes::new(),
    };
    let whole = chunks(&encoded, 1, 1);
    assert_eq!(whole.len(), 3);
    let join = |order: &[usize]| {
        order
            .iter()
            .flat_map(|at| whole[*at].to_vec())
            .collect::<Vec<u8>>()
    };
    check_broken(&mut decoder(), &join(&[1]), &Code::BAD_FRAME);
    check_broken(&mut decoder(), &join(&[0, 0]), &Code::BAD_FRAME);
    check_broken(&mut decoder(), &join(&[0, 2]), &Code::BAD_FRAME);
    check_broken(&mut decoder(), &join(&[0, 1, 1, 1]), &Code::BAD_FRAME);
    check_broken(&mut decoder(), &frame(1, &[1, 4]), &Code::BAD_FRAME);
    check_broken(&mut decoder(), &frame(1, &[1, 8]), &Code::BAD_FRAME);
    check_broken(
        &mut decoder(),
        &frame(1, &[1, 1, 0xff, 0xff, 0xff, 0x7f]),
        &Code::TOO_LARGE,
    );
    let mut stranger = BinaryDecoder::new(&Limits::default());
    let early = [&PREFACE[..], &join(&[0])].concat();
    check_broken(&mut stranger, &early, &Code::BAD_FRAME);
    let mut nine = Vec::new();
    (0..9).for_each(|stream| nine.extend(frame(1, &[stream, 1, 5])));
    check_broken(&mut decoder(), &nine, &Code::BAD_FRAME);
    let aborted = [join(&[0]), frame(1, &[1, 4]), join(&[0, 1, 2])].concat();
    assert_eq!(parcel_of(&aborted).name(), "command");
}

/// A stop may overtake the reply to `join`, which would bind the number.
#[test]
fn a_stop_binds_its_number_itself() {
    for (name, binds) in [("stop", true), ("say", false)] {
        let path = Path::parse("/robot/arm").expect("a path");
        let parcel = numbered(Parcel::new(Family::Message, name).context(path.clone()), Some(4));
        let bytes = Form::Binary.encode(&parcel).expect("a form").to_vec();
        let mut decoder = BinaryDecoder::for_peer(&Limits::default());
        let mut input = BytesMut::from(&[&PREFACE[..], &bytes].concat()[..]);
        match decoder.decode(&mut input) {
            Ok(Some(Frame::Parcel(heard))) => {
                assert_eq!((heard.context, binds), (Some(path), true), "{name}");
            }
            other => assert!(!binds && other.is_err(), "{name}: {other:?}"),
        }
    }
}

#[test]
fn a_peer_learns_the_numbers_of_contexts() {
    let path = Path::parse("/robot/arm").unwrap();
    let mut peer = BinaryDecoder::for_peer(&Limits::default());
    assert_eq!(peer.decode(&mut BytesMut::from(&PREFACE[..])), Ok(None));
    let mut feed = |parcel: &Parcel| peer.decode(&mut BytesMut::from(&encode(parcel).unwrap().to_vec()[..]));
    let reply = numbered(Parcel::new(Family::Reply, "ok").context(path.clone()), Some(7));
    let message = numbered(
        Parcel::new(Family::Message, "state").context(path.clone()),
        Some(7),
    );
    assert_eq!(feed(&message).expect_err("not bound yet").code, Code::BAD_FRAME);
    assert_eq!(feed(&reply), Ok(Some(Frame::Parcel(Box::new(reply.clone())))));
    match feed(&message) {
        Ok(Some(Frame::Parcel(parcel))) => assert_eq!(parcel.context, Some(path)),
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_hub_takes_chunks_after_login_and_a_peer_at_once() {
    let parcel = Parcel::new(Family::Event, "joined").content("x".repeat(50));
    let encoded = encode(&Parcel {
        number: Some(ContextNumber(3)),
        context: Some(Path::parse("/chat").unwrap()),
        ..parcel
    });
    let mut input = BytesMut::from(&PREFACE[..]);
    for chunk in chunks(&encoded.unwrap(), 77, 10) {
        input.extend_from_slice(&chunk);
    }
    let limits = Limits::default();
    let mut peer = BinaryDecoder::for_peer(&limits);
    let mut after_login = BinaryDecoder::new(&limits);
    after_login.set_limits(&limits);
    for decoder in [&mut peer, &mut after_login] {
        assert!(matches!(
            decoder.decode(&mut input.clone()),
            Ok(Some(Frame::Parcel(_)))
        ));
    }
    let error = BinaryDecoder::new(&limits).decode(&mut input).unwrap_err();
    assert_eq!(error.code, Code::BAD_FRAME);
    assert!(error.text.contains("until the login is over"), "{error}");
}
