//! Golden files of the JSON form: each is one line as it stands on the wire, and its parcel.

use bytes::{Bytes, BytesMut};
use mom_proto::codec::Frame;
use mom_proto::json::{JsonDecoder, encode};
use mom_proto::{Delivery, Family, Limits, MAX_ID, Map, Parcel, Path, Time, Value};

/// Whether the file is also what this side writes.
enum Written {
    Exactly,
    Otherwise,
}

fn check(file: &str, bytes: &[u8], expected: &Parcel, written: &Written) {
    let read = |bytes: &[u8]| {
        let mut input = BytesMut::from(bytes);
        let frame = JsonDecoder::new(&Limits::default()).decode(&mut input);
        assert!(input.is_empty(), "{file}: {input:?} is left");
        assert_eq!(
            frame,
            Ok(Some(Frame::Parcel(Box::new(expected.clone())))),
            "{file}"
        );
    };
    read(bytes);
    let encoded = encode(expected).expect("it has a form").to_vec();
    read(&encoded);
    if matches!(written, Written::Exactly) {
        let (encoded, bytes) = (String::from_utf8_lossy(&encoded), String::from_utf8_lossy(bytes));
        assert_eq!(encoded, bytes, "{file}");
    }
}

fn at(micros: i64) -> Option<Time> {
    Time::from_micros(micros)
}

fn binary(bytes: &[u8]) -> Value {
    Value::Binary(Bytes::copy_from_slice(bytes))
}

/// The sample of the design.
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
    let file = include_bytes!("golden/json/login.json");
    check("login", file, &parcel, &Written::Exactly);
}

#[test]
fn reply() {
    let mut parcel = Parcel::new(Family::Reply, "ok");
    parcel.reference = Some(1);
    let file = include_bytes!("golden/json/reply.json");
    check("reply", file, &parcel, &Written::Exactly);
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
    parcel.extra = Map::new()
        .with("colour", "rötlich")
        .with("$x", 1)
        .with("until", Time::MAX);
    let file = include_bytes!("golden/json/all_slots.json");
    check("all_slots", file, &parcel, &Written::Exactly);
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
        .with("no", false)
        .with("text", " <b> & \"c\" 'd'\\/\r\n\t\u{7f}\u{2028}😀")
        .with("empty", "")
        .with("", "")
        .with("1 \"2\n", "k")
        .with("bytes", binary(&[0, 1, 2, 255]))
        .with("none", binary(&[]))
        .with("time", Time::MIN)
        .with("like a tag", Map::new().with("$int", "5").with("b", 1))
        .with("like none", Map::new().with("b", 1).with("$int", "5"))
        .with("list", list);
    let parcel = Parcel::new(Family::Message, "state").content(content);
    let file = include_bytes!("golden/json/kinds.json");
    check("kinds", file, &parcel, &Written::Exactly);
}

#[test]
fn numbers() {
    let most = i64::try_from(MAX_ID).unwrap();
    let list: Vec<Value> = [0, 1, -1, most, -most, most + 1, -most - 1, i64::MIN, i64::MAX]
        .map(Value::Int)
        .into_iter()
        .chain([0.0, -0.0, 1.0, 0.1, 1e16, 5e-324, f64::MAX, f64::MIN_POSITIVE].map(Value::Double))
        .collect();
    let parcel = Parcel::new(Family::Message, "numbers").content(list);
    let file = include_bytes!("golden/json/numbers.json");
    check("numbers", file, &parcel, &Written::Exactly);
}

/// What other writers may write instead.
#[test]
fn by_hand() {
    let content = Map::new()
        .with("text", "Grüße 😀 / \t")
        .with("small", 5)
        .with("one", Value::Double(1.0))
        .with("exponent", Value::Double(100.0))
        .with("beyond", Value::Double(9_223_372_036_854_775_808.0))
        .with("zero", Value::Double(-0.0))
        .with("large", i64::MIN)
        .with("map", Map::new().with("a", Map::new()));
    let mut parcel = Parcel::new(Family::Message, "chat").content(content);
    parcel.timestamp = at(1_795_255_200_000_000);
    parcel.received = at(1_795_255_200_500_000);
    let file = include_bytes!("golden/json/by_hand.json");
    check("by_hand", file, &parcel, &Written::Otherwise);
}
