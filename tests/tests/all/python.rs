//! Peers in Python, written from `docs/PROTOCOL.md` with nothing but a socket, against a real broker.

use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use bytes::Bytes;
use mom_net::{Address, Transceiver};
use mom_proto::codec::Frame;
use mom_proto::{Family, Limits, Map, Parcel, Value};
use mom_tests::lab;
use mom_tests::raw::{PATIENCE, at, message};
use serde_json::Value as Json;
use tokio::io::{AsyncBufReadExt, BufReader, Lines};
use tokio::process::{Child, ChildStdout, Command};
use tokio::time::timeout;

const SCRIPT: &str = "move 100 50 200 0 0; grip close";

/// Every byte occurs in it, and what looks like the boundaries of parts.
fn image() -> Bytes {
    let bytes: Vec<u8> = (0..100_000_u32)
        .map(|number| (number.wrapping_mul(2_654_435_761) >> 13) as u8)
        .collect();
    [&b"\r\n--mom-0\r\n\r\n"[..], &bytes, b"\r\n--"].concat().into()
}

/// The other end: a Rust peer on the transceivers of `mom-net`.
struct Other {
    link: Transceiver,
    last: u64,
}

impl Other {
    async fn login(port: u16, user: &str) -> Other {
        let address: Address = format!("tcp://127.0.0.1:{port}").parse().expect("an address");
        let link = mom_net::connect(&address, &Limits::default(), None)
            .await
            .expect("the broker listens");
        let mut other = Other { link, last: 0 };
        let content = Map::new().with("name", user).with("password", user);
        other
            .ask(Parcel::new(Family::Login, "login").content(content))
            .await;
        for path in ["/robot", "/robot/arm", "/camera", "/camera/x"] {
            other
                .ask(Parcel::new(Family::Context, "join").context(at(path)))
                .await;
        }
        other
    }

    async fn next(&mut self) -> Parcel {
        let frame = timeout(PATIENCE, self.link.reader.next()).await.expect("in time");
        match frame.expect("a healthy link") {
            Some(Frame::Parcel(parcel)) => *parcel,
            other => panic!("{other:?}"),
        }
    }

    async fn next_of(&mut self, family: Family, name: &str) -> Parcel {
        loop {
            let parcel = self.next().await;
            if parcel.is(family, name) {
                return parcel;
            }
        }
    }

    async fn ask(&mut self, parcel: Parcel) -> Parcel {
        self.last += 1;
        self.link
            .writer
            .send(parcel.id(self.last))
            .await
            .expect("a healthy link");
        loop {
            let answer = self.next().await;
            if answer.reference == Some(self.last) {
                assert_ne!(answer.family, Family::Error, "{answer:?}");
                return answer;
            }
        }
    }
}

