//! Health, figures, and what a user may see by HTTP.

use mom_broker::{Broker, KeyFile};
use mom_client::{Client, Map, Value};
use mom_proto::codec::Form;
use mom_tests::lab;
use mom_tests::login::{Issuer, claims};
use mom_tests::raw::{Raw, message};
use mom_tests::web::{Answer, Connection, ask};
use serde_json::json;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

const TOKEN: &str = "figures-for-prometheus";

async fn hub() -> Broker {
    lab::start_with(|config| {
        config.web.metrics_token = Some(KeyFile::from_text(TOKEN));
        config.web.origins = vec!["https://lab.example.org".to_owned()];
    })
    .await
}

async fn get(broker: &Broker, path: &str, headers: &[&str]) -> Answer {
    ask(broker.local_addr(), &format!("GET {path}"), headers, b"").await
}

async fn log_in(broker: &Broker, user: &str) -> Answer {
    let login = json!({ "user": user, "password": user }).to_string();
    ask(broker.local_addr(), "POST /api/login", &[], login.as_bytes()).await
}

/// The header line of the cookie that a login gave.
fn cookie(answer: &Answer) -> String {
    let cookie = answer.header("set-cookie").expect("a cookie");
    format!("Cookie: {}", cookie.split(';').next().expect("a pair"))
}

#[tokio::test]
async fn health_is_told_to_anybody() {
    let broker = hub().await;
    for path in ["/healthz", "/readyz"] {
        assert_eq!(get(&broker, path, &[]).await.status, 200, "{path}");
    }
    let unknown = get(&broker, "/nothing", &[]).await;
    assert_eq!(
        (unknown.status, &unknown.json()["code"]),
        (404, &json!("unknown-path"))
    );
    broker.stop().await;
}

/// Nobody takes the places of all guests by visits that he leaves behind.
#[tokio::test]
async fn guests_of_one_address_have_some_visits_and_no_more() {
    let broker = lab::start_with(|config| {
        config.login.guests = true;
        config.connections_per_user = Some(40);
    })
    .await;
    let mut connection = Connection::open(broker.local_addr()).await;
    let mut cookies = Vec::new();
    for visit in 0..200 {
        let opened = connection.ask("POST /api/login", &[], b"{}").await;
        assert_eq!(opened.status, 200, "{visit}: {}", opened.text());
        cookies.push(cookie(&opened));
    }
    let mut open = 0;
    for cookie in &cookies {
        let status = connection.ask("GET /api/contexts", &[cookie], b"").await.status;
        // A guest may not look there.
        assert!([403, 401].contains(&status), "{status}");
        open += usize::from(status == 403);
    }
    assert_eq!(open, 16);
    let last = cookies.last().expect("many").as_str();
    assert_eq!(
        connection.ask("GET /api/contexts", &[last], b"").await.status,
        403
    );
    broker.stop().await;
}

/// RFC 9112, 3.2.
#[tokio::test]
async fn a_request_says_whom_it_asks() {
    let broker = hub().await;
    for (head, status) in [
        ("GET /healthz HTTP/1.1\r\nHost: hub\r\n", 200),
        ("GET /healthz HTTP/1.1\r\n", 400),
        ("GET /healthz HTTP/1.1\r\nHost: hub\r\nHost: hub\r\n", 400),
        ("GET /healthz HTTP/1.0\r\n", 200),
    ] {
        let mut stream = TcpStream::connect(broker.local_addr()).await.expect("it listens");
        let asked = format!("{head}Connection: close\r\n\r\n");
        stream.write_all(asked.as_bytes()).await.expect("it reads");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).await.expect("it answers");
        assert!(
            answer.starts_with(&format!(
                "HTTP/1.{} {status} ",
                if head.contains("1.0") { 0 } else { 1 }
            )),
            "{head}: {answer}"
        );
    }
    broker.stop().await;
}

