use std::future::poll_fn;
use std::io::IoSlice;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use proptest::prelude::*;
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::time::timeout;

use super::frame::{BINARY, TEXT, add};
use super::*;

const PING: u8 = 9;
const PONG: u8 = 10;
const PATIENCE: Duration = Duration::from_secs(60);
const MASK: [u8; 4] = [0x37, 0xfa, 0x21, 0x3d];

const HUB: Rules = Rules {
    text: false,
    client: false,
};
const HUB_TEXT: Rules = Rules { text: true, ..HUB };
const CLIENT: Rules = Rules {
    text: false,
    client: true,
};
const CLIENT_TEXT: Rules = Rules { text: true, ..CLIENT };

/// What becomes of bytes that arrive in these pieces: what the reader gets, and what is answered.
fn arrive(rules: Rules, pieces: &[&[u8]]) -> Result<(Vec<u8>, Vec<u8>), Fault> {
    let (mut incoming, mut room, mut out) = (Incoming::default(), Vec::new(), BytesMut::new());
    for piece in pieces {
        incoming.take(&mut piece.to_vec(), rules, &mut room, &mut out, 0)?;
    }
    Ok((room, out.to_vec()))
}

fn read(rules: Rules, bytes: &[u8]) -> Vec<u8> {
    arrive(rules, &[bytes]).expect("well-formed").0
}

fn status(rules: Rules, bytes: &[u8]) -> u16 {
    let refused = arrive(rules, &[bytes]).expect_err("refused").status;
    // Its head is enough, and the way it is cut makes no difference.
    let single: Vec<&[u8]> = bytes.chunks(1).collect();
    assert_eq!(arrive(rules, &single).expect_err("refused").status, refused);
    refused
}

fn frame(kind: u8, last: bool, payload: &[u8], rules: Rules) -> Vec<u8> {
    let mut out = BytesMut::new();
    // As the other side sends it.
    add(&mut out, kind, last, &[payload], (!rules.client).then_some(MASK));
    out.to_vec()
}

/// RFC 6455, 5.7.
#[test]
fn the_examples_of_the_standard() {
    let hello: [u8; 7] = [0x81, 5, 0x48, 0x65, 0x6c, 0x6c, 0x6f];
    let masked: [u8; 11] = [0x81, 0x85, 0x37, 0xfa, 0x21, 0x3d, 0x7f, 0x9f, 0x4d, 0x51, 0x58];
    let first: [u8; 5] = [1, 3, 0x48, 0x65, 0x6c];
    let second: [u8; 4] = [0x80, 2, 0x6c, 0x6f];
    assert_eq!(frame(TEXT, true, b"Hello", CLIENT_TEXT), hello);
    assert_eq!(frame(TEXT, true, b"Hello", HUB_TEXT), masked);
    assert_eq!(frame(TEXT, false, b"Hel", CLIENT_TEXT), first);
    assert_eq!(frame(CONTINUATION, true, b"lo", CLIENT_TEXT), second);
    assert_eq!(read(CLIENT_TEXT, &hello), b"Hello\n");
    assert_eq!(read(HUB_TEXT, &masked), b"Hello\n");
    assert_eq!(read(CLIENT_TEXT, &[&first[..], &second].concat()), b"Hello\n");

    let (mut ping, mut pong) = (hello, masked);
    (ping[0], pong[0]) = (0x89, 0x8a);
    assert_eq!(frame(PING, true, b"Hello", CLIENT), ping);
    let (heard, answered) = arrive(CLIENT, &[&ping]).expect("well-formed");
    assert_eq!((heard.len(), answered.len()), (0, pong.len()));
    assert_eq!(answered[..2], pong[..2]);
    let mut said = answered[6..].to_vec();
    let mut mask = [0; 4];
    mask.copy_from_slice(&answered[2..6]);
    frame::apply(&mut said, mask, 0);
    assert_eq!(said, b"Hello");
    assert_eq!(arrive(HUB, &[&pong]).expect("well-formed"), (vec![], vec![]));

    for (size, head) in [
        (256, &[0x82, 0x7e, 1, 0][..]),
        (65536, &[0x82, 0x7f, 0, 0, 0, 0, 0, 1, 0, 0]),
    ] {
        let payload = vec![7; size];
        let whole = frame(BINARY, true, &payload, CLIENT);
        assert_eq!(&whole[..head.len()], head);
        assert_eq!(read(CLIENT, &whole), payload);
    }
}

