//! A device at a hub, over sockets: what its loop and its way out do, which dialogues without IO cannot show.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use mom_broker::{Broker, Config};
use mom_client::{
    CardArg, CardVerb, Client, Event, Events, Family, Map, Parcel, Reconnect, Time, TokenGuard, Value,
};
use mom_device::{Call, Declared, Device, DeviceError, DevicePeer, DeviceTime, ErrorName, obey};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{Instant, timeout};

const CHANNEL: &str = "/robot/arm";
const TOKEN: &str = "/robot/token";

/// Until something has to have happened.
const PATIENCE: Duration = Duration::from_secs(20);

/// What a drum on an axle was told, in order.
type Told = Arc<Mutex<Vec<&'static str>>>;

/// A drum that turns as it is told, and is where it was told.
struct Drum {
    told: Told,
    turns: f64,
    is_turning: bool,
}

impl Drum {
    fn new(told: &Told) -> Drum {
        Drum {
            told: Arc::clone(told),
            turns: 0.0,
            is_turning: false,
        }
    }

    fn note(&self, what: &'static str) {
        self.told.lock().expect("nothing panics").push(what);
    }
}

impl Device for Drum {
    const NAME: &str = "the drum";
    const STOPS_WITHIN: Duration = Duration::from_millis(100);

    fn verbs() -> Vec<CardVerb> {
        let turns = CardArg::number("turns", "turns");
        vec![
            CardVerb::motion("turn", "Turns for good").args([turns]),
            CardVerb::motion("nudge", "Turns at once").args([CardArg::number("turns", "turns")]),
        ]
    }

    fn begin(&mut self, call: &Call) -> Result<(), DeviceError> {
        self.is_turning = call.name() == "turn";
        self.turns = call.number("turns")?;
        self.note(if self.is_turning { "turn" } else { "nudge" });
        Ok(())
    }

    fn is_done(&mut self) -> Result<bool, DeviceError> {
        Ok(!self.is_turning)
    }

    fn halt(&mut self) {
        self.is_turning = false;
        self.note("halt");
    }

    fn position(&self) -> Map {
        Map::new().with("turns", Value::Double(self.turns))
    }
}

/// The lab's hub, whose arm is a drum.
struct Lab {
    broker: Broker,
    told: Told,
}

impl Lab {
    async fn start() -> Lab {
        let mut config = Config::lab();
        config.listen = vec![SocketAddr::from(([127, 0, 0, 1], 0)).into()];
        let broker = Broker::start(config)
            .await
            .expect("the lab's configuration is right");
        Lab {
            broker,
            told: Told::default(),
        }
    }

    fn address(&self) -> String {
        format!("bin://{}", self.broker.local_addr())
    }

    async fn user(&self, name: &str) -> Client {
        let client = Client::builder(self.address())
            .user(name)
            .password(name)
            .connect()
            .await;
        client.expect("the lab knows its users")
    }

    /// The drum that obeys by this client, until the sender is dropped.
    fn drum(&self, client: &Client) -> (watch::Sender<()>, JoinHandle<Result<(), mom_client::ClientError>>) {
        let (end, mut ended) = watch::channel(());
        let (client, drum) = (client.clone(), Drum::new(&self.told));
        let obeying = tokio::spawn(async move {
            let until = async move {
                let _ = ended.changed().await;
            };
            obey(&client, CHANNEL, drum, until).await
        });
        (end, obeying)
    }

    fn told(&self) -> Vec<&'static str> {
        self.told.lock().expect("nothing panics").clone()
    }

    /// Waits until the drum was told so many things.
    async fn told_so_many(&self, count: usize) -> Vec<&'static str> {
        until(async || self.told().len() >= count).await;
        self.told()
    }
}

async fn until(is: impl AsyncFn() -> bool) {
    let waited = timeout(PATIENCE, async {
        while !is().await {
            tokio::task::yield_now().await;
        }
    });
    waited.await.expect("it happens in time");
}

/// Who drives, and hears what the device says.
struct Driver {
    client: Client,
    channel: mom_client::Channel,
    events: Events,
    guard: TokenGuard,
}

impl Driver {
    async fn at(lab: &Lab) -> Driver {
        let client = lab.user("alice").await;
        let channel = client.channel(CHANNEL).await.expect("she may");
        let events = channel.events();
        let token = client.token(TOKEN).await.expect("it is there");
        let guard = token.grab().await.expect("it is free");
        Driver {
            client,
            channel,
            events,
            guard,
        }
    }