/// A Python peer, and the lines in which it tells what it hears.
struct Python {
    child: Child,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Python {
    fn start(script: &str, port: u16, user: &str) -> Python {
        let file = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("tests/peers")
            .join(script);
        let mut child = Command::new("python3")
            .arg(file)
            .args([&port.to_string(), user])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .expect("python3 is installed by `cargo xtask test --install`");
        let lines = BufReader::new(child.stdout.take().expect("piped")).lines();
        Python { child, lines }
    }

    /// The next parcel of this class that it tells about.
    async fn heard(&mut self, family: &str, name: &str) -> Json {
        loop {
            let line = timeout(PATIENCE, self.lines.next_line()).await.expect("in time");
            let line = line
                .expect("UTF-8")
                .unwrap_or_else(|| panic!("it ended before {family} {name}"));
            let told: Json = serde_json::from_str(&line).expect("one line of JSON each");
            if told["family"] == family && told["name"] == name {
                return told;
            }
        }
    }

    async fn end(mut self) {
        let mut last = String::new();
        while let Some(line) = timeout(PATIENCE, self.lines.next_line())
            .await
            .expect("in time")
            .expect("UTF-8")
        {
            last = line;
        }
        assert_eq!(last, "{\"closed\": true}", "the hub closes after the logout");
        let status = timeout(PATIENCE, self.child.wait())
            .await
            .expect("in time")
            .expect("waited for");
        assert!(status.success(), "{status}");
    }
}

/// The same for both forms.
async fn check(script: &str) {
    // Short, so that a quiet peer is pinged during the test.
    let broker = lab::start_with(|config| config.limits.heartbeat = 300).await;
    let port = broker.local_addr().port();
    let mut arm = Other::login(port, "arm").await;
    let mut camera = Other::login(port, "camera").await;
    let mut python = Python::start(script, port, "bob");

    check_what_it_sends(&mut python, &mut arm).await;
    check_what_it_hears(&mut python, &mut camera).await;
    // It is pinged while it is quiet.
    for _ in 0..2 {
        let ping = python.heard("time", "ping").await;
        assert!(ping["id"].is_u64(), "{ping}");
        for end in [&mut arm, &mut camera] {
            end.ask(Parcel::new(Family::Time, "ping")).await;
        }
    }
    let bye = message("bye", "/camera/x", Value::Null);
    camera
        .ask(Parcel {
            receipt: Some(true),
            ..bye
        })
        .await;
    let released = arm.next_of(Family::Event, "released").await.value();
    assert_eq!(released.get("reason"), Some(&Value::from("released")));
    python.end().await;
    timeout(Duration::from_secs(10), broker.stop())
        .await
        .expect("it drains");
}

/// It takes the token, commands, and learns how many got it.
async fn check_what_it_sends(python: &mut Python, arm: &mut Other) {
    let grabbed = arm.next_of(Family::Event, "grabbed").await.value();
    assert_eq!(grabbed.get("owner"), Some(&Value::from("bob")));
    let command = arm.next_of(Family::Message, "command").await;
    assert_eq!(command.value(), Value::from(SCRIPT));
    assert_eq!(command.sender.as_deref(), Some("bob"));
    assert_eq!(
        command.fence.and_then(|fence| i64::try_from(fence).ok()),
        grabbed.get("fence").and_then(Value::as_int)
    );
    let fence = python.heard("event", "grabbed").await["content"]["fence"].clone();
    assert_eq!(fence.as_u64(), command.fence);
    let receipt = python.heard("reply", "ok").await;
    assert!(
        receipt["content"].get("lease").is_some(),
        "the grab's reply comes first: {receipt}"
    );
    let receipt = python.heard("reply", "ok").await;
    assert_eq!(
        receipt["content"]["delivered"], 3,
        "the arm, the camera, and its own echo: {receipt}"
    );
}

/// A picture arrives, and all kinds of values.
async fn check_what_it_hears(python: &mut Python, camera: &mut Other) {
    let content = Map::new()
        .with("format", "png <&>")
        .with("image", Value::Binary(image()))
        .with("small", Value::Binary(Bytes::from_static(b"\0\xff\r\n")))
        .with(
            "a key",
            vec![
                Value::Null,
                Value::Bool(true),
                Value::Int(-(1 << 40)),
                Value::Double(0.1),
            ],
        )
        .with("empty", Map::new());
    let mut picture = message("image", "/camera/x", content);
    picture.receipt = Some(true);
    let receipt = camera.ask(picture).await.value();
    assert_eq!(receipt.get("dropped"), Some(&Value::List(Vec::new())));
    let told = python.heard("message", "image").await;
    let told = &told["content"];
    assert_eq!(told["format"], "png <&>");
    assert_eq!(told["image"]["bytes"], image().len());
    assert_eq!(told["image"]["sha256"], sha256(&image()).await);
    assert_eq!(told["small"]["bytes"], 4);
    assert_eq!(
        told["a key"],
        serde_json::json!([null, true, -(1_i64 << 40), 0.1])
    );
    assert_eq!(told["empty"], serde_json::json!({}));
}

/// By the system's own tool: the tests need no hash of their own.
async fn sha256(bytes: &[u8]) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("image");
    std::fs::write(&file, bytes).expect("written");
    let program = "import hashlib, sys; print(hashlib.sha256(open(sys.argv[1], 'rb').read()).hexdigest())";
    let output = Command::new("python3")
        .args(["-c", program])
        .arg(&file)
        .output()
        .await
        .expect("python3");
    String::from_utf8(output.stdout).expect("UTF-8").trim().to_owned()
}

#[tokio::test]
async fn a_peer_in_python_speaks_xml() {
    check("simple_peer.py").await;
}

#[tokio::test]
async fn a_peer_in_python_speaks_binary() {
    check("binary_peer.py").await;
}
