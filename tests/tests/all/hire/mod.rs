//! Hiring an agent: what every agent of the kits does alike (docs/agents.md), by one in each language that only holds the token.

mod holder;

use std::time::{Duration, Instant};

use mom_agent::Hire;
use mom_client::{Channel, Client, Event, Events, Given, Map, Parcel, Token, TokenGuard, Value};
use mom_tests::faulty::{Fault, FaultyNetwork};
use mom_tests::programs::{PATIENCE, Running, project};
use tokio::task::spawn_blocking;
use tokio::time::timeout;

use self::holder::{Agent, Kit};

const TOKEN: &str = "/robot/token";

/// Has a case replayed by the agents of all kits.
macro_rules! alike {
    ($($case:ident)*) => {$(
        mod $case {
            #[tokio::test(flavor = "multi_thread")]
            async fn in_rust() {
                super::all::$case(super::Kit::Rust).await;
            }

            #[tokio::test(flavor = "multi_thread")]
            async fn in_python() {
                super::all::$case(super::Kit::Python).await;
            }

            #[tokio::test(flavor = "multi_thread")]
            async fn in_javascript() {
                super::all::$case(super::Kit::JavaScript).await;
            }
        }
    )*};
}

alike! {
    a_task_is_accepted_worked_at_and_cancelled_by_whose_it_is
    it_takes_the_token_of_its_peer_only
    its_task_ends_with_its_peer_its_token_and_its_program
    what_was_asked_before_it_came_is_no_task
    each_task_has_one_end_in_words
    it_ends_with_what_was_lent
    the_device_that_it_drives_has_ended_its_command_when_the_token_is_back
    a_cancel_while_the_token_is_handed_over_keeps_no_token
    its_task_ends_when_the_connection_of_its_peer_is_lost
    what_its_author_says_wrong_ends_the_task_all_the_same
}

async fn join(hub: &str, user: &str) -> Client {
    let client = Client::builder(hub).user(user).password(user).connect().await;
    client.expect("the lab knows its users")
}

/// A hub, which keeps for who joins what was said in the agent's channel `/servo`.
struct Hub {
    _broker: Running,
    _folder: tempfile::TempDir,
    address: String,
}

async fn hub() -> Hub {
    let folder = tempfile::tempdir().expect("a folder");
    let lab = std::fs::read_to_string(project().join("config/lab.toml")).expect("it is there");
    let place = "path = \"/servo\"\nkind = \"channel\"\n";
    assert!(lab.contains(place));
    let lab = lab.replace(place, &format!("{place}keep = {{ parcels = 10 }}\n"));
    let config = folder.path().join("lab.toml");
    std::fs::write(&config, lab).expect("it is written");
    let users = project().join("config/lab-users.toml");
    std::fs::copy(users, folder.path().join("lab-users.toml")).expect("it is copied");
    let started = spawn_blocking(move || Running::broker(&config));
    let (broker, address) = started.await.expect("it starts");
    Hub {
        _broker: broker,
        _folder: folder,
        address: format!("bin://{address}"),
    }
}

/// A hub with the agent in `/servo`, which the lab's rules know.
async fn hired(kit: Kit) -> (Hub, Agent) {
    let hub = hub().await;
    let agent = Agent::start(kit, &hub.address).await;
    (hub, agent)
}

/// Joins the agent's channel once the agent is there.
async fn meet(client: &Client) -> (Channel, Events) {
    let channel = client.channel("/servo").await.expect("people may");
    let events = channel.events();
    let here = async {
        while !client
            .members("/servo")
            .await
            .expect("it may look")
            .iter()
            .any(|member| member.user == "servo")
        {
            tokio::task::yield_now().await;
        }
    };
    timeout(PATIENCE, here).await.expect("the agent comes");
    (channel, events)
}

async fn ask(channel: &Channel, content: Map) {
    channel
        .send("hold", Value::from(content))
        .await
        .expect("it may ask");
}

async fn cancel(channel: &Channel) {
    channel.message("cancel").no_echo().send().await.expect("sent");
}

