//! Bytes on the wire, written out: the header (S14) and the paper's example of maps (S18).

mod common;

use common::element;
use mom_rsp::{
    Direction, Dropped, Header, Item, Items, Kind, Layout, Number, Payload, Refused, Type, Writer,
};

const WHEEL: Payload = Payload::Numbers(Number::I8, 1);

/// The robot of the paper's figure 8.
static FIGURE: Layout<'static> = Layout::new(
    0x1234,
    [0; 32],
    &[
        element("left-wheel", Kind::Effector, WHEEL),
        element("right-wheel", Kind::Effector, WHEEL),
        element("turret", Kind::Effector, Payload::Numbers(Number::I16, 1)),
        element("range", Kind::Sensor, WHEEL),
        element("note", Kind::MemoryEvent, Payload::Bytes(8)),
        element("ir-fire", Kind::Command, Payload::Nothing),
        element("ir-receiver", Kind::Event, WHEEL),
        element("all", Kind::Module, Payload::Nothing),
    ],
);

#[test]
fn a_header_has_20_bytes_big_endian() {
    let header = Header {
        version: 1,
        model: 0x1234,
        encryption: 1,
        kind: Type::UpData,
        sequence: 0xABCD,
        stamp: 0x0102_0304,
        session: [0x11, 0x22, 0x33, 0x44, 0x55, 0x66],
        last: 0xFEDC,
        buffers: 7,
    };
    let bytes = [
        0x01, 0x12, 0x34, 0x01, 0x81, 0xAB, 0xCD, 0x01, 0x02, 0x03, 0x04, 0x11, 0x22, 0x33, 0x44, 0x55, 0x66,
        0xFE, 0xDC, 0x07,
    ];
    assert_eq!(header.encode(), bytes);
    assert_eq!(Header::decode(&bytes), Ok(header));
    assert_eq!(Header::decode(&bytes[..19]), Err(Dropped::Short));
    let mut unknown = bytes;
    unknown[4] = 0x05;
    assert_eq!(Header::decode(&unknown), Err(Dropped::Type));
}

