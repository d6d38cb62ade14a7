//! Links, as any program with a socket has them: lost connections that come back, and what may not.

mod again;
mod doors;
mod held;
mod late;
mod survive;

use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use mom_broker::Broker;
use mom_proto::codec::Form;
use mom_proto::{Code, Family, Map, Parcel, ReadCount, Value};
use mom_tests::audit::AuditLog;
use mom_tests::lab;
use mom_tests::linked::{Link, Linked};
use mom_tests::raw::{Raw, at};

const GRACE: i64 = 60_000;

fn chat(text: &str) -> Parcel {
    Parcel::new(Family::Message, "say")
        .context(at("/chat"))
        .content(Value::from(text))
}

fn command(text: &str) -> Parcel {
    Parcel::new(Family::Message, "command")
        .context(at("/robot/arm"))
        .content(Value::from(text))
}

fn resent() -> Parcel {
    Parcel::new(Family::Time, "resent")
}

/// Loses a connection, as when a cable is pulled.
fn lose(linked: Linked) -> Link {
    linked.raw.reset();
    linked.link
}

async fn resume(link: &Link, address: SocketAddr, form: Form) -> (Linked, Value) {
    link.resume(address, form)
        .await
        .unwrap_or_else(|(error, _)| panic!("{error}"))
}

fn int(value: &Value, key: &str) -> i64 {
    value
        .get(key)
        .and_then(Value::as_int)
        .unwrap_or_else(|| panic!("{key} in {value:?}"))
}

/// Alice, with a link, in the chat; bob says things there.
async fn chatting(form: Form) -> (Broker, Linked, Raw) {
    let broker = lab::start().await;
    let mut alice = Linked::login(broker.local_addr(), form, "alice", GRACE).await;
    alice.about(Family::Context, "join", "/chat").await;
    let mut bob = Raw::login(broker.local_addr(), Form::Json, "bob").await;
    bob.join(&["/chat"]).await;
    alice.next_of(Family::Event, "joined").await;
    (broker, alice, bob)
}

async fn texts(linked: &mut Linked, count: usize) -> Vec<String> {
    let mut texts = Vec::new();
    while texts.len() < count {
        let said = linked.next_of(Family::Message, "say").await.value();
        texts.push(said.as_str().unwrap_or_default().to_owned());
    }
    texts
}

fn numbered(range: std::ops::Range<usize>) -> Vec<String> {
    range.map(|number| format!("{number}")).collect()
}

/// What was on its way, and what is said while the peer is away, comes once and in order: in the same form or another.
#[tokio::test]
async fn what_is_said_to_a_lost_peer_comes_once_and_in_order() {
    for (form, then) in [
        (Form::Binary, Form::Binary),
        (Form::Binary, Form::Xml),
        (Form::Json, Form::Binary),
        (Form::Xml, Form::Json),
    ] {
        let (broker, mut alice, mut bob) = chatting(form).await;
        let address = broker.local_addr();
        for text in numbered(0..20) {
            bob.send_parcel(&chat(&text)).await;
        }
        bob.check_alive().await;
        assert_eq!(texts(&mut alice, 7).await, numbered(0..7));
        let link = lose(alice);
        bob.next_of(Family::Event, "lost").await;
        for text in numbered(20..40) {
            bob.send_parcel(&chat(&text)).await;
        }
        bob.check_alive().await;
        let (mut alice, reply) = resume(&link, address, then).await;
        assert_eq!(
            reply.get("resumed"),
            Some(&Value::Bool(true)),
            "{form:?} {then:?}"
        );
        assert_eq!(reply.get("peer").and_then(Value::as_str), Some("alice"));
        assert_eq!(texts(&mut alice, 33).await, numbered(7..40), "{form:?} {then:?}");
        // It still is a member, under the same name.
        alice.raw.send_parcel(&resent()).await;
        alice.raw.send_parcel(&chat("back")).await;
        let said = bob.next_of(Family::Message, "say").await;
        let mut said = said;
        while said.value().as_str() != Some("back") {
            said = bob.next_of(Family::Message, "say").await;
        }
        assert_eq!(said.sender.as_deref(), Some("alice"));
        broker.stop().await;
    }
}