/// Work that brings nothing is bounded, whatever the frames are called and wherever they are cut.
#[test]
fn frames_without_payload_have_a_rate() {
    let ping = frame(PING, true, b"", HUB);
    let full = frame(PING, true, &[7; 125], HUB);
    let pong = frame(PONG, true, b"?", HUB);
    let empty = frame(BINARY, true, b"", HUB);
    let parts = [
        frame(BINARY, false, b"", HUB),
        frame(CONTINUATION, true, b"", HUB),
    ]
    .concat();
    for idle in [ping, full, pong, empty, parts] {
        let most = idle.repeat(1000);
        assert_eq!(arrive(HUB, &[&most]).expect("a burst").0, b"");
        assert_eq!(status(HUB, &[most, idle].concat()), 1008);
    }
    let (mut incoming, mut room, mut out) = (Incoming::default(), Vec::new(), BytesMut::new());
    let mut take = |count: usize, now| {
        let mut bytes = frame(PING, true, b"", HUB).repeat(count);
        incoming.take(&mut bytes, HUB, &mut room, &mut out, now)
    };
    assert_eq!(take(1000, 0), Ok(()));
    assert_eq!(take(100, 1_000_000), Ok(()), "a hundred come back each second");
    assert_eq!(take(1, 1_000_000).map_err(|fault| fault.status), Err(1008));
    // Those that bring something are no part of it.
    let payload = frame(BINARY, true, b"?", HUB).repeat(5000);
    assert_eq!(read(HUB, &payload).len(), 5000);
    let streamed = [
        frame(BINARY, false, b"?", HUB),
        frame(CONTINUATION, true, b"", HUB),
    ]
    .concat();
    assert_eq!(read(HUB, &streamed.repeat(5000)).len(), 5000);
}

/// The sizes at which a head grows.
#[test]
fn heads_of_every_length() {
    for size in [0, 1, 125, 126, 127, 65535, 65536, 70_000] {
        let payload: Vec<u8> = (0..size).map(|at: usize| (at % 251) as u8).collect();
        for rules in [HUB, CLIENT] {
            let whole = frame(BINARY, true, &payload, rules);
            let mask = if rules.client { 0 } else { 4 };
            let length = match size {
                0..=125 => 2,
                126..=65535 => 4,
                _ => 10,
            };
            assert_eq!(whole.len(), length + mask + size);
            assert_eq!(read(rules, &whole), payload);
        }
    }
}

#[test]
fn clients_mask_and_hubs_do_not() {
    assert_eq!(status(HUB, &frame(BINARY, true, b"plain", CLIENT)), 1002);
    assert_eq!(status(CLIENT, &frame(BINARY, true, b"masked", HUB)), 1002);
    assert_eq!(status(HUB, &frame(PING, true, b"", CLIENT)), 1002);
}

