//! Receivers that want fewer, through a real broker, over both forms.

use std::time::Duration;

use mom_broker::{Broker, Clock};
use mom_client::{Client, Event, MessageRate, Thinning};
use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel, Value};
use mom_tests::lab;
use mom_tests::raw::{Raw, at, message};

const CHAT: &str = "/chat";
const ARM: &str = "/robot/arm";
const TOKEN: &str = "/robot/token";

/// A join that says what one is to be spared.
fn join(path: &str, options: Map) -> Parcel {
    Parcel::new(Family::Context, "join")
        .context(at(path))
        .content(options)
}

fn rate(text: &str) -> Map {
    Map::new().with("rate", text)
}

struct Scene {
    clock: Clock,
    broker: Broker,
    alice: Raw,
    bob: Raw,
    /// Wants all.
    carol: Raw,
}

impl Scene {
    /// Bob speaks this form, the others the other.
    async fn new(form: Form, path: &str, options: Map) -> Scene {
        let other = match form {
            Form::Xml => Form::Binary,
            Form::Binary | Form::Packed => Form::Json,
            Form::Json => Form::Xml,
        };
        let clock = lab::clock();
        let broker = lab::start_at(clock.clone(), |_| {}).await;
        let address = broker.local_addr();
        let mut alice = Raw::login(address, other, "alice").await;
        let mut bob = Raw::login(address, form, "bob").await;
        let mut carol = Raw::login(address, form, "carol").await;
        let above = at(path).parent().expect("below the root");
        for raw in [&mut alice, &mut bob, &mut carol] {
            if !above.is_root() {
                raw.join(&[above.as_str()]).await;
            }
        }
        for raw in [&mut alice, &mut carol] {
            raw.join(&[path]).await;
        }
        bob.ask(join(path, options)).await.expect("a member");
        Scene {
            clock,
            broker,
            alice,
            bob,
            carol,
        }
    }

    /// Alice says something; by the receipt it is in the outboxes of all. How many took it, and carol hears all.
    async fn say(&mut self, path: &str, name: &str, words: &str) -> i64 {
        let mut parcel = message(name, path, words);
        parcel.receipt = Some(true);
        if name == "unstop" {
            parcel.extra.set("stop", self.alice.newest_stop(path).await);
        }
        let receipt = self.alice.ask(parcel).await.expect("taken").value();
        let heard = self.carol.next_of(Family::Message, name).await;
        assert_eq!(heard.value(), words.into(), "others hear all");
        receipt
            .get("delivered")
            .and_then(Value::as_int)
            .expect("a receipt")
    }

    /// The next message that bob hears.
    async fn hears(&mut self) -> (String, String) {
        loop {
            let parcel = self.bob.next().await.expect("the broker does not close");
            if parcel.family == Family::Message {
                let words = parcel.value().as_str().unwrap_or_default().to_owned();
                return (parcel.name().to_owned(), words);
            }
        }
    }

    async fn hears_words(&mut self, words: &str) {
        assert_eq!(self.hears().await.1, words);
    }

    fn pass(&self, millis: u64) {
        self.clock.advance(Duration::from_millis(millis));
    }
}

#[tokio::test]
async fn a_rate_hands_out_the_newest_when_its_turn_comes() {
    for form in Form::ALL {
        let mut scene = Scene::new(form, CHAT, rate("5/s")).await;
        for number in 0..10 {
            let taken = scene.say(CHAT, "state", &format!("state {number}")).await;
            assert_eq!(taken, 3, "what waits for its turn was taken");
        }
        // Another name has a turn of its own, and its own messages bob hears all.
        scene.say(CHAT, "image", "image 0").await;
        for words in ["mine", "mine too"] {
            scene.bob.send_parcel(&message("state", CHAT, words)).await;
        }
        for words in ["state 0", "image 0", "mine", "mine too"] {
            scene.hears_words(words).await;
        }
        scene.pass(199);
        scene.say(CHAT, "image", "image 1").await;
        scene.say(CHAT, "state", "state 10").await;
        scene.pass(1);
        // Two come at once, in the order of their names; nobody says anything meanwhile.
        scene.hears_words("image 1").await;
        scene.hears_words("state 10").await;
        let dropped = scene.alice.next_of(Family::Event, "dropped").await.value();
        assert_eq!(dropped.get("reason").and_then(Value::as_str), Some("rate"));
        assert_eq!(dropped.get("receiver").and_then(Value::as_str), Some("bob"));
        scene.broker.check();
        scene.broker.stop().await;
    }
}

/// Many small messages in one write, which go to members who want all of them together.
#[tokio::test]
async fn a_burst_of_plain_messages_is_thinned_too() {
    let clock = lab::clock();
    let broker = lab::start_at(clock.clone(), |_| {}).await;
    let mut alice = Raw::login(broker.local_addr(), Form::Binary, "alice").await;
    let mut bob = Raw::login(broker.local_addr(), Form::Binary, "bob").await;
    alice.join(&[CHAT]).await;
    bob.ask(join(CHAT, rate("1/s"))).await.expect("a member");
    let burst: Vec<u8> = (0..100)
        .flat_map(|number| {
            let parcel = message("state", CHAT, format!("{number}"));
            Form::Binary.encode(&parcel).expect("a message").to_vec()
        })
        .collect();
    alice.send(&burst).await;
    alice.check_alive().await;
    clock.advance(Duration::from_secs(1));
    for words in ["0", "99"] {
        let heard = bob.next_of(Family::Message, "state").await;
        assert_eq!(heard.value(), words.into());
    }
    broker.stop().await;
}