/// The next message of this name that was not said before.
async fn said(events: &mut Events, name: &str) -> Parcel {
    let wait = async {
        loop {
            match events.next().await {
                Some(Event::Message(parcel)) if parcel.name() == name && !parcel.is_history() => {
                    return parcel;
                }
                Some(_) => {}
                None => panic!("the channel is gone"),
            }
        }
    };
    let waited = timeout(PATIENCE, wait).await;
    waited.unwrap_or_else(|_| panic!("no {name} has come"))
}

fn word(parcel: &Parcel, key: &str) -> String {
    let value = parcel.value();
    value
        .get(key)
        .and_then(Value::as_str)
        .unwrap_or_default()
        .to_owned()
}

/// How a task ends: its state and the words for it.
async fn ended(events: &mut Events) -> (String, String) {
    loop {
        let progress = said(events, "progress").await;
        let state = word(&progress, "state");
        if !["accepted", "working", "ending"].contains(&&*state) {
            return (state, word(&progress, "text"));
        }
    }
}

/// Grabs the token as soon as it is free, and gives it to the agent for so long; it returns when either of these is dropped.
async fn lend_for(client: &Client, time: Duration) -> (TokenGuard, Given) {
    let token = client.token(TOKEN).await.expect("it may");
    let guard = token.grab().wait(PATIENCE).await.expect("it becomes free");
    let given = guard.give("servo").time(time).await;
    let given = given.expect("the agent is here");
    (guard, given)
}

async fn lend(client: &Client) -> (TokenGuard, Given) {
    lend_for(client, Duration::from_secs(60)).await
}

/// Asks the agent, which accepts that, and lends it the token.
async fn hire(client: &Client, channel: &Channel, events: &mut Events, task: &str) -> (TokenGuard, Given) {
    ask(channel, what(task)).await;
    // The end of the task before, which another peer has heard already, may come first.
    while word(&said(events, "progress").await, "state") != "accepted" {}
    let lent = lend(client).await;
    assert_eq!(word(&said(events, "progress").await, "state"), "working");
    lent
}

async fn is_back((_guard, given): (TokenGuard, Given)) {
    let back = timeout(PATIENCE, given.returned()).await;
    drop(back.expect("the token returns").expect("to whose it is"));
}

fn what(what: &str) -> Map {
    Map::new().with("what", what)
}

/// Each case, by its name.
mod all {
    pub(in crate::hire) use super::cases::*;
    pub(in crate::hire) use super::moments::*;
}

mod cases {
    use super::*;

    pub(in crate::hire) async fn a_task_is_accepted_worked_at_and_cancelled_by_whose_it_is(kit: Kit) {
        let (hub, _agent) = hired(kit).await;
        let (alice, bob) = (join(&hub.address, "alice").await, join(&hub.address, "bob").await);
        let (hers, mut events) = meet(&alice).await;
        let (his, mut seen_by_bob) = meet(&bob).await;
        for wrong in [Value::from(Map::new()), 5.into(), Value::Null] {
            hers.send("hold", wrong).await.expect("she may");
            let refused = said(&mut events, "hold-refused").await;
            assert_eq!(word(&refused, "name"), "bad-content");
            assert_eq!(refused.value().get("code").and_then(Value::as_int), Some(223));
        }
        ask(&hers, what("on")).await;
        let accepted = said(&mut events, "progress").await;
        let facts = ["by", "state", "agent"].map(|key| word(&accepted, key));
        assert_eq!(facts, ["alice", "accepted", "servo"]);
        // It has one task at a time, and only its peer ends it.
        ask(&his, what("off")).await;
        let busy = word(&said(&mut seen_by_bob, "hold-refused").await, "text");
        assert!(busy.starts_with("busy: alice has had it hold on for "), "{busy}");
        cancel(&his).await;
        let refused = word(&said(&mut seen_by_bob, "cancel-refused").await, "text");
        assert_eq!(refused, "the task is alice's; only alice cancels it");
        let lent = lend(&alice).await;
        assert_eq!(
            word(&said(&mut seen_by_bob, "progress").await, "state"),
            "working"
        );
        cancel(&hers).await;
        let last = said(&mut seen_by_bob, "progress").await;
        let facts = ["by", "state", "text"].map(|key| word(&last, key));
        assert_eq!(facts, ["alice", "cancelled", "alice cancelled it"]);
        is_back(lent).await;
        cancel(&hers).await;
        let refused = word(&said(&mut events, "cancel-refused").await, "text");
        assert_eq!(refused, "there is no task to cancel");
    }

