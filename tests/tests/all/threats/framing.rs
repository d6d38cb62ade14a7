//! Threats 4 and 6: where a parcel ends.

use std::time::Duration;

use bytes::Bytes;
use mom_proto::binary::{ChunkHead, PREFACE, chunks};
use mom_proto::codec::Form;
use mom_proto::{Family, Value, WireError};
use mom_tests::lab;
use mom_tests::raw::{PATIENCE, Raw, message};

use super::{After, World, chat_binary, chat_json, chat_xml, entity, frame};

/// Short enough for a test, long enough for the canary's own logins.
const LOGIN_TIME: u64 = 1500;

/// Threat 4: who does not log in is closed at the deadline, however it passes the time.
#[tokio::test]
async fn threat_4_the_login_deadline() {
    let mut world = World::start_with(|config| config.limits.login_time = LOGIN_TIME).await;
    let login = entity("<parcel><family>login</family><name>login</name>".to_owned() + &" ".repeat(10_000));
    let before = [
        ("a form that is not clear yet", Form::Xml, b"Con".to_vec()),
        (
            "an unfinished element",
            Form::Xml,
            login[..login.len() - 1].to_vec(),
        ),
        (
            "an unfinished line",
            Form::Json,
            chat_json(format!("\"content\":\"{}", "x".repeat(10_000)))[..9_000].to_vec(),
        ),
        (
            "an unfinished frame",
            Form::Binary,
            frame(&[0; 10_000])[..9_000].to_vec(),
        ),
    ];
    for (what, form, bytes) in before {
        let mut slow = world.stranger(form).await;
        let (end, all) = drip(&mut slow, &bytes).await;
        assert_eq!(end.code.word(), "login-timeout", "{what}");
        assert!(!all, "{what}: the deadline came before the end of the bytes");
        slow.check_closed().await;
        world.check_nothing_arrived(what).await;
    }
    // A browser's connection that was opened in advance would take a word for an answer.
    let mut silent = world.stranger(Form::Xml).await;
    let heard = silent.next_within(PATIENCE).await;
    assert!(heard.expect("it is closed").is_none(), "without a word");
    world.check_nothing_arrived("silence").await;
    world.end().await;
}

/// Sends bytes one by one with a pause until an error comes; also whether all of them went out.
async fn drip(slow: &mut Raw, bytes: &[u8]) -> (WireError, bool) {
    let endless = std::iter::once(None)
        .chain(bytes.iter().map(Some))
        .chain(std::iter::repeat(None));
    let mut sent = 0;
    for byte in endless {
        if let Some(byte) = byte {
            slow.send(&[*byte]).await;
            sent += 1;
        }
        if let Some(heard) = slow.next_within(Duration::from_millis(20)).await {
            let heard = heard.expect("an error before the end");
            assert_eq!(heard.family, Family::Error);
            return (
                WireError::from_parcel(&heard),
                sent > 0 && sent == bytes.len() && sent > 100,
            );
        }
    }
    unreachable!("the iterator has no end")
}

/// Threat 4: what is kept of a stranger is bounded at once, not at the deadline.
#[tokio::test]
async fn threat_4_what_is_kept_before_login() {
    kept_before_login(World::start().await).await;
}

pub(super) async fn kept_before_login(mut world: World) {
    let announced = "Content-Type: application/xml\r\nContent-Length: 16385\r\n\r\n";
    let endless = format!("Content-Type: application/xml{}", " ".repeat(1024));
    let long = 16_385_u32.to_be_bytes();
    for (what, form, bytes, code) in [
        (
            "an entity above 16 KiB",
            Form::Xml,
            announced.as_bytes(),
            "too-large",
        ),
        (
            "a header line without end",
            Form::Xml,
            endless.as_bytes(),
            "bad-frame",
        ),
        ("a frame above 16 KiB", Form::Binary, &long[..], "too-large"),
    ] {
        let stranger = world.stranger(form).await;
        world
            .attack_from(stranger, what, bytes, code, After::Closed)
            .await;
    }
    // Requests of strangers are refused one by one, and have no effect.
    let stranger = world.stranger(Form::Xml).await;
    let bytes = entity(chat_xml("<content>psst</content>"));
    world
        .attack_from(stranger, "a message", &bytes, "not-logged-in", After::Kept)
        .await;
    world.end().await;
}

/// Threat 6: lengths that lie, and what they would smuggle in.
#[tokio::test]
async fn threat_6_lengths_in_xml() {
    lengths_in_xml(World::start().await).await;
}

