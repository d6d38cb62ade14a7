//! The HTTP tunnel by its bytes: loss, replay, and who else may use it (M19).

use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use mom_broker::Broker;
use mom_client::{Client, Event, Events};
use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel, Path};
use mom_tests::lab;
use mom_tests::programs::PATIENCE;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpSocket, TcpStream};
use tokio::time::timeout;

/// What a hub takes of a stranger at once.
const BEFORE_LOGIN: usize = 16 * 1024;

/// An answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    head: String,
    body: Vec<u8>,
}

impl Answer {
    pub(crate) fn field(&self, wanted: &str) -> Option<&str> {
        let mut fields = self.head.lines().filter_map(|line| line.split_once(": "));
        fields
            .find(|(name, _)| name.eq_ignore_ascii_case(wanted))
            .map(|(_, value)| value)
    }

    pub(crate) fn number(&self, wanted: &str) -> Option<usize> {
        self.field(wanted)?.parse().ok()
    }

    fn said(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }
}

/// In HTTP/1.0, where an answer ends with its connection.
pub(crate) fn request(method: &str, path: &str, fields: &str, body: &[u8]) -> Vec<u8> {
    let size = body.len();
    let head = format!("{method} {path} HTTP/1.0\r\nHost: hub\r\n{fields}Content-Length: {size}\r\n\r\n");
    [head.as_bytes(), body].concat()
}

pub(crate) async fn send(address: SocketAddr, bytes: &[u8]) -> TcpStream {
    let mut stream = TcpStream::connect(address).await.expect("the hub listens");
    // A hub that refuses may close before it has read all.
    let _ = timeout(PATIENCE, stream.write_all(bytes))
        .await
        .expect("it reads or closes");
    stream
}

/// The whole answer on a connection.
pub(crate) async fn hear(mut stream: TcpStream) -> Answer {
    let mut heard = Vec::new();
    let whole = timeout(PATIENCE, stream.read_to_end(&mut heard)).await;
    // What was not read of a request may make a reset of the end.
    let _ = whole.expect("the hub ends its answer");
    let end = heard.windows(4).position(|four| four == b"\r\n\r\n");
    let end = end.unwrap_or_else(|| panic!("no head in {:?}", String::from_utf8_lossy(&heard)));
    let head = String::from_utf8_lossy(&heard[..end]).into_owned();
    let status = head.split(' ').nth(1).and_then(|status| status.parse().ok());
    Answer {
        status: status.expect("a status"),
        head,
        body: heard[end + 4..].to_vec(),
    }
}

pub(crate) async fn ask(address: SocketAddr, bytes: &[u8]) -> Answer {
    hear(send(address, bytes).await).await
}

/// A tunnel in JSON, by hand.
pub(crate) struct ByHand {
    pub(crate) address: SocketAddr,
    pub(crate) id: String,
    /// Bytes that went up.
    pub(crate) up: usize,
    last: u64,
}

impl ByHand {
    pub(crate) async fn open(broker: &Broker) -> ByHand {
        ByHand::open_with(broker, "").await
    }

    async fn open_with(broker: &Broker, fields: &str) -> ByHand {
        let address = broker.local_addr();
        let opened = ask(address, &request("POST", "/tunnel", fields, b"")).await;
        assert_eq!(opened.status, 201, "{opened:?}");
        let id = opened.field("mom-tunnel").expect("an id").to_owned();
        assert_eq!((id.len(), opened.said()), (32, id.clone()));
        ByHand {
            address,
            id,
            up: 0,
            last: 0,
        }
    }

    /// A tunnel whose peer is alice, in the chat; the id from before.
    async fn of_alice(broker: &Broker) -> (ByHand, String) {
        let mut tunnel = ByHand::open(broker).await;
        let before = tunnel.id.clone();
        let content = Map::new().with("name", "alice").with("password", "alice");
        let login = Parcel::new(Family::Login, "login").content(content);
        let answer = tunnel.say(login).await;
        tunnel.id = answer.field("mom-tunnel").expect("a new id").to_owned();
        tunnel
            .say(Parcel::new(Family::Context, "join").context(chat()))
            .await;
        (tunnel, before)
    }

    pub(crate) fn path(&self, query: &str) -> String {
        format!("/tunnel/{}?{query}", self.id)
    }

    pub(crate) fn encode(&mut self, parcel: Parcel) -> Vec<u8> {
        self.last += 1;
        let encoded = Form::Json.encode(&parcel.id(self.last));
        encoded.expect("a form on the wire").to_vec()
    }

