//! One bound for all that waits: who holds most loses, and nobody else.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use mom_broker::{Broker, Clock, Config};
use mom_proto::codec::Form;
use mom_proto::{Code, Family, Map, Parcel, Value, WireError};
use mom_tests::attacks::{Attack, Attackers, configuration};
use mom_tests::canary::Canary;
use mom_tests::process::resident;
use mom_tests::programs::{Running, project};
use mom_tests::raw::{PATIENCE, Raw, at, message};
use tempfile::TempDir;
use tokio::task::spawn_blocking;

const MIB: usize = 1 << 20;

async fn start(memory: usize) -> (Broker, Canary) {
    let mut config = Config::load(&configuration()).expect("a right configuration");
    config.memory = Some(memory);
    let broker = Broker::start_at(config, Clock::system())
        .await
        .expect("it starts");
    let canary = Canary::start(broker.local_addr()).await;
    (broker, canary)
}

/// What `stats` of the root says of memory.
async fn told(peer: &mut Raw) -> Value {
    let stats = peer
        .ask_about(Family::Context, "stats", "/")
        .await
        .expect("permitted");
    stats.get("memory").cloned().expect("the root tells of memory")
}

fn held_by(told: &Value, user: &str) -> i64 {
    let users = told.get("users").and_then(Value::as_list).unwrap_or_default();
    let of_user = users
        .iter()
        .find(|entry| entry.get("user") == Some(&Value::from(user)));
    of_user
        .and_then(|entry| entry.get("bytes")?.as_int())
        .unwrap_or_default()
}

/// A message that is never dropped by itself.
fn block(path: &str) -> Parcel {
    let mut block = message("block", path, Value::Binary(vec![7; 64 * 1024].into()));
    block.receipt = Some(true);
    block
}

/// The first error that a peer is told while it asks for the same again and again, without a pause, as a peer that is refused for a
/// second is put out.
async fn first_error(peer: &mut Raw, parcel: impl Fn() -> Parcel) -> WireError {
    loop {
        let id = peer.post(parcel()).await;
        loop {
            let answer = peer
                .next()
                .await
                .expect("an error is told before the connection ends");
            if answer.family == Family::Error {
                return WireError::from_parcel(&answer);
            }
            if answer.reference == Some(id) {
                break;
            }
        }
    }
}

#[tokio::test]
async fn who_has_most_kept_is_refused_then_put_out() {
    let (broker, mut canary) = start(4 * MIB).await;
    let mut carol = Raw::login(broker.local_addr(), Form::Binary, "carol").await;
    carol.join(&["/kept"]).await;
    carol.ask(block("/kept")).await.expect("there is room");
    let mut bob = Raw::login(broker.local_addr(), Form::Binary, "bob").await;
    let keep = Map::new().with("bytes", 16 * 1024 * 1024).with("parcels", 1000);
    let create = Parcel::new(Family::Context, "create").context(at("/free/hoard"));
    bob.join(&["/free"]).await;
    let made = bob
        .ask(create.content(Map::new().with("kind", "channel").with("keep", keep)))
        .await;
    made.expect("anybody may");
    bob.join(&["/free/hoard"]).await;
    let refused = first_error(&mut bob, || block("/free/hoard")).await;
    canary.check().await;
    // On a busy machine the second may be over before bob reads that he is refused.
    let is_out = refused.code == Code::OUT_OF_MEMORY;
    if !is_out {
        assert_eq!(refused.code, Code::OVER_MEMORY, "{refused}");
        assert!(refused.retry_in().is_some_and(|wait| wait > Duration::ZERO));
    }
    // Others go on, and control does.
    carol.ask(block("/kept")).await.expect("carol holds little");
    let memory = told(&mut carol).await;
    // On a busy machine bob may be out by now.
    let held = held_by(&memory, "bob");
    assert!(held > 3 * MIB as i64 || held == 0, "{memory:?}");
    assert_eq!(memory.get("bound"), Some(&Value::Int(4 * MIB as i64)));
    if !is_out {
        assert_eq!(bob.last_error().await, Some(Code::OUT_OF_MEMORY));
    }
    let memory = told(&mut carol).await;
    assert_eq!(held_by(&memory, "bob"), 0, "{memory:?}");
    assert!(
        held_by(&memory, "carol") > 128 * 1024,
        "what carol has kept stays: {memory:?}"
    );
    assert!(canary.stop().await > 0);
    broker.check();
    broker.stop().await;
}

#[tokio::test]
async fn the_largest_queues_lose_what_may_be_dropped() {
    let (broker, mut canary) = start(3 * MIB).await;
    let mut attackers = Attackers::connect(Attack::Sleepers, broker.local_addr()).await;
    while attackers.times("dropped: memory") == 0 {
        attackers.round().await;
        canary.check().await;
    }
    let mut carol = Raw::login(broker.local_addr(), Form::Binary, "carol").await;
    assert!(held_by(&told(&mut carol).await, "bob") <= 3 * MIB as i64);
    assert!(canary.stop().await > 0);
    broker.stop().await;
}

