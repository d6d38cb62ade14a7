//! Channels in which senders wait for receivers without room, through a real broker, by a clock that the test moves.

mod behind;

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use mom_broker::{Broker, Clock, Config};
use mom_client::{Client, Code};
use mom_proto::codec::Form;
use mom_proto::{Delivery, Family, Map, Parcel, Value, WireError};
use mom_tests::lab;
use mom_tests::raw::{Raw, at, message};
use tokio::time::timeout;

const BULK: &str = "/bulk";
const OUTBOX: usize = 256 * 1024;
const SIZE: usize = 32 * 1024;
/// More than outbox, kernel and one batch of a connection can hold together.
const MOST: u64 = 2000;
/// As long as a message waits.
const WAIT: Duration = Duration::from_secs(1);
/// An answer that does not come for so long is probably being waited for. Where that is wrong, a test goes on.
const QUIET: Duration = Duration::from_millis(300);

fn with_bulk(config: &mut Config) {
    lab::add_waiting_channel(config, BULK);
    (config.limits.outbox, config.limits.burst) = (OUTBOX, OUTBOX);
}

/// What the receivers of a block are.
fn block(number: u64) -> Parcel {
    let mut content = vec![7; SIZE];
    content[..8].copy_from_slice(&number.to_be_bytes());
    let mut parcel = message("block", BULK, Value::Binary(Bytes::from(content)));
    parcel.receipt = Some(true);
    parcel.echo = Some(false);
    parcel
}

fn number_of(block: &Parcel) -> u64 {
    match block.value() {
        Value::Binary(bytes) => u64::from_be_bytes(bytes[..8].try_into().expect("eight bytes")),
        other => panic!("{other:?}"),
    }
}

/// The answer to a parcel, if it comes within this time; the hub's pings come in any case.
async fn answer_within(raw: &mut Raw, id: u64, time: Duration) -> Option<Result<Value, WireError>> {
    let answer = timeout(time, raw.answer(id)).await.ok()?;
    Some(answer.map(|parcel| parcel.value()))
}

/// Alice sends to bob, who reads nothing, and to carol, who does.
struct Scene {
    clock: Clock,
    broker: Broker,
    alice: Raw,
    bob: Raw,
    carol: Raw,
    /// The next block, which is also how many were taken.
    next: u64,
}

impl Scene {
    async fn new(form: Form) -> Scene {
        Scene::with(form, |_| {}).await
    }

    async fn with(form: Form, change: impl FnOnce(&mut Config)) -> Scene {
        let clock = lab::clock();
        let broker = lab::start_at(clock.clone(), |config| {
            with_bulk(config);
            change(config);
        })
        .await;
        let address = broker.local_addr();
        let mut alice = Raw::login(address, form, "alice").await;
        let mut bob = Raw::connect_small(address, form).await;
        bob.log_in("bob").await;
        let mut carol = Raw::login(address, Form::Binary, "carol").await;
        for raw in [&mut alice, &mut bob, &mut carol] {
            raw.join(&[BULK]).await;
        }
        Scene {
            clock,
            broker,
            alice,
            bob,
            carol,
            next: 0,
        }
    }

    /// Sends blocks until one waits; gives its id.
    async fn fill(&mut self) -> u64 {
        while self.next < MOST {
            let id = self.alice.post(block(self.next)).await;
            match answer_within(&mut self.alice, id, QUIET).await {
                Some(receipt) => self.note_taken(&receipt.expect("there is room")),
                None => return id,
            }
        }
        panic!("{MOST} blocks were taken for a peer that reads nothing");
    }

    fn note_taken(&mut self, receipt: &Value) {
        assert_eq!(receipt.get("delivered"), Some(&Value::Int(2)), "{receipt:?}");
        assert_eq!(receipt.get("dropped"), Some(&Value::List(Vec::new())));
        self.next += 1;
    }

    /// Moves the clock until an answer comes.
    async fn wait_for(&mut self, id: u64) -> Result<Value, WireError> {
        for _ in 0..30 {
            if let Some(answer) = answer_within(&mut self.alice, id, QUIET).await {
                return answer;
            }
            self.clock.advance(WAIT);
        }
        panic!("no answer");
    }

    /// Sends blocks until one is refused.
    async fn until_refused(&mut self) -> WireError {
        loop {
            let id = self.fill().await;
            match self.wait_for(id).await {
                Ok(receipt) => self.note_taken(&receipt),
                Err(error) => return error,
            }
        }
    }

    /// What carol hears next, while bob reads what there is.
    async fn hear_while_bob_reads(&mut self) -> Parcel {
        loop {
            tokio::select! {
                biased;
                heard = self.carol.next() => return heard.expect("carol stays connected"),
                read = self.bob.next() => drop(read.expect("bob stays connected")),
            }
        }
    }

    /// They will not read what still waits for them, and the broker's end would wait for that.
    async fn end(self) {
        self.bob.reset();
        self.carol.reset();
        self.broker.check();
        self.broker.stop().await;
    }