/// Ready is who takes one more peer.
#[tokio::test]
async fn a_full_hub_is_not_ready() {
    let broker = lab::start_with(|config| config.connections = 2).await;
    let mut connection = Connection::open(broker.local_addr()).await;
    assert_eq!(connection.ask("GET /readyz", &[], b"").await.status, 200);
    // The session's peer is one, and the connection of a user is not a stranger's, who could go for another.
    let login = json!({ "user": "alice", "password": "alice" }).to_string();
    let opened = connection.ask("POST /api/login", &[], login.as_bytes()).await;
    assert_eq!(opened.status, 200, "{}", opened.text());
    let cookie = cookie(&opened);
    assert_eq!(
        connection.ask("GET /api/contexts", &[&cookie], b"").await.status,
        200
    );
    let full = connection.ask("GET /readyz", &[], b"").await;
    assert_eq!(
        (full.status, &full.json()["code"]),
        (503, &json!("too-many-connections"))
    );
    assert_eq!(connection.ask("GET /healthz", &[], b"").await.status, 200);
    broker.stop().await;
}

#[tokio::test]
async fn metrics_are_for_their_token_and_for_who_may_have_statistics() {
    let broker = hub().await;
    let mut alice = Raw::login(broker.local_addr(), Form::Json, "alice").await;
    alice.join(&["/chat"]).await;
    let mut hello = message("chat", "/chat", "hello");
    hello.receipt = Some(true);
    alice.ask(hello).await.expect("taken");
    let figure = |answer: &Answer, name: &str| {
        let text = answer.text();
        let line = text.lines().find(|line| line.starts_with(name));
        line.unwrap_or_else(|| panic!("{name}: {text}"))
            .rsplit(' ')
            .next()
            .map(str::to_owned)
    };
    let shown = get(&broker, "/metrics", &[&format!("Authorization: Bearer {TOKEN}")]).await;
    assert_eq!(shown.status, 200, "{}", shown.text());
    assert_eq!(
        shown.header("content-type"),
        Some("application/openmetrics-text; version=1.0.0; charset=utf-8")
    );
    for (name, value) in [
        ("mom_peers{form=\"json\",door=\"tcp\",tls=\"false\"}", "1"),
        ("mom_messages_total", "1"),
        ("mom_deliveries_total", "1"),
    ] {
        assert_eq!(figure(&shown, name).as_deref(), Some(value), "{name}");
    }
    assert!(
        shown.text().ends_with("# EOF\n") && !shown.text().contains("alice"),
        "no labels of peers"
    );
    let named = get(
        &broker,
        "/metrics?peers=1",
        &[&format!("Authorization: Bearer {TOKEN}")],
    )
    .await;
    assert_eq!(
        figure(&named, "mom_peer_queued_bytes{peer=\"alice\",user=\"alice\"}").as_deref(),
        Some("0.0")
    );
    for (headers, status) in [
        (&[][..], 401),
        (&["Authorization: Bearer figures-for-prometheu"][..], 401),
        (&["Authorization: Bearer "][..], 401),
        (&["Cookie: mom-session=00112233445566778899aabbccddeeff"][..], 401),
    ] {
        let refused = get(&broker, "/metrics", headers).await;
        assert_eq!(refused.status, status, "{headers:?}: {}", refused.text());
        assert!(!refused.text().contains("mom_"), "{headers:?}");
    }
    broker.stop().await;
}