    async fn says(&self, id: u64, script: &str) {
        let mut parcel = Parcel::new(Family::Message, "command").content(Value::from(script));
        parcel.context = Some(self.channel.path().clone());
        parcel.id = Some(id);
        self.client.send(parcel).await.expect("it leaves");
    }

    /// The next parcel of this name that fits.
    async fn hears(&mut self, name: &str, fits: impl Fn(&Map) -> bool) -> Parcel {
        let heard = timeout(PATIENCE, async {
            loop {
                let event = self.events.next().await.expect("the link stands");
                let Event::Message(parcel) = event else { continue };
                if parcel.name() == name && parcel.value().as_map().is_some_and(&fits) {
                    return parcel;
                }
            }
        });
        heard.await.expect("it is said in time")
    }

    async fn hears_status(&mut self, state: &'static str) -> Map {
        let parcel = self.hears("status", |map| word(map, "state") == state).await;
        parcel.value().as_map().cloned().unwrap_or_default()
    }
}

fn word<'a>(map: &'a Map, key: &str) -> &'a str {
    map.get(key).and_then(Value::as_str).unwrap_or_default()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_program_that_ends_halts_its_device_and_says_so() {
    let lab = Lab::start().await;
    let arm = lab.user("arm").await;
    let (end, obeying) = lab.drum(&arm);
    let mut driver = Driver::at(&lab).await;
    until(async || driver.client.card(CHANNEL).await.is_ok_and(|card| card.is_some())).await;
    driver.says(1, "nudge 2").await;
    let finished = driver.hears_status("finished").await;
    assert_eq!(word(&finished, "peer"), driver.client.name());
    driver.says(2, "turn 3").await;
    driver.hears_status("executing").await;
    drop(end);
    let ended = driver.hears_status("error").await;
    assert!(format!("{ended:?}").contains("its program ends"), "{ended:?}");
    obeying.await.expect("it does not panic").expect("it obeyed");
    let told = lab.told();
    assert_eq!(told.last(), Some(&"halt"), "{told:?}");
    // The client stays as it is, and may be the device again.
    let (end, obeying) = lab.drum(&arm);
    until(async || driver.client.card(CHANNEL).await.is_ok_and(|card| card.is_some())).await;
    driver.says(3, "nudge 1").await;
    driver.hears_status("finished").await;
    drop(end);
    obeying.await.expect("it does not panic").expect("it obeyed");
}

#[tokio::test(flavor = "multi_thread")]
async fn one_that_is_put_out_of_its_channel_stands_and_comes_back() {
    let lab = Lab::start().await;
    let arm = lab.user("arm").await;
    let (_end, _obeying) = lab.drum(&arm);
    let mut driver = Driver::at(&lab).await;
    until(async || driver.client.card(CHANNEL).await.is_ok_and(|card| card.is_some())).await;
    driver.says(1, "turn 3").await;
    driver.hears_status("executing").await;
    let before = lab.told().len();
    let carol = lab.user("carol").await;
    carol
        .expel(CHANNEL, &arm.name(), "to try", Some(Duration::from_millis(1)))
        .await
        .expect("she may");
    let told = lab.told_so_many(before + 1).await;
    assert_eq!(told.last(), Some(&"halt"), "{told:?}");
    // It comes back by itself, and obeys the same owner.
    until(async || driver.client.card(CHANNEL).await.is_ok_and(|card| card.is_some())).await;
    driver.says(2, "nudge 1").await;
    driver.hears_status("finished").await;
    assert_eq!(lab.told().last(), Some(&"nudge"));
}

/// A way to the hub that can be cut.
struct Way {
    address: SocketAddr,
    is_open: watch::Sender<bool>,
}