    /// Checks that a peer hears these blocks next, in their order and each once.
    async fn check_hears(raw: &mut Raw, blocks: std::ops::Range<u64>) {
        for number in blocks {
            let heard = raw.next_of(Family::Message, "block").await;
            assert_eq!(number_of(&heard), number, "lost, twice, or out of order");
        }
    }
}

/// All or nothing: what is refused after a wait has reached nobody, and can be sent again.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_finds_no_room_is_refused_and_reaches_nobody() {
    for form in Form::ALL {
        let mut scene = Scene::new(form).await;
        let info = scene.carol.ask_about(Family::Context, "info", BULK).await;
        let info = info.expect("people may");
        assert_eq!(info.get("overflow"), Some(&Value::from("wait")));
        let error = scene.until_refused().await;
        assert_eq!(error.code.word(), "try-later", "{error}");
        assert_eq!(error.get("slow"), Some(&Value::List(vec!["bob".into()])));
        assert_eq!(error.retry_in(), Some(WAIT));
        let taken = scene.next;
        assert!(taken >= 3, "about half of the outbox: {taken}");
        // The same again, and this time bob reads.
        let id = scene.alice.post(block(taken)).await;
        Scene::check_hears(&mut scene.bob, 0..taken + 1).await;
        let receipt = scene.alice.answer(id).await.expect("there is room").value();
        scene.note_taken(&receipt);
        Scene::check_hears(&mut scene.carol, 0..taken + 1).await;
        scene.bob.check_alive().await;
        scene.end().await;
    }
}

/// Nobody waits but the sender, for whatever it says next.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_waits_holds_up_nobody_else() {
    let mut scene = Scene::new(Form::Binary).await;
    let waiting = scene.fill().await;
    let about = Parcel::new(Family::Context, "info").context(at(BULK));
    let behind = scene.alice.post(about).await;
    let carol = &mut scene.carol;
    let mut to_alice = block(u64::MAX);
    to_alice.address = Some(vec!["alice".into()]);
    carol.ask(to_alice).await.expect("alice has room");
    let mut photo = message("photo", BULK, "of a class that does not wait");
    (photo.delivery, photo.receipt) = (Some(Delivery::Latest), Some(true));
    carol.ask(photo).await.expect("it does not wait");
    let mut stop = message("stop", BULK, Value::Null);
    stop.receipt = Some(true);
    let receipt = carol.ask(stop).await.expect("stops never wait").value();
    assert_eq!(receipt.get("delivered"), Some(&Value::Int(3)), "{receipt:?}");
    let mut unstop = message("unstop", BULK, Value::Null);
    unstop.extra.set("stop", carol.newest_stop(BULK).await);
    unstop.receipt = Some(true);
    carol.ask(unstop).await.expect("nor what takes it back");
    carol.join(&["/robot"]).await;
    for verb in ["grab", "renew", "release"] {
        let token = carol.ask_about(Family::Token, verb, "/robot/token").await;
        token.unwrap_or_else(|error| panic!("{verb}: {error}"));
    }
    let silent = answer_within(&mut scene.alice, behind, QUIET).await;
    assert!(silent.is_none(), "it was read before its turn: {silent:?}");
    // Bob hears the stop before much of what he has let pile up.
    let mut before = 0;
    loop {
        let heard = scene.bob.next().await.expect("not closed");
        if heard.is(Family::Message, "stop") {
            break;
        }
        before += u64::from(heard.is(Family::Message, "block"));
    }
    assert!(before < scene.next, "{before} of {}", scene.next);
    Scene::check_hears(&mut scene.bob, before..scene.next + 1).await;
    scene.alice.answer(waiting).await.expect("there is room now");
    scene.alice.answer(behind).await.expect("then the next");
    scene.end().await;
}

/// A receiver that stands still is not a burden for ever.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stalled_receiver_is_closed() {
    let mut scene = Scene::new(Form::Xml).await;
    scene.until_refused().await;
    let (refused_at, mut refused) = (scene.clock.now(), 1);
    let receipt = loop {
        let id = scene.alice.post(block(scene.next)).await;
        match scene.wait_for(id).await {
            Ok(receipt) => break receipt,
            Err(error) => {
                assert_eq!(error.code.word(), "try-later");
                refused += 1;
            }
        }
        assert!(refused <= 5, "it should be closed by now");
    };
    let dropped = receipt.get("dropped").and_then(Value::as_list);
    assert_eq!(dropped, Some(&["bob".into()][..]), "{receipt:?}");
    assert_eq!(receipt.get("delivered"), Some(&Value::Int(1)));
    let stood = Duration::from_micros(scene.clock.now() - refused_at);
    assert!(stood <= Duration::from_secs(30), "{stood:?}");
    assert!(refused >= 2, "not at once: {refused}");
    assert_eq!(
        scene.bob.last_error().await.expect("a reason").word(),
        "slow-receiver"
    );
    scene.end().await;
}