    pub(in crate::hire) async fn it_takes_the_token_of_its_peer_only(kit: Kit) {
        let (hub, _agent) = hired(kit).await;
        let (alice, bob) = (join(&hub.address, "alice").await, join(&hub.address, "bob").await);
        let (hers, mut events) = meet(&alice).await;
        ask(&hers, what("on")).await;
        assert_eq!(word(&said(&mut events, "progress").await, "state"), "accepted");
        let (guard, mut strangers) = lend(&bob).await;
        let declined = timeout(PATIENCE, strangers.accepted()).await;
        let declined = declined.expect("it is answered").expect_err("it is not hers");
        assert_eq!(declined.reason, "declined");
        guard.release().await.expect("his");
        let _lent = lend(&alice).await;
        assert_eq!(word(&said(&mut events, "progress").await, "state"), "working");
    }

    pub(in crate::hire) async fn its_task_ends_with_its_peer_its_token_and_its_program(kit: Kit) {
        let (hub, agent) = hired(kit).await;
        let carol = join(&hub.address, "carol").await;
        let (_seen, mut seen) = meet(&carol).await;
        let alice = join(&hub.address, "alice").await;
        for state in ["cancelled", "lost"] {
            let (hers, mut events) = meet(&alice).await;
            let _lent = hire(&alice, &hers, &mut events, "on").await;
            assert_eq!(word(&said(&mut seen, "progress").await, "state"), "working");
            match state {
                "cancelled" => hers.leave().await.expect("she may"),
                // Her level is above that of alice, who defends what she has lent.
                _ => {
                    let token = carol.token(TOKEN).await.expect("she may");
                    let guard = token.grab().await.expect("her level is higher");
                    guard.release().await.expect("hers");
                }
            }
            let (found, text) = ended(&mut seen).await;
            assert_eq!(found, state, "{text}");
            let words = match state {
                "cancelled" => "alice has left",
                _ => "lost /robot/token: carol has a higher level and took it",
            };
            assert_eq!(text, words);
        }
        let (hers, mut events) = meet(&alice).await;
        let _lent = hire(&alice, &hers, &mut events, "on").await;
        let _ends = agent.end();
        assert_eq!(ended(&mut seen).await.1, "the agent's program ends");
    }

    pub(in crate::hire) async fn what_was_asked_before_it_came_is_no_task(kit: Kit) {
        let hub = hub().await;
        let alice = join(&hub.address, "alice").await;
        let hers = alice.channel("/servo").await.expect("she may");
        let receipt = hers.message("hold").content(Value::from(what("on")));
        receipt.send_acknowledged().await.expect("it is kept");
        let _agent = Agent::start(kit, &hub.address).await;
        let (_hers, mut events) = meet(&alice).await;
        // It is idle.
        cancel(&hers).await;
        let refused = word(&said(&mut events, "cancel-refused").await, "text");
        assert_eq!(refused, "there is no task to cancel");
    }

    pub(in crate::hire) async fn each_task_has_one_end_in_words(kit: Kit) {
        let (hub, _agent) = hired(kit).await;
        let alice = join(&hub.address, "alice").await;
        let (hers, mut events) = meet(&alice).await;
        ask(&hers, what("nothing")).await;
        let refused = said(&mut events, "hold-refused").await;
        assert_eq!(word(&refused, "text"), "there is nothing to hold");
        for (task, state, text) in [
            ("once", "done", "I held it once"),
            ("badly", "failed", "my hands are full"),
            ("crashes", "failed", "the agent failed with an internal error"),
            ("once", "done", "I held it once"),
        ] {
            let lent = hire(&alice, &hers, &mut events, task).await;
            let last = said(&mut events, "progress").await;
            let facts = ["by", "state", "text"].map(|key| word(&last, key));
            assert_eq!(facts, ["alice", state, text]);
            let times = last.value().get("times").and_then(Value::as_int);
            assert_eq!(times.is_some(), state == "done", "what the trade says beside it");
            is_back(lent).await;
        }
    }

