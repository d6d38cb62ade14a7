//! What `docs/PROTOCOL.md` shows is what the codecs take, to the byte.

use bytes::BytesMut;
use mom_proto::binary::{PREFACE, WORDS};
use mom_proto::codec::{Decoder, Form, Frame};
use mom_proto::{Content, Family, Limits, Parcel, Value};
use mom_tests::lab;
use mom_tests::raw::{Raw, at, message};

const DOCUMENT: &str = include_str!("../../../docs/PROTOCOL.md");

/// The insides of the fenced blocks of this kind.
fn blocks(kind: &str) -> Vec<&'static str> {
    let open = format!("```{kind}\n");
    DOCUMENT
        .split(open.as_str())
        .skip(1)
        .map(|rest| {
            rest.split("```")
                .next()
                .unwrap_or_default()
                .trim_end_matches('\n')
        })
        .collect()
}

/// The one parcel in these bytes.
fn read(form: Form, bytes: &[u8]) -> Parcel {
    let mut input = BytesMut::from(bytes);
    let mut decoder = Decoder::new(form, &Limits::default());
    match decoder.decode(&mut input) {
        Ok(Some(Frame::Parcel(parcel))) => {
            assert!(input.is_empty(), "left over: {input:?}");
            *parcel
        }
        other => panic!("{other:?} for {:?}", String::from_utf8_lossy(bytes)),
    }
}

#[test]
fn the_entities_are_exact() {
    let entities: Vec<Parcel> = blocks("entity")
        .iter()
        .map(|block| read(Form::Xml, block.replace('\n', "\r\n").as_bytes()))
        .collect();
    let [login, settings, image] = &entities[..] else {
        panic!("{} entities", entities.len());
    };
    assert!(login.is(Family::Login, "login"));
    assert_eq!(
        settings.value().get("key"),
        Some(&Value::Binary(vec![1, 2, 3, 4].into()))
    );
    assert_eq!(image.value().get("image"), Some(&Value::Binary("PNG".into())));
}

/// What a device answers to two commands.
#[test]
fn the_statuses_are_exact() {
    let [block] = blocks("statuses")[..] else {
        panic!("one block of statuses")
    };
    let lines: Vec<Parcel> = block
        .lines()
        .map(|line| read(Form::Json, format!("{line}\n").as_bytes()))
        .collect();
    let [command, statuses @ ..] = &lines[..] else {
        panic!("a command")
    };
    assert!(command.is(Family::Message, "command"));
    let read = |parcel: &Parcel| {
        assert!(parcel.is(Family::Message, "status"));
        let status: mom_arm::Status = mom_client::from_value(parcel.value()).expect("a status");
        assert_eq!(status.id, parcel.reference);
        status
    };
    let statuses: Vec<mom_arm::Status> = statuses.iter().map(read).collect();
    assert_eq!(statuses.len(), 3);
    let error = statuses[2].error.as_ref().expect("an error");
    let word = |key: &str| error.get(key).cloned();
    assert_eq!(
        (word("name"), word("code")),
        (Some("syntax".into()), Some(5001.into()))
    );
}

#[test]
fn the_lines_are_exact() {
    let [block] = blocks("json")[..] else {
        panic!("one block of lines")
    };
    let lines: Vec<Parcel> = block
        .lines()
        .map(|line| read(Form::Json, format!("{line}\n").as_bytes()))
        .collect();
    let [login, join, settings] = &lines[..] else {
        panic!("{} lines", lines.len())
    };
    assert!(login.is(Family::Login, "login") && join.is(Family::Context, "join"));
    let content = settings.value();
    for (key, value) in [
        ("key", Value::Binary(vec![1, 2, 3, 4].into())),
        ("pixels", i64::MAX.into()),
        ("zoom", Value::Double(1.0)),
    ] {
        assert_eq!(content.get(key), Some(&value), "{key}");
    }
    assert!(matches!(content.get("since"), Some(Value::Time(_))));
}

