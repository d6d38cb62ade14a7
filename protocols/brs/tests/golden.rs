//! Golden vectors: bytes and the frames that they are, in both directions (W4, W5, W6).

use mom_brs::file::EXTENDED;
use mom_brs::{Code, Direction, Frame, PAPER, Parser, Table};

fn check(table: &'static Table, direction: Direction, vectors: &[(&str, Code, &[i32], &str)]) {
    for (bytes, code, values, words) in vectors {
        let command = table.get(*code).expect(bytes);
        let frame = Frame::said(command, direction, values).expect(bytes);
        assert!(!frame.is_clamped(), "{bytes}");
        assert_eq!(frame.encode().as_str(), *bytes);
        assert_eq!(frame.to_string(), *bytes);
        assert_eq!(format!("{frame:#}"), *words);
        assert_eq!(command.length(direction), Some(bytes.len()), "{bytes}");

        let mut parser = Parser::new(table, direction);
        let read: Vec<Frame> = parser.feed(bytes.as_bytes()).collect();
        assert_eq!(read, [frame], "{bytes}");
        assert!(parser.faults().is_none() && parser.buffered() == 0, "{bytes}");
    }
    // All of them joined are the same frames.
    let bytes: String = vectors.iter().map(|(bytes, ..)| *bytes).collect();
    let read = Parser::new(table, direction).feed(bytes.as_bytes()).count();
    assert_eq!(read, vectors.len());
}

const COMMANDS: &[(&str, Code, &[i32], &str)] = &[
    ("00", Code::NULL, &[], "null"),
    ("04", Code::STATUS, &[], "status"),
    // The paper's three examples: forward, on the spot, all stop.
    (
        "06 00100 00100",
        Code::MOTOR,
        &[100, 100],
        "motor left=100 right=100",
    ),
    (
        "06 00050 -0050",
        Code::MOTOR,
        &[50, -50],
        "motor left=50 right=-50",
    ),
    ("06 00000 00000", Code::MOTOR, &[0, 0], "motor left=0 right=0"),
    (
        "06 -1000 01000",
        Code::MOTOR,
        &[-1000, 1000],
        "motor left=-1000 right=1000",
    ),
    ("07 00000", Code::LEDS, &[0], "leds data=0"),
    ("07 00255", Code::LEDS, &[255], "leds data=255"),
];

const REPLIES: &[(&str, Code, &[i32], &str)] = &[
    ("00", Code::NULL, &[], "null"),
    ("04 00000", Code::STATUS, &[0], "status bits=0"),
    ("04 00005", Code::STATUS, &[5], "status bits=5"),
    ("04 99999", Code::STATUS, &[99_999], "status bits=99999"),
];

#[test]
fn the_papers_commands() {
    check(&PAPER, Direction::Command, COMMANDS);
    check(&EXTENDED, Direction::Command, COMMANDS);
}

#[test]
fn the_papers_replies() {
    check(&PAPER, Direction::Reply, REPLIES);
    check(&EXTENDED, Direction::Reply, REPLIES);
}

#[test]
fn the_commands_of_our_own_robots() {
    check(
        &EXTENDED,
        Direction::Command,
        &[
            ("10 01500 -0250", Code::GOTO, &[1500, -250], "goto x=1500 y=-250"),
            (
                "11 -9999 99999",
                Code::VIA,
                &[-9999, 99_999],
                "via x=-9999 y=99999",
            ),
            ("12", Code::POSE, &[], "pose"),
        ],
    );
}

#[test]
fn the_replies_of_our_own_robots() {
    check(
        &EXTENDED,
        Direction::Reply,
        &[
            (
                "12 01500 -0250 00359",
                Code::POSE,
                &[1500, -250, 359],
                "pose x=1500 y=-250 heading=359",
            ),
            (
                "90 00192 00168 00001 00020",
                Code::HOLDER,
                &[192, 168, 1, 20],
                "holder a=192 b=168 c=1 d=20",
            ),
        ],
    );
}
