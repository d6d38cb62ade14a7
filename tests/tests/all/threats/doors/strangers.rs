//! Threats 4 and 28: strangers at the doors of HTTP take their time, and places.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::time::{Duration, Instant};

use mom_broker::Config;
use mom_net::Door;
use mom_proto::codec::Form;
use mom_tests::asking::{Asking, request, upgrade};
use mom_tests::bridge::Way;
use mom_tests::raw::{PATIENCE, Raw};

use crate::threats::World;

/// Short enough for a test, long enough for the canary's own logins.
const LOGIN_TIME: u64 = 1500;

async fn world() -> World {
    World::start_with(|config| config.limits.login_time = LOGIN_TIME).await
}

/// Sends bytes one by one with a pause, until something is said.
async fn drip(asking: &mut Asking, bytes: &[u8]) {
    for byte in bytes {
        asking.send([*byte]).await;
        if asking.hears_within(Duration::from_millis(20)).await {
            return;
        }
    }
    panic!("all {} bytes were taken", bytes.len());
}

/// Opens a tunnel, and gives its path.
async fn open(asking: &mut Asking) -> String {
    let answer = asking.ask("POST /tunnel", &["Host: hub"], b"").await;
    assert_eq!(answer.status, 201, "{answer:?}");
    let id = answer.header("mom-tunnel").expect("it has an id");
    format!("/tunnel/{id}")
}

async fn check_too_late(mut slow: Asking, code: &str) {
    let answer = slow.answer().await.expect("told why");
    assert_eq!((answer.status, answer.code().as_deref()), (408, Some(code)));
    slow.check_closed().await;
}

/// Threats 4 and 28: half a head, a head and a body that come slowly, and a connection that says nothing more.
#[tokio::test]
async fn threat_28_slow_requests() {
    let world = world().await;
    let address = world.address();
    slow_requests(world, address).await;
}

#[tokio::test]
async fn threat_28_slow_requests_with_tls() {
    let tls = Way::beside(Form::Xml)
        .into_iter()
        .find(|way| way.door == Door::Stream);
    let change = |config: &mut Config| config.limits.login_time = LOGIN_TIME;
    let world = World::start_by_with(tls.expect("TLS alone"), Form::Xml, change).await;
    let entrance = world.entrance(Form::Xml);
    slow_requests(world, entrance).await;
}

async fn slow_requests(mut world: World, address: SocketAddr) {
    let endless = format!("GET / HTTP/1.1\r\nHost: hub\r\nX-One: {}", "a".repeat(10_000));
    let mut slow = Asking::connect(address).await;
    drip(&mut slow, endless.as_bytes()).await;
    check_too_late(slow, "login-timeout").await;
    world.check_nothing_arrived("a slow head").await;

    let mut slow = Asking::connect(address).await;
    slow.send("GET / HTTP/1.1\r\nHost: hub\r\n").await;
    check_too_late(slow, "login-timeout").await;

    let mut slow = Asking::connect(address).await;
    let path = open(&mut slow).await;
    let body = request(&format!("POST {path}?at=0"), &["Host: hub"], &[b'{'; 10_000]);
    let head = body.len() - 10_000;
    slow.send(&body[..head]).await;
    drip(&mut slow, &body[head..]).await;
    check_too_late(slow, "too-late").await;
    world.check_nothing_arrived("a slow body").await;

    // A body where none is wanted: answered at once, and not waited for.
    let mut slow = Asking::connect(address).await;
    let body = request("POST /nowhere", &["Host: hub"], &[b'{'; 10_000]);
    slow.send(&body[..body.len() - 10_000]).await;
    assert_eq!(slow.answer().await.expect("answered at once").status, 404);
    slow.check_closed().await;
    world.end().await;
}

/// Asks for a WebSocket, and gives it.
async fn websocket(world: &World, protocol: &str) -> Asking {
    let mut asking = Asking::connect(world.address()).await;
    let lines = upgrade(protocol);
    let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
    assert_eq!(asking.ask("GET /mom", &lines, b"").await.status, 101);
    asking
}

/// Reads to the end.
async fn to_the_end(mut asking: Asking) -> String {
    let mut all = Vec::new();
    loop {
        match asking.bytes().await {
            some if some.is_empty() => return String::from_utf8_lossy(&all).into_owned(),
            some => all.extend(some),
        }
    }
}

/// Threats 4 and 28: an upgrade is not a login, and neither is a tunnel.
#[tokio::test]
async fn threat_28_upgrades_and_tunnels_without_a_login() {
    let mut world = world().await;
    let silent = websocket(&world, "mom.json.v1").await;
    let heard = to_the_end(silent).await;
    assert!(heard.contains("login-timeout"), "{heard}");
    let mut slow = websocket(&world, "mom.json.v1").await;
    // A frame of 10 000 bytes, and most of them.
    let mut bytes = vec![0x81, 0xfe, 0x27, 0x10, 0, 0, 0, 0];
    bytes.extend([b' '; 9_000]);
    drip(&mut slow, &bytes).await;
    let heard = to_the_end(slow).await;
    assert!(heard.contains("login-timeout"), "{heard}");
    let heard = to_the_end(websocket(&world, "mom.bin.v1").await).await;
    assert!(heard.contains("login"), "{heard}");
    world.check_nothing_arrived("WebSockets").await;

    for (first, form) in [
        (&b""[..], "<name>login-timeout</name>"),
        (b"{", "\"login-timeout\""),
    ] {
        let mut asking = Asking::connect(world.address()).await;
        let path = open(&mut asking).await;
        if !first.is_empty() {
            let post = format!("POST {path}?at=0");
            assert_eq!(asking.ask(&post, &["Host: hub"], first).await.status, 200);
        }
        let mut heard = String::new();
        loop {
            // Each on a connection of its own: this one may be closed as a stranger's.
            let mut asking = Asking::connect(world.address()).await;
            let get = format!("GET {path}?at={}&wait=500", heard.len());
            let answer = asking.ask(&get, &["Host: hub"], b"").await;
            heard += &String::from_utf8_lossy(&answer.body);
            match answer.status {
                200 if answer.header("mom-end").is_none() => {}
                200 | 404 => break,
                _ => panic!("{answer:?}"),
            }
        }
        assert!(heard.contains(form), "{heard}");
        world.check_nothing_arrived("a tunnel").await;
    }
    world.end().await;
}