/// The hub says how many parcels of the peer it has read: the others are sent again, and only they.
#[tokio::test]
async fn what_a_lost_peer_has_said_is_counted() {
    let (broker, mut alice, mut bob) = chatting(Form::Binary).await;
    let before = 1;
    for text in numbered(0..300) {
        alice.raw.send_parcel(&chat(&text)).await;
    }
    alice.raw.send_parcel(&Parcel::new(Family::Time, "ping")).await;
    let mut acks = Vec::new();
    loop {
        let parcel = alice.next().await.expect("a pong");
        if parcel.is(Family::Time, "ack") {
            acks.push(int(&parcel.value(), "read"));
        }
        if parcel.is(Family::Time, "pong") {
            break;
        }
    }
    assert_eq!(acks.last(), Some(&(before + 300)), "before the pong: {acks:?}");
    alice.raw.send_parcel(&chat("300")).await;
    // A part of a frame is none.
    let half = Form::Binary.encode(&chat("301")).expect("a frame").to_vec();
    alice.raw.send(&half[..half.len() - 1]).await;
    let mut last = String::new();
    while last != "300" {
        let said = bob.next_of(Family::Message, "say").await.value();
        last = said.as_str().unwrap_or_default().to_owned();
    }
    let link = lose(alice);
    let (_alice, reply) = resume(&link, broker.local_addr(), Form::Binary).await;
    assert_eq!(int(&reply, "read"), before + 301);
    broker.stop().await;
}

/// Threat 14, 15: the device is halted at the loss, the token kept, and nothing of before moves the device again.
#[tokio::test]
async fn a_lost_owner_keeps_its_token_and_nothing_late_moves_the_robot() {
    let broker = lab::start().await;
    let address = broker.local_addr();
    let mut arm = Raw::login(address, Form::Binary, "arm").await;
    arm.join(&["/robot", "/robot/arm"]).await;
    let mut alice = Linked::login(address, Form::Json, "alice", GRACE).await;
    for path in ["/robot", "/robot/arm"] {
        alice.about(Family::Context, "join", path).await;
    }
    let fence = int(&alice.about(Family::Token, "grab", "/robot/token").await, "fence");
    alice.raw.send_parcel(&command("grip open")).await;
    arm.next_of(Family::Message, "command").await;
    let link = lose(alice);
    let halt = arm.next_of(Family::Message, "halt").await;
    assert_eq!(halt.sender.as_deref(), Some("hub"));
    let mut bob = Raw::login(address, Form::Json, "bob").await;
    bob.join(&["/robot"]).await;
    let error = bob
        .ask_about(Family::Token, "grab", "/robot/token")
        .await
        .expect_err("held");
    assert_eq!(error.code, Code::HELD);
    let lost = error
        .get("owner-lost")
        .and_then(Value::as_int)
        .expect("until when");
    assert!((1..=GRACE).contains(&lost), "{lost}");
    let (mut alice, _) = resume(&link, address, Form::Xml).await;
    // It says again what it had said before, without knowing of the halt.
    let late = alice.ask(command("move 1 2 3")).await.expect_err("too late");
    assert_eq!(
        (
            late.code.clone(),
            int(
                &Value::from(late.to_parcel(None).value().as_map().cloned().unwrap_or_default()),
                "fence"
            )
        ),
        (Code::OLDER_FENCE, fence)
    );
    let chat = alice.about(Family::Context, "info", "/robot/token").await;
    assert_eq!(chat.get("owner").and_then(Value::as_str), Some("alice"));
    alice.raw.send_parcel(&resent()).await;
    alice.raw.send_parcel(&command("grip close")).await;
    let next = arm.next_of(Family::Message, "command").await;
    assert_eq!(next.value().as_str(), Some("grip close"), "and nothing between");
    broker.stop().await;
}

