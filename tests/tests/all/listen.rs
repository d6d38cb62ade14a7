//! What a listener takes, and what it believes of proxies.

use std::net::{IpAddr, SocketAddr};

use mom_broker::{Broker, Config, FailureRate, ListenConfig, Protocol, TlsUse};
use mom_client::{Client, ClientError, Trust};
use mom_proto::binary::PREFACE;
use mom_proto::codec::Form;
use mom_proto::{Code, Family, Map, Parcel, WireError};
use mom_tests::asking::{Asking, upgrade};
use mom_tests::audit::AuditLog;
use mom_tests::login::log_in;
use mom_tests::programs::{PATIENCE, Running, run, text};
use mom_tests::raw::Raw;
use mom_tests::{lab, tls};
use tokio::io::{AsyncWriteExt as _, copy_bidirectional};
use tokio::net::{TcpListener, TcpSocket};
use tokio::time::timeout;

/// Where the proxy is; everything else of loopback is not trusted.
const PROXY: [u8; 4] = [127, 0, 0, 2];
/// The beginning of an entity.
const XML: &[u8] = b"Content-Length: 10\r\n";
/// The beginning of a ClientHello.
const HELLO: [u8; 11] = [0x16, 3, 1, 2, 0, 1, 0, 1, 0xfc, 3, 3];

fn listener(change: impl FnOnce(&mut ListenConfig)) -> Vec<ListenConfig> {
    let mut listen = ListenConfig::from("127.0.0.1:0");
    change(&mut listen);
    vec![listen]
}

async fn broker(change: impl FnOnce(&mut ListenConfig)) -> Broker {
    lab::start_with(|config| {
        config.tls = tls::of_hub();
        config.listen = listener(change);
    })
    .await
}

/// A hub behind a proxy, with guests: they log in without a password, however they come.
async fn behind_proxy(change: impl FnOnce(&mut Config)) -> Broker {
    lab::start_with(|config| {
        config.tls = tls::of_hub();
        config.listen = listener(|listen| listen.proxy = vec!["127.0.0.2/31".parse().expect("a network")]);
        config.login.guests = true;
        change(config);
    })
    .await
}

/// What a connection hears that begins so.
async fn refusal(broker: &Broker, first: &[u8]) -> WireError {
    let mut raw = Raw::connect(broker.local_addr(), Form::Xml).await;
    raw.send(first).await;
    let error = raw.next_error().await;
    raw.check_closed().await;
    error
}

fn check(error: &WireError, code: &Code, words: &str) {
    assert!(
        error.code == *code && error.to_string().contains(words),
        "{words:?} in {error:?}"
    );
}

async fn over_tls(broker: &Broker, scheme: &str, address: SocketAddr) -> Result<Client, ClientError> {
    let client = Client::builder(format!("{scheme}://{address}"));
    let trust = Trust::Pinned(broker.fingerprint().expect("it has a certificate"));
    let client = client.trust(trust).user("alice").password("alice");
    client.no_reconnect().connect().await
}

async fn from_proxy(broker: &Broker) -> Raw {
    Raw::connect_from(IpAddr::from(PROXY), broker.local_addr(), Form::Xml).await
}

async fn behind(broker: &Broker, header: &[u8]) -> Raw {
    let mut raw = from_proxy(broker).await;
    raw.send(header).await;
    raw
}

fn line(client: &str) -> Vec<u8> {
    format!("PROXY TCP4 {client} 127.0.0.1 4000 7666\r\n").into_bytes()
}

/// The binary header of a client in IPv4, which says behind the addresses that it came over TLS.
fn binary(command: u8, client: [u8; 4]) -> Vec<u8> {
    let more = [0x20, 0, 5, 1, 0, 0, 0, 0];
    let length = [0, 12 + more.len() as u8];
    let begin = b"\r\n\r\n\0\r\nQUIT\n";
    [
        &begin[..],
        &[command, 0x11],
        &length,
        &client,
        &[127, 0, 0, 1, 15, 160, 29, 242],
        &more,
    ]
    .concat()
}

async fn guest(mut raw: Raw) -> Raw {
    log_in(&mut raw, Map::new().with("guest", true))
        .await
        .expect("a guest");
    raw
}

