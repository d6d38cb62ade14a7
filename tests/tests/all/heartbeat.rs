//! Signs of life: what waits or is long on its way tears no link, and a link that is dead halts what moves.

use std::future::Future;
use std::net::SocketAddr;
use std::pin::pin;
use std::process::Command;
use std::time::{Duration, Instant};

use bytes::Bytes;
use mom_broker::Config;
use mom_client::{Channel, Client, Event, Events};
use mom_proto::codec::Form;
use mom_proto::{Family, Parcel, Value};
use mom_tests::faulty::{Fault, FaultyNetwork};
use mom_tests::lab;
use mom_tests::programs::{PATIENCE, Running, program};
use mom_tests::raw::Raw;
use tokio::task::spawn_blocking;
use tokio::time::timeout;

const BULK: &str = "/bulk";

/// A number that the environment gives, or this one.
fn given(name: &str, usual: u64) -> u64 {
    let given = std::env::var(name).ok();
    given.and_then(|text| text.parse().ok()).unwrap_or(usual)
}

/// A channel in which senders wait, and time for it.
fn with_bulk(config: &mut Config) {
    lab::add_waiting_channel(config, BULK);
    (config.limits.send_wait, config.limits.stalled) = (60_000, 120_000);
}

/// Alice, whose place is kept, and who asks for signs of life so often.
async fn alice(scheme: &str, address: SocketAddr, heartbeat: Duration) -> Client {
    let connected = Client::builder(format!("{scheme}://{address}"))
        .user("alice")
        .password("alice")
        .link(Duration::from_secs(60))
        .heartbeat(heartbeat)
        .request_timeout(PATIENCE)
        .connect()
        .await;
    connected.expect("a user of the lab")
}

/// How often the link was lost, as these events tell.
fn losses(events: &mut Events) -> usize {
    std::iter::from_fn(|| events.try_next())
        .filter(|event| matches!(event, Event::LinkDown))
        .count()
}

/// Sends a block that all receivers take.
async fn send(channel: &Channel, content: Bytes) {
    let block = channel.message("block").content(Value::Binary(content)).no_echo();
    block.send_acknowledged().await.expect("it waits for room");
}