    pub(in crate::hire) async fn it_ends_with_what_was_lent(kit: Kit) {
        let (hub, _agent) = hired(kit).await;
        let alice = join(&hub.address, "alice").await;
        let (hers, mut events) = meet(&alice).await;
        ask(&hers, what("on")).await;
        assert_eq!(word(&said(&mut events, "progress").await, "state"), "accepted");
        let lent = lend_for(&alice, Duration::from_millis(500)).await;
        let used_up = "lost /robot/token: returned, as the scope is used up: 0.5 s";
        assert_eq!(ended(&mut events).await, ("lost".to_owned(), used_up.to_owned()));
        is_back(lent).await;
        // Who has left the token has lent it to nobody's good, wherever else that one still is.
        let _lent = hire(&alice, &hers, &mut events, "on").await;
        let token: Token = alice.token(TOKEN).await.expect("it is joined");
        token.leave().await.expect("she may");
        let orphaned = "alice, who lent /robot/token, has left";
        assert_eq!(
            ended(&mut events).await,
            ("failed".to_owned(), orphaned.to_owned())
        );
    }

    pub(in crate::hire) async fn the_device_that_it_drives_has_ended_its_command_when_the_token_is_back(
        kit: Kit,
    ) {
        let (hub, _agent) = hired(kit).await;
        let address = hub.address.clone();
        let _arm = spawn_blocking(move || {
            let args = ["--hub", &address];
            Running::start("mom-arm", &args, &[("MOM_PASSWORD", "arm")])
        });
        let alice = join(&hub.address, "alice").await;
        let (hers, mut events) = meet(&alice).await;
        let arm = alice.channel("/robot/arm").await.expect("she may");
        let mut statuses = arm.events();
        let here = async {
            while !matches!(statuses.next().await, Some(Event::Message(state)) if state.name() == "state") {}
        };
        timeout(PATIENCE, here).await.expect("the arm is here");
        let lent = hire(&alice, &hers, &mut events, "the arm").await;
        while word(&said(&mut statuses, "status").await, "state") != "executing" {}
        cancel(&hers).await;
        assert_eq!(ended(&mut events).await.0, "cancelled");
        is_back(lent).await;
        while word(&said(&mut statuses, "status").await, "state") != "error" {}
    }
}

/// More cases.
mod moments {
    use super::*;

    pub(in crate::hire) async fn a_cancel_while_the_token_is_handed_over_keeps_no_token(kit: Kit) {
        let (hub, _agent) = hired(kit).await;
        let alice = join(&hub.address, "alice").await;
        let (hers, mut events) = meet(&alice).await;
        let token = alice.token(TOKEN).await.expect("she may");
        for _ in 0..8 {
            ask(&hers, what("on")).await;
            while word(&said(&mut events, "progress").await, "state") != "accepted" {}
            let guard = token.grab().wait(PATIENCE).await.expect("it becomes free");
            let _given = guard.give("servo").await.expect("the agent is here");
            cancel(&hers).await;
            assert_eq!(ended(&mut events).await.0, "cancelled");
            drop(guard);
            let free = async {
                while token.status().await.expect("told").owner.as_deref() == Some("servo") {
                    tokio::task::yield_now().await;
                }
            };
            timeout(PATIENCE, free).await.expect("it keeps no token");
        }
    }

    pub(in crate::hire) async fn its_task_ends_when_the_connection_of_its_peer_is_lost(kit: Kit) {
        let (hub, _agent) = hired(kit).await;
        let address = hub.address.trim_start_matches("bin://");
        let network = FaultyNetwork::to(address.parse().expect("an address"), |_| Fault::default()).await;
        let alice = Client::builder(format!("bin://{}", network.address));
        let alice = alice
            .user("alice")
            .password("alice")
            .link(Duration::from_secs(60));
        let alice = alice.connect().await.expect("the lab knows her");
        let carol = join(&hub.address, "carol").await;
        let (_seen, mut seen) = meet(&carol).await;
        let (hers, mut events) = meet(&alice).await;
        ask(&hers, what("on")).await;
        assert_eq!(word(&said(&mut events, "progress").await, "state"), "accepted");
        let _lent = lend(&alice).await;
        assert_eq!(word(&said(&mut seen, "progress").await, "state"), "working");
        network.freeze(true);
        network.sever();
        let words = "alice has lost its connection";
        assert_eq!(ended(&mut seen).await, ("cancelled".to_owned(), words.to_owned()));
    }

