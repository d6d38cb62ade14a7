//! Threat 27: a publisher at many times the rate of its receivers.

use std::net::SocketAddr;
use std::time::Duration;

use bytes::Bytes;
use mom_broker::Config;
use mom_proto::codec::Form;
use mom_proto::{ContextNumber, Delivery, Family, Map, Parcel, Value, from_value};
use mom_tests::bridge::Way;
use mom_tests::lab;
use mom_tests::raw::{Raw, message};
use tokio::sync::watch;
use tokio::task::JoinHandle;

use super::World;

const BULK: &str = "/bulk";
const OUTBOX: usize = 1024 * 1024;
const SIZE: usize = 16 * 1024;
/// What a batch of a writer holds beside the outbox, and one message.
const UNDER_WAY: i64 = 256 * 1024 + SIZE as i64;
/// Blocks that two sockets and an outbox hold together, at most.
const KERNEL: u64 = 2048;
/// Stops that pass while the flood goes on.
const STOPS: usize = 20;

fn bulk(config: &mut Config, overflow: &str, delivery: Delivery) {
    let bulk = Map::new()
        .with("path", BULK)
        .with("kind", "channel")
        .with("delivery", delivery.word())
        .with("overflow", overflow);
    config.contexts.push(from_value(bulk.into()).expect("a context"));
    (config.limits.outbox, config.limits.burst) = (OUTBOX, OUTBOX);
    // Nobody is late because the machine is busy.
    (config.limits.send_wait, config.limits.stalled) = (60_000, 120_000);
}

async fn world(overflow: &str, delivery: Delivery) -> World {
    World::start_with(|config| bulk(config, overflow, delivery)).await
}

/// The doors beside TCP, in the forms of those who command.
fn doors() -> Vec<(Form, Way)> {
    let of = |form| Way::beside(form).into_iter().map(move |way| (form, way));
    of(Form::Binary).chain(of(Form::Json).skip(2)).collect()
}

/// A peer in the channel, whose kernel takes little for it.
async fn listener(address: SocketAddr, form: Form, user: &str) -> Raw {
    let mut raw = Raw::connect_small(address, form).await;
    raw.log_in(user).await;
    raw.join(&[BULK]).await;
    raw
}

/// A publisher that never pauses and hears nothing; how many messages its system has taken from it so far.
struct Flood {
    sent: watch::Receiver<u64>,
    task: JoinHandle<()>,
}

impl Flood {
    async fn start(address: SocketAddr, form: Form) -> Flood {
        let mut raw = Raw::login(address, form, "bob").await;
        raw.join(&[BULK]).await;
        let (count, sent) = watch::channel(0);
        let task = tokio::spawn(async move {
            for id in 1.. {
                let mut frame = message("block", BULK, Value::Binary(Bytes::from(vec![7; SIZE])));
                (frame.id, frame.address) = (Some(id), Some(vec!["camera".into()]));
                let frame = form.encode(&frame).expect("a frame").to_vec();
                // Without Raw's patience: to be held back is what this is about.
                if raw.send_patiently(&frame).await.is_err() {
                    return;
                }
                count.send_replace(id);
            }
        });
        Flood { sent, task }
    }

    /// Waits until so many were sent.
    async fn reach(&mut self, count: u64) {
        let reached = self.sent.wait_for(|sent| *sent >= count);
        let reached = tokio::time::timeout(mom_tests::raw::PATIENCE, reached).await;
        reached.expect("it goes on").expect("it is connected");
    }

    fn sent(&self) -> u64 {
        *self.sent.borrow()
    }
}