#[test]
fn what_is_no_frame_is_refused_with_its_status() {
    let masked = |head: u8, second: u8| [&[head, second | 0x80][..], &MASK, &[0; 130]].concat();
    for reserved in [0x40, 0x20, 0x10] {
        assert_eq!(status(HUB, &masked(0x82 | reserved, 1)), 1002);
    }
    for kind in (3..8).chain(11..16) {
        assert_eq!(status(HUB, &masked(0x80 | kind, 1)), 1002, "{kind}");
    }
    for kind in [8, PING, PONG] {
        assert_eq!(status(HUB, &masked(kind, 1)), 1002, "a part of {kind}");
        let long = [&[0x80 | kind, 0x80 | 126, 0, 126][..], &MASK, &[0; 126]].concat();
        assert_eq!(status(HUB, &long), 1002, "a long {kind}");
        let full = match kind {
            8 => [&[0x03, 0xe8][..], &[b'x'; 123]].concat(),
            _ => vec![0; 125],
        };
        assert!(arrive(HUB, &[&frame(kind, true, &full, HUB)]).is_ok());
    }
    let endless = [&[0x82, 0xff][..], &[0xff; 8], &MASK].concat();
    assert_eq!(status(HUB, &endless), 1002);
    assert_eq!(status(HUB, &frame(CONTINUATION, true, b"of nothing", HUB)), 1002);
    let begun = frame(BINARY, false, b"begun", HUB);
    for rules in [HUB, HUB_TEXT] {
        let kind = if rules.text { TEXT } else { BINARY };
        let twice = [frame(kind, false, b"1", rules), frame(kind, true, b"2", rules)].concat();
        assert_eq!(status(rules, &twice), 1002);
    }
    let over = [
        begun,
        frame(CONTINUATION, true, b"", HUB),
        frame(CONTINUATION, true, b"", HUB),
    ];
    assert_eq!(status(HUB, &over.concat()), 1002);
    assert_eq!(status(HUB, &frame(TEXT, true, b"{}", HUB)), 1003);
    assert_eq!(status(HUB_TEXT, &frame(BINARY, true, b"{}", HUB)), 1003);
}

/// A close frame has no payload, or a status that may be sent, and words.
#[test]
fn a_close_frame_says_why_or_nothing() {
    let close = |payload: &[u8]| {
        arrive(HUB, &[&frame(8, true, payload, HUB)])
            .err()
            .map(|fault| fault.status)
    };
    let with = |status: u16, words: &[u8]| close(&[&status.to_be_bytes()[..], words].concat());
    assert_eq!(close(b""), None);
    assert_eq!(close(&[3]), Some(1002));
    for status in [1000, 1001, 1002, 1003, 1007, 1011, 1014, 3000, 4000, 4999] {
        assert_eq!(with(status, b""), None, "{status}");
        assert_eq!(with(status, "Schluß".as_bytes()), None, "{status}");
        assert_eq!(with(status, &[0xff]), Some(1007), "{status}");
    }
    for status in [0, 999, 1004, 1005, 1006, 1015, 1016, 2999, 5000, u16::MAX] {
        assert_eq!(with(status, b""), Some(1002), "{status}");
    }
}

/// A character may be cut anywhere, but not at the end of its message.
#[test]
fn a_text_is_utf_8() {
    let text = "{\"a\":\"grüße, 機械 🤖\"}";
    let whole = frame(TEXT, true, text.as_bytes(), HUB_TEXT);
    let heard = format!("{text}\n").into_bytes();
    for at in 0..whole.len() {
        let (first, second) = whole.split_at(at);
        assert_eq!(arrive(HUB_TEXT, &[first, second]).expect("a text").0, heard);
    }
    for at in 0..text.len() {
        let (first, second) = text.as_bytes().split_at(at);
        let fragments = [
            frame(TEXT, false, first, HUB_TEXT),
            frame(PING, true, b"\xff", HUB_TEXT),
            frame(CONTINUATION, false, b"", HUB_TEXT),
            frame(CONTINUATION, true, second, HUB_TEXT),
        ];
        assert_eq!(read(HUB_TEXT, &fragments.concat()), heard);
        let expected = if text.is_char_boundary(at) {
            None
        } else {
            Some(1007)
        };
        let ended = [
            frame(TEXT, true, first, HUB_TEXT),
            frame(TEXT, true, second, HUB_TEXT),
        ]
        .concat();
        let refused = arrive(HUB_TEXT, &[&ended]).err().map(|fault| fault.status);
        assert_eq!(refused, expected, "{at}");
    }
    for wrong in [
        &b"\xff"[..],
        b"a\xc0\x80",
        b"\xed\xa0\x80",
        b"\xf4\x90\x80\x80",
        b"\xce\xba\xe1\xbd\xb9\xcf\x83\xce\xbc\xce\xb5\xed\xa0\x80",
    ] {
        assert_eq!(
            status(HUB_TEXT, &frame(TEXT, true, wrong, HUB_TEXT)),
            1007,
            "{wrong:?}"
        );
        // Nobody waits for the rest of what cannot become a text.
        assert_eq!(
            status(HUB_TEXT, &frame(TEXT, false, wrong, HUB_TEXT)),
            1007,
            "{wrong:?}"
        );
        assert_eq!(read(HUB, &frame(BINARY, true, wrong, HUB)), wrong);
    }
}