#[tokio::test]
async fn commands_stops_and_halts_are_never_thinned() {
    for form in Form::ALL {
        let options = rate("1/min").with("newest", true);
        let mut scene = Scene::new(form, ARM, options).await;
        let grab = Parcel::new(Family::Token, "grab").context(at(TOKEN));
        scene.alice.ask(grab).await.expect("it is free");
        for number in 0..3 {
            scene.say(ARM, "command", &format!("command {number}")).await;
            scene.say(ARM, "note", &format!("note {number}")).await;
            scene.say(ARM, "stop", "stop").await;
            scene.say(ARM, "unstop", "unstop").await;
        }
        let release = Parcel::new(Family::Token, "release").context(at(TOKEN));
        scene.alice.ask(release).await.expect("she owns it");
        let mut heard = Vec::new();
        while heard.last().is_none_or(|name| name != "halt") {
            heard.push(scene.hears().await.0);
        }
        let count = |name: &str| heard.iter().filter(|heard| *heard == name).count();
        let counts = ["command", "note", "stop", "unstop", "halt"].map(count);
        assert_eq!(counts, [3, 1, 3, 3, 1], "{heard:?}");
        scene.broker.stop().await;
    }
}

#[tokio::test]
async fn joining_again_changes_it_and_leaving_ends_it() {
    for form in Form::ALL {
        let mut scene = Scene::new(form, CHAT, rate("1/min")).await;
        for words in ["one", "two"] {
            scene.say(CHAT, "state", words).await;
        }
        scene.hears_words("one").await;
        // A member that wants all from now on hears at once what waited.
        scene.bob.ask(join(CHAT, Map::new())).await.expect("a member");
        scene.hears_words("two").await;
        for words in ["three", "four"] {
            scene.say(CHAT, "state", words).await;
            scene.hears_words(words).await;
        }
        scene.bob.ask(join(CHAT, rate("1/min"))).await.expect("a member");
        for words in ["five", "six"] {
            scene.say(CHAT, "state", words).await;
        }
        scene.hears_words("five").await;
        let leave = Parcel::new(Family::Context, "leave").context(at(CHAT));
        scene.bob.ask(leave).await.expect("a member");
        scene.pass(60_000);
        scene.bob.join(&[CHAT]).await;
        scene.say(CHAT, "state", "seven").await;
        scene.hears_words("seven").await;
        scene.broker.stop().await;
    }
}

/// A peer that reads nothing for a while, so that all waits in its outbox.
#[tokio::test]
async fn who_wants_the_newest_is_never_too_slow() {
    for newest in [true, false] {
        let broker =
            lab::start_with(|config| (config.limits.outbox, config.limits.burst) = (256 * 1024, 256 * 1024))
                .await;
        let mut alice = Raw::login(broker.local_addr(), Form::Binary, "alice").await;
        let mut bob = Raw::connect_small(broker.local_addr(), Form::Binary).await;
        bob.log_in("bob").await;
        alice.join(&[CHAT]).await;
        bob.ask(join(CHAT, Map::new().with("newest", newest)))
            .await
            .expect("a member");
        let long = "x".repeat(60_000);
        // More than kernels and outbox take together, all of it reliable.
        for number in 0..200 {
            let mut parcel = message("state", CHAT, format!("{number} {long}"));
            parcel.echo = Some(false);
            alice.send_parcel(&parcel).await;
        }
        alice.check_alive().await;
        let (mut last, mut closed) = (String::new(), false);
        while !last.starts_with("199 ") && !closed {
            match bob.next().await {
                Some(parcel) if parcel.family == Family::Message => {
                    last = parcel.value().as_str().unwrap_or_default().to_owned();
                }
                Some(parcel) => closed |= parcel.family == Family::Error,
                None => closed = true,
            }
        }
        assert_eq!(closed, !newest, "newest {newest}");
        broker.stop().await;
    }
}

#[tokio::test]
async fn the_client_asks_for_it_and_changes_it() {
    let clock = lab::clock();
    let broker = lab::start_at(clock.clone(), |_| {}).await;
    let connect = async |user: &str| {
        let builder = Client::builder(format!("bin://{}", broker.local_addr()));
        let client = builder.user(user).password(user).connect().await;
        client.expect("a user of the lab")
    };
    let (alice, bob) = (connect("alice").await, connect("bob").await);
    let thinning = Thinning {
        newest: true,
        rate: MessageRate::per_second(2).ok(),
    };
    let chat = bob.channel_thinned(CHAT, thinning).await.expect("a channel");
    let info = bob.info(CHAT).await.expect("a channel");
    assert_eq!(info.get("rate").and_then(Value::as_str), Some("2/s"));
    let mut events = chat.events();
    let mut hears = async || loop {
        if let Event::Message(parcel) = events.next().await.expect("it is joined") {
            break parcel.value().as_str().unwrap_or_default().to_owned();
        }
    };
    let say = alice.channel(CHAT).await.expect("a channel");
    for words in ["one", "two", "three"] {
        say.message("state")
            .content(words)
            .send_acknowledged()
            .await
            .expect("taken");
    }
    assert_eq!(hears().await, "one");
    clock.advance(Duration::from_millis(500));
    assert_eq!(hears().await, "three");
    chat.thin(Thinning::default()).await.expect("a member");
    for words in ["four", "five"] {
        say.send("state", words).await.expect("sent");
        assert_eq!(hears().await, words);
    }
    broker.stop().await;
}
