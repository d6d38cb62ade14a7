//! What channels have counted, for who may ask: through a real broker, and by the command line.

use std::sync::Arc;
use std::time::Duration;

use mom_broker::{Broker, Clock};
use mom_client::{Client, ClientError, Code};
use mom_proto::codec::Form;
use mom_proto::{Delivery, Family, Map, Parcel, Time, Value};
use mom_tests::programs::{program, text};
use mom_tests::raw::{Raw, message};
use mom_tests::{lab, login, tls};
use tokio::process::Command;
use tokio::task::spawn_blocking;

const HOUR: i64 = 3_600_000_000;

async fn log_in(broker: &Broker, scheme: &str, user: &str) -> Client {
    let builder = Client::builder(format!("{scheme}://{}", broker.local_addr()));
    let builder = builder.user(user).password(user);
    builder.connect().await.expect("a user of the lab")
}

/// A peer whose clock is an hour ahead, and whom the hub has asked for it.
async fn measured(broker: &Broker, clock: &Clock) -> Raw {
    let mut raw = Raw::login(broker.local_addr(), Form::Binary, "alice").await;
    let now = || Time::from_micros(clock.wall().micros() + HOUR).expect("a time");
    let ping = Parcel::new(Family::Time, "ping").id(1 << 40);
    raw.send_parcel(&ping.content(Map::new().with("sent", now())))
        .await;
    for _ in 0..4 {
        let ping = raw.next_of(Family::Time, "ping").await;
        let stamps = Map::new().with("received", now()).with("sent", now());
        let mut pong = Parcel::new(Family::Time, "pong").content(stamps);
        pong.reference = ping.id;
        raw.send_parcel(&pong).await;
    }
    raw
}

#[tokio::test]
async fn what_was_sent_and_how_old_it_was() {
    let clock = lab::clock();
    let broker = lab::start_at(clock.clone(), |_| {}).await;
    let bob = log_in(&broker, "tcp", "bob").await;
    let _chat = bob.channel("/chat").await.expect("people may");
    let mut alice = measured(&broker, &clock).await;
    alice.join(&["/chat"]).await;
    for old in [1_000, 1_000, 1_000, 90_000] {
        let mut parcel = message("say", "/chat", "four");
        parcel.timestamp = Time::from_micros(clock.wall().micros() + HOUR - old);
        parcel.receipt = Some(true);
        alice.ask(parcel).await.expect("people may");
    }

    let stats = bob.stats("/chat").await.expect("people may");
    assert_eq!((stats.time, stats.more), (clock.wall(), false));
    let chat = &stats.channels[0];
    assert_eq!((chat.path.as_str(), chat.members), ("/chat", 2));
    assert_eq!((chat.all.sent, chat.all.delivered, chat.all.lost()), (4, 8, 0));
    assert!(chat.all.bytes >= 16, "{chat:?}");
    let age = chat.all.age.expect("known ages");
    assert_eq!((age.count, age.most), (4, Duration::from_millis(90)));
    assert!(
        age.p50 >= Duration::from_millis(1) && age.p50 <= Duration::from_micros(1250),
        "{age:?}"
    );
    assert!(age.p99 >= Duration::from_millis(90), "{age:?}");

    let figures: Vec<_> = chat
        .peers
        .iter()
        .map(|peer| {
            (
                peer.peer.as_str(),
                peer.counts.sent,
                peer.counts.delivered,
                peer.counts.age.is_some(),
            )
        })
        .collect();
    assert_eq!(figures, [("bob", 0, 4, false), ("alice", 4, 4, true)]);

    // Who comes back begins anew, the channel does not.
    alice
        .ask_about(Family::Context, "leave", "/chat")
        .await
        .expect("nobody is kept");
    alice.join(&["/chat"]).await;
    let again = bob.stats("/chat").await.expect("people may");
    let chat = &again.channels[0];
    assert_eq!((chat.all.sent, chat.peers[1].counts.sent), (4, 0));
}