#[tokio::test]
async fn forms_that_are_not_taken_are_refused_by_name() {
    let broker = broker(|listen| listen.takes = vec![Protocol::Xml, Protocol::Http]).await;
    let error = refusal(&broker, &PREFACE).await;
    check(&error, &Code::NOT_TAKEN, "accepts xml, http, not binary");
    over_tls(&broker, "bins", broker.local_addr())
        .await
        .expect_err("not within TLS either");
    let client = over_tls(&broker, "tcps", broker.local_addr()).await;
    client.expect("this form is taken").close().await;
    Raw::login(broker.local_addr(), Form::Xml, "alice").await;
    broker.stop().await;

    let broker = self::broker(|listen| listen.takes = vec![Protocol::Binary]).await;
    check(
        &refusal(&broker, XML).await,
        &Code::NOT_TAKEN,
        "accepts binary, not xml",
    );
    Raw::login(broker.local_addr(), Form::Binary, "alice").await;
    broker.stop().await;
}

/// What is asked by HTTP is told by its path; what is not taken is refused by name, and nothing of it is done.
#[tokio::test]
async fn ways_of_http_that_are_not_taken_are_refused_by_name() {
    let broker = broker(|listen| listen.takes = vec![Protocol::Binary]).await;
    for first in [&b"GET / HTTP/1.1\r\n"[..], b"POST /tunnel HTTP/1.1\r\n"] {
        let error = refusal(&broker, first).await;
        check(&error, &Code::NOT_TAKEN, "accepts binary, not http");
    }
    broker.stop().await;

    let upgrade = upgrade("mom.bin.v1");
    let upgrade: Vec<&str> = upgrade.iter().map(String::as_str).collect();
    let host = ["Host: hub"];
    for (taken, granted) in [
        (Protocol::Http, [200, 403, 403]),
        (Protocol::Websocket, [403, 101, 403]),
        (Protocol::Tunnel, [403, 403, 201]),
    ] {
        let broker = self::broker(|listen| listen.takes = vec![taken]).await;
        let asked = [
            ("GET /", &host[..]),
            ("GET /mom", &upgrade),
            ("POST /tunnel", &host),
        ];
        for ((first, lines), status) in asked.into_iter().zip(granted) {
            let mut asking = Asking::connect(broker.local_addr()).await;
            let answer = asking.ask(first, lines, b"").await;
            assert_eq!(answer.status, status, "{first} with {taken:?}: {answer:?}");
            let refused = (status == 403).then(|| "not-taken".to_owned());
            assert_eq!(answer.code(), refused, "{first} with {taken:?}");
        }
        check(&refusal(&broker, XML).await, &Code::NOT_TAKEN, ", not xml");
        broker.stop().await;
    }
}

#[tokio::test]
async fn tls_is_required_or_refused() {
    let broker = broker(|listen| listen.tls = TlsUse::Required).await;
    for first in [XML, &PREFACE, b"GET / HTTP/1.1\r\n\r\n"] {
        check(&refusal(&broker, first).await, &Code::NOT_TAKEN, "with TLS only");
    }
    for scheme in ["bins", "tcps"] {
        let client = over_tls(&broker, scheme, broker.local_addr()).await;
        client.expect("with TLS").close().await;
    }
    broker.stop().await;

    let broker = self::broker(|listen| listen.tls = TlsUse::Refused).await;
    check(
        &refusal(&broker, &HELLO).await,
        &Code::NOT_TAKEN,
        "without TLS only",
    );
    for form in [Form::Xml, Form::Binary] {
        Raw::login(broker.local_addr(), form, "alice").await;
    }
    broker.stop().await;
}

/// From a file to what a person reads.
#[tokio::test(flavor = "multi_thread")]
async fn the_program_listens_as_the_file_says() {
    tokio::task::spawn_blocking(listen_as_the_file_says)
        .await
        .expect("no panic");
}

