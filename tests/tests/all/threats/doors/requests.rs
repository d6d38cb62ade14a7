//! Threats 6 and 10: requests of HTTP that say it wrong.

use mom_tests::asking::{Asking, request, upgrade};

use crate::threats::World;

/// What would be read if one of the requests before it were shorter than it says, or longer.
const SMUGGLED: &[u8] = b"POST /tunnel HTTP/1.1\r\nHost: hub\r\nContent-Length: 0\r\n\r\n";

/// Sends this, and a request that must never be read behind it: the answer has this status, and the connection ends.
async fn refused(world: &mut World, what: &str, bytes: &[u8], status: u16) {
    let mut asking = Asking::connect(world.address()).await;
    let all = [bytes, SMUGGLED].concat();
    let (one, other) = all.split_at(bytes.len() / 2);
    asking.send(one).await;
    world.canary.check().await;
    asking.send(other).await;
    let answer = asking
        .answer()
        .await
        .unwrap_or_else(|| panic!("{what}: no answer"));
    assert_eq!(answer.status, status, "{what}: {answer:?}");
    asking.check_closed().await;
    world.check_nothing_arrived(what).await;
}

fn head(first: &str, lines: &str) -> Vec<u8> {
    format!("{first}\r\n{lines}\r\n").into_bytes()
}

fn post(lines: &str) -> Vec<u8> {
    head("POST /tunnel HTTP/1.1", &format!("Host: hub\r\n{lines}"))
}

fn get(lines: &str) -> Vec<u8> {
    head("GET / HTTP/1.1", &format!("Host: hub\r\n{lines}"))
}

/// Threat 6: lengths that lie, or that a proxy may read otherwise than the hub.
#[tokio::test]
async fn threat_6_lengths_of_requests() {
    let mut world = World::start().await;
    for (what, bytes, status) in [
        ("a negative length", post("Content-Length: -1\r\n"), 400),
        ("a length with a sign", post("Content-Length: +5\r\n"), 400),
        ("a hexadecimal length", post("Content-Length: 0x5\r\n"), 400),
        (
            "a length with a blank inside",
            post("Content-Length: 1 0\r\n"),
            400,
        ),
        ("an empty length", post("Content-Length:\r\n"), 400),
        (
            "a length of 2^64",
            post("Content-Length: 18446744073709551616\r\n"),
            400,
        ),
        (
            "two lengths",
            post("Content-Length: 5\r\nContent-Length: 6\r\n"),
            400,
        ),
        (
            "a length and chunks",
            post("Content-Length: 3\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n"),
            411,
        ),
        (
            "chunks and a length",
            post("Transfer-Encoding: chunked\r\nContent-Length: 3\r\n\r\n0\r\n"),
            411,
        ),
        ("chunks", post("Transfer-Encoding: chunked\r\n\r\n0\r\n"), 411),
        (
            "chunks of another name",
            post("Transfer-Encoding: chunked, identity\r\n"),
            400,
        ),
        (
            "chunks in HTTP/1.0",
            head("POST /tunnel HTTP/1.0", "Transfer-Encoding: chunked\r\n"),
            400,
        ),
    ] {
        refused(&mut world, what, &bytes, status).await;
    }
    world.end().await;
}

/// Threats 4 and 6: heads that are none, or have no end.
#[tokio::test]
async fn threat_6_heads_of_requests() {
    let mut world = World::start().await;
    for (what, bytes, status) in [
        ("two hosts", get("Host: other\r\n"), 400),
        ("a blank before the colon", get("Content-Length : 3\r\n"), 400),
        ("a folded line", get("X-One: 1\r\n Content-Length: 3\r\n"), 400),
        ("a line without a colon", get("Content-Length\r\n"), 400),
        (
            "a line that begins with a blank",
            head("GET / HTTP/1.1", " Host: hub\r\n"),
            400,
        ),
        ("NUL in a value", get("X-One: 1\0\r\n"), 400),
        (
            "a bare CR in a value",
            get("X-One: 1\rContent-Length: 3\r\n"),
            400,
        ),
        ("no version", b"GET /\r\n\r\n".to_vec(), 400),
        ("another version", head("GET / HTTP/2.0", ""), 400),
        ("a path with a blank", head("GET /a b HTTP/1.1", ""), 400),
        ("a path that is none", head("GET \\ HTTP/1.1", ""), 400),
        (
            "a gigantic first line",
            head(&format!("GET /{} HTTP/1.1", "a".repeat(1 << 20)), ""),
            431,
        ),
        (
            "a header line without end",
            get(&format!("X-One: {}", "a".repeat(1 << 20))),
            431,
        ),
        ("header lines without end", get(&"X: 1\r\n".repeat(100_000)), 431),
        ("65 short header lines", get(&"X: 1\r\n".repeat(64)), 431),
        (
            "a compressed body",
            post("Content-Encoding: gzip\r\nContent-Length: 0\r\n"),
            415,
        ),
    ] {
        refused(&mut world, what, &bytes, status).await;
    }
    world.end().await;
}