/// Threat 14: an owner that is frozen, and wakes when its lease is over and the robot another's, is refused whatever it had in hand:
/// on the connection that it still has, and on the next one.
#[tokio::test]
async fn a_frozen_owner_that_wakes_moves_nothing() {
    let clock = lab::clock();
    let broker = lab::start_at(clock.clone(), |_| {}).await;
    let address = broker.local_addr();
    let mut arm = Raw::login(address, Form::Binary, "arm").await;
    arm.join(&["/robot", "/robot/arm"]).await;
    let mut alice = Linked::login(address, Form::Json, "alice", GRACE).await;
    for path in ["/robot", "/robot/arm"] {
        alice.about(Family::Context, "join", path).await;
    }
    let fence = int(&alice.about(Family::Token, "grab", "/robot/token").await, "fence");
    let mut bob = Raw::login(address, Form::Json, "bob").await;
    bob.join(&["/robot", "/robot/arm"]).await;
    let held = bob.ask_about(Family::Token, "grab", "/robot/token").await;
    assert_eq!(held.expect_err("held").code, Code::HELD);
    // Longer than the lease, and no word of alice.
    clock.advance(Duration::from_secs(181));
    let taken = bob.ask_about(Family::Token, "grab", "/robot/token").await;
    assert!(int(&taken.expect("it is free"), "fence") > fence);
    let fenced = |text| Parcel {
        fence: Some(u64::try_from(fence).expect("a fence")),
        ..command(text)
    };
    let error = alice.ask(fenced("as of before")).await.expect_err("not hers");
    assert_eq!(error.code, Code::OLDER_FENCE, "{error}");
    let error = alice.ask(command("anything")).await.expect_err("not hers");
    assert_eq!(error.code, Code::NOT_OWNER, "{error}");
    let link = lose(alice);
    bob.next_of(Family::Event, "lost").await;
    let (mut alice, _) = resume(&link, address, Form::Binary).await;
    let error = alice.ask(fenced("said before")).await.expect_err("too late");
    assert_eq!(error.code, Code::OLDER_FENCE, "{error}");
    alice.raw.send_parcel(&resent()).await;
    for parcel in [fenced("as of before"), command("anything")] {
        alice.ask(parcel).await.expect_err("not hers");
    }
    bob.send_parcel(&command("grip open")).await;
    let next = arm.next_of(Family::Message, "command").await;
    assert_eq!(next.value().as_str(), Some("grip open"), "and nothing before");
    assert_eq!(next.sender.as_deref(), Some("bob"));
    broker.stop().await;
}

/// A robot whose address changes goes on from there, and is seen there.
#[tokio::test]
async fn a_peer_comes_back_from_another_address() {
    let (broker, alice, mut bob) = chatting(Form::Binary).await;
    let link = lose(alice);
    bob.next_of(Family::Event, "lost").await;
    bob.send_parcel(&chat("meanwhile")).await;
    bob.check_alive().await;
    let elsewhere = IpAddr::from([127, 0, 0, 2]);
    let mut raw = Raw::connect_from(elsewhere, broker.local_addr(), Form::Binary).await;
    let reply = link.prove(&mut raw).await.expect("its secret");
    assert_eq!(reply.get("resumed"), Some(&Value::Bool(true)));
    let mut alice = Linked { raw, link };
    assert_eq!(texts(&mut alice, 1).await, ["meanwhile"]);
    let mut carol = Raw::login(broker.local_addr(), Form::Json, "carol").await;
    let stats = carol.ask_about(Family::Context, "stats", "/").await;
    let stats = stats.expect("operators may");
    let peers = stats
        .get("peers")
        .and_then(Value::as_list)
        .expect("peers")
        .to_vec();
    let text = |peer: &Value, key: &str| peer.get(key).and_then(Value::as_str).map(str::to_owned);
    let peer = peers
        .iter()
        .find(|peer| text(peer, "user").as_deref() == Some("alice"));
    let peer = peer.expect("she is here");
    assert_eq!(text(peer, "from").as_deref(), Some("127.0.0.2"), "{peer:?}");
    broker.stop().await;
}