/// The form that is made of lines has one for each message, whatever line ends are in it.
#[test]
fn a_message_is_one_line() {
    let text = b"{\n  \"a\": 1\r\n}\n";
    let heard = read(HUB_TEXT, &frame(TEXT, true, text, HUB_TEXT));
    assert_eq!(heard, b"{\r  \"a\": 1\r\r}\r\n");
    assert_eq!(read(HUB, &frame(BINARY, true, text, HUB)), text);
}

/// A message in fragments with control frames between them, of one who masks.
#[derive(Clone, Debug)]
enum Sent {
    Message(Vec<Vec<u8>>),
    Ping(Vec<u8>),
    Pong(Vec<u8>),
}

fn sent() -> impl Strategy<Value = Vec<Sent>> {
    let payload = |most| proptest::collection::vec(any::<u8>(), 0..most);
    let fragments = proptest::collection::vec(payload(300), 1..4);
    let one = prop_oneof![
        2 => fragments.prop_map(Sent::Message),
        1 => payload(126).prop_map(Sent::Ping),
        1 => payload(126).prop_map(Sent::Pong),
    ];
    proptest::collection::vec(one, 0..8)
}

proptest! {
    /// However the bytes are cut, the same comes out, and each ping is answered.
    #[test]
    fn any_split_of_the_bytes(
        all in sent(),
        mut cuts in proptest::collection::vec(any::<prop::sample::Index>(), 0..20),
        mask in any::<[u8; 4]>(),
    ) {
        let (mut bytes, mut heard, mut pongs) = (BytesMut::new(), Vec::new(), BytesMut::new());
        for sent in &all {
            match sent {
                Sent::Message(fragments) => for (at, fragment) in fragments.iter().enumerate() {
                    let kind = if at == 0 { BINARY } else { CONTINUATION };
                    // What belongs to the connection may come between what belongs to a message.
                    add(&mut bytes, PING, true, &[&[at as u8]], Some(mask));
                    add(&mut pongs, PONG, true, &[&[at as u8]], None);
                    add(&mut bytes, kind, at + 1 == fragments.len(), &[fragment], Some(mask));
                    heard.extend_from_slice(fragment);
                },
                Sent::Ping(payload) => {
                    add(&mut bytes, PING, true, &[payload], Some(mask));
                    add(&mut pongs, PONG, true, &[payload], None);
                }
                Sent::Pong(payload) => add(&mut bytes, PONG, true, &[payload], Some(mask)),
            }
        }
        let mut places: Vec<usize> = cuts.drain(..).map(|cut| cut.index(bytes.len() + 1)).collect();
        places.extend([0, bytes.len()]);
        places.sort_unstable();
        let pieces: Vec<&[u8]> = places.windows(2).map(|pair| &bytes[pair[0]..pair[1]]).collect();
        let (read, out) = arrive(HUB, &pieces).expect("well-formed");
        prop_assert_eq!(read, heard);
        prop_assert_eq!(out, pongs.to_vec());
    }

    /// Whatever comes, it is taken or refused.
    #[test]
    fn noise(bytes in proptest::collection::vec(any::<u8>(), 0..200), client: bool, text: bool) {
        // Both outcomes are right; a panic is not.
        let _ = arrive(Rules { text, client }, &[&bytes]);
    }
}

