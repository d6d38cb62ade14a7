//! The end of agents' work: with its time, its scope and who lent the token; and what becomes of a device, or an agent,
//! that does not answer.

use std::future::pending;
use std::time::Duration;

use mom_client::{Channel, Client, Event, Events, Given, Map, Parcel, TokenGuard, Value};
use mom_drive::{Commander, DeviceChannel, Holding, WorkEnd};
use mom_tests::assistant::{Assistant, text};
use mom_tests::programs::{PATIENCE, Running, project};
use serde_json::json;
use tokio::sync::mpsc;
use tokio::task::spawn_blocking;
use tokio::time::{Instant, timeout};

const ROBOT: &str = "/robot/arm";
const TOKEN: &str = "/robot/token";

async fn join(hub: &str, user: &str) -> Client {
    let client = Client::builder(hub).user(user).password(user).connect().await;
    client.expect("the lab knows its users")
}

/// A hub without devices.
async fn hub() -> (Running, String) {
    let started = spawn_blocking(|| Running::broker(&project().join("config/lab.toml")));
    let (broker, address) = started.await.expect("it starts");
    (broker, format!("bin://{address}"))
}

/// A device that begins each command, and answers nothing from then on; what it hears.
async fn deaf(hub: &str) -> mpsc::UnboundedReceiver<String> {
    let client = join(hub, "arm").await;
    let channel = client.channel_as_device(ROBOT).await.expect("it is the arm");
    let mut events = channel.events();
    let (hear, heard) = mpsc::unbounded_channel();
    state(&channel, false).await;
    tokio::spawn(async move {
        let _client = client;
        while let Some(event) = events.next().await {
            // Who comes is told, as by the real one.
            if matches!(event, Event::Joined(_)) {
                state(&channel, false).await;
            }
            let Event::Message(parcel) = event else { continue };
            if parcel.name() == "command" {
                state(&channel, true).await;
                begun(&channel, &parcel).await;
            }
            if hear.send(parcel.name().to_owned()).is_err() {
                return;
            }
        }
    });
    heard
}

async fn state(channel: &Channel, moving: bool) {
    let pose = ["x", "y", "z", "spin", "tilt"].into_iter();
    let pose = pose.fold(Map::new(), |pose, axis| pose.with(axis, Value::Double(1.0)));
    let state = Map::new()
        .with("seq", i64::from(moving))
        .with("pose", pose)
        .with("moving", moving);
    let sent = channel.message("state").content(Value::from(state)).send().await;
    sent.expect("it is the arm");
}

async fn begun(channel: &Channel, command: &Parcel) {
    let status = Map::new()
        .with(
            "id",
            command.id.and_then(|id| i64::try_from(id).ok()).expect("an id"),
        )
        .with("peer", command.sender.as_deref().expect("a sender"))
        .with("state", "executing")
        .with("statement", 1)
        .with("of", 1);
    channel
        .send("status", Value::from(status))
        .await
        .expect("it is the arm");
}

/// Waits until a device has heard this.
async fn hears(heard: &mut mpsc::UnboundedReceiver<String>, name: &str) {
    let wait = async {
        while let Some(said) = heard.recv().await {
            if said == name {
                return;
            }
        }
        panic!("the device is gone");
    };
    let waited = timeout(PATIENCE, wait).await;
    waited.unwrap_or_else(|_| panic!("no {name} has come"));
}

