//! Golden files of the XML form: each is one entity as it stands on the wire, and its parcel.

use bytes::{Bytes, BytesMut};
use mom_proto::codec::Frame;
use mom_proto::xml::{XmlDecoder, encode};
use mom_proto::{Delivery, Family, Limits, MAX_ID, Map, Parcel, Path, Time, Value};

/// Whether the file is also what this side writes.
enum Written {
    Exactly,
    Otherwise,
}

fn check(file: &str, bytes: &[u8], expected: &Parcel, written: &Written) {
    let mut input = BytesMut::from(bytes);
    let frame = XmlDecoder::new(&Limits::default()).decode(&mut input);
    assert_eq!(
        frame,
        Ok(Some(Frame::Parcel(Box::new(expected.clone())))),
        "{file}"
    );
    assert!(input.is_empty(), "{file}: {input:?} is left");
    let encoded = encode(expected).expect("it has a form").to_vec();
    match *written {
        Written::Exactly => {
            let (encoded, bytes) = (String::from_utf8_lossy(&encoded), String::from_utf8_lossy(bytes));
            assert_eq!(encoded, bytes, "{file}");
        }
        Written::Otherwise => {
            let again = XmlDecoder::new(&Limits::default()).decode(&mut BytesMut::from(&encoded[..]));
            assert_eq!(
                again,
                Ok(Some(Frame::Parcel(Box::new(expected.clone())))),
                "{file}"
            );
        }
    }
}

fn at(micros: i64) -> Option<Time> {
    Time::from_micros(micros)
}

fn binary(bytes: &[u8]) -> Value {
    Value::Binary(Bytes::copy_from_slice(bytes))
}

/// The sample of the design, to the byte.
#[test]
fn login() {
    let mut parcel = Parcel::new(Family::Login, "login")
        .id(1)
        .context(Path::root())
        .content(
            Map::new()
                .with("name", "alice")
                .with("password", "secret")
                .with("nickname", "ally"),
        );
    parcel.timestamp = at(1_795_255_200_000_123);
    check(
        "login",
        include_bytes!("golden/xml/login.mime"),
        &parcel,
        &Written::Otherwise,
    );
}

#[test]
fn reply() {
    let mut parcel = Parcel::new(Family::Reply, "ok");
    parcel.reference = Some(1);
    check(
        "reply",
        include_bytes!("golden/xml/reply.mime"),
        &parcel,
        &Written::Exactly,
    );
}

#[test]
fn all_slots() {
    let mut parcel = Parcel::new(Family::Message, "command")
        .id(MAX_ID)
        .context(Path::parse("/robot/arm").unwrap())
        .content("grip open");
    parcel.reference = Some(0);
    parcel.sender = Some("alice~2".into());
    parcel.address = Some(vec!["arm".into(), "bob".into()]);
    parcel.timestamp = at(-1);
    parcel.priority = Some(-100);
    parcel.expires = Some(250);
    parcel.delivery = Some(Delivery::Latest);
    parcel.fence = Some(1_048_577);
    parcel.received = at(1_795_255_200_000_000);
    parcel.age = Some(-3);
    parcel.age_error = Some(12);
    parcel.echo = Some(false);
    parcel.receipt = Some(true);
    parcel.extra = Map::new().with("colour", "rötlich").with("urn:x", 1);
    check(
        "all_slots",
        include_bytes!("golden/xml/all_slots.mime"),
        &parcel,
        &Written::Exactly,
    );
}

#[test]
fn kinds() {
    let list = vec![
        Value::from(""),
        Value::List(vec![]),
        Map::new().with("a", Map::new()).into(),
        Time::MAX.into(),
    ];
    let content = Map::new()
        .with("nothing", Value::Null)
        .with("yes", true)
        .with("least", i64::MIN)
        .with("tiny", Value::Double(5e-324))
        .with("zero", Value::Double(-0.0))
        .with("text", " <b> & \"c\" 'd'\r\n\t")
        .with("empty", "")
        .with("slot", "s")
        .with("XML", "x")
        .with("1 <2\n\"", "k")
        .with("", "")
        .with("item", "not special here")
        .with("bytes", binary(&[0, 1, 2, 255]))
        .with("none", binary(&[]))
        .with("list", list);
    let parcel = Parcel::new(Family::Message, "state").content(content);
    check(
        "kinds",
        include_bytes!("golden/xml/kinds.mime"),
        &parcel,
        &Written::Exactly,
    );
}

#[test]
fn image() {
    let mut data: Vec<u8> = (0..=255).collect();
    data.extend_from_slice(b"\r\n--mom-0--\r\n--mom-2");
    let mut parcel = Parcel::new(Family::Message, "image").content(Map::new().with("image", binary(&data)));
    parcel.extra.set("thumb", binary(&[255; 65]));
    check(
        "image",
        include_bytes!("golden/xml/image.mime"),
        &parcel,
        &Written::Exactly,
    );
}

#[test]
fn by_hand() {
    let content = Map::new()
        .with("text", "one\ntwo")
        .with("greeting", "\"Grüße\" > ]] > '")
        .with("plain", "");
    let parcel = Parcel::new(Family::Message, "chat").content(content);
    check(
        "by_hand",
        include_bytes!("golden/xml/by_hand.mime"),
        &parcel,
        &Written::Otherwise,
    );
}

#[test]
fn related_by_hand() {
    let list = vec![
        binary(b"\xff\xd8\r\n--=_ 'B.1"),
        binary(b""),
        binary(&[0, 1, 2, 255]),
    ];
    let parcel = Parcel::new(Family::Message, "x").content(list);
    check(
        "related_by_hand",
        include_bytes!("golden/xml/related_by_hand.mime"),
        &parcel,
        &Written::Otherwise,
    );
}

/// Binary parts are not copied: they lie in the memory that was read.
#[test]
fn parts_share_the_input() {
    let mut input = BytesMut::from(&include_bytes!("golden/xml/image.mime")[..]);
    let range = input.as_ptr_range();
    let Ok(Some(Frame::Parcel(parcel))) = XmlDecoder::new(&Limits::default()).decode(&mut input) else {
        panic!("no parcel");
    };
    let thumb = parcel.extra.get("thumb").and_then(Value::as_binary).unwrap();
    assert!(range.contains(&thumb.as_ptr()));
}