/// Threat 6: what RFC 9110 and 9112 let a server take is taken in one way only, and the next request is where it seems to be.
#[tokio::test]
async fn threat_6_lenient_heads_have_one_meaning() {
    let mut world = World::start().await;
    let next = b"GET /next HTTP/1.1\r\nHost: hub\r\n\r\n";
    for (what, head) in [
        (
            "line ends without CR",
            "POST /nowhere HTTP/1.1\nHost: hub\nContent-Length: 3\n\n",
        ),
        (
            "the same length twice",
            "POST /nowhere HTTP/1.1\r\nHost: hub\r\nContent-Length: 3\r\nContent-Length: 3\r\n\r\n",
        ),
        (
            "an empty line before",
            "\r\nPOST /nowhere HTTP/1.1\r\nHost: hub\r\nContent-Length: 3\r\n\r\n",
        ),
    ] {
        let mut asking = Asking::connect(world.address()).await;
        // First one that is answered, so that this is HTTP.
        assert_eq!(asking.ask("GET /", &["Host: hub"], b"").await.status, 200);
        asking.send([head.as_bytes(), b"GET", next].concat()).await;
        for _ in 0..2 {
            let answer = asking.answer().await.unwrap_or_else(|| panic!("{what}: closed"));
            assert_eq!(answer.status, 404, "{what}: {answer:?}");
        }
        world.check_nothing_arrived(what).await;
    }
    world.end().await;
}

/// Threat 6: bodies that are longer or shorter than they say, and garbage where the next request should be.
#[tokio::test]
async fn threat_6_bodies_of_requests() {
    let mut world = World::start().await;
    for garbage in [&b"\0\0\0\x05garbage\r\n\r\n"[..], b"\x16\x03\x01\x02\0\r\n\r\n"] {
        let mut asking = Asking::connect(world.address()).await;
        asking
            .send([&request("GET /", &["Host: hub"], b""), garbage].concat())
            .await;
        assert_eq!(asking.answer().await.expect("an answer").status, 200);
        let answer = asking
            .answer()
            .await
            .unwrap_or_else(|| panic!("no answer to {garbage:?}"));
        assert_eq!(answer.status, 400);
        asking.check_closed().await;
        world.check_nothing_arrived("garbage").await;
    }
    // Who speaks HTTP/2 could not read an answer of HTTP/1.
    let mut asking = Asking::connect(world.address()).await;
    assert_eq!(asking.ask("GET /", &["Host: hub"], b"").await.status, 200);
    asking.send(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n").await;
    asking.check_closed().await;
    // Behind what was asked for no other request is read: it would be part of the WebSocket.
    let mut asking = Asking::connect(world.address()).await;
    let lines = upgrade("mom.json.v1");
    let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
    asking
        .send([request("GET /mom", &lines, b""), SMUGGLED.to_vec()].concat())
        .await;
    assert_eq!(asking.answer().await.expect("an answer").status, 101);
    // A client's frame is masked.
    check_ended(asking).await;
    world.check_nothing_arrived("a request behind an upgrade").await;
    world.end().await;
}

/// Checks that a WebSocket ends as one that is against its protocol.
async fn check_ended(mut asking: Asking) {
    let mut all = Vec::new();
    loop {
        match asking.bytes().await {
            some if some.is_empty() => break,
            some => all.extend(some),
        }
    }
    let close = |frame: &[u8]| frame[0] == 0x88 && frame[2..] == 1002_u16.to_be_bytes();
    assert!(all.windows(4).any(close), "{all:?}");
}

/// Threat 10: nothing is compressed, whatever is offered.
#[tokio::test]
async fn threat_10_compression_is_not_agreed_on() {
    let mut world = World::start().await;
    let mut asking = Asking::connect(world.address()).await;
    let answer = asking
        .ask("GET /", &["Host: hub", "Accept-Encoding: gzip, br"], b"")
        .await;
    assert_eq!((answer.status, answer.header("content-encoding")), (200, None));
    let mut lines = upgrade("mom.json.v1");
    lines.push("Sec-WebSocket-Extensions: permessage-deflate; client_max_window_bits".to_owned());
    let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
    let answer = asking.ask("GET /mom", &lines, b"").await;
    assert_eq!(
        (answer.status, answer.header("sec-websocket-extensions")),
        (101, None)
    );
    // A message that says that it is compressed all the same: refused by its first bit, before any of it is looked at.
    asking.send([0xc1, 0x80, 0, 0, 0, 0]).await;
    check_ended(asking).await;
    world.check_nothing_arrived("compression").await;
    world.end().await;
}