pub(super) async fn lengths_in_xml(mut world: World) {
    let body = chat_xml("<content>smuggled</content>");
    let headed = |lines: &str| [lines.as_bytes(), b"\r\n", body.as_bytes(), &entity(&body)].concat();
    let length = body.len();
    let kind = "Content-Type: application/xml\r\n";
    for (what, lines, code) in [
        ("negative", format!("{kind}Content-Length: -1\r\n"), "bad-frame"),
        (
            "with a sign",
            format!("{kind}Content-Length: +{length}\r\n"),
            "bad-frame",
        ),
        (
            "hexadecimal",
            format!("{kind}Content-Length: 0x{length:x}\r\n"),
            "bad-frame",
        ),
        (
            "with a blank inside",
            format!("{kind}Content-Length: 1 0\r\n"),
            "bad-frame",
        ),
        (
            "a list",
            format!("{kind}Content-Length: {length}, {length}\r\n"),
            "bad-frame",
        ),
        ("empty", format!("{kind}Content-Length:\r\n"), "bad-frame"),
        ("absent", kind.to_owned(), "bad-frame"),
        (
            "twice",
            format!("{kind}Content-Length: {length}\r\ncontent-length: {length}\r\n"),
            "bad-frame",
        ),
        (
            "a blank before the colon",
            format!("{kind}Content-Length : {length}\r\n"),
            "bad-frame",
        ),
        (
            "a folded line",
            format!("{kind}Content-Length:\r\n {length}\r\n"),
            "bad-frame",
        ),
        (
            "chunked too",
            format!("{kind}Content-Length: {length}\r\nTransfer-Encoding: chunked\r\n"),
            "bad-frame",
        ),
        (
            "2^64",
            format!("{kind}Content-Length: 18446744073709551616\r\n"),
            "too-large",
        ),
        (
            "a byte too many",
            format!("{kind}Content-Length: 8388609\r\n"),
            "too-large",
        ),
    ] {
        let bytes = headed(&lines);
        world.attack(what, Form::Xml, &bytes, code, After::Closed).await;
    }
    world.end().await;
}

/// Threat 6: a length that is a number but not this body's.
#[tokio::test]
async fn threat_6_short_and_long() {
    short_and_long(World::start().await).await;
}

pub(super) async fn short_and_long(mut world: World) {
    let body = chat_xml("<content>smuggled</content>");
    for wrong in [body.len() - 9, body.len() - 1, body.len() + 1, body.len() + 40] {
        let head = format!("Content-Type: application/xml\r\nContent-Length: {wrong}\r\n\r\n");
        let bytes = [head.as_bytes(), body.as_bytes(), &entity(&body)].concat();
        let mut attacker = world.attacker(Form::Xml).await;
        attacker.send(&bytes).await;
        // The entity that was cut is malformed, and what follows is not a header.
        let first = attacker.next_error().await;
        assert_eq!(
            first.code.word(),
            "bad-xml",
            "{wrong} for {}: {first}",
            body.len()
        );
        assert_eq!(attacker.next_error().await.code.word(), "bad-frame", "{wrong}");
        attacker.check_closed().await;
        world.check_nothing_arrived("a wrong length").await;
    }
    world.end().await;
}

/// Threat 6: the same in binary, and chunks that do not keep their word.
#[tokio::test]
async fn threat_6_lengths_in_binary() {
    lengths_in_binary(World::start().await).await;
}

pub(super) async fn lengths_in_binary(mut world: World) {
    let smuggled = chat_binary(b"\xa8smuggled".to_vec());
    let payload = &smuggled[4..];
    let chunk = |stream: u8, flags: u8, length: Option<usize>, bytes: &[u8]| {
        let length = length.map(|length| u8::try_from(length).expect("small"));
        let head: Vec<u8> = [1, stream, flags].into_iter().chain(length).collect();
        frame(&[&head, bytes].concat())
    };
    let whole = payload.len();
    let streams: Vec<u8> = (0..9)
        .flat_map(|stream| chunk(stream, 1, Some(100), &[]))
        .collect();
    let huge = frame(&[1, 1, 1, 0xff, 0xff, 0xff, 0xff, 0x7f]);
    for (what, bytes, code) in [
        ("2^32-1", u32::MAX.to_be_bytes().to_vec(), "too-large"),
        (
            "a byte too many",
            8_388_609_u32.to_be_bytes().to_vec(),
            "too-large",
        ),
        ("nothing", frame(&[]), "bad-frame"),
        ("an unknown kind", frame(&[2]), "bad-frame"),
        (
            "longer than announced",
            chunk(1, 3, Some(whole - 1), payload),
            "bad-frame",
        ),
        (
            "shorter than announced",
            chunk(1, 3, Some(whole + 1), payload),
            "bad-frame",
        ),
        ("never begun", chunk(1, 2, None, payload), "bad-frame"),
        ("an abort of nothing", chunk(1, 4, None, &[]), "bad-frame"),
        ("unknown flags", chunk(1, 8, None, &[]), "bad-frame"),
        (
            "begun twice",
            [chunk(1, 1, Some(50), &[]), chunk(1, 1, Some(50), &[])].concat(),
            "bad-frame",
        ),
        ("nine streams", streams, "bad-frame"),
        ("a stream of 32 GiB", huge, "too-large"),
        ("chunks of a chunk", chunk(1, 3, Some(3), &[1, 1, 3]), "bad-frame"),
        ("the preface again", PREFACE.to_vec(), "too-large"),
    ] {
        let bytes = [&bytes[..], &smuggled].concat();
        world
            .attack(what, Form::Binary, &bytes, code, After::Closed)
            .await;
    }
    let stranger = world.stranger(Form::Binary).await;
    let early = [chunk(1, 3, Some(whole), payload), smuggled.clone()].concat();
    world
        .attack_from(
            stranger,
            "chunks before login",
            &early,
            "bad-frame",
            After::Closed,
        )
        .await;
    world.end().await;
}