    /// Brings bytes up that begin at this place.
    pub(crate) async fn post(&self, at: usize, body: &[u8]) -> Answer {
        let path = self.path(&format!("at={at}"));
        ask(self.address, &request("POST", &path, "", body)).await
    }

    /// Brings a parcel up.
    pub(crate) async fn say(&mut self, parcel: Parcel) -> Answer {
        let bytes = self.encode(parcel);
        let answer = self.post(self.up, &bytes).await;
        self.up += bytes.len();
        assert_eq!(
            (answer.status, answer.number("mom-taken")),
            (200, Some(self.up)),
            "{answer:?}"
        );
        answer
    }

    /// What comes down from this place on.
    pub(crate) async fn get(&self, at: usize) -> Answer {
        let path = self.path(&format!("at={at}&wait=10000"));
        ask(self.address, &request("GET", &path, "", b"")).await
    }

    /// Reads until these words have come down, and gives all of it.
    pub(crate) async fn until(&self, words: &str) -> Vec<u8> {
        let all = async {
            loop {
                let answer = self.get(0).await;
                if answer.said().contains(words) {
                    return answer.body;
                }
            }
        };
        timeout(PATIENCE, all).await.expect("it comes")
    }
}

pub(crate) fn chat() -> Path {
    Path::parse("/chat").expect("a path")
}

fn message(text: &str) -> Parcel {
    Parcel::new(Family::Message, "chat").context(chat()).content(text)
}

/// A peer in the chat that is not a part of the tunnel.
async fn carol(broker: &Broker) -> (Client, Events) {
    let carol = Client::builder(format!("bin://{}", broker.local_addr()));
    let carol = carol.user("carol").password("carol").no_reconnect().connect();
    let carol = carol.await.expect("a user of the lab");
    let chat = carol.channel("/chat").await.expect("everybody may");
    (carol, chat.events())
}

/// What was said in the chat, to the message that says `last`.
async fn said(events: &mut Events, last: &str) -> Vec<String> {
    let mut said = Vec::new();
    while said.last().is_none_or(|text| text != last) {
        let event = timeout(PATIENCE, events.next()).await.expect("it comes");
        if let Event::Message(parcel) = event.expect("the link stays") {
            said.push(parcel.value().as_str().expect("text").to_owned());
        }
    }
    said
}

/// A client that did not hear the answer asks again: what is here already counts once, what is missing is asked for.
#[tokio::test]
async fn threat_17_what_goes_up_is_taken_once() {
    let broker = lab::start().await;
    let (mut tunnel, _) = ByHand::of_alice(&broker).await;
    let (carol, mut events) = carol(&broker).await;
    let (one, two) = (tunnel.encode(message("one")), tunnel.encode(message("two")));
    let (from, then) = (tunnel.up, tunnel.up + one.len());
    let end = then + two.len();
    for _ in 0..3 {
        let answer = tunnel.post(from, &one).await;
        assert_eq!((answer.status, answer.number("mom-taken")), (200, Some(then)));
    }
    // Something before it is missing, by one byte and by many.
    for at in [then + 1, end, usize::MAX / 2] {
        let answer = tunnel.post(at, &two).await;
        assert_eq!(
            (answer.status, answer.number("mom-taken")),
            (409, Some(then)),
            "{at}"
        );
    }
    // A part of it was taken already; then all of it comes again.
    for (at, bytes) in [
        (from, [&one[..], &two[..5]].concat()),
        (from, [one, two].concat()),
    ] {
        let answer = tunnel.post(at, &bytes).await;
        assert_eq!(
            (answer.status, answer.number("mom-taken")),
            (200, Some(at + bytes.len()))
        );
    }
    tunnel.up = end;
    // What is cut off is not taken in part.
    let three = request("POST", &tunnel.path(&format!("at={end}")), "", b"{\"family\":");
    let mut cut = send(tunnel.address, &three[..three.len() - 4]).await;
    cut.shutdown().await.expect("it is open");
    assert_eq!(hear(cut).await.number("mom-taken"), None);
    tunnel.say(message("three")).await;
    assert_eq!(said(&mut events, "three").await, ["one", "two", "three"]);
    carol.close().await;
    broker.stop().await;
}

