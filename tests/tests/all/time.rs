//! Clocks that are wrong, ages that are right: skewed peers and slow links, through a real broker, over both forms.

use std::net::SocketAddr;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use mom_broker::{Broker, Clock};
use mom_client::{Client, Event, HubClock};
use mom_proto::codec::Form;
use mom_proto::{Code, Family, Map, Parcel, Time, Value};
use mom_tests::lab;
use mom_tests::programs::Running;
use mom_tests::raw::{PATIENCE, Raw, at, message};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;
use tokio::task::spawn_blocking;
use tokio::time::timeout;

const HOUR: i64 = 3_600_000_000;

/// A peer whose clock is off.
struct Skewed {
    raw: Raw,
    hub: Clock,
    ahead: i64,
}

impl Skewed {
    async fn login(broker: &Broker, hub: &Clock, form: Form, ahead: i64) -> Skewed {
        let raw = Raw::login(broker.local_addr(), form, "alice").await;
        let hub = hub.clone();
        Skewed { raw, hub, ahead }
    }

    /// What its clock shows.
    fn now(&self) -> Time {
        Time::from_micros(self.hub.wall().micros() + self.ahead).expect("a time")
    }

    /// Shows the hub its clock, as far as the hub asks at once.
    async fn measured(&mut self) {
        let ping = Map::new().with("sent", self.now());
        let ping = Parcel::new(Family::Time, "ping").id(1 << 40).content(ping);
        self.raw.send_parcel(&ping).await;
        for _ in 0..4 {
            self.answer_ping().await;
        }
        // What was answered has been read.
        self.raw.check_alive().await;
    }

    async fn answer_ping(&mut self) {
        let ping = self.raw.next_of(Family::Time, "ping").await;
        assert!(
            ping.value().get("sent").and_then(Value::as_time).is_some(),
            "{ping:?}"
        );
        let stamps = Map::new().with("received", self.now()).with("sent", self.now());
        let mut pong = Parcel::new(Family::Time, "pong").content(stamps);
        pong.reference = ping.id;
        self.raw.send_parcel(&pong).await;
    }

    /// A message to the chat, created so many µs ago.
    fn say(&self, name: &str, old: i64) -> Parcel {
        let mut parcel = message(name, "/chat", "words");
        parcel.timestamp = Time::from_micros(self.now().micros() - old);
        parcel.receipt = Some(true);
        parcel
    }
}

#[tokio::test]
async fn a_clock_that_is_an_hour_off_is_known() {
    for (form, other) in [(Form::Xml, Form::Binary), (Form::Binary, Form::Xml)] {
        for ahead in [HOUR, -HOUR] {
            let clock = lab::clock();
            let broker = lab::start_at(clock.clone(), |_| {}).await;
            let mut bob = Raw::login(broker.local_addr(), other, "bob").await;
            bob.join(&["/chat"]).await;
            let mut alice = Skewed::login(&broker, &clock, form, ahead).await;
            alice.raw.join(&["/chat"]).await;

            // Before the exchange nothing is known, and nothing is refused for it.
            let strange = alice.say("say", -2 * ahead);
            alice.raw.ask(strange).await.expect("taken");
            let heard = bob.next_of(Family::Message, "say").await;
            assert_eq!((heard.age, heard.age_error), (Some(0), None));

            alice.measured().await;
            let parcel = alice.say("say", 30_000);
            clock.advance(Duration::from_millis(10));
            alice.raw.ask(parcel.clone()).await.expect("taken");
            let heard = bob.next_of(Family::Message, "say").await;
            assert_eq!((heard.age, heard.timestamp), (Some(40_000), parcel.timestamp));
            // Two readings of µs, and 100 µs a second of which 10 ms have passed.
            assert_eq!((heard.age_error, heard.received), (Some(2), Some(clock.wall())));
        }
    }
}