fn written(items: &[(u8, Item<'_>)]) -> Vec<u8> {
    let mut buffer = [0xEE; 64];
    let mut writer = Writer::new(&FIGURE, Direction::Down, &mut buffer).expect("it fits");
    for (place, item) in items {
        writer.put(*place, *item).expect("it fits");
    }
    let len = writer.finish();
    let parsed: Vec<(u8, Item<'_>)> = Items::parse(&FIGURE, Direction::Down, &buffer[..len])
        .expect("it fits")
        .collect();
    assert_eq!(parsed, items);
    buffer[..len].to_vec()
}

#[test]
fn the_maps_of_the_paper_have_these_payloads() {
    let wheels = [
        (0, Item::Value(&[10])),
        (1, Item::Value(&[0xF6])),
        (2, Item::Value(&[0x01, 0x02])),
    ];
    assert_eq!(written(&wheels), [0b1110_0000, 10, 0xF6, 0x01, 0x02]);
    let mut fire = wheels.to_vec();
    fire.push((5, Item::Call { id: 9, data: &[] }));
    assert_eq!(written(&fire), [0b1110_0100, 10, 0xF6, 0x01, 0x02, 9]);
    let mut heard = wheels.to_vec();
    heard.push((6, Item::Ack(3)));
    assert_eq!(written(&heard), [0b1110_0010, 10, 0xF6, 0x01, 0x02, 3]);
}

#[test]
fn an_uplink_has_values_acknowledgements_and_events() {
    let mut buffer = [0; 64];
    let mut writer = Writer::new(&FIGURE, Direction::Up, &mut buffer).unwrap();
    writer.put(3, Item::Value(&[5])).unwrap();
    writer.put(4, Item::Call { id: 2, data: b"abc" }).unwrap();
    writer.put(5, Item::Ack(9)).unwrap();
    writer.put(6, Item::Call { id: 255, data: &[1] }).unwrap();
    let len = writer.finish();
    assert_eq!(
        buffer[..len],
        [0b0001_1110, 5, 2, 0, 3, b'a', b'b', b'c', 9, 255, 1]
    );
}

/// The page shows the bytes of the tests above, in the same order.
#[test]
fn the_page_shows_these_bytes() {
    let page = include_str!("../../../docs/rsp.md");
    let block = |kind: &str| -> Vec<String> {
        let rest = page.split_once(&format!("```{kind}\n")).expect("a block").1;
        let inside = rest.split_once("```").expect("its end").0;
        inside.lines().map(|line| line.replace(' ', "")).collect()
    };
    assert_eq!(
        block("header"),
        ["011234".to_owned() + "0181abcd01020304112233445566fedc07"]
    );
    let hex = |items: &[(u8, Item<'_>)]| -> String {
        written(items).iter().map(|byte| format!("{byte:02x}")).collect()
    };
    let wheels = [
        (0, Item::Value(&[10][..])),
        (1, Item::Value(&[0xF6])),
        (2, Item::Value(&[0x01, 0x02])),
    ];
    let with = |item| [&wheels[..], &[item]].concat();
    assert_eq!(
        block("bodies"),
        [
            hex(&wheels),
            hex(&with((5, Item::Call { id: 9, data: &[] }))),
            hex(&with((6, Item::Ack(3)))),
            "1e050200036162".to_owned() + "6309ff01",
        ]
    );
}

#[test]
fn what_does_not_fit_the_model_is_said() {
    let parse = |direction, bytes: &[u8]| Items::parse(&FIGURE, direction, bytes).map(Iterator::count);
    assert_eq!(parse(Direction::Down, &[]), Err(Dropped::Map));
    assert_eq!(parse(Direction::Down, &[0x80]), Err(Dropped::Payload), "cut off");
    assert_eq!(
        parse(Direction::Down, &[0x80, 1, 2]),
        Err(Dropped::Payload),
        "too long"
    );
    assert_eq!(
        parse(Direction::Down, &[0x04, 0]),
        Err(Dropped::Payload),
        "a command has no id 0"
    );
    assert_eq!(
        parse(Direction::Down, &[0x08, 0]),
        Ok(1),
        "but a memory event is asked by it"
    );
    assert_eq!(
        parse(Direction::Up, &[0x80, 1]),
        Err(Dropped::Map),
        "an effector says nothing"
    );
    assert_eq!(
        parse(Direction::Up, &[0x08, 1, 0, 9, 0, 0, 0, 0, 0, 0, 0, 0, 0]),
        Err(Dropped::Payload),
        "more than 8 bytes"
    );
    let mut buffer = [0; 3];
    let mut writer = Writer::new(&FIGURE, Direction::Down, &mut buffer).unwrap();
    assert_eq!(writer.put(0, Item::Value(&[1, 2])), Err(Refused::Size));
    assert_eq!(writer.put(0, Item::Ask), Err(Refused::Kind));
    assert_eq!(
        writer.put(5, Item::Call { id: 0, data: &[] }),
        Err(Refused::Value)
    );
    assert_eq!(writer.put(8, Item::Ask), Err(Refused::Element));
    assert_eq!(writer.put(1, Item::Value(&[1])), Ok(()));
    assert_eq!(
        writer.put(0, Item::Value(&[1])),
        Err(Refused::Element),
        "not rising"
    );
    assert_eq!(writer.put(2, Item::Value(&[1, 2])), Err(Refused::Full));
    assert_eq!(writer.finish(), 2);
    assert_eq!(buffer, [0x40, 1, 0]);
}

#[test]
fn bits_behind_the_last_element_are_0() {
    let seven = Layout::new(FIGURE.id(), *FIGURE.hash(), &FIGURE.elements()[..7]);
    assert_eq!(
        Items::parse(&seven, Direction::Down, &[0x01]).map(Iterator::count),
        Err(Dropped::Map)
    );
}