/// What a client and a hub say to each other through a network that loses each fifth request or its answer.
#[cfg(target_os = "linux")]
#[tokio::test]
async fn threat_17_what_is_lost_on_the_way_comes_again() {
    use mom_tests::proxies::{BufferingProxy, Manners};
    const COUNT: u32 = 100;
    let broker = lab::start().await;
    let (carol, mut heard) = carol(&broker).await;
    let from_carol = carol.channel("/chat").await.expect("she is there");
    let manners = Manners {
        to: Some(broker.local_addr()),
        ..Manners::default()
    };
    let proxy = BufferingProxy::start(manners).await;
    let alice = Client::builder(proxy.url()).user("alice").password("alice");
    let alice = alice.no_reconnect().connect().await.expect("nothing is lost yet");
    let chat = alice.channel("/chat").await.expect("everybody may");
    let mut events = chat.events();
    proxy.lose_each(5);
    for number in 0..COUNT {
        // Each waits for its receipt, so that they are not one request.
        let message = chat.message("chat").content(format!("up {number}"));
        message.send_acknowledged().await.expect("it arrives");
        from_carol
            .send("chat", format!("down {number}"))
            .await
            .expect("it goes");
    }
    for (way, events) in [("up", &mut heard), ("down", &mut events)] {
        let last = format!("{way} {}", COUNT - 1);
        let said = said(events, &last).await;
        let said: Vec<String> = said.into_iter().filter(|text| text.starts_with(way)).collect();
        let all: Vec<String> = (0..COUNT).map(|number| format!("{way} {number}")).collect();
        assert_eq!(said, all);
    }
    let asked = proxy.asked();
    assert!(asked.len() > 100, "{}", asked.len());
    for client in [alice, carol] {
        client.close().await;
    }
    broker.stop().await;
}

/// An answer that was lost is asked for again, until the peer says that it has it.
#[tokio::test]
async fn threat_17_what_comes_down_can_be_asked_for_again() {
    let broker = lab::start().await;
    let (mut tunnel, _) = ByHand::of_alice(&broker).await;
    tunnel.say(message("good morning")).await;
    let all = tunnel.until("good morning").await;
    let half = all.len() / 2;
    for at in [0, 0, 10] {
        let again = tunnel.get(at).await;
        assert_eq!(again.status, 200);
        assert!(again.body.starts_with(&all[at..]), "{at}: {again:?}");
    }
    // Who asks from here on has what is before: by asking, and by saying so beside what goes up.
    assert_eq!(tunnel.get(9).await.status, 410);
    let path = tunnel.path(&format!("at={}&ack={half}", tunnel.up));
    assert_eq!(
        ask(tunnel.address, &request("POST", &path, "", b"")).await.status,
        200
    );
    assert_eq!(tunnel.get(10).await.status, 410);
    assert!(tunnel.get(half).await.body.starts_with(&all[half..]));
    // Nobody has what was never sent.
    let beyond = all.len() + 100_000;
    assert_eq!(tunnel.get(beyond).await.status, 400);
    let path = tunnel.path(&format!("at={}&ack={beyond}", tunnel.up));
    assert_eq!(
        ask(tunnel.address, &request("POST", &path, "", b"")).await.status,
        400
    );
    for query in ["at=x", "at=-1", "at", "from=0", "at=99999999999999999999"] {
        let path = tunnel.path(query);
        let answer = ask(tunnel.address, &request("GET", &path, "", b"")).await;
        assert_eq!(answer.status, 400, "{query}");
    }
    broker.stop().await;
}

/// One that asks again has lost the first answer: it ends, and what comes goes to the second.
#[tokio::test]
async fn threat_17_a_second_poll_takes_the_place_of_the_first() {
    let broker = lab::start().await;
    let (mut tunnel, _) = ByHand::of_alice(&broker).await;
    tunnel.say(message("before")).await;
    let here = tunnel.until("before").await.len();
    for query in [format!("at={here}"), format!("at={here}&wait=20000")] {
        let first = send(tunnel.address, &request("GET", &tunnel.path(&query), "", b"")).await;
        // The hub has its turn when its head comes, or, if it waits, some time after; the second asks until it has displaced it.
        let second = async {
            loop {
                let path = tunnel.path(&format!("at={here}&wait=1"));
                let answer = ask(tunnel.address, &request("GET", &path, "", b"")).await;
                assert_eq!((answer.status, answer.body.len()), (200, 0));
            }
        };
        // By itself it would end after 20 s.
        let first = timeout(Duration::from_secs(15), hear(first));
        let ended = tokio::select! {
            ended = first => ended.expect("it is displaced"),
            () = second => unreachable!("it goes on"),
        };
        assert_eq!((ended.status, ended.body.len()), (200, 0), "{query}");
    }
    tunnel.say(message("after")).await;
    assert!(tunnel.get(here).await.status == 200);
    broker.stop().await;
}