/// `mom watch` tells the age of each message where the hub knows it.
#[tokio::test(flavor = "multi_thread")]
async fn who_watches_sees_ages() {
    let clock = lab::clock();
    let broker = lab::start_at(clock.clone(), |_| {}).await;
    let mut alice = Skewed::login(&broker, &clock, Form::Binary, HOUR).await;
    alice.raw.join(&["/chat"]).await;
    let hub = format!("bin://{}", broker.local_addr());
    let watch = spawn_blocking(move || {
        let settings = [("MOM_HUB", &*hub), ("MOM_USER", "bob"), ("MOM_PASSWORD", "bob")];
        Running::start("mom", &["watch", "--messages", "/chat"], &settings)
    });
    let watch = watch.await.expect("it starts");
    alice.raw.next_of(Family::Event, "joined").await;

    // Before its clock is known nobody knows how old what it says is.
    let strange = alice.say("strange", 0);
    alice.raw.ask(strange).await.expect("taken");
    alice.measured().await;
    let parcel = alice.say("late", 30_000);
    clock.advance(Duration::from_millis(12));
    alice.raw.ask(parcel).await.expect("taken");
    let lines = spawn_blocking(move || (watch.line_with("strange"), watch.line_with("late")));
    let (strange, late) = lines.await.expect("they come");
    assert!(strange.ends_with(" alice strange: words"), "{strange}");
    assert!(late.ends_with(" alice late (42 ms old): words"), "{late}");
    broker.stop().await;
}

#[tokio::test]
async fn what_is_of_the_future_or_over_is_refused_but_no_stop() {
    let clock = lab::clock();
    let broker = lab::start_at(clock.clone(), |config| config.limits.future = 200).await;
    let mut bob = Raw::login(broker.local_addr(), Form::Xml, "bob").await;
    bob.join(&["/chat"]).await;
    let mut alice = Skewed::login(&broker, &clock, Form::Xml, HOUR).await;
    alice.raw.join(&["/chat"]).await;
    alice.measured().await;
    let until = |mut parcel: Parcel, expires| {
        parcel.expires = Some(expires);
        parcel
    };
    for (parcel, refusal) in [
        (alice.say("say", -200_000), None),
        (alice.say("say", -201_000), Some((Code::BAD_SLOT, "timestamp"))),
        (alice.say("say", -HOUR), Some((Code::BAD_SLOT, "timestamp"))),
        (alice.say("stop", -HOUR), None),
        (until(alice.say("say", 99_000), 100), None),
        (
            until(alice.say("say", 100_000), 100),
            Some((Code::EXPIRED, "expires")),
        ),
        (
            until(alice.say("unstop", 100_000), 100),
            Some((Code::EXPIRED, "expires")),
        ),
        (until(alice.say("stop", 100_000), 100), None),
    ] {
        let what = format!("{parcel:?}");
        match (alice.raw.ask(parcel.clone()).await, refusal) {
            (Ok(receipt), None) => {
                let delivered = receipt.value().get("delivered").and_then(Value::as_int);
                assert_eq!(delivered, Some(2), "{what}");
                let heard = bob.next_of(Family::Message, parcel.name()).await;
                assert_eq!(heard.timestamp, parcel.timestamp, "{what}");
            }
            (Err(error), Some((code, slot))) => {
                assert_eq!(
                    (&error.code, error.get("slot").and_then(Value::as_str)),
                    (&code, Some(slot))
                );
            }
            (answer, _) => panic!("{what}: {answer:?}"),
        }
    }
}

/// A channel whose manager lets `step` pass only while it is fresh.
fn fresh_steps(config: &mut mom_broker::Config) {
    let fresh = Map::new()
        .with("name", "steps are fresh")
        .with("allow", lab::words(&["send"]))
        .with("messages", lab::words(&["step"]))
        .with("max-age", 500);
    lab::rule_chat(config, fresh);
}

#[tokio::test]
async fn a_manager_may_ask_for_fresh_messages() {
    for form in Form::ALL {
        let clock = lab::clock();
        let broker = lab::start_at(clock.clone(), fresh_steps).await;
        let mut alice = Skewed::login(&broker, &clock, form, -HOUR).await;
        alice.raw.join(&["/chat"]).await;

        let unknown = alice
            .raw
            .ask(alice.say("step", 0))
            .await
            .expect_err("of unknown age");
        assert_eq!(unknown.code, Code::TRY_LATER, "{unknown}");
        alice.raw.ask(alice.say("chat", 0)).await.expect("of any age");
        alice.measured().await;
        // Twice: first the hub is asked, then the verdict stands; and what is too old changes nothing of it.
        for _ in 0..2 {
            alice.raw.ask(alice.say("step", 499_000)).await.expect("fresh");
            let error = alice
                .raw
                .ask(alice.say("step", 500_000))
                .await
                .expect_err("perhaps too old");
            assert_eq!(error.code, Code::DENIED);
            assert!(
                error
                    .text
                    .contains("up to an age of 500 ms, and this one is 500 ms old"),
                "{error}"
            );
            let rule = error.get("rule").and_then(Value::as_str);
            assert!(
                rule.is_some_and(|rule| rule.ends_with("/steps are fresh")),
                "{rule:?}"
            );
            alice.raw.ask(alice.say("chat", HOUR)).await.expect("of any age");
        }
        let mut bare = alice.say("step", 0);
        bare.timestamp = None;
        let error = alice.raw.ask(bare).await.expect_err("of no age");
        assert_eq!(error.code, Code::TRY_LATER);
    }
}