fn listen_as_the_file_says() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("mom.toml").display().to_string();
    let table = "[[listen]]\naddress = \"127.0.0.1:0\"\ntakes = [\"xml\"]\ntls = \"required\"\n";
    std::fs::write(&file, table).expect("written");
    let refused = run("mom-broker", &["check", &file], &[]);
    let told = text(&refused.stderr);
    assert_eq!(refused.status.code(), Some(1), "{told}");
    assert!(told.contains(":4: listen[0].tls: TLS is required here"), "{told}");
    let certificate = "[tls]\ncertificate = \"hub.crt\"\nkey = \"hub.key\"\nself-signed = true\n";
    std::fs::write(&file, format!("{table}{certificate}")).expect("written");
    let broker = Running::start("mom-broker", &["--config", &file], &[]);
    let line = broker.line_with("listening at");
    assert!(
        line.contains("tcps://127.0.0.1:") && !line.contains("bin"),
        "{line}"
    );
    broker.signal("TERM");
    assert!(broker.wait().success());
}

/// What the header says is in the audit log; what the proxy does for itself counts as its own.
#[tokio::test]
async fn a_proxy_says_whose_connection_it_is() {
    let audit = AuditLog::new();
    let broker = behind_proxy(|config| config.audit.path = Some(audit.path())).await;
    let mut in_pieces = from_proxy(&broker).await;
    for byte in line("192.0.2.4") {
        in_pieces.send(&[byte]).await;
    }
    for raw in [
        behind(&broker, &line("192.0.2.1")).await,
        behind(&broker, &binary(0x21, [192, 0, 2, 2])).await,
        behind(&broker, b"PROXY TCP6 2001:db8::3 ::1 4000 7666\r\n").await,
        in_pieces,
        behind(&broker, &binary(0x20, [192, 0, 2, 9])).await,
        behind(&broker, b"PROXY UNKNOWN 192.0.2.9\r\n").await,
        // Who is not a proxy has no header.
        Raw::connect(broker.local_addr(), Form::Xml).await,
    ] {
        guest(raw).await;
    }
    // In the same segment as the header.
    let ping = Form::Xml.encode(&Parcel::new(Family::Time, "ping").id(7));
    let together = [line("192.0.2.5"), ping.expect("a parcel").to_vec()];
    let mut raw = behind(&broker, &together.concat()).await;
    raw.answer(7).await.expect("a pong");
    guest(raw).await;
    broker.stop().await;
    let lines = audit.lines();
    for (address, count) in [
        ("192.0.2.1", 1),
        ("192.0.2.2", 1),
        ("2001:db8::3", 1),
        ("192.0.2.4", 1),
        ("192.0.2.5", 1),
        ("127.0.0.2", 2),
        ("127.0.0.1", 1),
        ("192.0.2.9", 0),
    ] {
        assert_eq!(
            lines.count(&[("what", "login"), ("from", address)]),
            count,
            "{address}"
        );
    }
}

#[tokio::test]
async fn threat_28_proxies_that_say_it_wrong_or_not_at_all() {
    let broker = behind_proxy(|_| {}).await;
    for header in [
        XML,
        &PREFACE,
        &HELLO,
        b"PROXY TCP4 127.0.0.1\r\n",
        b"PROXY TCP4 1.2.3.4 127.0.0.1 1 1\n",
        b"\r\n\r\n\0\r\nQUIT\n\x31\x11\0\x0c",
        b"\r\n\r\n\0\r\nQUIT\n\x21\x11\xff\xff",
    ] {
        let mut raw = behind(&broker, header).await;
        check(&raw.next_error().await, &Code::BAD_FRAME, "PROXY protocol header");
        raw.check_closed().await;
    }
    // A header of another protocol is nothing that begins a form.
    for header in [line("192.0.2.1"), binary(0x21, [192, 0, 2, 2])] {
        assert_eq!(refusal(&broker, &header).await.code, Code::BAD_FRAME);
    }
    broker.stop().await;

    let broker = behind_proxy(|config| config.limits.login_time = 500).await;
    for half in [&b""[..], b"PROXY TCP4 1.2", &binary(0x21, [1, 2, 3, 4])[..20]] {
        let mut raw = behind(&broker, half).await;
        assert_eq!(raw.next_error().await.code, Code::LOGIN_TIMEOUT);
        raw.check_closed().await;
    }
    broker.stop().await;
}

/// What is not a login counts as one that failed.
async fn fail(raw: &mut Raw) -> Code {
    let nothing = Map::new().with("name", "bob");
    log_in(raw, nothing).await.expect_err("no login").code
}