/// 128 bits that nobody guesses; what was seen before the login is worth nothing after it.
#[tokio::test]
async fn threat_17_a_guessed_or_old_id_gets_nothing() {
    let broker = lab::start().await;
    let (mut tunnel, before) = ByHand::of_alice(&broker).await;
    assert_ne!(tunnel.id, before);
    tunnel.say(message("secret")).await;
    tunnel.until("secret").await;
    let near = |digit: usize| {
        let mut id = tunnel.id.clone().into_bytes();
        id[digit] = if id[digit] == b'0' { b'1' } else { b'0' };
        String::from_utf8(id).expect("digits")
    };
    let mut nothing: Option<String> = None;
    for id in [
        before,
        near(0),
        near(31),
        "0".repeat(32),
        String::new(),
        tunnel.id[..31].to_owned(),
        format!("{}0", tunnel.id),
        format!("0x{}", &tunnel.id[2..]),
        format!("{}/..", tunnel.id),
    ] {
        for (method, query) in [
            ("GET", "at=0&wait=1"),
            ("POST", "at=0"),
            ("PUT", "at=x"),
            ("GET", "at=x"),
        ] {
            let path = format!("/tunnel/{id}?{query}");
            let answer = ask(tunnel.address, &request(method, &path, "", b"{}\n")).await;
            assert_eq!(answer.status, 404, "{method} {path}");
            // No difference tells how near it was.
            let said = answer.said();
            assert_eq!(*nothing.get_or_insert(said.clone()), said, "{method} {path}");
            assert_eq!(answer.field("mom-taken").or(answer.field("mom-tunnel")), None);
        }
    }
    // Nor does a second login of the same peer change it.
    tunnel.say(message("still here")).await;
    assert!(!tunnel.until("still here").await.is_empty());
    broker.stop().await;
}

/// The id of the peer that has ended is nobody's.
#[tokio::test]
async fn threat_17_a_closed_tunnel_is_forgotten() {
    let broker = lab::start().await;
    let (mut tunnel, _) = ByHand::of_alice(&broker).await;
    tunnel.say(Parcel::new(Family::Login, "logout")).await;
    let mut at = 0;
    let ended = async {
        loop {
            let answer = tunnel.get(at).await;
            at += answer.body.len();
            if answer.field("mom-end").is_some() {
                break;
            }
            assert_eq!(answer.status, 200);
        }
        while tunnel.get(at).await.status != 404 {}
    };
    timeout(PATIENCE, ended).await.expect("it ends");
    broker.stop().await;
}

#[tokio::test]
async fn a_body_has_its_bounds() {
    let broker = lab::start().await;
    let stranger = ByHand::open(&broker).await;
    let answer = stranger.post(0, &vec![b'x'; BEFORE_LOGIN + 1]).await;
    assert_eq!((answer.status, answer.number("mom-taken")), (413, None));
    let (mut alice, _) = ByHand::of_alice(&broker).await;
    // Nothing of it comes back, which nobody reads here.
    let large = message(&"x".repeat(100_000));
    let large = alice.encode(Parcel {
        echo: Some(false),
        ..large
    });
    assert_eq!(alice.post(alice.up, &large).await.status, 200);
    let answer = alice
        .post(alice.up + large.len(), &vec![b'x'; 128 * 1024 + 1])
        .await;
    assert_eq!(answer.status, 413);
    broker.stop().await;
}