/// What a user sees is what the peer of that user sees, and goes with the session.
#[tokio::test]
async fn a_session_sees_what_its_user_may_see() {
    let broker = hub().await;
    let wrong = json!({ "user": "alice", "password": "nope" }).to_string();
    let wrong = ask(broker.local_addr(), "POST /api/login", &[], wrong.as_bytes()).await;
    assert_eq!((wrong.status, &wrong.json()["code"]), (401, &json!("bad-login")));
    assert_eq!(wrong.header("set-cookie"), None);
    assert_eq!(get(&broker, "/api/contexts", &[]).await.status, 401);

    let opened = log_in(&broker, "alice").await;
    assert_eq!(opened.status, 200, "{}", opened.text());
    assert_eq!(opened.json()["user"], "alice");
    let line = opened.header("set-cookie").expect("a cookie").to_owned();
    for part in ["HttpOnly", "SameSite=Strict", "Path=/"] {
        assert!(line.contains(part), "{line}");
    }
    assert!(!line.contains("Secure"), "loopback is plain: {line}");
    let cookie = cookie(&opened);
    let root = get(&broker, "/api/contexts", &[&cookie]).await.json();
    let paths: Vec<&str> = root["contexts"]
        .as_array()
        .expect("a list")
        .iter()
        .filter_map(|one| one["path"].as_str())
        .collect();
    assert!(paths.contains(&"/chat"), "{root}");
    let chat = get(&broker, "/api/contexts/chat", &[&cookie]).await.json();
    assert_eq!(
        (&chat["kind"], &chat["path"]),
        (&json!("channel"), &json!("/chat"))
    );
    let peers = get(&broker, "/api/peers", &[&cookie]).await;
    assert_eq!(peers.status, 200, "{}", peers.text());
    let peers = peers.json();
    // The session itself is a peer, inside the hub's process.
    assert_eq!(
        (&peers["peers"][0]["user"], &peers["peers"][0]["door"]),
        (&json!("alice"), &json!("http"))
    );
    // It leaves her the plain name for what she types.
    assert_eq!(
        (&opened.json()["peer"], &peers["peers"][0]["peer"]),
        (&json!("alice@http"), &json!("alice@http"))
    );
    let nothing = get(&broker, "/api/contexts/no%20thing", &[&cookie]).await;
    assert_eq!(
        (nothing.status, &nothing.json()["code"]),
        (400, &json!("bad-path"))
    );
    assert_eq!(
        get(&broker, "/api/contexts/nothing", &[&cookie]).await.status,
        404
    );

    let ended = ask(broker.local_addr(), "POST /api/logout", &[&cookie], b"").await;
    assert!(
        ended
            .header("set-cookie")
            .is_some_and(|line| line.contains("Max-Age=0"))
    );
    assert_eq!(get(&broker, "/api/contexts", &[&cookie]).await.status, 401);
    broker.stop().await;
}

/// Another site cannot ask in a user's name: neither with the cookie nor by a form.
#[tokio::test]
async fn a_foreign_origin_gets_nothing() {
    let broker = hub().await;
    let cookie = cookie(&log_in(&broker, "alice").await);
    for origin in ["https://evil.example.org", "null", "http://rebound.example.net"] {
        let answer = get(&broker, "/api/contexts", &[&cookie, &format!("Origin: {origin}")]).await;
        assert_eq!(answer.status, 403, "{origin}");
        assert_eq!(answer.header("access-control-allow-origin"), None);
    }
    let listed = get(
        &broker,
        "/api/contexts",
        &[&cookie, "Origin: https://lab.example.org"],
    )
    .await;
    assert_eq!(listed.status, 200);
    assert_eq!(
        listed.header("access-control-allow-origin"),
        Some("https://lab.example.org")
    );
    broker.stop().await;
}

/// M37: the newest image of a channel has a URL.
#[tokio::test]
async fn the_newest_image_of_a_channel_has_a_url() {
    let broker = hub().await;
    let cookie = cookie(&log_in(&broker, "alice").await);
    let address = broker.local_addr();
    let camera = Client::builder(format!("bin://{address}"))
        .user("camera")
        .password("camera")
        .connect();
    let camera = camera.await.expect("it may");
    let channel = camera.channel("/camera/x").await.expect("it may");
    let mut asked = channel.events();
    let take = |bytes: &[u8]| {
        Map::new()
            .with("format", "png")
            .with("image", Value::Binary(bytes.to_vec().into()))
    };
    let first = tokio::spawn({
        let (broker, cookie) = (address, cookie.clone());
        async move { ask(broker, "GET /api/image/camera/x", &[&cookie], b"").await }
    });
    // The caller becomes a member and requests an image.
    loop {
        let event = asked.next().await.expect("the hub goes on");
        if matches!(&event, mom_client::Event::Message(parcel) if parcel.name() == "request") {
            break;
        }
    }
    channel.send("image", take(b"first")).await.expect("sent");
    let first = first.await.expect("it ends");
    assert_eq!(
        (first.status, &first.body[..]),
        (200, &b"first"[..]),
        "{}",
        first.head
    );
    assert_eq!(first.header("content-type"), Some("image/png"));
    assert!(
        first.header("mom-age").is_some() && first.header("last-modified").is_some(),
        "{}",
        first.head
    );
    channel
        .message("image")
        .content(take(b"second"))
        .send_acknowledged()
        .await
        .expect("delivered");
    let mut second = get(&broker, "/api/image/camera/x", &[&cookie]).await;
    // The image is delivered to the session's peer; that it has been looked at is another task's work.
    while second.body == b"first" {
        second = get(&broker, "/api/image/camera/x", &[&cookie]).await;
    }
    assert_eq!(second.body, b"second");
    let denied = get(&broker, "/api/image/nothing", &[&cookie]).await;
    assert_eq!(denied.status, 404, "{}", denied.text());
    broker.stop().await;
}