/// Alice lends the token to the assistant, which accepts it; she leaves it when what she has given is dropped.
async fn lent(alice: &Client, assistant: &Client) -> (Holding, Given) {
    let guard = alice
        .token(TOKEN)
        .await
        .expect("she may")
        .grab()
        .await
        .expect("it is free");
    let token = assistant.token(TOKEN).await.expect("it may look");
    let given = guard.give("assistant").time(Duration::from_secs(60)).await;
    let given = given.expect("the assistant is here");
    let holding = Holding::accept(token).await.expect("it was offered");
    (holding, given)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_device_that_does_not_end_a_command_is_halted_then_stopped_three_times() {
    let (_broker, hub) = hub().await;
    let mut heard = deaf(&hub).await;
    let (alice, assistant) = (join(&hub, "alice").await, join(&hub, "assistant").await);
    let (mut holding, _given) = lent(&alice, &assistant).await;
    let channel = DeviceChannel::join(&assistant, ROBOT).await.expect("it may");
    let mut robot = Commander::new(channel, holding.fence());
    let begins = async { hears(&mut heard, "command").await };
    let work = async { Ok(robot.carry_out("move 0 0 300 0 0").await) };
    let ended = holding.during(begins, work).await;
    assert!(matches!(ended, WorkEnd::Interrupted), "{ended:?}");
    let failure = holding.end(&mut robot).await.expect_err("it does not answer");
    assert!(
        failure
            .to_string()
            .contains("though the hub was asked to halt it, and 3 times to stop it"),
        "{failure}"
    );
    hears(&mut heard, "halt").await;
    for _ in 0..3 {
        hears(&mut heard, "stop").await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn who_lent_the_token_leaves_and_the_work_ends() {
    let (_broker, hub) = hub().await;
    let (alice, assistant) = (join(&hub, "alice").await, join(&hub, "assistant").await);
    let (mut holding, _given) = lent(&alice, &assistant).await;
    let work = holding.during(pending(), pending::<Result<(), _>>());
    let leave = async {
        alice.close().await;
        pending::<()>().await;
    };
    let ended = timeout(PATIENCE, async {
        tokio::select! {
            ended = work => ended,
            () = leave => unreachable!("it waits for ever"),
        }
    });
    let WorkEnd::Ended(Err(why)) = ended.await.expect("it ends") else {
        panic!("it ends by its principal");
    };
    assert_eq!(why.to_string(), "alice, who lent /robot/token, has left");
}

/// Hands the token over to the assistant for a second, by its own wish, and has it carry out a script.
async fn moves_for_a_second(hub: &str, script: &'static str) -> (serde_json::Value, Duration) {
    let alice = join(hub, "alice").await;
    let token = alice.token(TOKEN).await.expect("she may look");
    let mut events: Events = token.events();
    let _guard: TokenGuard = token.grab().await.expect("it is free");
    let place = hub.to_owned();
    let asked = spawn_blocking(move || {
        let mut assistant = Assistant::at(&place);
        let wish = json!({"reason": "to wave", "for_seconds": 1});
        let asked = assistant.begin("request_token", &wish);
        let granted = assistant.result(asked);
        assert!(text(&granted).contains("for good"), "{granted}");
        let begun = Instant::now();
        let moving = assistant.begin("move", &json!({"script": script}));
        (assistant.answer(moving), begun.elapsed())
    });
    while !matches!(events.next().await, Some(Event::Requested { .. })) {}
    token.accept_request("assistant").await.expect("she may");
    let (answer, took) = asked.await.expect("it answers");
    assert_eq!(
        token.status().await.expect("told").owner,
        None,
        "it is given back"
    );
    (answer["result"].clone(), took)
}

#[tokio::test(flavor = "multi_thread")]
async fn the_limit_of_time_ends_a_script_that_runs() {
    let (_lab, hub) = spawn_blocking(Running::lab).await.expect("it starts");
    let (answer, took) = moves_for_a_second(&hub, "move 0 0 320 0 0; wait 60000; home").await;
    assert_eq!(answer["structuredContent"]["error"]["code"], "over", "{answer}");
    let said = text(&answer);
    assert!(
        said.contains("the 1 s for which you may keep it are over, so the script was ended"),
        "{said}"
    );
    assert!(said.contains("the robot has ended it"), "{said}");
    assert!(
        took < Duration::from_secs(20),
        "not after the minute that it waits: {took:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn the_limit_of_time_tells_of_an_arm_that_does_not_answer() {
    let (_broker, hub) = hub().await;
    let mut heard = deaf(&hub).await;
    let (answer, _took) = moves_for_a_second(&hub, "home").await;
    let said = text(&answer);
    assert!(
        said.contains("though the hub was asked to halt it, and 3 times to stop it"),
        "{said}"
    );
    assert!(said.contains("tell a person at once"), "{said}");
    hears(&mut heard, "halt").await;
    hears(&mut heard, "stop").await;
}

/// An agent that takes the task and the token, and hears nothing from then on.
async fn deaf_agent(hub: &str) -> (Client, mpsc::UnboundedReceiver<String>) {
    let client = join(hub, "servo").await;
    let channel = client.channel("/servo").await.expect("it may");
    let token = client.token(TOKEN).await.expect("it may");
    let (mut events, mut offers) = (channel.events(), token.events());
    let (hear, heard) = mpsc::unbounded_channel();
    let me = client.name();
    tokio::spawn(async move {
        let mut held = None;
        loop {
            tokio::select! {
                event = offers.next() => match event {
                    Some(Event::Offer { to, .. }) if to == me => {
                        held = token.accept().await.ok();
                        drop(hear.send("token".to_owned()));
                    }
                    Some(_) => {}
                    None => return drop(held),
                },
                event = events.next() => {
                    let Some(Event::Message(parcel)) = event else { continue };
                    if parcel.name() == "align" {
                        let peer = parcel.sender.clone().expect("a sender");
                        let accepted = Map::new().with("peer", &*peer).with("state", "accepted").with("agent", me.as_str());
                        let answer = channel.message("progress").content(Value::from(accepted)).to([peer.clone()]);
                        let answer = answer.reference(parcel.id.expect("an id"));
                        answer.send().await.expect("sent");
                    }
                    drop(hear.send(parcel.name().to_owned()));
                }
            }
        }
    });
    (client, heard)
}

#[tokio::test(flavor = "multi_thread")]
async fn an_agent_that_does_not_answer_to_cancel_has_its_robot_stopped() {
    let (_broker, hub) = hub().await;
    let mut robot = deaf(&hub).await;
    let (_agent, mut heard) = deaf_agent(&hub).await;
    let place = hub.clone();
    let started = spawn_blocking(move || {
        let environment = [
            ("MOM_HUB", place.as_str()),
            ("MOM_USER", "alice"),
            ("MOM_PASSWORD", "alice"),
        ];
        Running::start("mom", &["servo", "red", "green", "--for", "60s"], &environment)
    });
    let running = started.await.expect("it starts");
    hears(&mut heard, "token").await;
    running.signal("INT");
    for _ in 0..3 {
        hears(&mut heard, "cancel").await;
    }
    hears(&mut robot, "stop").await;
    let ended = spawn_blocking(move || running.wait()).await.expect("it ends");
    assert_eq!(ended.code(), Some(1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_without_a_scope_has_a_limit() {
    let (_lab, hub) = spawn_blocking(Running::lab).await.expect("it starts");
    let alice = join(&hub, "alice").await;
    let token = alice.token(TOKEN).await.expect("she may look");
    let guard = token.grab().await.expect("it is free");
    let place = hub.clone();
    let started = spawn_blocking(move || Assistant::at(&place));
    let mut assistant = started.await.expect("it starts");
    let mut given = guard.give("assistant").await.expect("it is here");
    given.accepted().await.expect("it takes what a person gives");
    let moved = spawn_blocking(move || {
        let granted = assistant.call("request_token", &json!({"reason": "to wave"}));
        assert!(text(&granted).contains("after 120 s or 20 commands"), "{granted}");
        let fast = json!({"script": "jog 0 0 101 0 0 100"});
        assistant.bad("move", &fast, "too-fast");
        for _ in 0..20 {
            assistant.moves("wait 1");
        }
        assistant.bad("move", &json!({"script": "home"}), "not-owner")
    });
    let said = moved.await.expect("it moves");
    assert!(said.contains("what you asked for is over"), "{said}");
    assert_eq!(token.status().await.expect("told").owner, None);
}

/// A token that is lost is not a word of the arm: whether that has ended the script is for the arm to say.
#[tokio::test(flavor = "multi_thread")]
async fn a_lost_token_does_not_say_that_the_arm_stands() {
    let (_broker, hub) = hub().await;
    let mut heard = deaf(&hub).await;
    let alice = join(&hub, "alice").await;
    let token = alice.token(TOKEN).await.expect("she may look");
    let guard = token.grab().await.expect("it is free");
    let place = hub.clone();
    let started = spawn_blocking(move || Assistant::at(&place));
    let mut assistant = started.await.expect("it starts");
    let mut given = guard
        .give("assistant")
        .time(Duration::from_secs(2))
        .await
        .expect("it is here");
    given.accepted().await.expect("it takes what a person gives");
    let moved = spawn_blocking(move || {
        let wish = json!({"reason": "to wave"});
        assistant.call("request_token", &wish);
        assistant.bad("move", &json!({"script": "home"}), "lost")
    });
    let said = moved.await.expect("it answers");
    assert!(
        said.contains("the robot has not said that it has ended the script: tell a person at once"),
        "{said}"
    );
    assert!(said.contains("by its last word"), "{said}");
    hears(&mut heard, "halt").await;
}