/// Who manages a channel itself is told how old a message is before it decides.
#[tokio::test]
async fn a_managing_peer_is_told_the_age() {
    let clock = lab::clock();
    let broker = lab::start_at(clock.clone(), |_| {}).await;
    let mut carol = Raw::login(broker.local_addr(), Form::Xml, "carol").await;
    let spec = Map::new().with("kind", "channel").with("manager", "self");
    let create = Parcel::new(Family::Context, "create")
        .context(at("/booth"))
        .content(spec);
    carol.ask(create).await.expect("operators may");
    let mut alice = Skewed::login(&broker, &clock, Form::Binary, HOUR).await;
    alice.measured().await;
    let answer = |consult: &Parcel| {
        let number = consult
            .id
            .and_then(|id| i64::try_from(id).ok())
            .expect("a number");
        let verdict = Map::new().with("consult", number).with("allow", true);
        Parcel::new(Family::Manager, "verdict").content(verdict)
    };
    let joining = alice
        .raw
        .post(Parcel::new(Family::Context, "join").context(at("/booth")))
        .await;
    let consult = carol.next_of(Family::Manager, "consult").await;
    assert_eq!(consult.value().get("age"), None, "only messages have an age");
    carol.ask(answer(&consult)).await.expect("in time");
    alice.raw.answer(joining).await.expect("allowed");

    let mut parcel = alice.say("say", 70_000);
    parcel.context = Some(at("/booth"));
    let sending = alice.raw.post(parcel).await;
    let consult = carol.next_of(Family::Manager, "consult").await;
    let asked = consult.value();
    let told = |key| asked.get(key).and_then(Value::as_int);
    assert_eq!((told("age"), told("age-error")), (Some(70_000), Some(1)));
    // The time in which it waits for the answer makes it older.
    clock.advance(Duration::from_millis(500));
    carol.ask(answer(&consult)).await.expect("in time");
    alice.raw.answer(sending).await.expect("allowed");
    let heard = alice.raw.next_of(Family::Message, "say").await;
    assert_eq!((heard.age, heard.age_error), (Some(570_000), Some(51)));
}

/// Its clock is set anew while it is connected: the next heartbeat shows it.
#[tokio::test]
async fn a_step_of_a_clock_is_seen_at_the_next_heartbeat() {
    let clock = lab::clock();
    let broker = lab::start_at(clock.clone(), |config| config.limits.heartbeat = 20).await;
    let mut alice = Skewed::login(&broker, &clock, Form::Binary, HOUR).await;
    alice.raw.join(&["/chat"]).await;
    alice.measured().await;
    alice.ahead = 3 * HOUR;
    let error = alice
        .raw
        .ask(alice.say("say", 0))
        .await
        .expect_err("of a future of two hours");
    assert_eq!(error.code, Code::BAD_SLOT);
    // What was known is not believed any more.
    for _ in 0..4 {
        alice.answer_ping().await;
    }
    alice.raw.post(alice.say("say", 7_000)).await;
    let heard = alice.raw.next_of(Family::Message, "say").await;
    assert_eq!(heard.age, Some(7_000));
}

/// Peers that answer pings without stamps live as before, and nothing is known of their clocks.
#[tokio::test]
async fn without_stamps_nothing_is_known() {
    let broker = lab::start_with(|config| config.limits.heartbeat = 20).await;
    let mut alice = Raw::login(broker.local_addr(), Form::Xml, "alice").await;
    alice.join(&["/chat"]).await;
    let mut last = None;
    for _ in 0..3 {
        let ping = alice.next_of(Family::Time, "ping").await;
        assert!(ping.id > last, "{ping:?} after {last:?}");
        last = ping.id;
        let mut pong = Parcel::new(Family::Time, "pong");
        pong.reference = ping.id;
        alice.send_parcel(&pong).await;
    }
    let mut parcel = message("say", "/chat", "words");
    parcel.timestamp = Some(Time::MAX);
    alice.post(parcel).await;
    let heard = alice.next_of(Family::Message, "say").await;
    assert_eq!((heard.age, heard.age_error), (Some(0), None));
}

