//! The robot's own page and camera (W21, W22): beside its control, and on the hub.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::Instant;

use mom_client::{Client, Code, Event, Events, Value};
use mom_tests::programs::{PATIENCE, Running, text};
use serde_json::Value as Json;
use tokio::time::timeout;

/// `mom-linuxbot` with a page: its control, and the pages of its robots.
fn robots(options: &[&str], robots: usize) -> (Running, SocketAddr, Vec<SocketAddr>) {
    let base = ["--listen", "127.0.0.1:0", "--web", "127.0.0.1:0"];
    let running = Running::start("mom-linuxbot", &[&base, options].concat(), &[]);
    let line = running.line_with("listen");
    let control = line.split_whitespace().find_map(|word| word.parse().ok());
    let pages = (1..=robots).map(|unit| {
        let line = running.line_with(&format!("robot {unit} has its page at "));
        let page = line.split("http://").nth(1).expect("a URL");
        page.trim_end_matches('/').parse().expect("an address")
    });
    let pages = pages.collect();
    (running, control.expect("its address"), pages)
}

/// The answer to a request that is written on this connection: its status, and its body.
fn answered(mut stream: TcpStream, method: &str, path: &str) -> (u16, Vec<u8>) {
    stream.set_read_timeout(Some(PATIENCE)).expect("a time");
    write!(stream, "{method} {path} HTTP/1.1\r\nHost: robot\r\n\r\n").expect("it reads");
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).expect("it answers");
    let end = answer.windows(4).position(|bytes| bytes == b"\r\n\r\n");
    let body = answer.split_off(end.expect("a head") + 4);
    let status = text(&answer).split(' ').nth(1).and_then(|word| word.parse().ok());
    (status.expect("a status"), body)
}

fn got(page: SocketAddr, path: &str) -> Vec<u8> {
    let stream = TcpStream::connect(page).expect("it listens");
    let (status, body) = answered(stream, "GET", path);
    assert_eq!(status, 200, "{path}: {}", text(&body));
    body
}

fn state(page: SocketAddr) -> Json {
    serde_json::from_slice(&got(page, "/status.json")).expect("JSON")
}

/// The picture of a robot once it is not this one any more, as there is a new one five times a second.
fn picture_after(page: SocketAddr, before: &[u8]) -> Vec<u8> {
    let begin = Instant::now();
    while begin.elapsed() < PATIENCE {
        let picture = got(page, "/camera.jpg");
        if picture != before {
            return picture;
        }
    }
    panic!("it sees the same still");
}

/// A base station of two commands (W4, W5, W8).
struct Station(TcpStream);

impl Station {
    /// The reply to STATUS, after these commands.
    fn say(&mut self, commands: &str) -> u32 {
        write!(self.0, "{commands}04").expect("it reads");
        let mut reply = [0; 8];
        self.0.read_exact(&mut reply).expect("a STATUS");
        text(&reply[3..]).parse().expect("a mask")
    }
}

#[test]
fn a_robot_shows_itself_while_a_base_station_drives_it() {
    let (_robot, control, pages) = robots(&["--watchdog", "30s"], 1);
    let page = pages[0];
    let mut station = Station(TcpStream::connect(control).expect("it listens"));
    let before = got(page, "/camera.jpg");
    let decoded = image::load_from_memory(&before).expect("a picture");
    assert_eq!((decoded.width(), decoded.height()), (320, 240));
    // What it sees follows from its pose alone, so that only a robot that moves sees something else.
    assert_eq!(state(page)["moving"], false);
    assert_eq!(station.say("06 00060 -0060") & 16, 16, "it moves");
    let after = picture_after(page, &before);
    assert!(image::load_from_memory(&after).is_ok());
    let seen = state(page);
    assert_eq!(
        (&seen["moving"], &seen["left"]),
        (&true.into(), &60.into()),
        "{seen}"
    );
    assert_ne!(seen["heading"], 0.0, "{seen}");
    let me = station.0.local_addr().expect("it has one").to_string();
    assert_eq!(seen["station"], me.as_str());
    let shown = text(&got(page, "/"));
    assert!(
        shown.contains("<td>moving</td>") && shown.contains(&me),
        "{shown}"
    );
    // It obeys at once, whether anyone watches or not.
    assert_eq!(station.say("06 00000 00000") & 16, 0, "it stands");
    assert_eq!(state(page)["moving"], false);
    for (method, path, status) in [
        ("HEAD", "/camera.jpg", 200),
        ("GET", "/secret", 404),
        ("PUT", "/", 405),
    ] {
        let stream = TcpStream::connect(page).expect("it listens");
        let (answer, body) = answered(stream, method, path);
        assert_eq!(
            (answer, body.is_empty()),
            (status, method == "HEAD"),
            "{method} {path}"
        );
    }
}