/// A device that was away gets no command of that time, nor one that it had not read; their senders are told.
#[tokio::test]
async fn a_lost_device_gets_no_command_of_before() {
    let broker = lab::start().await;
    let address = broker.local_addr();
    let mut arm = Linked::login(address, Form::Binary, "arm", GRACE).await;
    for path in ["/robot", "/robot/arm"] {
        arm.about(Family::Context, "join", path).await;
    }
    let mut alice = Raw::login(address, Form::Json, "alice").await;
    alice.join(&["/robot", "/robot/arm"]).await;
    alice
        .ask_about(Family::Token, "grab", "/robot/token")
        .await
        .expect("free");
    let receipt = |text| {
        let mut parcel = command(text);
        parcel.receipt = Some(true);
        parcel
    };
    let taken = alice.ask(receipt("before")).await.expect("owner").value();
    assert_eq!(int(&taken, "delivered"), 2);
    let link = lose(arm);
    alice.next_of(Family::Event, "lost").await;
    let taken = alice.ask(receipt("while")).await.expect("owner").value();
    assert_eq!(taken.get("dropped"), Some(&Value::from(vec![Value::from("arm")])));
    let (mut arm, _) = resume(&link, address, Form::Binary).await;
    let mut dropped = 0;
    while dropped < 2 {
        let told = alice.next_of(Family::Event, "dropped").await.value();
        assert_eq!(
            told.get("reason").and_then(Value::as_str),
            Some("lost"),
            "{told:?}"
        );
        dropped += int(&told, "count");
    }
    alice.send_parcel(&command("after")).await;
    let next = arm.next_of(Family::Message, "command").await;
    assert_eq!(next.value().as_str(), Some("after"));
    broker.stop().await;
}

/// What the peer had in hand before it got lost comes with its id, so a request whose answer is lost is answered once.
#[tokio::test]
async fn an_answer_on_its_way_is_not_lost() {
    let (broker, mut alice, mut bob) = chatting(Form::Json).await;
    let id = alice
        .raw
        .post(Parcel::new(Family::Context, "members").context(at("/chat")))
        .await;
    alice.raw.send_parcel(&chat("done")).await;
    bob.next_of(Family::Message, "say").await;
    let link = lose(alice);
    let (mut alice, _) = resume(&link, broker.local_addr(), Form::Json).await;
    let reply = alice.next_of(Family::Reply, "ok").await;
    assert_eq!(reply.reference, Some(id));
    broker.stop().await;
}

#[tokio::test]
async fn a_link_that_is_over_is_not_resumed_and_a_login_may_follow() {
    let (broker, alice, _bob) = chatting(Form::Json).await;
    let address = broker.local_addr();
    let link = lose(alice);
    let stolen = Link {
        secret: vec![0; 32],
        ..link.clone()
    };
    let guessed = Link {
        id: "0".repeat(32),
        ..link.clone()
    };
    for wrong in [stolen, guessed] {
        let (error, mut raw) = wrong.resume(address, Form::Json).await.expect_err("nothing");
        assert_eq!(error.code, Code::NOT_RESUMED);
        assert_eq!(error.get("resumed"), Some(&Value::Bool(false)));
        raw.log_in("carol").await;
    }
    // That has hurt nobody.
    let (mut alice, _) = resume(&link, address, Form::Json).await;
    alice
        .ask(Parcel::new(Family::Login, "logout"))
        .await
        .expect("always");
    while alice.next().await.is_some() {}
    let (error, _) = alice
        .link
        .resume(address, Form::Json)
        .await
        .expect_err("it has logged out");
    assert_eq!(error.code, Code::NOT_RESUMED);
    broker.stop().await;
}

/// Threat 14: a stolen id without its secret gets nothing, and the audit log tells whose it was.
#[tokio::test]
async fn a_stolen_id_is_in_the_audit_log() {
    let audit = AuditLog::new();
    let broker = lab::start_with(|config| config.audit.path = Some(audit.path())).await;
    let address = broker.local_addr();
    let alice = Linked::login(address, Form::Json, "alice", GRACE).await;
    let stolen = Link {
        secret: vec![1; 32],
        ..alice.link.clone()
    };
    assert!(stolen.resume(address, Form::Json).await.is_err());
    drop(alice);
    broker.stop().await;
    let refused = [
        ("what", "refused"),
        ("verb", "resume"),
        ("peer", "alice"),
        ("user", "alice"),
        ("code", "not-resumed"),
        ("from", "127.0.0.1"),
    ];
    assert_eq!(audit.lines().count(&refused), 1);
    let text = std::fs::read_to_string(audit.path()).expect("the log");
    assert!(!text.contains(&stolen.id), "nobody reads ids there");
}

