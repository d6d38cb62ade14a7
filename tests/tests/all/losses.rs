//! What a robot does, and what its driver hears, when the token goes to another: a real broker, arm and command line.

use std::process::Stdio;
use std::time::Duration;

use mom_arm::{ArmOptions, CommandState, Status, peer};
use mom_broker::{Broker, Config};
use mom_client::{Client, ClientError, Code, Event, Events, Map, from_value};
use mom_tests::faulty::{Fault, FaultyNetwork};
use mom_tests::lab;
use mom_tests::programs::{PATIENCE, program, text};
use tokio::io::AsyncWriteExt as _;
use tokio::process::Command;
use tokio::sync::oneshot;
use tokio::task::{JoinHandle, spawn_blocking};
use tokio::time::timeout;

const TOKEN: &str = "/robot/token";
const SCRIPT: &str = "move 100 50 200 0 0; move -100 50 200 0 0; move 100 50 200 0 0; move 0 200 200 0 0";

/// The lab with its arm.
pub(crate) struct Lab {
    pub(crate) broker: Broker,
    stop: oneshot::Sender<()>,
    arm: JoinHandle<Result<(), ClientError>>,
}

impl Lab {
    pub(crate) async fn start() -> Lab {
        Lab::start_with(|_| {}).await
    }

    /// One whose arm is not alone in its channel.
    pub(crate) async fn start_with_several() -> Lab {
        Lab::start_with(|config| {
            let arm = config
                .contexts
                .iter_mut()
                .find(|spec| spec.path.as_deref() == Some("/robot/arm"));
            arm.expect("the lab has an arm").devices = Some(from_value("several".into()).expect("a word"));
        })
        .await
    }

    async fn start_with(change: impl FnOnce(&mut Config)) -> Lab {
        let broker = lab::start_with(change).await;
        let arm = log_in(&broker, "arm").await;
        let (stop, stopped) = oneshot::channel::<()>();
        let arm = tokio::spawn(peer::run(arm, ArmOptions::default(), async {
            // Its sender going is a reason to stop too.
            let _ = stopped.await;
        }));
        Lab { broker, stop, arm }
    }

    pub(crate) async fn end(self) {
        drop(self.stop);
        let ended = timeout(PATIENCE, self.arm).await.expect("the arm ends in time");
        ended.expect("it did not panic").expect("its channel stays");
        self.broker.stop().await;
    }
}

async fn log_in(broker: &Broker, name: &str) -> Client {
    let builder = Client::builder(format!("bin://{}", broker.local_addr()));
    let connected = builder.user(name).password(name).connect().await;
    connected.expect("a user of the lab")
}

/// The next event that `pick` takes.
async fn next<T>(events: &mut Events, what: &str, mut pick: impl FnMut(&Event) -> Option<T>) -> T {
    let found = timeout(PATIENCE, async {
        loop {
            let event = events.next().await.expect("the channel stays");
            if let Some(found) = pick(&event) {
                return found;
            }
        }
    });
    found.await.unwrap_or_else(|_| panic!("never came: {what}"))
}

fn status(event: &Event) -> Option<Status> {
    match event {
        Event::Message(parcel) if parcel.name() == "status" => from_value(parcel.value()).ok(),
        _ => None,
    }
}

fn executing(event: &Event) -> Option<()> {
    let status = status(event)?;
    (status.state == CommandState::Executing).then_some(())
}

/// A peer that accepts a robot does not take over what its giver began.
#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_is_given_away_stops_what_its_giver_began() {
    let lab = Lab::start().await;
    let [alice, bob] = [
        log_in(&lab.broker, "alice").await,
        log_in(&lab.broker, "bob").await,
    ];
    let channel = bob.channel("/robot/arm").await.expect("people may");
    let mut events = channel.events();
    let (hers, his) = (alice.token(TOKEN).await, bob.token(TOKEN).await);
    let guard = hers.expect("people may").grab().await.expect("free");
    let command = alice.channel("/robot/arm").await.expect("people may");
    let command = command.message("command").content(SCRIPT);
    command.send().await.expect("the link is up");
    next(&mut events, "its first statement", executing).await;
    let _given = guard.give("bob").await.expect("bob is there");
    let taken = his.expect("people may").accept().await;
    let _taken = taken.expect("alice gives it");
    let mut story = Vec::new();
    next(&mut events, "the end of alice's command", |event| {
        match event {
            Event::Message(parcel) if parcel.name() == "halt" => story.push("halt"),
            Event::Released { .. } => story.push("released"),
            Event::Grabbed { owner, .. } if owner == "bob" => story.push("grabbed"),
            _ => {}
        }
        let status = status(event)?;
        assert!(
            status.state != CommandState::Executing || !story.contains(&"grabbed"),
            "statement {} began after bob had the token",
            status.statement
        );
        (status.state == CommandState::Error).then_some(())
    })
    .await;
    assert_eq!(story, ["halt", "released", "grabbed"]);
    lab.end().await;
}

