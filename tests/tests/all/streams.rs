//! Connections that are compressed as a whole (M16), by their bytes: by what any language has at hand, zlib and zstd.

use std::io::{Read as _, Write as _};
use std::net::SocketAddr;
use std::process::Stdio;

use mom_broker::Broker;
use mom_proto::codec::Form;
use mom_proto::{Code, Compression, Family, Map, Parcel, STREAM_MARK, Value};
use mom_tests::lab;
use mom_tests::programs::{PATIENCE, project};
use mom_tests::raw::{Raw, at, message};
use tokio::io::{AsyncBufReadExt as _, AsyncReadExt as _, AsyncWriteExt as _, BufReader};
use tokio::net::TcpStream;
use tokio::process::Command;
use tokio::time::timeout;

const CHAT: &str = "/chat";

/// A peer of a few lines: JSON, one stream of zlib in each direction.
struct ByHand {
    stream: TcpStream,
    packer: flate2::write::ZlibEncoder<Vec<u8>>,
    unpacker: flate2::write::ZlibDecoder<Vec<u8>>,
    /// The hub's bytes that have come, once it compresses.
    came: usize,
}

impl ByHand {
    async fn connect(address: SocketAddr) -> ByHand {
        ByHand {
            stream: TcpStream::connect(address).await.expect("the broker listens"),
            packer: flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default()),
            unpacker: flate2::write::ZlibDecoder::new(Vec::new()),
            came: 0,
        }
    }

    /// Says a line as it is.
    async fn say_plain(&mut self, line: &str) {
        let line = format!("{line}\n");
        self.stream.write_all(line.as_bytes()).await.expect("a link");
    }

    /// Says lines compressed.
    async fn say(&mut self, lines: &str) {
        self.packer.write_all(lines.as_bytes()).expect("memory");
        self.packer.write_all(b"\n").expect("memory");
        self.packer.flush().expect("memory");
        let bytes = std::mem::take(self.packer.get_mut());
        self.stream.write_all(&bytes).await.expect("a link");
    }

    /// The next line, which comes as it is.
    async fn hear_plain(&mut self) -> String {
        let mut line = Vec::new();
        while !line.ends_with(b"\n") {
            line.push(
                timeout(PATIENCE, self.stream.read_u8())
                    .await
                    .expect("it comes")
                    .expect("a link"),
            );
        }
        String::from_utf8(line).expect("text")
    }

    /// What has come, opened, once it has this in it.
    async fn hear(&mut self, wanted: &str) -> String {
        let mut bytes = [0; 4096];
        loop {
            let heard = String::from_utf8_lossy(self.unpacker.get_ref()).into_owned();
            if heard.contains(wanted) {
                self.unpacker.get_mut().clear();
                return heard;
            }
            let count = timeout(PATIENCE, self.stream.read(&mut bytes)).await;
            let count = count
                .unwrap_or_else(|_| panic!("{wanted} does not come: {heard}"))
                .expect("a link");
            assert!(count > 0, "{wanted} does not come: {heard}");
            self.came += count;
            self.unpacker
                .write_all(&bytes[..count])
                .expect("a stream of zlib");
            self.unpacker.flush().expect("a stream of zlib");
        }
    }
}

const LOGIN: &str = r#"{"family":"login","name":"login","id":1,"content":{"name":"bob","password":"bob","compress":["stream-deflate"]}}"#;
const JOIN: &str = r#"{"family":"context","name":"join","id":2,"context":"/chat"}"#;