    pub(in crate::hire) async fn what_its_author_says_wrong_ends_the_task_all_the_same(kit: Kit) {
        let (hub, _agent) = hired(kit).await;
        let alice = join(&hub.address, "alice").await;
        let (hers, mut events) = meet(&alice).await;
        // Rust says nothing that cannot be sent.
        let wrong: &[&str] = if kit == Kit::Rust {
            &["once"]
        } else {
            &["unsayable", "cancels itself"]
        };
        for task in wrong {
            let lent = hire(&alice, &hers, &mut events, task).await;
            let (state, _) = ended(&mut events).await;
            assert!(["done", "failed"].contains(&&*state), "{task}: {state}");
            is_back(lent).await;
        }
    }
}

/// Work that does not end keeps neither the token nor its peer, and no other task begins beside it.
async fn deaf(kit: Kit) {
    let (hub, _agent) = hired(kit).await;
    let alice = join(&hub.address, "alice").await;
    let (hers, mut events) = meet(&alice).await;
    let lent = hire(&alice, &hers, &mut events, "deaf").await;
    let told = Instant::now();
    cancel(&hers).await;
    is_back(lent).await;
    assert!(
        told.elapsed() < Duration::from_secs(4),
        "the token waits for no work"
    );
    ask(&hers, what("on")).await;
    let busy = word(&said(&mut events, "hold-refused").await, "text");
    assert!(
        busy.starts_with("busy: alice has had it hold deaf for "),
        "{busy}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn deaf_work_in_python_keeps_no_token() {
    deaf(Kit::Python).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn deaf_work_in_javascript_keeps_no_token() {
    deaf(Kit::JavaScript).await;
}

/// Who hires an agent and is put out of where the token is hears an end, and why.
#[tokio::test(flavor = "multi_thread")]
async fn who_hires_and_is_put_out_of_the_token_is_told() {
    put_out_of(TOKEN, "lost /robot/token: you may no longer be here").await;
}

/// The same where it is put out of where the agent is.
#[tokio::test(flavor = "multi_thread")]
async fn who_hires_and_is_put_out_of_the_agents_channel_is_told() {
    let words = "carol has put you out of /servo: the agent ends its task as it does when you leave";
    put_out_of("/servo", words).await;
}

async fn put_out_of(path: &str, expected: &str) {
    let (hub, _agent) = hired(Kit::Rust).await;
    let (alice, carol) = (
        join(&hub.address, "alice").await,
        join(&hub.address, "carol").await,
    );
    let bob = join(&hub.address, "bob").await;
    let (_his, mut events) = meet(&bob).await;
    let mut tell = |_: serde_json::Value, _: String| Ok(());
    let hire = Hire {
        channel: "/servo",
        user: Some("servo"),
        absent: "start it",
        verb: "hold",
        task: what("on"),
        words: "hold".to_owned(),
        token: TOKEN,
        wait: Some(PATIENCE),
        time: Duration::from_secs(60),
        commands: None,
        robot: "/robot/arm",
        untouched: "nothing is done".to_owned(),
        line: |_| String::new(),
    };
    let hiring = hire.carry_out(&alice, std::future::pending(), &mut tell);
    let putting_out = async {
        while word(&said(&mut events, "progress").await, "state") != "working" {}
        let second = Some(Duration::from_secs(1));
        carol
            .expel(path, &alice.name(), "", second)
            .await
            .expect("she may");
    };
    let (hired, ()) = tokio::join!(timeout(PATIENCE, hiring), putting_out);
    let failure = hired
        .expect("it ends")
        .expect_err("it came to nothing")
        .to_string();
    assert!(failure.starts_with(expected), "{failure}");
    alice.close().await;
    // The agent has ended it too, and is free for another one.
    let goes_on = |report: &Parcel| matches!(&*word(report, "state"), "working" | "ending");
    while goes_on(&said(&mut events, "progress").await) {}
}