/// Lets the robot's token declare this script as its safe state.
fn declare_safe(config: &mut Config, script: &str) {
    let mut contexts = config.contexts.iter_mut();
    let token = contexts.find(|context| context.path.as_deref() == Some(TOKEN));
    let safe = Map::new()
        .with("channel", "/robot/arm")
        .with("name", "command")
        .with("content", script);
    let safe = from_value(safe.into()).expect("a safe state");
    token.expect("of the lab").safe = Some(safe);
}

/// A token may declare any message as its safe state, one that it guards among them: the arm ends what its owner began,
/// and goes home.
#[tokio::test(flavor = "multi_thread")]
async fn a_declared_safe_state_is_obeyed() {
    let lab = Lab::start_with(|config| declare_safe(config, "home")).await;
    let alice = log_in(&lab.broker, "alice").await;
    let channel = alice.channel("/robot/arm").await.expect("people may");
    let mut events = channel.events();
    let token = alice.token(TOKEN).await.expect("people may");
    let guard = token.grab().await.expect("free");
    let command = channel.message("command").content(SCRIPT);
    command.send().await.expect("the link is up");
    next(&mut events, "its first statement", executing).await;
    guard.release().await.expect("hers");
    let end_of = |peer: &'static str| {
        move |event: &Event| {
            let status = status(event).filter(|status| status.peer == peer)?;
            matches!(status.state, CommandState::Finished | CommandState::Error).then_some(status)
        }
    };
    let hers = next(&mut events, "the end of her command", end_of("alice")).await;
    assert_eq!(hers.state, CommandState::Error, "{hers:?}");
    let safe = next(&mut events, "the end of the safe state", end_of("hub")).await;
    assert_eq!(safe.state, CommandState::Finished, "{safe:?}");
    lab.end().await;
}

