//! A client whose connections are lost again and again during a scripted exchange: nothing is lost, nothing comes twice, the
//! token is kept, and nothing that is said before a halt moves the device after it.

use std::time::Duration;

use mom_broker::Broker;
use mom_client::{Builder, Client, Delivery, Event, Family, Parcel, Path, Reconnect, Trust};
use mom_tests::faulty::{End, Fault, FaultyNetwork};
use mom_tests::programs::PATIENCE;
use mom_tests::{lab, tls};
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::timeout;

/// How many connections are lost on each door; through a tunnel each loss takes longer. `MOM_LOSSES` says another number.
const LOSSES: u64 = 200;
const LOSSES_OF_TUNNELS: u64 = 20;

fn losses(scheme: &str) -> u64 {
    let given = std::env::var("MOM_LOSSES").ok();
    let usual = match scheme {
        "http" | "https" => LOSSES_OF_TUNNELS,
        _ => LOSSES,
    };
    given.and_then(|text| text.parse().ok()).unwrap_or(usual)
}

/// How long all losses may take; `MOM_PATIENCE_SECONDS` says another time.
fn patience() -> Duration {
    let given = std::env::var("MOM_PATIENCE_SECONDS").ok();
    given
        .and_then(|text| text.parse().ok())
        .map_or(PATIENCE, Duration::from_secs)
}

/// The nth connection: cut at the nth byte and at others, so that in the end every byte of a resume and of what follows was the last.
///
/// A resume takes about `resume` bytes.
fn fault(number: u64, resume: u64) -> Fault {
    let byte = number * 5 / 4;
    let end = match number % 40 {
        // Half-open: only a silence that is too long tells of it.
        39 => End::Frozen(3 * resume + number),
        // Some have to live long enough for something to be said.
        place if place % 4 == 3 => End::Closed(2 * resume + number * 7 % (8 * resume)),
        place if place % 2 == 1 => End::Closed(1 + byte % resume),
        _ => End::Reset(1 + byte % (2 * resume)),
    };
    Fault {
        end,
        slice: if number.is_multiple_of(5) { 7 } else { 0 },
        delay: Duration::ZERO,
    }
}

fn builder(address: &str, user: &str) -> Builder {
    Client::builder(address).user(user).password(user)
}

fn say(number: i64) -> Parcel {
    Parcel::new(Family::Message, "say")
        .context(path("/chat"))
        .content(number)
}

/// Says between the numbers what is not kept, and what overtakes all that waits.
async fn disturb(clients: [&Client; 2], said: i64) {
    for client in clients {
        // While the connection is lost it may be refused.
        if said % 3 == 0 {
            let _ = client.send(between("tick")).await;
        }
        if said % 8 == 0 {
            let _ = client.send(between("stop")).await;
        }
    }
}

/// It is not a number, which would be heard.
fn between(name: &str) -> Parcel {
    let mut parcel = Parcel::new(Family::Message, name).context(path("/chat"));
    parcel.delivery = (name != "stop").then_some(Delivery::Fleeting);
    parcel
}

fn path(text: &str) -> Path {
    Path::parse(text).expect("a path")
}

async fn steady(broker: &Broker, user: &str) -> Client {
    let connected = builder(&format!("bin://{}", broker.local_addr()), user)
        .connect()
        .await;
    connected.expect("a user of the lab")
}

/// The numbers that come in the chat from another peer.
async fn hear(client: Client, from: &'static str) -> mpsc::UnboundedReceiver<i64> {
    let (sender, numbers) = mpsc::unbounded_channel();
    let chat = client.channel("/chat").await.expect("anybody may");
    let mut events = chat.events();
    tokio::spawn(async move {
        let _client = client;
        while let Some(event) = events.next().await {
            if let Event::Message(parcel) = event
                && parcel.sender.as_deref() == Some(from)
                && let Some(number) = parcel.value().as_int()
                && sender.send(number).is_err()
            {
                return;
            }
        }
    });
    numbers
}

/// The arm: it counts halts, and checks that no command comes from before the last.
async fn obey(client: Client) -> (watch::Receiver<u64>, mpsc::UnboundedSender<()>, JoinHandle<()>) {
    let (stop, mut stopped) = mpsc::unbounded_channel();
    let (obeyed, commands) = watch::channel(0);
    let arm = client.channel("/robot/arm").await.expect("it is its channel");
    let mut events = arm.events();
    let obeying = tokio::spawn(async move {
        let mut halts = 0;
        loop {
            let event = tokio::select! {
                event = events.next() => event.expect("the channel stays"),
                _ = stopped.recv() => break,
            };
            match event {
                Event::Message(parcel) if parcel.name() == "halt" => halts += 1,
                Event::Message(parcel) if parcel.name() == "command" => {
                    let known = parcel.value().as_int().expect("how many halts its sender knew");
                    assert_eq!(known, halts, "a command of before a halt came after it");
                    obeyed.send_modify(|commands| *commands += 1);
                }
                Event::Released { reason, .. } => assert_eq!(reason, "released", "the token is kept"),
                _ => {}
            }
        }
        drop(client);
    });
    (commands, stop, obeying)
}