/// A token (JWT) opens no session of its own for each request, and is refused when its time is over.
#[tokio::test]
async fn a_token_is_a_login_too() {
    let issuer = Issuer::number(1);
    let broker = lab::start_with(|config| config.login.jwt = Some(issuer.config())).await;
    let token = issuer.sign(&claims("alice", 4_000_000_000));
    let bearer = format!("Authorization: Bearer {token}");
    for _ in 0..2 {
        let answer = get(&broker, "/api/contexts/chat", &[&bearer]).await;
        assert_eq!(answer.status, 200, "{}", answer.text());
    }
    let over = format!(
        "Authorization: Bearer {}",
        issuer.sign(&claims("alice", 1_000_000_000))
    );
    let stranger = format!(
        "Authorization: Bearer {}",
        Issuer::number(2).sign(&claims("alice", 4_000_000_000))
    );
    for wrong in [over, stranger, format!("{bearer}x")] {
        let answer = get(&broker, "/api/contexts/chat", &[&wrong]).await;
        assert_eq!(
            (answer.status, &answer.json()["code"]),
            (401, &json!("bad-login"))
        );
    }
    let opened = ask(
        broker.local_addr(),
        "POST /api/login",
        &[],
        json!({ "jwt": token }).to_string().as_bytes(),
    )
    .await;
    assert_eq!((opened.status, &opened.json()["user"]), (200, &json!("alice")));
    broker.stop().await;
}

/// What comes through a proxy counts as near only where a proxy on the list says that nobody has read along.
#[tokio::test]
async fn a_login_through_a_proxy_needs_its_word() {
    let near = ["127.0.0.1".parse().expect("a network")];
    let broker = lab::start_with(|config| config.web.forwarded_by = near.to_vec()).await;
    let unlisted = lab::start().await;
    let login = json!({ "user": "alice", "password": "alice" }).to_string();
    for (broker, header, status) in [
        (&broker, "Forwarded: for=192.0.2.7;proto=https", 200),
        (&broker, "Forwarded: for=192.0.2.7;proto=http", 403),
        (&broker, "Forwarded: for=127.0.0.1;proto=http", 403),
        (&broker, "X-Other: 1", 403),
        (&unlisted, "Forwarded: for=192.0.2.7;proto=https", 403),
        (&unlisted, "Via: 1.1 squid", 403),
        (&unlisted, "X-Forwarded-For: 127.0.0.1", 403),
        (&unlisted, "X-Other: 1", 200),
    ] {
        let answer = ask(
            broker.local_addr(),
            "POST /api/login",
            &[header],
            login.as_bytes(),
        )
        .await;
        assert_eq!(answer.status, status, "{header}: {}", answer.text());
        match answer.header("set-cookie") {
            Some(cookie) => assert_eq!(cookie.contains("Secure"), header.contains("https"), "{cookie}"),
            None => assert_eq!(answer.json()["code"], "insecure", "{header}"),
        }
    }
    broker.stop().await;
    unlisted.stop().await;
}

#[tokio::test]
async fn a_new_configuration_holds_for_the_next_request() {
    let broker = hub().await;
    let origin = &["Origin: https://lab.example.org"];
    assert_eq!(get(&broker, "/healthz", origin).await.status, 200);
    let mut config = mom_broker::Config::lab();
    config.web.metrics_token = Some(KeyFile::from_text("another-token-of-16"));
    let report = broker.reload(config).expect("it is right");
    assert!(report.keys.contains(&"web".to_owned()), "{report}");
    assert_eq!(get(&broker, "/healthz", origin).await.status, 403);
    let bearer = |token: &str| format!("Authorization: Bearer {token}");
    assert_eq!(get(&broker, "/metrics", &[&bearer(TOKEN)]).await.status, 401);
    assert_eq!(
        get(&broker, "/metrics", &[&bearer("another-token-of-16")])
            .await
            .status,
        200
    );
    broker.stop().await;
}