#[tokio::test]
async fn two_connections_that_resume_do_not_share_the_link() {
    let (broker, mut alice, mut bob) = chatting(Form::Json).await;
    let address = broker.local_addr();
    // The first connection has not noticed that it is lost.
    let link = alice.link.clone();
    let (mut second, _) = resume(&link, address, Form::Binary).await;
    let error = alice.raw.next_error().await;
    assert_eq!(error.code, Code::TAKEN_OVER);
    assert!(alice.next().await.is_none(), "and it is closed");
    second.raw.send_parcel(&resent()).await;
    second.raw.send_parcel(&chat("still here")).await;
    bob.next_of(Family::Message, "say").await;
    let link = second.link.clone();
    let both = tokio::join!(link.resume(address, Form::Json), link.resume(address, Form::Json));
    let (mut won, mut lost) = (0, 0);
    for one in [both.0, both.1] {
        match one {
            Ok((mut linked, _)) => {
                linked.raw.send_parcel(&Parcel::new(Family::Time, "ping")).await;
                // One that had it for a moment hears that it has lost it.
                let lives = loop {
                    match linked.next().await {
                        Some(parcel) if parcel.is(Family::Time, "pong") => break true,
                        Some(parcel) if parcel.is(Family::Error, "taken-over") => break false,
                        Some(_) => {}
                        None => break false,
                    }
                };
                won += u32::from(lives);
                lost += u32::from(!lives);
            }
            Err((error, _)) => {
                // It came after the other one, or before it with an older challenge.
                assert!(
                    [Code::TAKEN_OVER, Code::NOT_RESUMED].contains(&error.code),
                    "{error}"
                );
                lost += 1;
            }
        }
    }
    assert_eq!((won, lost), (1, 1));
    broker.stop().await;
}

#[tokio::test]
async fn counts_that_cannot_be_end_the_link() {
    let (broker, mut alice, mut bob) = chatting(Form::Json).await;
    let address = broker.local_addr();
    let ack = |read: i64| Parcel::new(Family::Time, "ack").content(Map::new().with("read", read));
    alice.raw.send_parcel(&ack(1000)).await;
    assert_eq!(alice.raw.next_error().await.code, Code::BAD_COUNT);
    bob.next_of(Family::Event, "left").await;
    let (error, _) = alice
        .link
        .resume(address, Form::Json)
        .await
        .expect_err("it has ended");
    assert_eq!(error.code, Code::NOT_RESUMED);
    let mut alice = Linked::login(address, Form::Json, "alice", GRACE).await;
    alice.about(Family::Context, "join", "/chat").await;
    let read = alice.link.read;
    alice
        .raw
        .send_parcel(&ack(i64::try_from(read.parcels).expect("a few")))
        .await;
    alice.raw.send_parcel(&ack(0)).await;
    assert_eq!(
        alice.raw.next_error().await.code,
        Code::BAD_COUNT,
        "less than before"
    );
    let mut alice = Linked::login(address, Form::Json, "alice", GRACE).await;
    alice.about(Family::Context, "join", "/chat").await;
    let link = Link {
        read: ReadCount {
            parcels: 99,
            checksum: None,
        },
        ..lose(alice)
    };
    let (error, mut raw) = link.resume(address, Form::Json).await.expect_err("never said");
    assert_eq!(error.code, Code::BAD_COUNT);
    raw.check_closed().await;
    bob.next_of(Family::Event, "left").await;
    broker.stop().await;
}