/// While the safe state moves the arm, the next owner's command waits; it begins when the arm rests after it.
#[tokio::test(flavor = "multi_thread")]
async fn the_next_owner_waits_until_the_arm_stands() {
    let lab = Lab::start_with(|config| declare_safe(config, "wait 3000")).await;
    let alice = log_in(&lab.broker, "alice").await;
    let channel = alice.channel("/robot/arm").await.expect("people may");
    let mut events = channel.events();
    let token = alice.token(TOKEN).await.expect("people may");
    token.grab().await.expect("free").release().await.expect("hers");
    let program = spawn_blocking(|| program("mom")).await.expect("it is built");
    let mut command = Command::new(program);
    let hub = format!("bin://{}", lab.broker.local_addr());
    command.args(["run", "--json", "-"]).kill_on_drop(true);
    command.envs([("MOM_HUB", &*hub), ("MOM_USER", "bob"), ("MOM_PASSWORD", "bob")]);
    command.stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut running = command.spawn().expect("the program starts");
    let mut stdin = running.stdin.take().expect("its input is piped");
    stdin.write_all(b"grip close").await.expect("it reads");
    drop(stdin);
    let of_bob = |state: CommandState| {
        move |event: &Event| status(event).filter(|status| status.peer == "bob" && status.state == state)
    };
    next(&mut events, "his command", of_bob(CommandState::Waiting)).await;
    let first = |event: &Event| {
        let status = status(event)?;
        let begins = status.peer == "bob" && status.state == CommandState::Executing;
        let is_safe = status.peer == "hub" && status.state == CommandState::Finished;
        (begins || is_safe).then_some(status.peer)
    };
    assert_eq!(next(&mut events, "the end of the safe state", first).await, "hub");
    let rests = |event: &Event| match event {
        Event::Message(parcel) if parcel.name() == "state" => {
            let rest = parcel.value().get("rest").cloned();
            rest.map(|_| "rest".to_owned())
        }
        event => first(event),
    };
    assert_eq!(next(&mut events, "the word that it rests", rests).await, "rest");
    next(&mut events, "its end", of_bob(CommandState::Finished)).await;
    let output = timeout(PATIENCE, running.wait_with_output()).await;
    let output = output.expect("it ends").expect("it ran");
    let said = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(
        said.contains(r#""state":"finished""#) && !said.contains("changing-hands"),
        "{said}"
    );
    lab.end().await;
}

/// The robot's word that it was halted may be here before the hub's that another took it; what its driver has to know
/// is who did.
#[tokio::test(flavor = "multi_thread")]
async fn who_loses_the_robot_hears_who_took_it() {
    let lab = Lab::start().await;
    let carol = log_in(&lab.broker, "carol").await;
    let channel = carol.channel("/robot/arm").await.expect("people may");
    let mut events = channel.events();
    let token = carol.token(TOKEN).await.expect("people may");
    let hub = format!("bin://{}", lab.broker.local_addr());
    let environment = [
        ("MOM_HUB", &*hub),
        ("MOM_USER", "alice"),
        ("MOM_PASSWORD", "alice"),
    ];
    for json in [false, true, false, true, false, true, false, true] {
        let arguments: &[&str] = if json {
            &["run", "--json", "-"]
        } else {
            &["run", "-"]
        };
        let program = spawn_blocking(|| program("mom")).await.expect("it is built");
        let mut command = Command::new(program);
        command.args(arguments).envs(environment);
        command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .kill_on_drop(true);
        let mut running = command.spawn().expect("the program starts");
        let mut stdin = running.stdin.take().expect("its input is piped");
        stdin.write_all(SCRIPT.as_bytes()).await.expect("it reads");
        drop(stdin);
        next(&mut events, "its first statement", executing).await;
        let guard = token.grab().await.expect("her level is higher");
        let output = timeout(PATIENCE, running.wait_with_output()).await;
        let output = output.expect("it ends in time").expect("it ends");
        let said = text(&output.stdout) + &text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{said}");
        let words =
            "lost /robot/token: carol has a higher level and took it; the device has ended the command";
        assert!(said.contains(words), "{said}");
        guard.release().await.expect("hers");
    }
    lab.end().await;
}

/// What stood in an uplink that froze, and was not lost, follows no stop that was lifted meanwhile: who said it did not see the stop.
#[tokio::test(flavor = "multi_thread")]
async fn what_was_said_before_a_stop_does_not_follow_its_unstop() {
    let lab = Lab::start_with(|config| config.limits.gone = 30_000).await;
    let network = FaultyNetwork::to(lab.broker.local_addr(), |_| Fault::default()).await;
    let alice = Client::builder(format!("bin://{}", network.address))
        .user("alice")
        .password("alice")
        .heartbeat(Duration::from_secs(10))
        .connect();
    let alice = alice.await.expect("a user of the lab");
    let bob = log_in(&lab.broker, "bob").await;
    let token = alice.token(TOKEN).await.expect("people may");
    let _guard = token.grab().await.expect("free");
    let channel = alice.channel("/robot/arm").await.expect("people may");
    let (mut events, mut heard) = (
        channel.events(),
        bob.channel("/robot/arm").await.expect("people may").events(),
    );
    // Until the hub knows her clock, no message of hers has an age.
    let measured = |event: &Event| match event {
        Event::Message(parcel) if parcel.name() == "note" => Some(parcel.age_error.is_some()),
        _ => None,
    };
    loop {
        channel.send("note", "here").await.expect("the link is up");
        if next(&mut heard, "her note", measured).await {
            break;
        }
    }

    network.freeze(true);
    channel.send("command", SCRIPT).await.expect("it is on its way");
    let stopped = bob.stop("/robot/arm").send().await.expect("people may");
    assert_eq!(stopped.channels.len(), 1, "{stopped:?}");
    let number = bob.stops("/robot/arm").await.expect("it is there").number;
    let path = channel.path().clone();
    let unstop = bob.unstop("/robot/arm", [(&path, number)]);
    unstop.send().await.expect("people may");
    network.freeze(false);
    let refused = |event: &Event| match event {
        Event::Refused(error, _) => Some(error.code.clone()),
        event => status(event).map(|status| panic!("{status:?}")),
    };
    let refused = next(&mut events, "its refusal", refused).await;
    assert_eq!(refused, Code::TOO_LATE);
    // What she says now is meant for now.
    channel.send("command", SCRIPT).await.expect("the link is up");
    next(&mut events, "its first statement", executing).await;
    drop(alice);
    lab.end().await;
}