/// Messages of nearly the largest size wait for room, each for longer than a peer may be silent, and both sides hear all the time that
/// the other is there.
///
/// `MOM_HEARTBEAT_SECONDS` says for how long, `MOM_HEARTBEAT_MS` how often they ask. Gives how many waited.
async fn large_messages_wait(scheme: &str, size: usize) -> usize {
    let beat = Duration::from_millis(given("MOM_HEARTBEAT_MS", 300));
    let time = Duration::from_secs(given("MOM_HEARTBEAT_SECONDS", 4));
    let broker = lab::start_with(with_bulk).await;
    let alice = alice(scheme, broker.local_addr(), beat).await;
    let mut bob = Raw::connect_small(broker.local_addr(), Form::Binary).await;
    bob.log_in("bob").await;
    bob.join(&[BULK]).await;
    let bulk = alice.channel(BULK).await.expect("people may");
    let mut events = bulk.events();
    let content = Bytes::from(vec![7; size]);
    let (began, mut waited) = (Instant::now(), 0);
    while began.elapsed() < time || waited < 2 {
        let mut sending = pin!(send(&bulk, content.clone()));
        if timeout(5 * beat, &mut sending).await.is_ok() {
            continue;
        }
        waited += 1;
        // Bob reads until there is room.
        let reading = async {
            loop {
                bob.next_of(Family::Message, "block").await;
            }
        };
        let taken = async {
            tokio::select! {
                () = &mut sending => {}
                () = reading => {}
            }
        };
        timeout(PATIENCE, taken).await.expect("there is room now");
    }
    assert_eq!(losses(&mut events), 0, "{scheme}: after {waited} that waited");
    bob.reset();
    drop((bulk, alice));
    broker.stop().await;
    waited
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn large_messages_that_wait_tear_no_link() {
    let waited = large_messages_wait("bin", (8 << 20) - 1024).await;
    println!("{waited} messages waited");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn large_messages_that_wait_tear_no_link_in_xml() {
    let waited = large_messages_wait("tcp", (8 << 20) - 4096).await;
    println!("{waited} messages waited");
}

/// A message that takes longer than a peer may be silent, there and back, in forms that cannot send anything in between.
#[tokio::test]
async fn a_large_message_on_a_slow_link_tears_it_not() {
    let slow = Fault {
        slice: 4096,
        delay: Duration::from_millis(10),
        ..Fault::default()
    };
    let broker = lab::start().await;
    let network = FaultyNetwork::to(broker.local_addr(), move |_| slow).await;
    for scheme in ["tcp", "json"] {
        let heartbeat = Duration::from_millis(500);
        let alice = alice(scheme, network.address, heartbeat).await;
        let chat = alice.channel("/chat").await.expect("anybody may");
        let mut events = chat.events();
        let began = Instant::now();
        let map = "m".repeat(1 << 20);
        chat.send("map", map.as_str()).await.expect("it is sent");
        let echo = heard(&mut events, |event| match event {
            Event::LinkDown => panic!("{scheme}: the link was lost after {:?}", began.elapsed()),
            Event::Message(parcel) if parcel.name() == "map" => Some(parcel.value()),
            _ => None,
        });
        assert_eq!(echo.await, Value::from(map), "{scheme}");
        assert!(
            began.elapsed() > 4 * heartbeat,
            "{scheme}: the network is slow enough"
        );
        drop((chat, alice));
    }
    broker.stop().await;
}

/// The first of these events that is wanted.
async fn heard<T>(events: &mut Events, wanted: impl Fn(Event) -> Option<T>) -> T {
    let heard = async {
        loop {
            if let Some(heard) = wanted(events.next().await.expect("the channel stays")) {
                return heard;
            }
        }
    };
    timeout(PATIENCE, heard).await.expect("it comes")
}

fn event(name: &'static str) -> impl Fn(Event) -> Option<Parcel> {
    move |event| match event {
        Event::Other(parcel) if parcel.is(Family::Event, name) => Some(parcel),
        _ => None,
    }
}

/// The arm's own program behind this address of the hub; its log comes with its output.
fn start_arm(hub: &str) -> Running {
    let mut command = Command::new("sh");
    command
        .args(["-c", "exec \"$0\" \"$@\" 2>&1"])
        .arg(program("mom-arm"))
        .args(["--hub", hub])
        .env("MOM_PASSWORD", "arm");
    Running::of("mom-arm", &mut command)
}

/// Does this within the time that a dead link may take to be noticed. Three heartbeats of 500 ms are meant; without them it was 30 s.
async fn soon<T>(what: impl Future<Output = T>) -> T {
    timeout(Duration::from_secs(5), what)
        .await
        .expect("within 5 s of the freeze")
}

/// Bytes neither pass nor is a socket closed: the arm halts by itself, and the others hear that it is lost. When all passes again it is at
/// rest, and goes on with its link.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn behind_a_frozen_link_the_arm_halts_by_itself() {
    let broker = lab::start_with(|config| config.limits.gone = 30_000).await;
    let network = FaultyNetwork::to(broker.local_addr(), |_| Fault::default()).await;
    let hub = format!("bin://{}", network.address);
    let arm = spawn_blocking(move || {
        let arm = start_arm(&hub);
        arm.line_with("the arm is ready");
        arm
    });
    let arm = arm.await.expect("it starts");
    let alice = alice("bin", broker.local_addr(), Duration::from_secs(10)).await;
    let token = alice.token("/robot/token").await.expect("alice may look");
    let _guard = token.grab().await.expect("it is free");
    let channel = alice.channel("/robot/arm").await.expect("alice may drive");
    let mut events = channel.events();
    move_to_and_fro(&channel, &mut events).await;

    network.freeze(true);
    let frozen = Instant::now();
    let halted = spawn_blocking(move || {
        arm.line_with("the link is lost; the arm halts");
        arm
    });
    let (arm, _) = soon(async { tokio::join!(halted, heard(&mut events, event("lost"))) }).await;
    println!("lost and halted after {:?}", frozen.elapsed());

    network.freeze(false);
    heard(&mut events, event("resumed")).await;
    let ended = heard(&mut events, |event| status(&event, "error")).await;
    let text = ended.get("text").and_then(Value::as_str).unwrap_or_default();
    assert!(text.contains("the link to the hub was lost"), "{ended:?}");
    drop((arm.expect("no panic"), alice));
    broker.stop().await;
}

/// Has the arm carry out a command that takes a minute, and waits until it has begun.
async fn move_to_and_fro(channel: &Channel, events: &mut Events) {
    let script = "move 300 0 300 0 0; move -300 0 300 0 0; ".repeat(8);
    loop {
        channel
            .send("command", script.as_str())
            .await
            .expect("it is sent");
        // It refuses while its token changes hands.
        let taken = heard(events, |event| {
            let begun = status(&event, "state").filter(|state| *state == Value::from("executing"));
            let refused = status(&event, "error");
            begun.map(|_| true).or(refused.map(|_| false))
        });
        if taken.await {
            return;
        }
    }
}

/// A slot of the content of a message `status`.
fn status(event: &Event, key: &str) -> Option<Value> {
    match event {
        Event::Message(parcel) if parcel.name() == "status" => parcel.value().get(key).cloned(),
        _ => None,
    }
}