#[test]
fn the_frames_are_exact() {
    let [block] = blocks("frames")[..] else {
        panic!("one block of frames")
    };
    let frames: Vec<Parcel> = block
        .lines()
        .map(|line| {
            let hex = line
                .split(' ')
                .map(|byte| u8::from_str_radix(byte, 16).expect("hexadecimal"));
            read(Form::Binary, &PREFACE.into_iter().chain(hex).collect::<Vec<u8>>())
        })
        .collect();
    let [login, command, pong] = &frames[..] else {
        panic!("{} frames", frames.len())
    };
    assert!(login.is(Family::Login, "login") && login.value().get("name") == Some(&Value::from("alice")));
    assert!(command.is(Family::Message, "command") && command.value() == Value::from("grip open"));
    assert_eq!(
        (command.id, command.number.map(|number| number.0)),
        (Some(7), Some(5))
    );
    assert!(pong.is(Family::Time, "pong") && pong.reference == Some(0));
}

#[test]
fn the_compressed_frame_is_exact() {
    let [block] = blocks("compressed")[..] else {
        panic!("one compressed frame")
    };
    let bytes = block
        .split_whitespace()
        .map(|byte| u8::from_str_radix(byte, 16).expect("hexadecimal"));
    let read = Form::Packed.read(&bytes.collect::<Vec<u8>>()).expect("healthy");
    let [message] = &read[..] else {
        panic!("{} parcels", read.len())
    };
    assert!(matches!(message.content, Some(Content::Packed(_))));
    assert!(message.is(Family::Message, "m") && message.number.map(|number| number.0) == Some(5));
    assert_eq!(message.value(), Value::Binary(vec![0; 512].into()));
}

#[test]
fn the_words_are_all_there_in_order() {
    let table = DOCUMENT
        .split("| number | words |")
        .nth(1)
        .expect("the table of words");
    let rows = table.lines().skip(2).take_while(|line| line.starts_with('|'));
    let mut words = Vec::new();
    for row in rows {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let first = cells[1].split('–').next().unwrap_or_default();
        assert_eq!(first, words.len().to_string(), "{row}");
        words.extend(cells[2].split(", ").map(|word| word.trim_matches('`')));
    }
    assert_eq!(words, WORDS);
}

#[test]
fn the_limits_are_all_there_with_their_defaults() {
    for (key, value) in Limits::default().to_map() {
        let number = value.as_int().expect("no default is unlimited");
        assert!(
            DOCUMENT.contains(&format!("| `{key}` | {number} |")),
            "{key} {number}"
        );
    }
}

#[test]
fn the_transcript_is_of_parcels() {
    let lines = DOCUMENT
        .lines()
        .filter_map(|line| line.split_once("> <").or_else(|| line.split_once("< <")));
    let mut count = 0;
    for (_, body) in lines.filter(|(who, _)| *who == "alice" || *who == "bob") {
        let body = format!("<{body}");
        let slip = body.contains("<priority>high</priority>");
        let entity = format!(
            "Content-Type: application/xml\r\nContent-Length: {}\r\n\r\n{body}",
            body.len()
        );
        if !slip {
            read(Form::Xml, entity.as_bytes());
        }
        count += 1;
    }
    assert!(count > 30, "{count} parcels");
}

/// "A parcel that gives both number and path binds the number to the path; the hub's replies and events do so."
#[tokio::test(flavor = "multi_thread")]
async fn what_the_hub_says_of_a_context_has_path_and_number() {
    let broker = lab::start().await;
    let mut alice = Raw::login(broker.local_addr(), Form::Binary, "alice").await;
    let joined = |path| Parcel::new(Family::Context, "join").context(at(path));
    alice.ask(joined("/robot")).await.expect("people may");
    let id = alice.post(joined("/robot/arm")).await;
    let number = alice.answer(id).await.expect("people may").number;
    assert!(number.is_some());
    let mut stop = message("stop", "/robot/arm", "x".repeat(8 * 1024));
    stop.receipt = Some(true);
    let id = alice.post(stop).await;
    let shortened = alice.next_of(Family::Event, "shortened").await;
    let receipt = alice.answer(id).await.expect("it is sent");
    for parcel in [shortened, receipt] {
        assert_eq!((parcel.context, parcel.number), (Some(at("/robot/arm")), number));
    }
    broker.stop().await;
}
