//! Threats 7, 8, 9 and 37: parcels in several parts.

use std::time::Duration;

use mom_proto::codec::Form;
use mom_proto::{Family, Parcel, Value, WireError};
use mom_tests::raw::Raw;

use super::{After, World, chat_xml, entity, frame};

const IMAGE: &str = "<content type=\"binary\"><cid>one</cid></content>";

/// An entity of several parts: the boundary of its header, and its whole body.
fn multipart(boundary: &str, body: &[u8]) -> Vec<u8> {
    let head = format!(
        "Content-Type: multipart/related; type=\"application/xml\"; boundary=\"{boundary}\"\r\n\
         Content-Length: {}\r\n\r\n",
        body.len()
    );
    [head.as_bytes(), body].concat()
}

/// The beginning of a body: the XML part, without the line end before the next boundary.
fn first(boundary: &str, slots: &str) -> String {
    format!(
        "--{boundary}\r\nContent-Type: application/xml\r\n\r\n{}",
        chat_xml(slots)
    )
}

/// A part of a body.
fn part(boundary: &str, id: &str, data: &str) -> String {
    format!("\r\n--{boundary}\r\nContent-ID: <{id}>\r\n\r\n{data}")
}

/// Threat 7: boundaries that cannot be trusted.
#[tokio::test]
async fn threat_7_boundaries() {
    let mut world = World::start().await;
    let good = |data: &str| first("b", IMAGE) + &part("b", "one", data);
    let long = "b".repeat(71);
    for (what, boundary, body) in [
        ("inside the data", "b", good("a\r\n--b and more") + "\r\n--b--"),
        ("as a prefix", "b", good("a\r\n--bb\r\nmore") + "\r\n--b--"),
        ("missing at the end", "b", good("data")),
        ("half at the end", "b", good("data") + "\r\n--b-"),
        ("followed by more", "b", good("data") + "\r\n--b--\r\nmore"),
        (
            "preceded by more",
            "b",
            "preamble\r\n".to_owned() + &good("data") + "\r\n--b--",
        ),
        ("another one", "c", good("data") + "\r\n--b--"),
        ("over-long", &long, good("data") + "\r\n--b--"),
        ("ending in a blank", "b ", good("data") + "\r\n--b --"),
        (
            "nested",
            "b",
            first("b", IMAGE)
                + "\r\n--b\r\nContent-Type: multipart/mixed; boundary=c\r\nContent-ID: <one>\r\n\r\n--c--\r\n--b--",
        ),
        (
            "no XML first",
            "b",
            "--b\r\nContent-ID: <one>\r\n\r\ndata\r\n--b--".to_owned(),
        ),
        ("no part at all", "b", "--b--".to_owned()),
        (
            "a part without id",
            "b",
            first("b", IMAGE) + "\r\n--b\r\nContent-Type: image/png\r\n\r\ndata\r\n--b--",
        ),
        (
            "another encoding",
            "b",
            first("b", IMAGE)
                + "\r\n--b\r\nContent-ID: <one>\r\nContent-Transfer-Encoding: base64\r\n\r\nAAAA\r\n--b--",
        ),
        (
            "endless part headers",
            "b",
            first("b", IMAGE)
                + "\r\n--b\r\nContent-ID: <one>\r\nContent-X: "
                + &"x".repeat(2000)
                + "\r\n\r\n\r\n--b--",
        ),
    ] {
        let bytes = multipart(boundary, body.as_bytes());
        world
            .attack(what, Form::Xml, &bytes, "bad-mime", After::Kept)
            .await;
    }
    world.end().await;
}

/// Threat 7: entities whose type does not say how to read them.
#[tokio::test]
async fn threat_7_types() {
    let mut world = World::start().await;
    let body = first("b", IMAGE) + &part("b", "one", "data") + "\r\n--b--";
    for (what, kind) in [
        ("no boundary", "multipart/related; type=\"application/xml\""),
        (
            "two boundaries",
            "multipart/related; type=\"application/xml\"; boundary=b; boundary=c",
        ),
        (
            "another root",
            "multipart/related; type=\"text/html\"; boundary=b",
        ),
        ("mixed", "multipart/mixed; boundary=b"),
        ("JSON", "application/json"),
    ] {
        let head = format!("Content-Type: {kind}\r\nContent-Length: {}\r\n\r\n", body.len());
        let bytes = [head.as_bytes(), body.as_bytes()].concat();
        world
            .attack(what, Form::Xml, &bytes, "bad-mime", After::Kept)
            .await;
    }
    world.end().await;
}