/// A request whose length is told twice may be one thing to a proxy and another to the hub.
#[tokio::test]
async fn threat_17_no_request_has_two_lengths() {
    let broker = lab::start().await;
    let (mut tunnel, _) = ByHand::of_alice(&broker).await;
    let (carol, mut events) = carol(&broker).await;
    let smuggled = tunnel.encode(message("smuggled"));
    let size = smuggled.len();
    let (path, text) = (
        tunnel.path(&format!("at={}", tunnel.up)),
        String::from_utf8_lossy(&smuggled),
    );
    let chunked = format!("{size:x}\r\n{text}\r\n0\r\n\r\n");
    for (fields, body) in [
        (
            format!("Content-Length: {size}\r\nTransfer-Encoding: chunked\r\n"),
            &*chunked,
        ),
        (
            format!("Transfer-Encoding: chunked\r\nContent-Length: {size}\r\n"),
            &*chunked,
        ),
        ("Transfer-Encoding: chunked\r\n".to_owned(), &*chunked),
        (
            format!("Transfer-Encoding: xchunked\r\nContent-Length: {size}\r\n"),
            &*text,
        ),
        (format!("Content-Length: {size}\r\nContent-Length: 0\r\n"), &*text),
        (format!("Content-Length: +{size}\r\n"), &*text),
        (format!("Content-Length: {size}\r\nHost: other\r\n"), &*text),
    ] {
        let behind = "GET /tunnel HTTP/1.1\r\nHost: hub\r\n\r\n";
        let whole =
            format!("POST {path} HTTP/1.1\r\nHost: hub\r\nConnection: close\r\n{fields}\r\n{body}{behind}");
        let answer = ask(tunnel.address, whole.as_bytes()).await;
        assert!([400, 411].contains(&answer.status), "{fields}: {answer:?}");
        assert!(!answer.said().contains("HTTP/1.1"), "one answer: {answer:?}");
    }
    let taken = tunnel.post(tunnel.up, b"").await.number("mom-taken");
    assert_eq!(taken, Some(tunnel.up));
    tunnel.say(message("the end")).await;
    assert_eq!(said(&mut events, "the end").await, ["the end"]);
    carol.close().await;
    broker.stop().await;
}

/// Where others on the path could read the id and take the tunnel over, it needs TLS.
#[tokio::test]
async fn threat_17_without_tls_it_is_for_loopback() {
    let broker = lab::start_with(|config| {
        config.listen[0].proxy = vec!["127.0.0.2/32".parse().expect("a network")];
    })
    .await;
    let open = request("POST", "/tunnel", "", b"");
    for header in [
        "PROXY TCP4 192.0.2.1 127.0.0.1 4000 7666\r\n",
        "PROXY TCP4 127.0.0.1 127.0.0.1 4000 7666\r\n",
        "PROXY UNKNOWN\r\n",
    ] {
        let socket = TcpSocket::new_v4().expect("a socket");
        let proxy = IpAddr::from([127, 0, 0, 2]);
        socket.bind((proxy, 0).into()).expect("an address of loopback");
        let mut stream = socket.connect(broker.local_addr()).await.expect("it listens");
        let bytes = [header.as_bytes(), &open].concat();
        stream.write_all(&bytes).await.expect("it reads");
        let answer = hear(stream).await;
        assert_eq!(answer.status, 403, "{header}");
        assert!(answer.said().contains("\"insecure\""), "{}", answer.said());
        assert!(answer.said().contains("https://"), "{}", answer.said());
    }
    ByHand::open(&broker).await;
    broker.stop().await;
}

/// What a proxy on this machine brings is a remote client's, which may be anywhere: neither a tunnel nor a password is taken from there.
#[tokio::test]
async fn threat_17_a_proxy_that_shows_itself_makes_no_password_safe() {
    let broker = lab::start().await;
    for field in [
        "Via: 1.1 proxy.example.org (squid/5.7)\r\n",
        "Forwarded: for=127.0.0.1;proto=https\r\n",
        "X-Forwarded-For: 127.0.0.1\r\n",
    ] {
        let open = request("POST", "/tunnel", field, b"");
        let refused = ask(broker.local_addr(), &open).await;
        assert_eq!(refused.status, 403, "{field}");
        assert!(refused.said().contains("\"insecure\""), "{field}: {refused:?}");
    }
    broker.stop().await;
}

/// What was opened where nobody could read along is used there only; a proxy that is believed says so.
#[tokio::test]
async fn threat_17_a_tunnel_of_tls_is_used_over_tls_only() {
    let broker = lab::start_with(|config| {
        config.web.forwarded_by = vec!["127.0.0.1/32".parse().expect("a network")];
    })
    .await;
    let secured = "Forwarded: for=192.0.2.60;proto=https\r\n";
    let tunnel = ByHand::open_with(&broker, secured).await;
    let path = tunnel.path("at=0");
    for (field, status) in [
        (secured, 200),
        ("", 403),
        ("Forwarded: for=192.0.2.60\r\n", 403),
        ("Forwarded: for=192.0.2.60;proto=https;by=\"_a\r\n", 403),
    ] {
        let answer = ask(tunnel.address, &request("POST", &path, field, b"")).await;
        assert_eq!(answer.status, status, "{field}: {answer:?}");
    }
    let open = request("POST", "/tunnel", "Forwarded: for=192.0.2.60\r\n", b"");
    assert_eq!(ask(tunnel.address, &open).await.status, 403);
    broker.stop().await;
}
