//! The visual-servoing agent (M41) with the real programs: it aligns two blocks with a token that was lent to it, and loses that by
//! cancelling, by its scope, and to others never.

use std::time::{Duration, Instant};

use mom_client::{Client, Event, Events, Map};
use mom_tests::faulty::{Fault, FaultyNetwork};
use mom_tests::programs::{PATIENCE, Running, project, run, text, turn};
use serde_json::Value as Json;
use tokio::task::spawn_blocking;
use tokio::time::timeout;

fn environment<'a>(hub: &'a str, user: &'a str) -> [(&'a str, &'a str); 3] {
    [("MOM_HUB", hub), ("MOM_USER", user), ("MOM_PASSWORD", user)]
}

/// Who owns the robot's token.
async fn owner(client: &Client) -> Option<String> {
    let token = client.token("/robot/token").await.expect("all may join");
    token.status().await.expect("told").owner
}

async fn join(hub: &str, user: &str) -> Client {
    let client = Client::builder(hub).user(user).password(user).connect().await;
    client.expect("the lab knows its users")
}

/// `mom servo` as alice, while it runs.
async fn servo(hub: &str, args: &[&str]) -> Running {
    let hub = hub.to_owned();
    let args: Vec<String> = ["servo", "--json"]
        .iter()
        .chain(args)
        .map(|&arg| arg.to_owned())
        .collect();
    let started = spawn_blocking(move || {
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        Running::start("mom", &args, &environment(&hub, "alice"))
    });
    started.await.expect("it starts")
}

/// The next report with this in it.
async fn report(running: Running, part: &'static str) -> (Running, Json) {
    let heard = spawn_blocking(move || {
        let line = running.line_with(part);
        (running, line)
    });
    let (running, line) = heard.await.expect("it is said");
    let report = serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line}"));
    (running, report)
}