/// The way to a broker that takes this long in each direction.
async fn slow_way(to: SocketAddr, there: Duration, back: Duration) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("bound");
    tokio::spawn(async move {
        let (near, _) = listener.accept().await.expect("a client");
        let far = TcpStream::connect(to).await.expect("the broker");
        near.set_nodelay(true).expect("a socket option");
        far.set_nodelay(true).expect("a socket option");
        let (near_read, near_write) = near.into_split();
        let (far_read, far_write) = far.into_split();
        tokio::spawn(delay(near_read, far_write, there));
        tokio::spawn(delay(far_read, near_write, back));
    });
    address
}

/// Hands bytes on after this time, in their order.
async fn delay(
    mut from: impl AsyncReadExt + Unpin + Send + 'static,
    mut to: impl AsyncWriteExt + Unpin,
    time: Duration,
) {
    let (sender, mut receiver) = mpsc::unbounded_channel::<(tokio::time::Instant, Vec<u8>)>();
    tokio::spawn(async move {
        let mut buffer = vec![0; 64 * 1024];
        while let Ok(read @ 1..) = from.read(&mut buffer).await {
            let due = tokio::time::Instant::now() + time;
            if sender.send((due, buffer[..read].to_vec())).is_err() {
                return;
            }
        }
    });
    while let Some((due, bytes)) = receiver.recv().await {
        tokio::time::sleep_until(due).await; // tidy: a slow way is what this test is about
        if to.write_all(&bytes).await.is_err() {
            return;
        }
    }
}

fn system() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).expect("after 1970");
    i64::try_from(since.as_micros()).expect("before 9999")
}

async fn connect(address: SocketAddr, user: &str, ahead: i64) -> (Client, HubClock) {
    let builder = Client::builder(format!("bin://{address}"))
        .user(user)
        .password(user);
    let builder = builder.wall_clock(move || Time::from_micros(system() + ahead).expect("a time"));
    let client = builder.connect().await.expect("a user of the lab");
    let clock = client.clock();
    (client, clock)
}

/// Both clocks are wrong and both ways are slow, each by another time: the true age is within what is told.
#[tokio::test(flavor = "multi_thread")]
async fn the_true_age_is_within_the_error_over_slow_links() {
    let broker = lab::start().await;
    let millis = Duration::from_millis;
    let near = slow_way(broker.local_addr(), millis(40), millis(10)).await;
    let far = slow_way(broker.local_addr(), millis(5), millis(30)).await;
    let (alice, _) = connect(near, "alice", HOUR).await;
    let (bob, clock) = connect(far, "bob", -HOUR).await;
    let sender = alice.channel("/chat").await.expect("people may");
    let mut events = bob.channel("/chat").await.expect("people may").events();
    let (mut known, start) = (0, Instant::now());
    while known < 5 {
        assert!(start.elapsed() < PATIENCE, "the clocks are never known");
        let created = Instant::now();
        sender.message("say").no_echo().send().await.expect("sent");
        let parcel = loop {
            let event = timeout(PATIENCE, events.next()).await.expect("heard");
            if let Event::Message(parcel) = event.expect("the channel stays") {
                break parcel;
            }
        };
        let (Some(age), truth) = (clock.age(&parcel), created.elapsed()) else {
            continue;
        };
        let Some(error) = age.error() else { continue };
        known += 1;
        // The truth is read after the age, and the message is stamped after `created`.
        assert!(age.duration() <= truth + error, "{age:?} of {truth:?}");
        assert!(age.at_most() >= Some(millis(70)), "the ways take 70 ms: {age:?}");
        assert!(
            error < PATIENCE && error >= millis(15),
            "half of both round trips: {age:?}"
        );
    }
}

/// A peer that says nothing by itself is asked after the heartbeat, and not after nearly two of them, which here would
/// be too late.
#[tokio::test(flavor = "multi_thread")]
async fn who_only_answers_is_asked_in_time() {
    let broker = lab::start_with(|config| (config.limits.heartbeat, config.limits.gone) = (2000, 3900)).await;
    let mut alice = Raw::login(broker.local_addr(), Form::Binary, "alice").await;
    for _ in 0..2 {
        let ping = alice.next_of(Family::Time, "ping").await;
        let mut pong = Parcel::new(Family::Time, "pong");
        pong.reference = ping.id;
        alice.send_parcel(&pong).await;
    }
    alice.check_alive().await;
    broker.stop().await;
}