/// What had to hold for a message when it came has to hold when it goes.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_message_that_waits_may_lose_its_right() {
    let mut scene = Scene::new(Form::Binary).await;
    // At once, and not after the wait: the clock stands.
    let id = scene.fill().await;
    let expel = Parcel::new(Family::Context, "expel")
        .context(at(BULK))
        .content(Map::new().with("peer", "alice"));
    scene.carol.ask(expel).await.expect("operators may");
    let error = scene.alice.answer(id).await.expect_err("she is not a member now");
    assert_eq!(error.code.word(), "not-member");
    scene.end().await;

    let mut scene = Scene::new(Form::Binary).await;
    let error = loop {
        scene.until_refused().await;
        let mut short = block(scene.next);
        short.expires = Some(400);
        let id = scene.alice.post(short).await;
        if let Err(error) = scene.wait_for(id).await {
            break error;
        }
    };
    assert_eq!(error.code.word(), "expired", "its age counts the wait: {error}");
    scene.end().await;
}

/// Who leaves is not waited for; the clock stands.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_leaves_is_not_waited_for() {
    let mut scene = Scene::new(Form::Xml).await;
    let id = scene.fill().await;
    let leave = Parcel::new(Family::Context, "leave").context(at(BULK));
    scene.bob.post(leave).await;
    let receipt = scene
        .alice
        .answer(id)
        .await
        .expect("there is room for the others");
    let delivered = receipt.value().get("delivered").and_then(Value::as_int);
    assert!(matches!(delivered, Some(1 | 2)), "{delivered:?}");
    scene.end().await;
}

/// A sender that goes while it waits makes way.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_goes_leaves_no_place_behind() {
    let mut scene = Scene::new(Form::Binary).await;
    scene.fill().await;
    let mut mine = message("mine", BULK, "behind her");
    (mine.receipt, mine.echo) = (Some(true), Some(false));
    let id = scene.carol.post(mine).await;
    scene.alice.reset();
    let heard = scene.bob.next_of(Family::Message, "mine").await;
    assert_eq!(heard.sender.as_deref(), Some("carol"));
    scene.carol.answer(id).await.expect("there is room");
    scene.broker.check();
    scene.broker.stop().await;
}

/// Plain messages go as runs: they wait too, and lose nothing.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn runs_wait_too() {
    const COUNT: u64 = 120_000;
    let broker = lab::start_with(|config| {
        with_bulk(config);
        // However busy the machine is, nobody is late.
        (config.limits.send_wait, config.limits.stalled) = (60_000, 120_000);
    })
    .await;
    let address = broker.local_addr();
    let mut alice = Raw::login(address, Form::Binary, "alice").await;
    let mut bob = Raw::connect_small(address, Form::Binary).await;
    bob.log_in("bob").await;
    for raw in [&mut alice, &mut bob] {
        raw.join(&[BULK]).await;
    }
    // Small at first, so that the channel's number comes with the join and all is plain.
    let frames = |from: u64, to: u64| -> Vec<u8> {
        let frame = |id| {
            let mut parcel = message("line", BULK, "a line of some log, as it comes").id(id);
            parcel.echo = Some(false);
            Form::Binary.encode(&parcel).expect("a frame").to_vec()
        };
        (from..to).flat_map(frame).collect()
    };
    let sends = tokio::spawn(async move {
        for from in (0..COUNT).step_by(1000) {
            alice
                .send(&frames(1_000_000 + from, 1_000_000 + from + 1000))
                .await;
        }
        alice
    });
    for id in 0..COUNT {
        let heard = bob.next_of(Family::Message, "line").await;
        assert_eq!(heard.id, Some(1_000_000 + id), "lost, twice, or out of order");
    }
    let mut alice = sends.await.expect("all is sent");
    alice.check_alive().await;
    broker.stop().await;
}

/// Peers inside the broker's process wait and are waited for as others are; the client says `try-later`.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn clients_are_told_to_try_later() {
    let broker = lab::start_with(|config| {
        with_bulk(config);
        (config.limits.send_wait, config.limits.stalled) = (20, 600_000);
    })
    .await;
    let broker = Arc::new(broker);
    let mut bob = Raw::connect_small(broker.local_addr(), Form::Xml).await;
    bob.log_in("bob").await;
    bob.join(&[BULK]).await;
    let over = Client::builder(format!("tcp://{}", broker.local_addr()));
    let inside = Client::builder_local({
        let broker = Arc::clone(&broker);
        move || broker.connect_local()
    });
    for builder in [over, inside] {
        let client = builder.user("alice").password("alice").connect().await;
        let client = client.expect("a user of the lab");
        let bulk = client.channel(BULK).await.expect("people may");
        let content = Value::Binary(Bytes::from(vec![7; SIZE]));
        let error = loop {
            let sent = bulk.message("block").content(content.clone()).no_echo();
            if let Err(error) = sent.send_acknowledged().await {
                break error;
            }
        };
        assert_eq!(error.code(), Some(&Code::TRY_LATER), "{error}");
        let refusal = error.refusal().expect("the hub said so");
        assert_eq!(refusal.slow, ["bob"]);
        assert_eq!(refusal.retry_after, Some(Duration::from_millis(20)));
        client.close().await;
    }
    bob.check_alive().await;
}