impl Drop for Flood {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// The bytes that wait for a peer of the channel.
async fn queued(raw: &mut Raw, peer: &str) -> i64 {
    let stats = raw.ask_about(Family::Context, "stats", BULK).await;
    let stats = stats.expect("people may");
    let peers = stats.get("peers").and_then(Value::as_list);
    let of = |known: &&Value| known.get("peer").and_then(Value::as_str) == Some(peer);
    let known = peers.expect("its members").iter().find(of).expect("a member");
    known.get("queued").and_then(Value::as_int).expect("a number")
}

/// A stop of another peer arrives though the flood goes on; gives how many blocks came before it.
async fn stop_passes(operator: &mut Raw, robot: &mut Raw) -> u64 {
    let mut stop = message("stop", BULK, Value::Null);
    stop.receipt = Some(true);
    operator.ask(stop).await.expect("never refused for load");
    let mut before = 0;
    loop {
        let heard = robot.next().await.expect("not closed");
        if heard.is(Family::Message, "stop") {
            return before;
        }
        before += u64::from(heard.is(Family::Message, "block"));
    }
}

/// The robot stops and reads on, again and again; nothing piles up beyond `most` bytes. Gives the last block heard.
async fn stop_and_go(world: &mut World, robot: &mut Raw, most: i64) -> u64 {
    let mut last = 0;
    for _ in 0..STOPS {
        let waits = queued(&mut world.witness, "camera").await;
        assert!(waits <= most, "{waits} bytes wait");
        stop_passes(&mut world.witness, robot).await;
        for _ in 0..8 {
            let heard = robot.next_of(Family::Message, "block").await;
            assert!(heard.id > Some(last), "twice, or out of order");
            last = heard.id.expect("each has one");
        }
        world.canary.check().await;
    }
    last
}

/// Where its channel has it wait, the publisher is held back by its own socket: nothing piles up beyond half of the
/// outbox, nothing is lost, and urgent parcels pass.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_27_a_publisher_is_held_back() {
    for form in [Form::Binary, Form::Xml] {
        a_publisher_is_held_back(world("wait", Delivery::Reliable).await, form).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_27_a_publisher_is_held_back_at_other_doors() {
    for (form, way) in doors() {
        let change = |config: &mut Config| bulk(config, "wait", Delivery::Reliable);
        a_publisher_is_held_back(World::start_by_with(way, form, change).await, form).await;
    }
}

async fn a_publisher_is_held_back(mut world: World, form: Form) {
    world.witness.join(&[BULK]).await;
    let mut robot = listener(world.entrance(form), form, "camera").await;
    let mut flood = Flood::start(world.entrance(form), form).await;
    flood.reach((OUTBOX / SIZE) as u64).await;
    world.canary.check().await;
    let mut heard = 0;
    for _ in 0..STOPS {
        let waits = queued(&mut world.witness, "camera").await;
        assert!(waits <= OUTBOX as i64 / 2 + UNDER_WAY, "{waits} bytes wait");
        let before = stop_passes(&mut world.witness, &mut robot).await;
        assert!(
            before < (OUTBOX / SIZE) as u64 / 2,
            "{before} blocks before a stop"
        );
        heard += before;
        // What was taken in arrives in order, whatever has overtaken it.
        for _ in 0..8 {
            heard += 1;
            let block = robot.next_of(Family::Message, "block").await;
            assert_eq!(block.id, Some(heard), "lost, twice, or out of order");
        }
    }
    let ahead = flood.sent() - heard;
    assert!(ahead < KERNEL, "it runs away: {ahead} blocks ahead");
    drop(flood);
    end(world, robot).await;
}

/// What may be dropped is dropped for the receiver that is behind: nobody is held back or closed.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_27_what_may_be_dropped_is() {
    for delivery in [Delivery::Latest, Delivery::Fleeting] {
        what_may_be_dropped_is(world("wait", delivery).await, Form::Binary).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_27_what_may_be_dropped_is_at_other_doors() {
    let form = Form::Binary;
    for way in Way::beside(form) {
        let change = |config: &mut Config| bulk(config, "wait", Delivery::Fleeting);
        what_may_be_dropped_is(World::start_by_with(way, form, change).await, form).await;
    }
}

async fn what_may_be_dropped_is(mut world: World, form: Form) {
    world.witness.join(&[BULK]).await;
    let mut robot = listener(world.entrance(form), form, "camera").await;
    let mut flood = Flood::start(world.address(), Form::Binary).await;
    // More than anything between the two could hold.
    flood.reach(2 * KERNEL).await;
    let last = stop_and_go(&mut world, &mut robot, OUTBOX as i64 + UNDER_WAY).await;
    assert!(last > 8 * STOPS as u64, "some were dropped");
    let told = robot.next_of(Family::Event, "dropped").await.value();
    assert!(told.get("count").and_then(Value::as_int) > Some(0), "{told:?}");
    drop(flood);
    end(world, robot).await;
}

/// One message becomes a hundred: who keeps up hears all, who does not is closed, as its channel says.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_27_a_broadcast_is_amplified() {
    const RECEIVERS: usize = 100;
    let mut world = world("close", Delivery::Reliable).await;
    let mut sender = Raw::login(world.address(), Form::Binary, "bob").await;
    sender.join(&[BULK]).await;
    let mut slow = listener(world.address(), Form::Binary, "camera").await;
    let mut others = Vec::new();
    for number in 1..RECEIVERS {
        let form = if number % 2 == 0 { Form::Xml } else { Form::Binary };
        let mut raw = Raw::login(world.address(), form, "alice").await;
        raw.join(&[BULK]).await;
        others.push(raw);
    }
    let mut sent = 0;
    loop {
        let mut block = message("block", BULK, Value::Binary(Bytes::from(vec![7; SIZE])));
        (block.receipt, block.echo) = (Some(true), Some(false));
        let id = sender.post(block).await;
        let receipt = sender
            .answer(id)
            .await
            .expect("its sender did nothing wrong")
            .value();
        sent += 1;
        for raw in &mut others {
            let heard = raw.next_of(Family::Message, "block").await;
            assert_eq!(heard.id, Some(id), "lost, twice, or out of order");
        }
        let dropped = receipt.get("dropped").and_then(Value::as_list);
        if dropped != Some(&[]) {
            assert_eq!(dropped, Some(&["camera".into()][..]), "{receipt:?}");
            break;
        }
        assert!(
            sent * SIZE < OUTBOX + 8 * 1024 * 1024,
            "{sent} blocks taken for one that reads nothing"
        );
    }
    // The block that found no place is counted, too.
    assert!(sent * SIZE >= OUTBOX, "its outbox holds {OUTBOX}: {sent}");
    assert_eq!(slow.last_error().await.expect("a reason").word(), "slow-receiver");
    world.check_nothing_arrived("a broadcast").await;
    drop(others);
    world.end().await;
}

/// Ten times its rate: each second passes what the rate allows, and the rest is refused with the time to wait. Stops are
/// never counted.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_27_a_rate_is_a_rate() {
    const RATE: u64 = 20;
    let clock = lab::clock();
    let mut world = World::start_at(clock.clone(), |config| {
        let limit = Map::new()
            .with("parcels", i64::try_from(RATE).expect("small"))
            .with("burst", i64::try_from(RATE).expect("small"))
            .with("verbs", vec!["send".into()]);
        let quota = Map::new()
            .with("kind", "quota")
            .with("limits", vec![Value::Map(limit)]);
        let bulk = Map::new().with("path", BULK).with("kind", "channel").with(
            "manager",
            Map::new()
                .with("kind", "chain")
                .with("of", vec![Value::Map(quota)]),
        );
        config.contexts.push(from_value(bulk.into()).expect("a context"));
    })
    .await;
    let mut robot = Raw::login(world.address(), Form::Binary, "camera").await;
    robot.join(&[BULK]).await;
    let mut bob = Raw::login(world.address(), Form::Binary, "bob").await;
    let joined = bob
        .ask_about(Family::Context, "join", BULK)
        .await
        .expect("he may");
    let number = joined.get("number").and_then(Value::as_int).expect("a number");
    let frame = |id| {
        let mut parcel = Parcel::new(Family::Message, "state").id(id).content("much");
        (parcel.number, parcel.echo) = (Some(ContextNumber(number.unsigned_abs())), Some(false));
        Form::Binary.encode(&parcel).expect("a frame").to_vec()
    };
    for second in 1..=5 {
        let ids = second * 1_000_000..second * 1_000_000 + 10 * RATE;
        bob.send(&ids.clone().flat_map(frame).collect::<Vec<u8>>()).await;
        let mut stop = message("stop", BULK, Value::Null);
        stop.receipt = Some(true);
        for id in ids.clone().skip(RATE as usize) {
            let error = bob.answer(id).await.expect_err("more than the rate");
            assert_eq!(error.code.word(), "over-quota");
            assert!(error.retry_in() <= Some(Duration::from_secs(1)), "{error}");
        }
        bob.ask(stop).await.expect("a stop is not counted");
        let passed = async {
            let mut passed = Vec::new();
            loop {
                let heard = robot.next().await.expect("connected");
                match heard.name() {
                    "state" => passed.extend(heard.id),
                    "stop" => return passed,
                    _ => {}
                }
            }
        };
        let passed = passed.await;
        assert_eq!(passed, ids.take(RATE as usize).collect::<Vec<_>>());
        world.canary.check().await;
        clock.advance(Duration::from_secs(1));
    }
    world.check_nothing_arrived("too much").await;
    world.end().await;
}

/// A peer that will not read any more goes first: the broker's end would wait for it.
async fn end(mut world: World, robot: Raw) {
    robot.reset();
    world.check_nothing_arrived("a flood").await;
    world.end().await;
}