/// Threat 4: what is kept of a stranger is bounded at once, not at the deadline.
#[tokio::test]
async fn threat_4_what_is_kept_before_login_at_other_doors() {
    let mut world = World::start().await;
    let large = [&b"{\"family\":\""[..], &[b'x'; 17_000]].concat();
    let frame = |kind: u8, payload: &[u8]| {
        let size = u16::try_from(payload.len()).expect("small").to_be_bytes();
        [&[kind, 0xfe][..], &size, &[0; 4], payload].concat()
    };
    // The head says how much would come; a part of it is enough.
    let binary = [
        &mom_proto::binary::PREFACE[..],
        &16_385_u32.to_be_bytes(),
        &[0; 200],
    ]
    .concat();
    for (what, protocol, bytes) in [
        ("a text above 16 KiB", "mom.json.v1", frame(0x81, &large)),
        (
            "fragments above 16 KiB",
            "mom.json.v1",
            [frame(1, &large[..9000]), frame(0, &large[9000..])].concat(),
        ),
        ("a frame above 16 KiB", "mom.bin.v1", frame(0x82, &binary)),
    ] {
        let mut asking = websocket(&world, protocol).await;
        asking.send(&bytes).await;
        let heard = to_the_end(asking).await;
        assert!(heard.contains("16") && heard.contains("bytes"), "{what}: {heard}");
        if protocol == "mom.json.v1" {
            assert!(heard.contains("too-large"), "{what}: {heard}");
        }
        world.check_nothing_arrived(what).await;
    }
    let mut asking = Asking::connect(world.address()).await;
    let path = open(&mut asking).await;
    let post = request(&format!("POST {path}?at=0"), &["Host: hub"], &large);
    // Refused for what it announces.
    asking.send(&post[..post.len() - large.len()]).await;
    let answer = asking.answer().await.expect("refused");
    assert_eq!(
        (answer.status, answer.code().as_deref()),
        (413, Some("too-large"))
    );
    asking.check_closed().await;
    world.check_nothing_arrived("a body above 16 KiB").await;
    world.end().await;
}

/// An address of loopback.
fn address(last: u8) -> IpAddr {
    IpAddr::from(Ipv4Addr::new(127, 0, 9, last))
}

/// Threat 28: half hellos, half heads, upgrades and tunnels take the places of strangers, and no others; the oldest goes and hears
/// why, and a peer with something to say gets in, also from their address.
#[tokio::test]
async fn threat_28_places_at_every_door() {
    let mut world = World::start_with(|config| {
        config.tls = mom_tests::tls::of_hub();
        config.connections = 30;
        config.connections_before_login = Some(16);
        config.connections_per_address = Some(8);
    })
    .await;
    let lines = upgrade("mom.bin.v1");
    let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
    let half = [
        b"\x16\x03\x01\x02\0\x01\0\x01\xfc\x03\x03".to_vec(),
        b"GET / HTTP/1.1\r\nHost: hub\r\n".to_vec(),
        request("GET /mom", &lines, b""),
        request("POST /tunnel", &["Host: hub"], b""),
        b"{".to_vec(),
    ];
    let mut strangers = Vec::new();
    let mut peers = Vec::new();
    for _ in 0..4 {
        for number in 0..40_usize {
            let from = address(1 + (number % 4) as u8);
            let mut asking = Asking::connect_from(from, world.address()).await;
            asking.send(&half[number % half.len()]).await;
            strangers.push(asking);
        }
        for from in [address(1), address(9)] {
            let mut peer = Raw::connect_from(from, world.address(), Form::Json).await;
            peer.log_in("bob").await;
            peers.push(peer);
        }
        world.check_nothing_arrived("strangers").await;
    }
    let told = strangers[1].answer().await.expect("told why");
    assert_eq!(
        (told.status, told.code().as_deref()),
        (503, Some("too-many-connections"))
    );
    for peer in &mut peers {
        peer.check_alive().await;
    }
    drop(peers);
    world.end().await;
}

/// Threat 28: a client that only asks has a place for as long as a login may take, and not for ever.
#[tokio::test]
async fn threat_28_who_only_asks_goes() {
    let world = world().await;
    let mut asking = Asking::connect(world.address()).await;
    let (mut answered, begun) = (0, Instant::now());
    loop {
        assert!(begun.elapsed() < PATIENCE, "it has asked {answered} times");
        asking.send(request("GET /", &["Host: hub"], b"")).await;
        let Some(answer) = asking.answer().await else {
            break;
        };
        answered += 1;
        assert_eq!(answer.status, 200);
        if answer.header("connection") == Some("close") {
            asking.check_closed().await;
            break;
        }
    }
    assert!(answered > 1, "it may ask for a while: {answered}");
    let mut again = Asking::connect(world.address()).await;
    assert_eq!(again.ask("GET /", &["Host: hub"], b"").await.status, 200);
    world.end().await;
}
