//! Golden files of the binary form: each is the hex of one frame, and its parcel. They may never change: peers
//! in the field speak them.

use bytes::{Bytes, BytesMut};
use mom_proto::binary::{BinaryDecoder, PREFACE, encode};
use mom_proto::codec::Frame;
use mom_proto::{ContextNumber, Delivery, Family, Limits, Map, Parcel, Path, Time, Value};

fn check(file: &str, hex: &str, expected: &Parcel) {
    let digits: String = hex.lines().filter(|line| !line.starts_with('#')).collect();
    let digits: Vec<u8> = digits
        .bytes()
        .filter(|byte| !byte.is_ascii_whitespace())
        .collect();
    let digit = |byte: u8| {
        char::from(byte)
            .to_digit(16)
            .expect("golden files hold hex digits")
    };
    let byte = |pair: &[u8]| u8::try_from(digit(pair[0]) * 16 + digit(pair[1])).expect("two digits");
    let bytes: Vec<u8> = digits.chunks(2).map(byte).collect();
    let written: String = encode(expected)
        .expect("it has a form")
        .to_vec()
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    assert_eq!(
        written,
        bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>(),
        "{file}"
    );
    let mut input = BytesMut::from(&[&PREFACE[..], &bytes].concat()[..]);
    let frame = BinaryDecoder::new(&Limits::default()).decode(&mut input);
    assert_eq!(
        frame,
        Ok(Some(Frame::Parcel(Box::new(expected.clone())))),
        "{file}"
    );
}

fn time(micros: i64) -> Option<Time> {
    Time::from_micros(micros)
}

#[test]
fn login() {
    let content = Map::new().with("name", "alice").with("password", "secret");
    let parcel = Parcel::new(Family::Login, "login")
        .id(1)
        .context(Path::root())
        .content(content);
    check("login", include_str!("golden/binary/login.hex"), &parcel);
}

#[test]
fn command_as_the_hub_passes_it_on() {
    let mut parcel = Parcel::new(Family::Message, "command").id(7).content("grip open");
    parcel.number = Some(ContextNumber(5));
    parcel.sender = Some("alice".into());
    parcel.timestamp = time(1_795_255_200_000_123);
    parcel.fence = Some((1 << 20) + 3);
    parcel.received = time(1_795_255_200_000_456);
    parcel.age = Some(0);
    check("command", include_str!("golden/binary/command.hex"), &parcel);
}

#[test]
fn all_slots() {
    let mut parcel = Parcel::new(Family::Event, "lights")
        .id(300)
        .context(Path::parse("/a/b").unwrap());
    parcel.number = Some(ContextNumber(129));
    parcel.reference = Some(2);
    parcel.address = Some(vec!["bob".into(), "hub".into()]);
    parcel.priority = Some(-5);
    parcel.expires = Some(250);
    parcel.delivery = Some(Delivery::Fleeting);
    parcel.age = Some(-1);
    parcel.age_error = Some(9);
    parcel.echo = Some(false);
    parcel.receipt = Some(true);
    parcel.extra.set("colour", "red");
    let list = vec![
        Value::Null,
        Value::Bool(true),
        Value::Int(-1),
        Value::Double(0.5),
        Value::Time(time(1).unwrap()),
        Value::Binary(Bytes::from_static(b"\x00\xff")),
    ];
    parcel.content = Some(Value::List(list).into());
    check("all_slots", include_str!("golden/binary/all_slots.hex"), &parcel);
}
