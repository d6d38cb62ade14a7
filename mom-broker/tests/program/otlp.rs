//! Export of spans by OTLP, by the program with a little server of HTTP in the collector's place.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use mom_client::{Channel, Client};
use serde_json::Value;

use super::{Running, lab, program};

const TRACE: &str = "0af7651916cd43dd8448eb211c80319c";
const PARENT: &str = "b7ad6b7169203331";
const PATIENCE: Duration = Duration::from_secs(30);

/// One request that a collector got.
struct Export {
    /// In lower case.
    head: String,
    body: Vec<u8>,
}

/// Takes exports until the test is over.
fn collector() -> (SocketAddr, mpsc::Receiver<Export>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("bound");
    let (took, exports) = mpsc::channel();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let export = take(stream.expect("a connection"));
            if took.send(export).is_err() {
                return;
            }
        }
    });
    (address, exports)
}

fn take(stream: TcpStream) -> Export {
    let mut reader = BufReader::new(stream);
    let mut head = String::new();
    while !head.ends_with("\r\n\r\n") {
        reader.read_line(&mut head).expect("a head");
    }
    let head = head.to_lowercase();
    let length = head.split("content-length: ").nth(1).expect("a length");
    let length = length.lines().next().and_then(|length| length.parse().ok());
    let mut body = vec![0; length.expect("a number")];
    reader.read_exact(&mut body).expect("a body");
    let answer = b"HTTP/1.1 200 OK\r\ncontent-type: application/json\r\ncontent-length: 2\r\n\r\n{}";
    reader.get_mut().write_all(answer).expect("written");
    Export { head, body }
}

/// The lab's broker that exports to a collector, with other variables too.
fn exporting(to: SocketAddr, variables: &[(&str, &str)]) -> Running {
    let mut command = program();
    for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("OTEL_")) {
        command.env_remove(name);
    }
    command
        .env("OTEL_EXPORTER_OTLP_ENDPOINT", format!("http://{to}"))
        .env("NO_PROXY", "127.0.0.1")
        .envs(variables.iter().copied());
    Running::of_command(command, &lab())
}

/// Alice in the lab's chat.
async fn chat(broker: &Running) -> (Client, Channel) {
    let client = Client::builder(format!("tcp://{}", broker.address));
    let client = client.user("alice").password("alice").connect().await;
    let client = client.expect("a user of the lab");
    let channel = client.channel("/chat").await.expect("people may");
    (client, channel)
}

async fn say(channel: &Channel, name: &str, flags: &str) {
    let message = channel
        .message(name)
        .trace(&format!("00-{TRACE}-{PARENT}-{flags}"))
        .no_echo();
    let sent = tokio::time::timeout(PATIENCE, message.send_acknowledged()).await;
    sent.expect("no collector holds the hub up").expect("people may");
}

/// The value of an attribute, as text.
fn attribute<'a>(of: &'a Value, key: &str) -> Option<&'a str> {
    let all = of["attributes"].as_array()?;
    let found = all.iter().find(|attribute| attribute["key"] == key)?;
    found["value"]["stringValue"].as_str()
}

fn nanoseconds(span: &Value, key: &str) -> u64 {
    let text = span[key].as_str().unwrap_or_else(|| panic!("{key} in {span}"));
    text.parse().expect("a number")
}

