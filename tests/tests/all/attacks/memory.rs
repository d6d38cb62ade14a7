//! One bound for all that waits: who holds most loses, and nobody else.

use std::time::Duration;

use mom_broker::{Broker, Clock, Config};
use mom_proto::codec::Form;
use mom_proto::{Code, Family, Map, Parcel, Value};
use mom_tests::attacks::{Attack, Attackers, configuration};
use mom_tests::canary::Canary;
use mom_tests::raw::{Raw, at, message};

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
    let refused = loop {
        if let Err(error) = bob.ask(block("/free/hoard")).await {
            break error;
        }
        canary.check().await;
    };
    assert_eq!(refused.code, Code::OVER_MEMORY, "{refused}");
    assert!(refused.retry_in().is_some_and(|wait| wait > Duration::ZERO));
    // Others go on, and control does.
    carol.ask(block("/kept")).await.expect("carol holds little");
    let memory = told(&mut carol).await;
    // On a busy machine bob may be out by now.
    let held = held_by(&memory, "bob");
    assert!(held > 3 * MIB as i64 || held == 0, "{memory:?}");
    assert_eq!(memory.get("bound"), Some(&Value::Int(4 * MIB as i64)));
    assert_eq!(bob.last_error().await, Some(Code::OUT_OF_MEMORY));
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