/// Threat 8: ids of parts that do not match.
#[tokio::test]
async fn threat_8_ids_of_parts() {
    let mut world = World::start().await;
    let one = part("b", "one", "data");
    let two = part("b", "two", "data");
    let both = "<content type=\"list\"><item type=\"binary\"><cid>one</cid></item>\
                <item type=\"binary\"><cid>one</cid></item></content>";
    for (what, slots, parts, cid) in [
        ("missing", IMAGE, String::new(), "one"),
        ("another one", IMAGE, two.clone(), "one"),
        ("unused", IMAGE, format!("{one}{two}"), "two"),
        ("used twice", both, one.clone(), "one"),
        ("given twice", IMAGE, format!("{one}{one}"), "one"),
        ("unused by anything", "", one.clone(), "one"),
    ] {
        let body = first("b", slots) + &parts + "\r\n--b--";
        let bytes = multipart("b", body.as_bytes());
        let error = world
            .attack(what, Form::Xml, &bytes, "bad-cid", After::Kept)
            .await;
        assert_eq!(error.get("cid"), Some(&Value::from(cid)), "{what}");
        assert!(error.text.contains(cid), "{what}: the words name it too: {error}");
    }
    let bytes = entity(chat_xml(IMAGE));
    world
        .attack("no parts at all", Form::Xml, &bytes, "bad-cid", After::Kept)
        .await;
    // The same, right: it arrives.
    let mut sender = world.attacker(Form::Xml).await;
    let body = first("b", IMAGE) + &one + "\r\n--b--";
    sender.send(&multipart("b", body.as_bytes())).await;
    let heard = world.witness.next_of(Family::Message, "chat").await;
    assert_eq!(heard.value(), Value::Binary("data".into()));
    world.end().await;
}

/// Threat 9: too many parts, a byte too many.
#[tokio::test]
async fn threat_9_too_much() {
    let mut world = World::start().await;
    let ids: Vec<String> = (0..10_000).map(|number| format!("p{number}")).collect();
    let items: String = ids
        .iter()
        .map(|id| format!("<item type=\"binary\"><cid>{id}</cid></item>"))
        .collect();
    let parts: String = ids.iter().map(|id| part("b", id, "x")).collect();
    let body = first("b", &format!("<content type=\"list\">{items}</content>")) + &parts + "\r\n--b--";
    let bytes = multipart("b", body.as_bytes());
    world
        .attack("10 000 parts", Form::Xml, &bytes, "bad-mime", After::Kept)
        .await;
    // The announcement alone is enough: not a byte of the body is sent.
    let head = "Content-Type: multipart/related; type=\"application/xml\"; boundary=b\r\nContent-Length: 8388609\r\n";
    let bytes = head.as_bytes();
    world
        .attack("a byte too many", Form::Xml, bytes, "too-large", After::Closed)
        .await;
    world.end().await;
}

/// Threats 9 and 37: parcels that come too slowly are closed, however the attacker passes the time. Between chunks it can ping, as
/// much as it likes.
#[tokio::test]
async fn threat_9_slow_uploads() {
    let mut world = World::start_with(|config| {
        config.limits.heartbeat = 500;
        config.limits.gone = 3000;
    })
    .await;
    let head = "Content-Type: application/xml\r\nContent-Length: 8388608\r\n\r\n<parcel>";
    // The first chunk of 1 MiB.
    let chunk = frame(&[&[1, 1, 1, 0x80, 0x80, 0x40][..], &[0; 1000]].concat());
    let ways = [
        (Form::Xml, head.as_bytes(), false),
        (Form::Binary, &[0, 0x80, 0, 0, 0, 0], false),
        (Form::Binary, &chunk, true),
    ];
    let mut slow = Vec::new();
    for (form, begin, pings) in ways.iter().cycle().take(9) {
        let mut upload = Raw::login(world.address(), *form, "bob").await;
        upload.send(begin).await;
        slow.push((upload, *pings));
        // The witness says something as it goes, or it would be the one that is gone.
        world.check_nothing_arrived("slow uploads").await;
    }
    let ping = Parcel::new(Family::Time, "ping").content("x".repeat(1000));
    let mut closed = Vec::new();
    while closed.len() < 9 {
        world.check_nothing_arrived("slow uploads").await;
        for (mut upload, pings) in std::mem::take(&mut slow) {
            match pings {
                true => upload.send_parcel(&ping).await,
                false => upload.send(b" ").await,
            }
            // Far below a KiB in a second, in a loop of nine.
            match upload.next_within(Duration::from_millis(5)).await {
                Some(Some(heard)) if heard.family == Family::Error => {
                    closed.push(WireError::from_parcel(&heard).code);
                }
                Some(None) => panic!("an error before the end"),
                _ => slow.push((upload, pings)),
            }
        }
    }
    assert!(closed.iter().all(|code| code.word() == "silent"), "{closed:?}");
    world.end().await;
}