#[tokio::test]
async fn spans_of_traced_messages_reach_the_collector() {
    let (address, exports) = collector();
    let variables = [
        ("OTEL_EXPORTER_OTLP_PROTOCOL", "http/json"),
        ("OTEL_SERVICE_NAME", "hub-of-the-test"),
        ("OTEL_EXPORTER_OTLP_HEADERS", "authorization=secret"),
    ];
    let mut broker = exporting(address, &variables);
    let (_client, channel) = chat(&broker).await;
    let plain = channel.message("plain").no_echo();
    plain.send_acknowledged().await.expect("people may");
    say(&channel, "unsampled", "00").await;
    say(&channel, "first", "01").await;
    say(&channel, "second", "01").await;
    // What waits is sent before the end.
    broker.signal("-TERM");
    assert!(broker.child.wait().expect("it ends").success());

    let mut spans = Vec::new();
    while spans.len() < 2 {
        let export = exports.recv_timeout(PATIENCE).expect("spans");
        assert!(
            export.head.starts_with("post /v1/traces http/1.1\r\n"),
            "{}",
            export.head
        );
        assert!(
            export.head.contains("authorization: secret\r\n"),
            "{}",
            export.head
        );
        let document: Value = serde_json::from_slice(&export.body).expect("JSON");
        let resource = &document["resourceSpans"][0];
        assert_eq!(
            attribute(&resource["resource"], "service.name"),
            Some("hub-of-the-test")
        );
        let some = resource["scopeSpans"][0]["spans"].as_array().expect("spans");
        spans.extend(some.iter().cloned());
    }
    for (span, name) in spans.iter().zip(["first", "second"]) {
        assert_eq!(span["traceId"], TRACE, "{span}");
        assert_eq!(span["parentSpanId"], PARENT, "{span}");
        assert_eq!(span["name"], "pass", "{span}");
        assert_eq!(attribute(span, "mom.context"), Some("/chat"), "{span}");
        assert_eq!(attribute(span, "mom.message"), Some(name), "{span}");
        assert_eq!(attribute(span, "mom.result"), Some("passed on"), "{span}");
        let begin = nanoseconds(span, "startTimeUnixNano");
        assert!(
            begin > 0 && begin <= nanoseconds(span, "endTimeUnixNano"),
            "{span}"
        );
    }
    let id = |span: &Value| span["spanId"].as_str().map(str::to_owned);
    assert!(id(&spans[0]).is_some_and(|id| id.len() == 16 && id != PARENT));
    assert_ne!(id(&spans[0]), id(&spans[1]));
    assert_eq!(
        (spans.len(), exports.try_iter().count()),
        (2, 0),
        "only what is sampled"
    );
}

#[tokio::test]
async fn spans_are_protobuf_unless_json_is_asked_for() {
    let (address, exports) = collector();
    let broker = exporting(address, &[]);
    let (_client, channel) = chat(&broker).await;
    say(&channel, "say", "01").await;
    let export = exports.recv_timeout(PATIENCE).expect("a span");
    assert!(
        export.head.contains("content-type: application/x-protobuf"),
        "{}",
        export.head
    );
    let trace = u128::from_str_radix(TRACE, 16).expect("a number").to_be_bytes();
    let parent = u64::from_str_radix(PARENT, 16).expect("a number").to_be_bytes();
    for part in [&trace[..], &parent, b"/chat", b"mom-broker"] {
        assert!(
            export.body.windows(part.len()).any(|window| window == part),
            "{part:?} in {:?}",
            export.body
        );
    }
}

#[tokio::test]
async fn a_collector_that_is_not_there_costs_spans_and_one_line() {
    let nobody = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = nobody.local_addr().expect("bound");
    drop(nobody);
    let mut broker = exporting(address, &[]);
    let (_client, channel) = chat(&broker).await;
    say(&channel, "say", "01").await;
    let line = broker.logged("OTLP");
    for words in ["does not accept spans", &address.to_string(), "refused"] {
        assert!(line.contains(words), "{words} in {line}");
    }
    for _ in 0..5 {
        say(&channel, "say", "01").await;
    }
    broker.signal("-TERM");
    assert!(broker.child.wait().expect("it ends").success());
    let last = broker.logged("OTLP");
    assert!(last.contains("rejected") && last.contains("lost=6"), "{last}");
}

/// It takes connections, and says nothing.
#[tokio::test]
async fn a_silent_collector_does_not_keep_the_broker_from_ending() {
    let silent = TcpListener::bind("127.0.0.1:0").expect("a port");
    let mut broker = exporting(silent.local_addr().expect("bound"), &[]);
    let (_client, channel) = chat(&broker).await;
    say(&channel, "say", "01").await;
    let _export = silent.accept().expect("it tries");
    say(&channel, "say", "01").await;
    let begin = Instant::now();
    broker.signal("-TERM");
    assert!(broker.child.wait().expect("it ends").success());
    assert!(begin.elapsed() < Duration::from_secs(9), "{:?}", begin.elapsed());
}

#[test]
fn a_wrong_address_of_a_collector_does_not_start() {
    let mut command = program();
    command.env("OTEL_EXPORTER_OTLP_ENDPOINT", "http://[");
    let refused = super::run(command.arg("--config").arg(lab()));
    assert_eq!(refused.status.code(), Some(1));
    let said = super::text(&refused.stderr);
    assert!(said.contains("OTEL_EXPORTER_OTLP_ENDPOINT"), "{said}");
}