/// Alice drives: each command says how many halts she has heard of.
async fn drive(client: Client, mut over: watch::Receiver<bool>, ready: oneshot::Sender<()>) -> u64 {
    let token = client.token("/robot/token").await.expect("anybody may look");
    let arm = client.channel("/robot/arm").await.expect("anybody may");
    let mut events = arm.events();
    let guard = token.grab().await.expect("it is free");
    ready.send(()).expect("it is waited for");
    let (mut halts, mut resumes, mut settled) = (0_i64, 0, false);
    while !*over.borrow_and_update() {
        // All halts of before are here when an answer is, and are heard of before the next command.
        if !settled {
            settled = client.info("/robot").await.is_ok();
        }
        let mut next = events.try_next();
        if next.is_none() && settled {
            let command = Parcel::new(Family::Message, "command")
                .context(path("/robot/arm"))
                .content(halts);
            // While the connection is lost nothing is taken that would come late.
            let _ = client.send(command).await;
        }
        if next.is_none() {
            next = tokio::select! {
                event = events.next() => event,
                _ = over.changed() => break,
            };
        }
        match next.expect("the channel stays") {
            Event::Message(parcel) if parcel.name() == "halt" => halts += 1,
            Event::LinkDown => settled = false,
            Event::Resumed => resumes += 1,
            Event::Rejoined => panic!("the link was not resumed but begun anew"),
            _ => {}
        }
    }
    assert!(guard.release().await.is_ok(), "it was hers all the time");
    resumes
}

/// Alice's client, on the other side of a network that fails.
async fn behind(network: &FaultyNetwork, scheme: &str, query: &str, compress: bool) -> Client {
    let reconnect = Reconnect {
        first: Duration::from_millis(1),
        most: Duration::from_millis(5),
        give_up_after: None,
    };
    let trust = Trust::Authorities(tls::of_hub().certificate.expect("one"));
    let builder = builder(&format!("{scheme}://{}{query}", network.address), "alice")
        .trust(trust)
        .link(Duration::from_secs(120))
        .heartbeat(Duration::from_millis(100))
        .reconnect(reconnect)
        .compress(compress)
        .wait_for_hub();
    builder.connect().await.expect("alice")
}

async fn survive(scheme: &str, query: &str, resume: u64) {
    survive_as(scheme, query, resume, false).await;
}

async fn survive_as(scheme: &str, query: &str, resume: u64, compress: bool) {
    let broker = lab::start_with(|config| config.tls = tls::of_hub()).await;
    let network = FaultyNetwork::to(broker.local_addr(), move |number| fault(number, resume)).await;
    let alice = behind(&network, scheme, query, compress).await;
    let (commands, stop, obeying) = obey(steady(&broker, "arm").await).await;
    let bob = steady(&broker, "bob").await;
    let mut from_alice = hear(bob.clone(), "alice").await;
    let mut from_bob = hear(alice.clone(), "bob").await;
    let (end, over) = watch::channel(false);
    let (ready, driven) = oneshot::channel();
    let driving = tokio::spawn(drive(alice.clone(), over, ready));
    timeout(PATIENCE, driven)
        .await
        .expect("in time")
        .expect("she drives");
    let (mut said, losses) = (0, network.cut() + losses(scheme));
    let exchange = async {
        while network.cut() < losses || *commands.borrow() == 0 {
            said += 1;
            alice
                .send(say(said))
                .await
                .expect("it waits for the next connection");
            bob.send(say(said)).await.expect("bob is steady");
            disturb([&alice, &bob], said).await;
            // Now and then both have heard all, so that the exchange goes at the pace of the network.
            if said % 8 == 0 {
                for wanted in said - 7..=said {
                    assert_eq!(
                        from_alice.recv().await,
                        Some(wanted),
                        "{scheme}: to bob, once and in order"
                    );
                    assert_eq!(
                        from_bob.recv().await,
                        Some(wanted),
                        "{scheme}: to alice, once and in order"
                    );
                }
            }
        }
    };
    timeout(patience(), exchange).await.unwrap_or_else(|_| {
        panic!(
            "{scheme}: after {} losses all stands still: {:?}",
            network.cut(),
            alice.state().borrow()
        )
    });
    end.send(true).expect("it drives");
    let resumes = timeout(PATIENCE, driving)
        .await
        .expect("in time")
        .expect("no panic");
    stop.send(()).expect("it obeys");
    obeying.await.expect("no command of before a halt");
    assert!(resumes > 0, "{scheme}: nothing was resumed");
    assert_eq!(
        alice.name(),
        "alice",
        "{scheme}: it has been the same peer all the time"
    );
    broker.check();
    drop((alice, bob, network));
    broker.stop().await;
}

#[tokio::test]
async fn over_tcp() {
    survive("bin", "", 1000).await;
}

#[tokio::test]
async fn over_tcp_in_xml() {
    survive("tcp", "", 16_000).await;
}

/// All that follows a login or a resume is compressed, anew on each connection (M16).
#[tokio::test]
async fn over_tcp_in_xml_compressed() {
    survive_as("tcp", "", 8000, true).await;
}

#[tokio::test]
async fn over_a_websocket_in_json_compressed() {
    survive_as("ws", "?form=json", 4000, true).await;
}

#[tokio::test]
async fn over_tls() {
    survive("bins", "", 4000).await;
}

#[tokio::test]
async fn over_a_websocket() {
    survive("ws", "?form=json", 4000).await;
}

#[tokio::test]
async fn over_a_websocket_with_tls() {
    survive("wss", "", 5000).await;
}

#[tokio::test]
async fn through_a_tunnel() {
    survive("http", "", 3000).await;
}

#[tokio::test]
async fn through_a_polled_tunnel() {
    survive("http", "?poll=1", 3000).await;
}