/// Nobody makes the hub keep answers without end.
#[test]
fn a_flood_of_pings_is_not_kept() {
    let ping = frame(PING, true, &[1; 125], HUB);
    let (_, out) = arrive(HUB, &[&ping.repeat(1000)]).expect("well-formed");
    assert!(out.len() < 8192, "{}", out.len());
}

/// Two ends of a connection whose sockets take little: the hub's, and its peer's, over which anything may be said.
async fn ends(rules: Rules) -> (WebSocket, TcpStream) {
    let listener = TcpSocket::new_v4().expect("a socket");
    listener.set_send_buffer_size(4096).expect("a socket option");
    let any: SocketAddr = ([127, 0, 0, 1], 0).into();
    listener.bind(any).expect("a free port");
    let listener: TcpListener = listener.listen(1).expect("it is bound");
    let peer = TcpSocket::new_v4().expect("a socket");
    peer.set_recv_buffer_size(4096).expect("a socket option");
    let address = listener.local_addr().expect("it is bound");
    let (peer, accepted) = tokio::join!(peer.connect(address), listener.accept());
    let (stream, _) = accepted.expect("it comes");
    let hub = WebSocket::new(Carrier::Tcp(stream), rules, BytesMut::new());
    (hub, peer.expect("it listens"))
}

/// Reads until the end, or an error.
async fn read_all(link: &WebSocket) -> (Vec<u8>, io::Result<usize>) {
    let mut all = Vec::new();
    loop {
        let read = poll_fn(|context| link.poll_read(&mut all, context));
        match timeout(PATIENCE, read).await.expect("it comes") {
            Ok(1..) => {}
            end => return (all, end),
        }
    }
}

async fn say(peer: &Carrier, mut bytes: &[u8]) {
    while !bytes.is_empty() {
        match peer.try_write(&[IoSlice::new(bytes)]).expect("the hub reads") {
            Some(written) => bytes = &bytes[written..],
            None => peer.writable().await.expect("the hub reads"),
        }
    }
}

async fn heard(peer: &Carrier) -> Vec<u8> {
    let mut heard = BytesMut::new();
    while timeout(PATIENCE, peer.read(&mut heard))
        .await
        .expect("it comes")
        .expect("the link stays")
        > 0
    {}
    heard.to_vec()
}

/// Why a link ends is said to the other side, once, before it ends.
#[tokio::test]
async fn the_end_has_a_status() {
    let normal = [0x88, 2, 0x03, 0xe8];
    let (hub, peer) = ends(HUB).await;
    let peer = Carrier::Tcp(peer);
    say(
        &peer,
        &[frame(BINARY, true, b"last", HUB), frame(8, true, &[3, 0xe8], HUB)].concat(),
    )
    .await;
    // What comes behind a close is nobody's.
    say(&peer, &frame(BINARY, true, b"more", HUB)).await;
    let (read, end) = read_all(&hub).await;
    assert_eq!((&read[..], end.expect("an orderly end")), (&b"last"[..], 0));
    hub.finish();
    drop(hub);
    // The peer has said more than was read, which may cut the link behind the close.
    let mut told = BytesMut::new();
    while told.len() < normal.len() {
        assert!(peer.read(&mut told).await.expect("it is told") > 0);
    }
    assert_eq!(told[..], normal);

    // Who goes away for good says so, which is not a loss of a link.
    let (hub, peer) = ends(HUB).await;
    let peer = Carrier::Tcp(peer);
    let left = [frame(BINARY, true, b"last", HUB), frame(8, true, &[3, 0xe9], HUB)].concat();
    say(&peer, &left).await;
    let (read, end) = read_all(&hub).await;
    assert_eq!(read, b"last");
    let error = end.expect_err("it has left");
    assert!(error.to_string().contains("left"), "{error}");

    for (wrong, status) in [
        (frame(TEXT, true, b"{}", HUB), 1003_u16),
        (frame(3, true, b"", HUB), 1002),
        (frame(BINARY, true, b"", CLIENT), 1002),
    ] {
        let (hub, peer) = ends(HUB).await;
        let peer = Carrier::Tcp(peer);
        say(&peer, &[frame(PING, true, b"?", HUB), wrong].concat()).await;
        let (read, end) = read_all(&hub).await;
        let error = end.expect_err("refused");
        assert_eq!((read.len(), error.kind()), (0, ErrorKind::InvalidData));
        assert!(error.to_string().contains("WebSocket"), "{error}");
        // Why is said in a parcel before.
        assert_eq!(
            hub.try_write(&[IoSlice::new(b"why")]).expect("it is open"),
            Some(3)
        );
        hub.finish();
        assert!(hub.try_write(&[IoSlice::new(b"too late")]).is_err());
        let told = heard(&peer).await;
        assert_eq!(told[..8], [0x8a, 1, b'?', 0x82, 3, b'w', b'h', b'y']);
        assert_eq!((told[8], &told[10..12]), (0x88, &status.to_be_bytes()[..]));
        assert_eq!(told.len(), 10 + usize::from(told[9]), "and nothing else");
    }
}