/// The hub keeps no more than an outbox for a peer that is away.
#[tokio::test]
async fn what_does_not_fit_is_told_and_not_resumed() {
    let broker = lab::start_with(|config| config.limits.outbox = 64 * 1024).await;
    let address = broker.local_addr();
    let mut alice = Linked::login(address, Form::Binary, "alice", GRACE).await;
    alice.about(Family::Context, "join", "/chat").await;
    let mut bob = Raw::login(address, Form::Binary, "bob").await;
    bob.join(&["/chat"]).await;
    let large = "x".repeat(8 * 1024);
    // More than is kept has left, and the peer says that it has read none of it.
    let read = alice.link.read;
    for _ in 0..20 {
        bob.send_parcel(&chat(&large)).await;
    }
    texts(&mut alice, 20).await;
    let link = Link { read, ..lose(alice) };
    let (error, _) = link.resume(address, Form::Binary).await.expect_err("lost");
    assert_eq!(error.code, Code::NOT_RESUMED);
    let lost = error.get("lost").and_then(Value::as_int).expect("how many");
    assert!((10..=21).contains(&lost), "{lost}");
    // What is heard of the next one must not be taken for this one's.
    bob.next_of(Family::Event, "left").await;
    // While it is away, no more waits than that; then it is gone.
    let mut alice = Linked::login(address, Form::Binary, "alice", GRACE).await;
    alice.about(Family::Context, "join", "/chat").await;
    let link = lose(alice);
    bob.next_of(Family::Event, "lost").await;
    for _ in 0..20 {
        bob.send_parcel(&chat(&large)).await;
    }
    bob.next_of(Family::Event, "left").await;
    let (error, _) = link.resume(address, Form::Binary).await.expect_err("gone");
    assert_eq!(error.code, Code::NOT_RESUMED);
    broker.stop().await;
}

#[tokio::test]
async fn who_does_not_come_back_in_time_is_gone_and_a_restart_knows_no_link() {
    let broker = lab::start().await;
    let address = broker.local_addr();
    let mut bob = Raw::login(address, Form::Json, "bob").await;
    bob.join(&["/chat"]).await;
    let mut alice = Linked::login(address, Form::Json, "alice", 50).await;
    alice.about(Family::Context, "join", "/chat").await;
    let link = lose(alice);
    bob.next_of(Family::Event, "lost").await;
    bob.next_of(Family::Event, "left").await;
    let (error, _) = link.resume(address, Form::Json).await.expect_err("gone");
    assert_eq!(error.code, Code::NOT_RESUMED);
    let mut alice = Linked::login(address, Form::Json, "alice", GRACE).await;
    alice.about(Family::Context, "join", "/chat").await;
    let link = lose(alice);
    bob.next_of(Family::Event, "lost").await;
    broker.stop().await;
    let broker = lab::start().await;
    let (error, mut raw) = link
        .resume(broker.local_addr(), Form::Json)
        .await
        .expect_err("another hub");
    assert_eq!(error.code, Code::NOT_RESUMED);
    assert_eq!(error.get("resumed"), Some(&Value::Bool(false)));
    raw.log_in("alice").await;
    broker.stop().await;
}

/// A login that asks for it is heard of every 100 ms, and its loss is known after three times that.
#[tokio::test]
async fn signs_of_life_are_as_often_as_a_login_asks() {
    let broker = lab::start().await;
    let mut bob = Raw::login(broker.local_addr(), Form::Json, "bob").await;
    bob.join(&["/chat"]).await;
    let mut alice = Raw::connect(broker.local_addr(), Form::Json).await;
    let login = |beat: i64| {
        let content = Map::new()
            .with("name", "alice")
            .with("password", "alice")
            .with("link", true)
            .with("heartbeat", beat);
        Parcel::new(Family::Login, "login").content(content)
    };
    let error = alice.ask(login(99)).await.expect_err("too often");
    assert_eq!(
        error.get("slot").and_then(Value::as_str),
        Some("content/heartbeat")
    );
    let welcome = alice.ask(login(100)).await.expect("a user").value();
    let limits = welcome.get("limits").expect("limits").clone();
    assert_eq!((int(&limits, "heartbeat"), int(&limits, "gone")), (100, 300));
    alice.join(&["/chat"]).await;
    alice.next_of(Family::Time, "ping").await;
    // It answers no more: half-open, for all that the hub knows.
    bob.next_of(Family::Event, "lost").await;
    // Nothing is said that it would count: it comes back, or is gone.
    while let Some(parcel) = alice.next().await {
        assert_ne!(parcel.family, Family::Error, "{parcel:?}");
    }
    broker.stop().await;
}