async fn code(running: Running) -> Option<i32> {
    spawn_blocking(move || running.wait())
        .await
        .expect("it ends")
        .code()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_block_is_put_beside_another_and_the_token_returns() {
    let _turn = turn().lock().await;
    let (_lab, hub) = spawn_blocking(Running::lab).await.expect("it starts");
    let bob = join(&hub, "bob").await;
    let running = servo(&hub, &["red", "green", "--commands", "80"]).await;
    let (running, first) = report(running, "\"approaching\"").await;
    assert_eq!(first["by"], "alice", "{first}");
    assert_eq!(owner(&bob).await.as_deref(), Some("servo"));
    // Who asks meanwhile is told for whom it works, and cancels nothing.
    let channel = bob.channel("/servo").await.expect("people may");
    let mut events = channel.events();
    let blue = Map::new().with("first", "blue").with("second", "green");
    channel.send("align", blue).await.expect("sent");
    channel.send("cancel", Map::new()).await.expect("sent");
    let mut refusals = Vec::new();
    let heard = async {
        while refusals.len() < 2 {
            if let Some(Event::Message(parcel)) = events.next().await
                && parcel.name().ends_with("-refused")
            {
                let words = parcel.value();
                let words = words.get("text").and_then(mom_client::Value::as_str);
                refusals.push(words.unwrap_or_default().to_owned());
            }
        }
    };
    timeout(PATIENCE, heard).await.expect("both are refused");
    assert!(
        refusals[0].starts_with("busy: alice has had it put red beside green for "),
        "{refusals:?}"
    );
    assert_eq!(refusals[1], "the task is alice's; only alice cancels it");

    let (running, last) = report(running, "\"done\"").await;
    assert_eq!(code(running).await, Some(0), "{last}");
    assert!(last["mm"].as_f64().expect("told") <= 3.0, "{last}");
    assert_eq!((owner(&bob).await, last["first"].as_str()), (None, Some("table")));
    // By the simulation's own word: 60 mm from green along the face that is turned by 20 degrees.
    let mut states = bob.channel("/robot/arm").await.expect("people may").events();
    let blocks = async {
        loop {
            if let Some(Event::Message(parcel)) = states.next().await
                && parcel.name() == "state"
            {
                let state: Json = mom_client::from_value(parcel.value()).expect("a map");
                break state["blocks"].clone();
            }
        }
    };
    let blocks = timeout(PATIENCE, blocks).await.expect("a state");
    let of = |key: &str| blocks[0][key].as_f64().expect("a number");
    let (sin, cos) = 20.0_f64.to_radians().sin_cos();
    let off = (of("x") - 60.0 * cos).hypot(of("y") - 150.0 - 60.0 * sin);
    assert!(off < 4.0 && (of("z") - 20.0).abs() < 1.0, "{off}: {blocks}");
}

/// How many commands of the servo the hub has received after the task was cancelled, as who listened to both has heard it.
async fn sent_after_cancel(mut servo: Events, mut arm: Events) -> usize {
    let (mut cancelled, mut is_over) = (None, false);
    let hears = async {
        while !is_over {
            if let Some(Event::Message(parcel)) = servo.next().await {
                let state = parcel.value();
                let state = state.get("state").and_then(mom_client::Value::as_str);
                is_over = state == Some("cancelled");
                if parcel.name() == "cancel" {
                    cancelled = parcel.received;
                }
            }
        }
    };
    timeout(PATIENCE, hears).await.expect("it is cancelled");
    let cancelled = cancelled.expect("the hub says when");
    let mut late = 0;
    while let Some(event) = arm.try_next() {
        if let Event::Message(parcel) = event
            && parcel.name() == "command"
            && parcel.received > Some(cancelled)
        {
            late += 1;
        }
    }
    late
}

#[tokio::test(flavor = "multi_thread")]
async fn ctrl_c_takes_the_token_back_and_nonsense_is_refused() {
    let (_lab, hub) = spawn_blocking(Running::lab).await.expect("it starts");
    let bob = join(&hub, "bob").await;
    let running = servo(&hub, &["red", "green"]).await;
    let (running, _) = report(running, "\"approaching\"").await;
    running.signal("INT");
    let (running, last) = report(running, "\"cancelled\"").await;
    let words = last["text"].as_str().expect("words");
    assert!(
        words.starts_with("alice cancelled it; red stands on the table near -1"),
        "{words}"
    );
    assert_eq!(code(running).await, Some(1));
    assert_eq!(owner(&bob).await, None);

    // Each of these is refused, and leaves the token free.
    let asked = hub.clone();
    let said = spawn_blocking(move || {
        [
            &["red", "red"][..],
            &["rde", "green"],
            &["cyan", "green"],
            &["red", "green", "--gap", "300"],
        ]
        .map(|args| {
            let output = run("mom", &[&["servo"], args].concat(), &environment(&asked, "alice"));
            (output.status.code(), text(&output.stderr))
        })
    });
    let said = said.await.expect("they end");
    for ((code, words), expected) in said.iter().zip([
        "red cannot stand beside itself",
        "no block is called \"rde\"; did you mean red?",
        "cyan is not seen; there are red, ",
        "the gap is 300 mm; it must be 5 to 200 mm",
    ]) {
        assert!(*code == Some(1) && words.contains(expected), "{code:?} {words}");
    }
    assert_eq!(owner(&bob).await, None);
}

/// While it carries a block there are always a newer image and a command to send: who cancels is heard all the same.
#[tokio::test(flavor = "multi_thread")]
async fn a_cancel_is_heard_while_images_and_commands_are_ready() {
    let _turn = turn().lock().await;
    let (_lab, hub) = spawn_blocking(Running::lab).await.expect("it starts");
    let bob = join(&hub, "bob").await;
    let servo_says = bob.channel("/servo").await.expect("people may").events();
    let arm_hears = bob.channel("/robot/arm").await.expect("people may").events();
    let running = servo(&hub, &["red", "green"]).await;
    let (running, _) = report(running, "\"carrying\"").await;
    running.signal("INT");
    let (running, last) = report(running, "\"cancelled\"").await;
    assert!(last["text"].to_string().contains("red is in the jaws"), "{last}");
    let late = sent_after_cancel(servo_says, arm_hears).await;
    // One was on its way to the hub.
    assert!(late <= 1, "it has driven on by {late} commands");
    assert_eq!(code(running).await, Some(1));
    assert_eq!(owner(&bob).await, None);
}

/// A hub with the arm, two cameras and, by the address that it is given of the hub, the agent; all have come.
async fn parts(hub: &str, agents: &str) -> (Running, [Running; 2], Running) {
    let (place, agents) = (hub.to_owned(), agents.to_owned());
    let devices = spawn_blocking(move || {
        let start = |name: &str, hub: &str, user: &str, more: &[&str]| {
            let args = [&["--hub", hub], more].concat();
            Running::start(name, &args, &[("MOM_PASSWORD", user)])
        };
        let cameras = ["x", "top"].map(|view| start("mom-camera", &place, "camera", &["--view", view]));
        (
            start("mom-arm", &place, "arm", &[]),
            cameras,
            start("mom-servo", &agents, "servo", &[]),
        )
    });
    let started = devices.await.expect("they start");
    let bob = join(hub, "bob").await;
    let all_there = async {
        for (place, user) in [
            ("/robot/arm", "arm"),
            ("/camera/x", "camera"),
            ("/camera/top", "camera"),
            ("/servo", "servo"),
        ] {
            let channel = bob.channel(place).await.expect("people may");
            let mut events = channel.events();
            loop {
                let members = bob.members(place).await.expect("told");
                if members.iter().any(|member| member.user == user) {
                    break;
                }
                // A peer comes, or goes.
                let _news = events.next().await;
            }
        }
    };
    timeout(PATIENCE, all_there).await.expect("all come");
    started
}

/// The arm's next state that is so.
async fn arm_is(events: &mut Events, moving: bool) -> Json {
    let heard = async {
        loop {
            if let Some(Event::Message(parcel)) = events.next().await
                && parcel.name() == "state"
            {
                let state: Json = mom_client::from_value(parcel.value()).expect("a map");
                if state["moving"] == moving {
                    break state;
                }
            }
        }
    };
    timeout(PATIENCE, heard).await.expect("a state")
}

#[tokio::test(flavor = "multi_thread")]
async fn an_agent_that_hangs_loses_the_token_by_its_scope() {
    let (broker, address) = spawn_blocking(|| Running::broker(&project().join("config/lab.toml")))
        .await
        .expect("it starts");
    let hub = format!("bin://{address}");
    let (_arm, _cameras, agent) = parts(&hub, &hub).await;
    let bob = join(&hub, "bob").await;
    let running = servo(&hub, &["red", "green", "--for", "6s"]).await;
    let (running, _) = report(running, "\"working\"").await;
    agent.signal("STOP");
    assert_eq!(code(running).await, Some(1));
    assert_eq!(owner(&bob).await, None, "it returned, and was released");
    agent.signal("CONT");
    drop(broker);
}

/// Neither end hears why nothing comes any more: the arm rests, the hub takes the token back when it has kept the agent's place for its
/// time (30 s), and the agent moves nothing when all passes again.
#[tokio::test(flavor = "multi_thread")]
async fn an_agent_whose_link_stands_still_loses_the_token_and_the_arm_rests() {
    let (broker, address) = spawn_blocking(|| Running::broker(&project().join("config/lab.toml")))
        .await
        .expect("it starts");
    let hub = format!("bin://{address}");
    let network = FaultyNetwork::to(address.parse().expect("an address"), |_| Fault::default()).await;
    let (_arm, _cameras, _agent) = parts(&hub, &format!("bin://{}", network.address)).await;
    let bob = join(&hub, "bob").await;
    let mut states = bob.channel("/robot/arm").await.expect("people may").events();
    let running = servo(&hub, &["red", "green"]).await;
    let (running, _) = report(running, "\"working\"").await;
    arm_is(&mut states, true).await;
    network.freeze(true);
    let frozen = Instant::now();
    let rests = arm_is(&mut states, false).await;
    // A command lasts a second at most, whatever the hub knows by then.
    let took = frozen.elapsed();
    assert!(took < Duration::from_secs(10), "{took:?}");
    assert_eq!(code(running).await, Some(1));
    assert_eq!(owner(&bob).await, None, "it returned, and was released");
    // What it had sent meanwhile is worth nothing, and it comes back without a task.
    network.freeze(false);
    let mut news = bob.channel("/servo").await.expect("people may").events();
    let back = async {
        loop {
            let members = bob.members("/servo").await.expect("told");
            if members.iter().any(|member| member.user == "servo") {
                break;
            }
            let _news = news.next().await;
        }
    };
    timeout(PATIENCE, back).await.expect("it comes back");
    let moved = std::iter::from_fn(|| states.try_next()).any(|event| match event {
        Event::Message(parcel) if parcel.name() == "state" => {
            let state: Json = mom_client::from_value(parcel.value()).expect("a map");
            state["pose"] != rests["pose"]
        }
        _ => false,
    });
    assert!(!moved, "no command is obeyed after the token is gone");
    drop(broker);
}

/// The token is back at once; that the arm stands is said when the arm has said so, and else that it has not.
#[tokio::test(flavor = "multi_thread")]
async fn ctrl_c_beside_a_frozen_arm_says_that_the_arm_has_not_answered() {
    let (broker, address) = spawn_blocking(|| Running::broker(&project().join("config/lab.toml")))
        .await
        .expect("it starts");
    let hub = format!("bin://{address}");
    let (arm, _cameras, _agent) = parts(&hub, &hub).await;
    let bob = join(&hub, "bob").await;
    let mut states = bob.channel("/robot/arm").await.expect("people may").events();
    let running = servo(&hub, &["red", "green"]).await;
    let (running, _) = report(running, "\"working\"").await;
    arm_is(&mut states, true).await;
    arm.signal("STOP");
    running.signal("INT");
    let (running, ending) = report(running, "\"ending\"").await;
    let words = ending["text"].as_str().expect("words").to_owned();
    assert!(words.starts_with("alice cancelled it; "), "{words}");
    let (running, last) = report(running, "\"cancelled\"").await;
    let said = last["text"].as_str().expect("words");
    assert!(
        said.starts_with(&words) && said.contains("/robot/arm has not said that it has ended its command"),
        "{said}"
    );
    assert_eq!(code(running).await, Some(1));
    assert_eq!(owner(&bob).await, None);
    arm.signal("CONT");
    drop(broker);
}