/// What a password hears.
async fn refused_password(raw: &mut Raw) -> WireError {
    let content = Map::new().with("name", "alice").with("password", "alice");
    raw.post(Parcel::new(Family::Login, "login").content(content))
        .await;
    raw.next_error().await
}

/// Failures and places before login are counted by who is behind the proxy.
#[tokio::test]
async fn clients_behind_one_proxy_are_told_apart() {
    let broker = behind_proxy(|config| {
        config.login.attempts = 100;
        config.login.throttle.per_address = FailureRate {
            per_minute: 1,
            burst: 2,
        };
        config.connections_per_address = Some(2);
    })
    .await;
    let mut one = behind(&broker, &line("192.0.2.1")).await;
    let mut two = behind(&broker, &binary(0x21, [192, 0, 2, 2])).await;
    for code in [Code::BAD_CONTENT, Code::BAD_CONTENT, Code::TRY_LATER] {
        assert_eq!(fail(&mut one).await, code);
    }
    assert_eq!(fail(&mut two).await, Code::BAD_CONTENT);

    let second = behind(&broker, &line("192.0.2.1")).await;
    let mut second = guest(second).await;
    let mut more = Vec::new();
    for _ in 0..2 {
        let mut raw = behind(&broker, &line("192.0.2.1")).await;
        raw.check_alive().await;
        more.push(raw);
    }
    let error = one.next_error().await;
    check(&error, &Code::TOO_MANY_CONNECTIONS, "oldest");
    for raw in [&mut two, &mut second].into_iter().chain(&mut more) {
        raw.check_alive().await;
    }
    broker.stop().await;
}

/// The way from the proxy to the hub is not loopback, whatever the header says, and whatever the proxy's address.
#[tokio::test]
async fn a_header_makes_no_password_safe() {
    let broker = behind_proxy(|_| {}).await;
    for header in [
        line("127.0.0.1"),
        binary(0x20, [127, 0, 0, 1]),
        b"PROXY UNKNOWN\r\n".to_vec(),
    ] {
        let mut raw = behind(&broker, &header).await;
        check(&refused_password(&mut raw).await, &Code::INSECURE, "TLS");
        raw.check_closed().await;
    }
    // TLS to the hub itself is safe; that a proxy says of one that has ended there is not.
    let mut raw = behind(&broker, &binary(0x21, [192, 0, 2, 7])).await;
    // Nobody here has seen that.
    assert_eq!(refused_password(&mut raw).await.code, Code::INSECURE);
    for (scheme, header) in [
        ("bins", binary(0x21, [192, 0, 2, 7])),
        ("tcps", line("192.0.2.8")),
    ] {
        let proxy = proxy(&broker, header).await;
        let client = over_tls(&broker, scheme, proxy)
            .await
            .expect("TLS to the hub itself");
        client.lookup("/chat").await.expect("it is alice");
        client.close().await;
    }
    // Who is not a proxy comes over loopback as before.
    Raw::login(broker.local_addr(), Form::Xml, "alice").await;
    broker.stop().await;
}

/// A proxy for one connection.
async fn proxy(broker: &Broker, header: Vec<u8>) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let (here, hub) = (listener.local_addr().expect("an address"), broker.local_addr());
    tokio::spawn(async move {
        let (mut client, _) = listener.accept().await.expect("the client connects");
        let socket = TcpSocket::new_v4().expect("a socket");
        socket.bind((PROXY, 0).into()).expect("an address of loopback");
        let mut hub = socket.connect(hub).await.expect("the broker listens");
        hub.write_all(&header).await.expect("the broker reads");
        // However it ends, the client and the broker see it.
        let _ = copy_bidirectional(&mut client, &mut hub).await;
    });
    here
}

/// As many as come back at once after a restart: nobody is turned away while the proxy says in time whose they are.
#[tokio::test]
async fn a_crowd_comes_through_one_proxy() {
    let broker = behind_proxy(|config| config.connections_per_address = Some(2500)).await;
    let header = line("192.0.2.1");
    let mut crowd = Vec::new();
    for _ in 0..300 {
        crowd.push(behind(&broker, &header).await);
    }
    let all = async {
        for raw in &mut crowd {
            raw.check_alive().await;
        }
    };
    timeout(PATIENCE, all).await.expect("all are served");
    broker.stop().await;
}