/// Chunks as they should be: streams between each other, one given up, whole parcels in between; each parcel is said when its
/// last chunk is there.
#[tokio::test]
async fn streams_of_chunks_go_between_each_other() {
    let broker = lab::start().await;
    let mut bob = Raw::login(broker.local_addr(), Form::Binary, "bob").await;
    let mut carol = Raw::login(broker.local_addr(), Form::Binary, "carol").await;
    bob.join(&["/chat"]).await;
    carol.join(&["/chat"]).await;
    let said = |what: usize, size: usize| {
        let parcel = message("chat", "/chat", vec![Value::Int(what as i64); size]);
        Form::Binary.encode(&parcel).expect("a frame")
    };
    let mut streams: Vec<Vec<Bytes>> = (0..8)
        .map(|stream| chunks(&said(stream, 100 * (stream + 1)), stream as u64, 64))
        .collect();
    let mut sent = Vec::new();
    while streams.iter().any(|stream| !stream.is_empty()) {
        for stream in streams.iter_mut().filter(|stream| !stream.is_empty()) {
            sent.extend_from_slice(&stream.remove(0));
        }
        sent.extend_from_slice(&said(99, 1).to_vec());
        if streams[6].len() == 3 {
            streams[6].clear();
            sent.extend_from_slice(ChunkHead::abort(6).bytes());
        }
    }
    carol.send(&sent).await;
    let mut order = Vec::new();
    while order.last() != Some(&7) {
        let content = bob.next_of(Family::Message, "chat").await.value();
        let list = content.as_list().expect("a list");
        let what = list[0].as_int().expect("a number");
        if what != 99 {
            assert_eq!(list.len() as i64, 100 * (what + 1), "whole");
            order.push(what);
        }
    }
    assert_eq!(
        order,
        [0, 1, 2, 3, 4, 5, 7],
        "as their last chunks came, without the one given up"
    );
    carol.check_alive().await;
    broker.stop().await;
}

/// A healthy frame around a header that lies about its own lengths.
#[tokio::test]
async fn threat_6_lengths_inside_a_frame() {
    let mut world = World::start().await;
    let endless = [0xff_u8; 11];
    for (what, bytes) in [
        ("no bits", &b"\0"[..]),
        ("bits without end", &[&b"\0"[..], &endless].concat()),
        ("a name beyond the frame", b"\0\x02\x7ename"),
        (
            "a name of 2^62 bytes",
            &[&b"\0\x02"[..], b"\xfe\xff\xff\xff\xff\xff\xff\xff\x7f"].concat(),
        ),
        ("a word that is not in the table", b"\0\x02\xff\x7f"),
        ("half a timestamp", b"\0\x0a\x01\0\0"),
        ("a million receivers", b"\0\x82\x40\x01\xc0\x84\x3d"),
        ("nobody", b"\0\x82\x40\x01\x00"),
    ] {
        world
            .attack(what, Form::Binary, &frame(bytes), "bad-slot", After::Kept)
            .await;
    }
    for first in [
        &b"SSH-2.0-MOM\r\n"[..],
        b"\x8fMOX\x01\0",
        b"\x16\x03\x01\x02\0\x01\0\x01",
        b"<parcel/>",
    ] {
        let stranger = world.stranger(Form::Xml).await;
        world
            .attack_from(stranger, "no form", first, "bad-frame", After::Closed)
            .await;
    }
    let mut future = Raw::connect(world.address(), Form::Xml).await;
    future.send(b"\x8fMOM\x02\0").await;
    let answer = future.read_to_end().await;
    let words = String::from_utf8_lossy(&answer).into_owned();
    assert!(
        answer.starts_with(&PREFACE) && words.contains("bad-version"),
        "{words:?}"
    );
    world.end().await;
}