#[tokio::test]
async fn unfinished_parcels_count() {
    let (broker, mut canary) = start(64 * MIB).await;
    let mut attackers = Attackers::connect(Attack::Chunks, broker.local_addr()).await;
    attackers.round().await;
    canary.check().await;
    let mut carol = Raw::login(broker.local_addr(), Form::Binary, "carol").await;
    let memory = told(&mut carol).await;
    assert!(held_by(&memory, "bob") > 7 * MIB as i64, "{memory:?}");
    assert!(canary.stop().await > 0);
    broker.stop().await;
}

#[tokio::test]
async fn a_large_stop_goes_without_its_content_and_its_sender_hears_so() {
    let (broker, canary) = start(64 * MIB).await;
    let mut robot = Raw::login(broker.local_addr(), Form::Xml, "carol").await;
    let mut operator = Raw::login(broker.local_addr(), Form::Binary, "bob").await;
    for peer in [&mut robot, &mut operator] {
        peer.join(&["/chat"]).await;
    }
    for (size, heard) in [(4000, true), (5000, false)] {
        let mut stop = message("stop", "/chat", "x".repeat(size));
        stop.echo = Some(false);
        stop.extra = Map::new().with("why", "smoke");
        let id = operator.post(stop).await;
        let came = robot.next_of(Family::Message, "stop").await;
        assert_eq!(
            (came.content.is_some(), came.extra.get("why").is_some()),
            (heard, heard),
            "{size}"
        );
        if !heard {
            let told = operator.next_of(Family::Event, "shortened").await;
            assert_eq!(told.reference, Some(id));
            assert_eq!(told.value().get("most"), Some(&Value::Int(4096)));
        }
    }
    operator.check_alive().await;
    canary.stop().await;
    broker.stop().await;
}

/// A broker of its own with so much memory: its process is looked at.
async fn program(memory: usize) -> (Running, SocketAddr, TempDir) {
    let folder = tempfile::tempdir().expect("a folder");
    let attacked = std::fs::read_to_string(configuration()).expect("it is there");
    let users = project().join("config/lab-users.toml");
    let attacked = attacked.replace(
        "../config/lab-users.toml",
        users.to_str().expect("a path in text"),
    );
    let file = folder.path().join("attacked.toml");
    std::fs::write(&file, format!("memory = {memory}\n{attacked}")).expect("written");
    let started = spawn_blocking(move || Running::broker(&file)).await;
    let (broker, address) = started.expect("it starts");
    (broker, address.parse().expect("an address"), folder)
}

/// What is dropped before its turn is not written, no queue keeps it, and who reads something else in that form does not wait for it.
#[tokio::test(flavor = "multi_thread")]
async fn what_waits_to_be_written_in_another_form_is_bounded_and_delays_no_other_reader() {
    let bound = 64 * MIB;
    let (broker, address, _folder) = program(bound).await;
    let mut canary = Canary::start(address).await;
    let mut reader = Raw::login(address, Form::Xml, "bob").await;
    reader.join(&["/bulk"]).await;
    let mut viewer = Raw::login(address, Form::Xml, "carol").await;
    viewer.join(&["/chat"]).await;
    let mut sender = Raw::login(address, Form::Binary, "bob").await;
    sender.join(&["/bulk", "/chat"]).await;
    let begin = resident(&broker, "VmRSS");
    let read = tokio::spawn(async move { while reader.next().await.is_some() {} });
    let doubles = |count: usize| (0..count).map(|number| Value::Double(number as f64 + 0.125));
    let scan = message("scan", "/bulk", Value::List(doubles(110_000).collect()));
    let small = message("scan", "/chat", Value::List(doubles(1000).collect()));
    for round in 0..40 {
        for _ in 0..16 {
            sender.send_parcel(&scan).await;
        }
        if round % 10 == 0 {
            sender.send_parcel(&small).await;
            viewer.next_of(Family::Message, "scan").await;
        }
        canary.check().await;
    }
    let most = resident(&broker, "VmHWM");
    let allowed = bound + bound / 4 + 64 * MIB;
    assert!(most <= allowed, "{} of {} MiB", most / MIB, allowed / MIB);
    // And it is given back.
    let allowed = begin + begin / 10 * 3 + 64 * MIB;
    let until = Instant::now() + PATIENCE;
    while resident(&broker, "VmRSS") > allowed {
        let now = resident(&broker, "VmRSS");
        assert!(Instant::now() < until, "{} of {} MiB", now / MIB, allowed / MIB);
        canary.check().await;
    }
    read.abort();
    assert!(canary.stop().await > 0);
    drop(broker);
}