/// Who is here, through which door, and how they are: over each door, plain and with TLS, and inside the process.
#[tokio::test]
async fn who_is_here_and_through_which_door() {
    let broker = Arc::new(lab::start_with(|config| config.tls = tls::of_hub()).await);
    let mut alice = measured(&broker, &Clock::system()).await;
    alice.join(&["/chat"]).await;
    let address = broker.local_addr();
    let pin = broker.fingerprint().expect("it has a certificate");
    let mut clients = Vec::new();
    for url in [
        format!("tcp://{address}"),
        format!("jsons://{address}?pin={pin}"),
        format!("ws://{address}"),
        format!("wss://{address}?form=json&pin={pin}"),
        format!("http://{address}"),
        format!("https://{address}?poll=1&pin={pin}"),
    ] {
        let client = Client::builder(url).user("bob").password("bob");
        clients.push(client.connect().await.expect("a user of the lab"));
    }
    let local = Arc::clone(&broker);
    let inside = Client::builder_local(move || local.connect_local());
    let inside = inside.user("carol").password("carol");
    clients.push(inside.connect().await.expect("a user of the lab"));
    let asks = &clients[0];
    let stats = asks.stats("/").await.expect("people may");
    let seen: Vec<(&str, &str, &str, &str, bool)> = stats
        .peers
        .iter()
        .map(|peer| (&*peer.peer, &*peer.user, &*peer.form, &*peer.door, peer.tls))
        .collect();
    assert_eq!(
        seen,
        [
            ("alice", "alice", "binary", "tcp", false),
            ("bob", "bob", "xml", "tcp", false),
            ("bob~2", "bob", "json", "tcp", true),
            ("bob~3", "bob", "binary", "websocket", false),
            ("bob~4", "bob", "json", "websocket", true),
            ("bob~5", "bob", "binary", "tunnel", false),
            ("bob~6", "bob", "binary", "tunnel", true),
            ("carol", "carol", "none", "local", false),
        ]
    );
    let [alice, bob, .., inside] = stats.peers.as_slice() else {
        panic!("{stats:?}")
    };
    assert!(
        bob.heard < alice.heard,
        "he asks, and she has said nothing since: {stats:?}"
    );
    assert_eq!(
        (alice.from.as_deref(), inside.from.as_deref()),
        (Some("127.0.0.1"), None)
    );
    assert!(alice.round_trip.is_some(), "its pongs were heard: {alice:?}");
    assert!(alice.since < bob.since && inside.since < stats.time, "{stats:?}");
    for peer in &stats.peers[..7] {
        assert!(peer.sent > 0 && peer.received > 0, "{peer:?}");
        assert_eq!(peer.dropped, 0, "{peer:?}");
    }
    assert!(
        stats
            .memory
            .is_some_and(|memory| memory.bound > Some(memory.used))
    );
    assert_eq!(stats.more_peers, 0);
    // A session below the root tells nothing of it, and who has gone is gone.
    assert!(asks.stats("/robot").await.expect("people may").peers.is_empty());
    clients.pop().expect("the one inside").close().await;
    let again = clients[0].stats("/").await.expect("people may");
    assert_eq!(again.peers.len(), 7);
}

#[tokio::test]
async fn only_the_first_256_peers_are_listed() {
    let broker = lab::start_with(|config| config.login.guests = true).await;
    let mut guests = Vec::new();
    for _ in 0..257 {
        let mut guest = Raw::connect(broker.local_addr(), Form::Binary).await;
        let asked = login::log_in(&mut guest, Map::new().with("guest", true)).await;
        asked.expect("guests may");
        guests.push(guest);
    }
    let alice = log_in(&broker, "bin", "alice").await;
    let stats = alice.stats("/").await.expect("people may");
    assert_eq!((stats.peers.len(), stats.more_peers), (256, 2));
}

#[tokio::test]
async fn what_was_dropped_and_what_waits() {
    let broker = lab::start_with(|config| config.limits.outbox = 64 * 1024).await;
    let mut slow = Raw::connect_small(broker.local_addr(), Form::Binary).await;
    slow.log_in("bob").await;
    slow.join(&["/chat"]).await;
    let carol = log_in(&broker, "bin", "carol").await;
    let chat = carol.channel("/chat").await.expect("operators may");
    // Bob does not read: the link takes some, 64 KiB wait, and the rest is dropped.
    let frame = Value::Binary(vec![0; 16 * 1024].into());
    let mut dropped = 0;
    for _ in 0..2000 {
        let sent = chat.message("frame").no_echo().content(frame.clone());
        let receipt = sent.delivery(Delivery::Fleeting).send_acknowledged().await;
        receipt.expect("operators may");
        let stats = carol.stats("/chat").await.expect("operators may");
        let bob = &stats.channels[0].peers[0];
        assert_eq!(bob.peer, "bob");
        assert!(bob.counts.queued <= 80 * 1024, "{bob:?}");
        dropped = bob.counts.dropped.get("queue-full").copied().unwrap_or_default();
        if dropped > 0 {
            assert!(
                bob.counts.queued > 16 * 1024,
                "what is dropped has no room: {bob:?}"
            );
            let all = &stats.channels[0].all;
            assert_eq!(all.dropped.get("queue-full"), Some(&dropped));
            assert_eq!(all.dropped_classes, [("fleeting".to_owned(), dropped)].into());
            assert!(all.delivered <= all.sent, "one receiver: {all:?}");
            let peers = carol.stats("/").await.expect("operators may").peers;
            let bob = peers.iter().find(|peer| peer.peer == "bob").expect("he is here");
            assert!(bob.dropped >= dropped && bob.queued > 16 * 1024, "{bob:?}");
            break;
        }
    }
    assert!(dropped > 0, "nothing was dropped");
}