impl Way {
    async fn to(hub: SocketAddr) -> Way {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("it is bound");
        let (is_open, open) = watch::channel(true);
        tokio::spawn(async move {
            while let Ok((mut near, _)) = listener.accept().await {
                let mut open = open.clone();
                if !*open.borrow() {
                    continue;
                }
                tokio::spawn(async move {
                    let Ok(mut far) = TcpStream::connect(hub).await else {
                        return;
                    };
                    tokio::select! {
                        _ = tokio::io::copy_bidirectional(&mut near, &mut far) => {}
                        _ = open.wait_for(|is_open| !is_open) => {}
                    }
                });
            }
        });
        Way { address, is_open }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_it_has_to_say_without_a_link_is_said_when_that_is_back() {
    let lab = Lab::start().await;
    let way = Way::to(lab.broker.local_addr()).await;
    let quick = Reconnect {
        first: Duration::from_millis(20),
        most: Duration::from_millis(50),
        give_up_after: None,
    };
    let arm = Client::builder(format!("bin://{}", way.address))
        .user("arm")
        .password("arm")
        .reconnect(quick)
        .connect()
        .await
        .expect("the way is open");
    let (_end, _obeying) = lab.drum(&arm);
    let mut driver = Driver::at(&lab).await;
    until(async || driver.client.card(CHANNEL).await.is_ok_and(|card| card.is_some())).await;
    driver.says(1, "turn 3").await;
    driver.hears_status("executing").await;
    let before = lab.told().len();
    way.is_open.send_replace(false);
    let told = lab.told_so_many(before + 1).await;
    assert_eq!(told.last(), Some(&"halt"), "a lost link halts it: {told:?}");
    way.is_open.send_replace(true);
    let ended = driver.hears_status("error").await;
    assert_eq!(ended.get("id").and_then(Value::as_int), Some(1), "{ended:?}");
    // It has heard how it stands, and obeys again, for who has the token by then.
    if driver.guard.is_lost() {
        let token = driver.client.token(TOKEN).await.expect("it is there");
        driver.guard = token.grab().await.expect("it is free");
    }
    driver.says(2, "nudge 1").await;
    driver.hears_status("finished").await;
}

/// The loop itself, as programs use it whose devices need more than `obey`.
struct Own {
    peer: DevicePeer<Declared<Drum>>,
}

impl Own {
    async fn start(lab: &Lab, arm: &Client) -> Own {
        let drum = Declared::new(Drum::new(&lab.told));
        let channel = arm
            .channel_with_card(CHANNEL, &mom_device::card(&drum))
            .await
            .expect("it may");
        Own {
            peer: DevicePeer::start(arm, &channel, drum, Instant::now()),
        }
    }

    /// Goes on until it has said this, or for ever.
    async fn beside<T>(&mut self, what: impl Future<Output = T>) -> T {
        let obeys = async { while self.peer.step().await {} };
        tokio::select! {
            said = what => said,
            () = obeys => panic!("its channel is gone: {}", self.peer.why_gone()),
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn its_program_ends_what_it_does_by_an_error_or_in_words() {
    let lab = Lab::start().await;
    let arm = lab.user("arm").await;
    let mut own = Own::start(&lab, &arm).await;
    let mut driver = own.beside(Driver::at(&lab)).await;
    own.beside(async {
        driver.says(1, "turn 3").await;
        driver.hears_status("executing").await;
    })
    .await;
    own.peer
        .fail(&DeviceError::new(ErrorName::Obstacle, "a belt is torn"));
    let ended = own.beside(driver.hears_status("error")).await;
    assert!(format!("{ended:?}").contains("a belt is torn"), "{ended:?}");
    own.beside(async {
        driver.says(2, "turn 3").await;
        driver.hears_status("executing").await;
    })
    .await;
    own.peer.halt("a door is open");
    let ended = own.beside(driver.hears_status("error")).await;
    assert!(format!("{ended:?}").contains("a door is open"), "{ended:?}");
    // What moves it beside its commands is seen.
    own.peer.note(|drum| drum.device_mut().turns = 7.0);
    own.peer.report();
    let seven = |map: &Map| map.get("turns") == Some(&Value::Double(7.0));
    own.beside(driver.hears("state", seven)).await;
    assert_eq!(own.peer.machine().device().turns, 7.0);
    assert!(own.peer.put_out().is_none() && !own.peer.is_down());
    assert_eq!(own.peer.why_gone(), "its channel is gone");
    let owner = own.peer.gate().guard().and_then(|guard| guard.owner);
    assert_eq!(owner.as_deref(), Some(&*driver.client.name()));
    own.beside(async {
        driver.says(3, "turn 3").await;
        driver.hears_status("executing").await;
    })
    .await;
    own.peer.end("that was all").await;
    let ended = driver.hears_status("error").await;
    assert!(format!("{ended:?}").contains("that was all"), "{ended:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn it_knows_why_it_was_put_out() {
    let lab = Lab::start().await;
    let (arm, carol) = (lab.user("arm").await, lab.user("carol").await);
    let mut own = Own::start(&lab, &arm).await;
    let minute = Some(Duration::from_secs(60));
    // Who is beside it is put out without it.
    let _bob = lab.user("bob").await.channel(CHANNEL).await.expect("he may");
    carol
        .expel(CHANNEL, "bob", "for another reason", minute)
        .await
        .expect("she may");
    carol
        .expel(CHANNEL, &arm.name(), "to try", minute)
        .await
        .expect("she may");
    let out = timeout(PATIENCE, async { while own.peer.step().await {} }).await;
    out.expect("its channel is gone");
    assert_eq!(own.peer.put_out(), Some("to try"));
    assert_eq!(own.peer.why_gone(), "it was expelled from its channel: to try");
}

/// Where its channel is missing, it is made with all above it, guarded by the token beside it; once more, nothing changes.
#[tokio::test(flavor = "multi_thread")]
async fn a_device_makes_its_channel_where_that_is_missing() {
    let mut config = Config::lab();
    config.listen = vec![SocketAddr::from(([127, 0, 0, 1], 0)).into()];
    config.root = Value::from("open");
    config.contexts.clear();
    let broker = Broker::start(config).await.expect("the configuration is right");
    let lab = Lab {
        broker,
        told: Told::default(),
    };
    let arm = lab.user("arm").await;
    for _ in 0..2 {
        let (end, obeying) = lab.drum(&arm);
        let mut driver = {
            until(async || arm.card(CHANNEL).await.is_ok_and(|card| card.is_some())).await;
            Driver::at(&lab).await
        };
        driver.says(1, "nudge 1").await;
        driver.hears_status("finished").await;
        // Nobody drives it without the token.
        let bob = lab.user("bob").await.channel(CHANNEL).await.expect("all may");
        let refused = bob
            .message("command")
            .content(Value::from("nudge 2"))
            .send_acknowledged()
            .await;
        assert!(refused.is_err(), "{refused:?}");
        drop(end);
        obeying.await.expect("it does not panic").expect("it obeyed");
        driver.guard.release().await.expect("it is hers");
    }
    let denied = mom_device::ensure_session(&lab.user("bob").await, "/robot").await;
    denied.expect("it is there");
}

#[tokio::test(flavor = "multi_thread")]
async fn its_time_may_pass_faster_than_that_of_its_users() {
    let lab = Lab::start().await;
    let arm = lab.user("arm").await;
    let own = Own::start(&lab, &arm).await;
    let slow = Instant::now();
    let mut own = Own {
        peer: own.peer.at_pace(1000),
    };
    let mut driver = own.beside(Driver::at(&lab)).await;
    // A minute of its own time.
    own.beside(async {
        driver.says(1, "wait 60000").await;
        driver.hears_status("finished").await;
    })
    .await;
    let passed = slow.elapsed();
    assert!(passed < PATIENCE, "{passed:?}");
    assert!(own.peer.now() > 60_000_000, "{}", own.peer.now());
    let real = DeviceTime::try_from(slow.elapsed().as_micros()).expect("short");
    assert!(own.peer.now() <= (real + 2_000_000) * 1000);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_device_with_a_limit_of_its_own_refuses_what_is_older() {
    let lab = Lab::start().await;
    let arm = lab.user("arm").await;
    let own = Own::start(&lab, &arm).await;
    let mut own = Own {
        peer: own.peer.with_max_age(Duration::from_nanos(1)),
    };
    let mut driver = own.beside(Driver::at(&lab)).await;
    driver.says(1, "nudge 1").await;
    let refused = own.beside(driver.hears_status("error")).await;
    assert!(format!("{refused:?}").contains("too-old"), "{refused:?}");
    assert_eq!(lab.told(), ["halt"], "nothing has moved it since it began");
}

#[tokio::test(flavor = "multi_thread")]
async fn one_that_asks_for_its_commands_says_so() {
    let lab = Lab::start().await;
    let arm = lab.user("arm").await;
    let own = Own::start(&lab, &arm).await;
    let mut own = Own {
        peer: own.peer.pulling(Duration::from_secs(2)),
    };
    let mut driver = own.beside(Driver::at(&lab)).await;
    let asked = own.beside(driver.hears("next", |_| true)).await;
    assert!(asked.id.is_some(), "{asked:?}");
    assert!(asked.timestamp.unwrap_or_default() > Time::default());
}