/// What the network does not take now goes later: nothing is lost, doubled or mixed with answers to pings.
#[tokio::test]
async fn a_blocked_network_loses_nothing() {
    for (rules, theirs) in [
        (HUB, CLIENT),
        (CLIENT, HUB),
        (HUB_TEXT, CLIENT_TEXT),
        (CLIENT_TEXT, HUB_TEXT),
    ] {
        let (hub, peer) = ends(rules).await;
        let peer = WebSocket::new(Carrier::Tcp(peer), theirs, BytesMut::new());
        // Lines of every length, which are what a text is made of.
        let mut sent = Vec::new();
        for line in 0..2000_usize {
            let length = [0, 1, 10, 124, 125, 126, 1000, 40_000][line % 8]
                * usize::from(line % 64 < 16 || line % 8 < 6);
            sent.extend((0..length).map(|at| b'a' + ((at + line) % 26) as u8));
            sent.push(b'\n');
        }
        let mut blocked = 0;
        let writing = async {
            let mut at = 0;
            while at < sent.len() {
                // In pieces, as parcels come.
                let rest = &sent[at..sent.len().min(at + 100_000)];
                let pieces: Vec<IoSlice<'_>> = rest.chunks(777).map(IoSlice::new).collect();
                match hub.try_write(&pieces).expect("the peer reads") {
                    Some(told) => at += told,
                    None => {
                        blocked += 1;
                        hub.writable().await.expect("the peer reads");
                    }
                }
            }
            hub.finish();
        };
        // The hub reads pings meanwhile, and answers them between its frames.
        let pinged = read_all(&hub);
        let pings = async {
            for number in 0..200_u8 {
                say(&peer.carrier, &frame(PING, true, &[number], rules)).await;
                tokio::task::yield_now().await;
            }
        };
        let reading = read_all(&peer);
        let both = async { tokio::join!(writing, reading, pings).1 };
        let (heard, end) = tokio::select! {
            heard = both => heard,
            (_, end) = pinged => panic!("{end:?}"),
        };
        assert_eq!(end.expect("an orderly end"), 0, "{rules:?}");
        let expected = match rules.text {
            true => String::from_utf8(sent)
                .expect("letters")
                .replace('\n', "\r\n")
                .into_bytes(),
            false => sent,
        };
        assert!(
            heard == expected,
            "{rules:?}: {} of {} bytes",
            heard.len(),
            expected.len()
        );
        assert!(blocked > 10, "{rules:?}: {blocked}");
    }
}

/// What has no bytes in a form leaves at once: to wait for a network that is ready would be to turn for ever.
#[tokio::test]
async fn nothing_leaves_at_once() {
    let (hub, _peer) = ends(HUB).await;
    let half = crate::socket::WriteHalf::WebSocket(Arc::new(hub));
    for pieces in [&[][..], &[IoSlice::new(b"")], &[IoSlice::new(b""); 3]] {
        assert_eq!(half.try_write(pieces).expect("it is open"), Some(0));
    }
}