#[tokio::test]
async fn who_may_not_ask_is_not_told() {
    let broker = lab::start_with(|config| {
        let secret = Map::new()
            .with("deny", lab::words(&["stats"]))
            .with("users", lab::words(&["bob"]));
        lab::rule_chat(config, secret);
    })
    .await;
    let (alice, bob) = (
        log_in(&broker, "tcp", "alice").await,
        log_in(&broker, "bin", "bob").await,
    );
    let code = |refused: Result<_, ClientError>| match refused {
        Err(ClientError::Refused(error)) => error.code,
        other => panic!("{other:?}"),
    };
    assert_eq!(code(bob.stats("/chat").await), Code::DENIED);
    assert_eq!(code(bob.stats("/robot/token").await), Code::WRONG_KIND);
    assert_eq!(code(bob.stats("/nowhere").await), Code::UNKNOWN_PATH);
    let paths = |stats: &mom_client::Stats| {
        let mut paths: Vec<String> = stats
            .channels
            .iter()
            .map(|channel| channel.path.to_string())
            .collect();
        paths.sort();
        assert!(stats.channels.iter().all(|channel| channel.peers.is_empty()));
        paths
    };
    let seen = alice.stats("/").await.expect("people may");
    assert_eq!(
        paths(&seen),
        [
            "/calibrate",
            "/camera/pan",
            "/camera/top",
            "/camera/wrist",
            "/camera/x",
            "/camera/y",
            "/chat",
            "/model/objects",
            "/robot/arm",
            "/servo"
        ]
    );
    let seen = bob.stats("/").await.expect("people may");
    assert_eq!(
        paths(&seen),
        [
            "/calibrate",
            "/camera/pan",
            "/camera/top",
            "/camera/wrist",
            "/camera/x",
            "/camera/y",
            "/model/objects",
            "/robot/arm",
            "/servo"
        ]
    );
    assert_eq!(
        paths(&alice.stats("/robot").await.expect("people may")),
        ["/robot/arm"]
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn the_command_line_shows_it() {
    let broker = lab::start().await;
    let bob = log_in(&broker, "bin", "bob").await;
    let chat = bob.channel("/chat").await.expect("people may");
    chat.message("say")
        .content("hello")
        .send_acknowledged()
        .await
        .expect("people may");
    let built = spawn_blocking(|| program("mom")).await.expect("it is built");
    let mom = |args: &[&str]| {
        let mut command = Command::new(&built);
        command.args(args).kill_on_drop(true);
        command.env("MOM_HUB", format!("bin://{}", broker.local_addr()));
        command.env("MOM_USER", "alice").env("MOM_PASSWORD", "alice");
        command
    };
    let shown = mom(&["stats"]).output().await.expect("runs");
    let shown = text(&shown.stdout);
    let line = shown
        .lines()
        .find(|line| line.starts_with("/chat"))
        .expect("a row");
    let columns: Vec<&str> = line.split_whitespace().collect();
    assert_eq!(columns[..2], ["/chat", "1"], "{shown}");
    assert!(
        shown.contains("/robot/arm") && shown.contains("age p99"),
        "{shown}"
    );

    let shown = mom(&["stats", "/chat", "--json"]).output().await.expect("runs");
    let json: serde_json::Value = serde_json::from_slice(&shown.stdout).expect("JSON");
    assert_eq!(
        (&json["sent"], &json["peers"][0]["peer"]),
        (&1.into(), &"bob".into()),
        "{json}"
    );

    let refused = mom(&["stats", "/robot/token"]).output().await.expect("runs");
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        text(&refused.stderr).contains("only channels have statistics"),
        "{refused:?}"
    );
}