/// After the reply, which comes as it is, all that the hub says is one stream; what the peer says is as it wants, from any line on.
#[tokio::test]
async fn a_peer_of_a_few_lines_compresses_by_zlib() {
    let broker = lab::start().await;
    let mut bob = ByHand::connect(broker.local_addr()).await;
    bob.say_plain(LOGIN).await;
    let reply = bob.hear_plain().await;
    assert!(reply.contains(r#""compress":"stream-deflate""#), "{reply}");
    // Still as it is.
    bob.say_plain(JOIN).await;
    bob.hear(r#""reference":2"#).await;
    // One line, cut anywhere, and several in one block.
    bob.say(r#"{"family":"message","name":"say","id":3,"context":"/chat","receipt":true,"content":"one"}"#)
        .await;
    bob.hear(r#""reference":3"#).await;
    let lines: Vec<String> = (4..200)
        .map(|id| format!(r#"{{"family":"message","name":"say","id":{id},"context":"/chat","receipt":true,"content":"a text that is much like the others"}}"#))
        .collect();
    let before = bob.came;
    bob.say(&lines.join("\n")).await;
    let heard = bob.hear(r#""reference":199"#).await;
    for id in 4..200 {
        assert!(
            heard.contains(&format!(r#""reference":{id},"#))
                || heard.contains(&format!(r#""reference":{id}}}"#)),
            "{id}: {heard}"
        );
    }
    assert!(
        bob.came - before < heard.len() / 4,
        "{} of {}",
        bob.came - before,
        heard.len()
    );
    // An error of one line is an answer, as ever.
    bob.say("{\"family\":\"nonsense\"}").await;
    bob.hear("bad-").await;
    bob.say(r#"{"family":"time","name":"ping","id":500}"#).await;
    bob.hear(r#""reference":500"#).await;
    broker.stop().await;
}

/// Only one who has proved who it is, as a stream costs memory, and the hub opens what comes.
#[tokio::test]
async fn guests_get_no_stream() {
    let broker = lab::start_with(|config| config.login.guests = true).await;
    for (form, user, agreed) in [
        (Form::Json, "guest", None),
        (Form::Xml, "bob", Some("stream-zstd")),
    ] {
        let mut peer = Raw::connect(broker.local_addr(), form).await;
        let content = match user {
            "guest" => Map::new().with("guest", true),
            user => Map::new().with("name", user).with("password", user),
        };
        let ways = vec![Value::from(Compression::StreamZstd.word())];
        let login = Parcel::new(Family::Login, "login").content(content.with("compress", ways));
        let told = peer.ask(login).await.expect("they may").value();
        assert_eq!(told.get("compress").and_then(Value::as_str), agreed);
    }
    broker.stop().await;
}

async fn logged_in(broker: &Broker, form: Form, way: Compression) -> Raw {
    let mut bob = Raw::connect(broker.local_addr(), form).await;
    let content = Map::new()
        .with("name", "bob")
        .with("password", "bob")
        .with("compress", vec![Value::from(way.word())]);
    let login = Parcel::new(Family::Login, "login").content(content);
    bob.ask(login).await.expect("a user of the lab");
    bob
}

fn zstd_of(bytes: &[u8], window_log: u32) -> Vec<u8> {
    let mut encoder = zstd::stream::write::Encoder::new(Vec::new(), 3).expect("memory");
    encoder.window_log(window_log).expect("a window");
    encoder.write_all(bytes).expect("memory");
    encoder.finish().expect("memory")
}

/// What is not a stream, or needs more memory than was agreed on, ends this connection, with the reason, and harms nobody else.
#[tokio::test]
async fn hostile_streams_end_alone() {
    let broker = lab::start().await;
    let mut carol = Raw::login(broker.local_addr(), Form::Json, "carol").await;
    carol.join(&[CHAT]).await;
    let endless = vec![b' '; 64 * 1024 * 1024];
    let noise: Vec<u8> = (0..300_000_u32)
        .map(|at| (at.wrapping_mul(2_654_435_761) >> 13) as u8)
        .collect();
    for (form, bytes, code) in [
        (Form::Json, zstd_of(&noise, 22), Code::BAD_FRAME),
        (
            Form::Xml,
            [&[0x28, 0xb5, 0x2f, 0xfd][..], &[0xff; 90]].concat(),
            Code::BAD_FRAME,
        ),
        // 64 MiB in a few KiB: as long as a line may be, and no longer.
        (Form::Json, zstd_of(&endless, 17), Code::TOO_LARGE),
        (
            Form::Binary,
            [&STREAM_MARK[..], b"no stream"].concat(),
            Code::BAD_FRAME,
        ),
    ] {
        let mut bob = logged_in(&broker, form, Compression::StreamZstd).await;
        bob.send(&bytes).await;
        let said = last_word(&mut bob).await;
        assert!(said.contains(code.word()), "{form:?}: {said}");
        carol.check_alive().await;
    }
    // Not agreed on, it is what it was before.
    let mut plain = Raw::login(broker.local_addr(), Form::Json, "bob").await;
    plain.send(&zstd_of(b"{}\n", 17)).await;
    plain.send(b"\n").await;
    let error = plain.next_error().await;
    assert_eq!(error.code.word().split('-').next(), Some("bad"), "{error}");
    broker.stop().await;
}

/// All that the hub still says, opened.
async fn last_word(bob: &mut Raw) -> String {
    let bytes = bob.read_to_end().await;
    let from = bytes
        .windows(4)
        .position(|bytes| bytes == [0x28, 0xb5, 0x2f, 0xfd]);
    let mut said = String::new();
    let opened = zstd::stream::read::Decoder::new(&bytes[from.expect("it compresses")..]).expect("memory");
    let mut all = Vec::new();
    // The last frame has no end: the connection has.
    let _ = opened.take(1 << 20).read_to_end(&mut all);
    said.push_str(&String::from_utf8_lossy(&all));
    said
}

/// The memory of a stream is charged to its user for as long as the connection.
#[tokio::test]
async fn a_stream_is_charged_to_its_user() {
    let broker = lab::start().await;
    let mut carol = Raw::login(broker.local_addr(), Form::Json, "carol").await;
    let charged = async |carol: &mut Raw| {
        let stats = carol
            .ask(Parcel::new(Family::Context, "stats").context(at("/")))
            .await;
        let stats = stats.expect("operators may").value();
        let memory = stats.get("memory").expect("it is told").clone();
        let users = memory
            .get("users")
            .and_then(Value::as_list)
            .expect("a list")
            .to_vec();
        let of_bob = users
            .iter()
            .find(|user| user.get("user").and_then(Value::as_str) == Some("bob"));
        of_bob
            .and_then(|user| user.get("bytes"))
            .and_then(Value::as_int)
            .unwrap_or(0)
    };
    let bob = logged_in(&broker, Form::Xml, Compression::StreamDeflate).await;
    assert!(charged(&mut carol).await >= 1024 * 1024);
    drop(bob);
    let freed = async {
        while charged(&mut carol).await > 0 {
            tokio::task::yield_now().await;
        }
    };
    timeout(PATIENCE, freed).await.expect("it is given back");
    broker.stop().await;
}

/// What is said to a channel reaches peers that are compressed and peers that are not, in order, each once.
#[tokio::test]
async fn each_hears_the_same() {
    let broker = lab::start().await;
    let mut carol = Raw::login(broker.local_addr(), Form::Binary, "carol").await;
    carol.join(&[CHAT]).await;
    let mut bob = ByHand::connect(broker.local_addr()).await;
    bob.say_plain(LOGIN).await;
    bob.hear_plain().await;
    bob.say(JOIN).await;
    bob.hear(r#""reference":2"#).await;
    for number in 0..50_i64 {
        carol.send_parcel(&message("count", CHAT, number)).await;
    }
    carol
        .send_parcel(&message("last", CHAT, "x".repeat(500_000)))
        .await;
    let heard = bob.hear(r#""name":"last""#).await;
    let numbers: Vec<i64> = heard
        .lines()
        .filter(|line| line.contains(r#""name":"count""#))
        .filter_map(|line| {
            let line: serde_json::Value = serde_json::from_str(line).expect("JSON");
            line["content"].as_i64()
        })
        .collect();
    assert_eq!(numbers, (0..50).collect::<Vec<_>>());
    broker.stop().await;
}

/// The peer of PROTOCOL.md, as it stands there.
#[tokio::test]
async fn the_peer_on_the_page_opens_what_the_hub_says() {
    let broker = lab::start().await;
    let page = std::fs::read_to_string(project().join("docs/PROTOCOL.md")).expect("it is there");
    let example = page.split("A peer in Python that speaks JSON and listens").nth(1);
    let example = example.and_then(|rest| rest.split("```python\n").nth(1));
    let example = example
        .and_then(|rest| rest.split("```").next())
        .expect("a block");
    let port = broker.local_addr().port().to_string();
    let mut peer = Command::new(project().join("target/python/bin/python"))
        .args(["-c", &example.replace("7666", &port)])
        .stdout(Stdio::piped())
        .kill_on_drop(true)
        .spawn()
        .expect("the tests have a Python");
    let mut lines = BufReader::new(peer.stdout.take().expect("piped")).lines();
    let mut next = async || {
        timeout(PATIENCE, lines.next_line())
            .await
            .expect("it comes")
            .expect("text")
    };
    let welcome = next().await.expect("a line");
    assert!(welcome.contains(r#""compress":"stream-deflate""#), "{welcome}");
    // It is in no channel: what the hub says to it is that it goes.
    let mut carol = Raw::login(broker.local_addr(), Form::Json, "carol").await;
    let content = Map::new()
        .with("peer", "alice")
        .with("text", "the page is read: 5 €");
    let expel = Parcel::new(Family::Context, "expel")
        .context(at("/"))
        .content(content);
    carol.ask(expel).await.expect("operators may");
    let mut said = String::new();
    while let Some(line) = next().await {
        said.push_str(&line);
    }
    assert!(said.contains("the page is read: 5 €"), "{said}");
    broker.stop().await;
}