#[test]
fn each_robot_has_a_page_of_its_own() {
    let (_robots, _, pages) = robots(&["--robots", "3"], 3);
    for (page, unit) in pages.iter().zip(1..) {
        assert_eq!(state(*page)["unit"], unit);
    }
    assert_ne!(got(pages[0], "/camera.jpg"), got(pages[1], "/camera.jpg"));
}

/// A connection from another address of this machine.
#[cfg(target_os = "linux")]
async fn connect_from(from: &str, to: SocketAddr) -> TcpStream {
    let socket = tokio::net::TcpSocket::new_v4().expect("a socket");
    let from: std::net::IpAddr = from.parse().expect("an address");
    socket.bind((from, 0).into()).expect("all of 127/8 is ours");
    let stream = socket.connect(to).await.expect("it listens");
    let stream = stream.into_std().expect("it is a socket");
    stream.set_nonblocking(false).expect("it can wait");
    stream
}

#[cfg(target_os = "linux")]
#[tokio::test]
async fn who_is_not_listed_is_refused() {
    let (_robot, _, pages) = robots(&["--allow", "127.0.0.1"], 1);
    for (from, expected) in [("127.0.0.2", 403), ("127.0.0.1", 200)] {
        for path in ["/", "/status.json", "/camera.jpg"] {
            let stream = connect_from(from, pages[0]).await;
            let (status, body) = answered(stream, "GET", path);
            assert_eq!(status, expected, "{from} {path}");
            let refused = text(&body).starts_with("127.0.0.2 is not allowed to drive");
            assert_eq!(refused, expected == 403, "{from} {path}");
        }
    }
}

async fn image(events: &mut Events) -> Value {
    let shown = async {
        loop {
            let Event::Message(parcel) = events.next().await.expect("the client lives") else {
                continue;
            };
            if parcel.name() == "image" {
                return parcel.value();
            }
        }
    };
    timeout(PATIENCE, shown).await.expect("an image")
}

#[tokio::test(flavor = "multi_thread")]
async fn the_hub_shows_what_robots_see() {
    let (_lab, hub) = Running::lab_with(&["--fleet", "2"]);
    let alice = Client::builder(hub.as_str()).user("alice").password("alice");
    let alice = alice.connect().await.expect("the lab knows its users");
    for unit in [1, 2] {
        let place = format!("/fleet/{unit}/camera");
        let channel = alice.channel(&place).await.expect("she may look");
        let mut events = channel.events();
        for _ in 0..2 {
            let shown = image(&mut events).await;
            let file = shown.get("image").and_then(Value::as_binary).expect("an image");
            assert!(file.starts_with(&[0xff, 0xd8, 0xff]), "a JPEG file");
            let number = |key| shown.get(key).and_then(Value::as_int);
            assert_eq!((number("width"), number("height")), (Some(320), Some(240)));
            assert_eq!(shown.get("overlays"), None, "there is no arm");
        }
        for name in ["image", "camera-error"] {
            let forged = channel.message(name).content("nothing").send_acknowledged().await;
            let refused = forged.expect_err("only the camera says so");
            assert_eq!(refused.code(), Some(&Code::DENIED), "{name}: {refused}");
        }
    }
}
