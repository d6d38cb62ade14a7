//! Hiring an agent: what every agent of the kit does alike, by one that only holds the token.

use std::time::Duration;

use mom_agent::{Ended, Hired, Trade};
use mom_client::{Channel, Client, Event, Events, Given, Map, Parcel, Token, TokenGuard, Value, WireError};
use mom_drive::{Holding, WorkEnd};
use mom_tests::programs::{PATIENCE, Running, project};
use tokio::sync::oneshot;
use tokio::task::spawn_blocking;
use tokio::time::timeout;

const TOKEN: &str = "/robot/token";

/// Holds the token until it is told to end.
struct Holder;

impl Trade for Holder {
    type Task = String;
    type Tools = ();

    const VERB: &'static str = "hold";

    fn read(&self, content: &Value) -> Result<String, WireError> {
        let what = content.get("what").and_then(Value::as_str);
        what.map(str::to_owned)
            .ok_or_else(|| WireError::new(mom_client::Code::BAD_CONTENT, "say `what`"))
    }

    fn words(task: &String) -> String {
        format!("hold {task}")
    }

    async fn meet(&self, hired: &Hired<String>) -> Result<((), Token), WireError> {
        let token = hired.client.token(TOKEN).await;
        token
            .map(|token| ((), token))
            .map_err(|error| WireError::new(mom_client::Code::TRY_LATER, error.to_string()))
    }

    async fn work(&self, hired: &Hired<String>, (): (), mut holding: Holding) -> Ended {
        hired.tell(hired.report("working")).await;
        let wanted = async { drop(hired.ends().await) };
        let work = std::future::pending::<Result<(), _>>();
        let ended = holding.during(wanted, work).await;
        let ended = match ended {
            WorkEnd::Interrupted => Ended::new("cancelled", hired.ends().await),
            WorkEnd::Lost(lost) => Ended::new("lost", holding.lost_words(&lost)),
            WorkEnd::Ended(ended) => Ended::new("failed", format!("{ended:?}")),
        };
        drop(holding.release().await);
        ended
    }
}

async fn join(hub: &str, user: &str) -> Client {
    let client = Client::builder(hub).user(user).password(user).connect().await;
    client.expect("the lab knows its users")
}

/// A hub with the agent in `/servo`, which the lab's rules know; the agent ends when this is used.
async fn hired() -> (Running, String, oneshot::Sender<()>) {
    let started = spawn_blocking(|| Running::broker(&project().join("config/lab.toml")));
    let (broker, address) = started.await.expect("it starts");
    let hub = format!("bin://{address}");
    let agent = join(&hub, "servo").await;
    let (end, ends) = oneshot::channel();
    tokio::spawn(mom_agent::run(agent, "/servo", Holder, async {
        drop(ends.await);
    }));
    (broker, hub, end)
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

async fn said(events: &mut Events, name: &str) -> Parcel {
    let wait = async {
        loop {
            match events.next().await {
                Some(Event::Message(parcel)) if parcel.name() == name => return parcel,
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

/// Lends the agent the token, which is free soon; it returns when either of these is dropped.
async fn lend(client: &Client) -> (TokenGuard, Given) {
    let token = client.token(TOKEN).await.expect("it may");
    let guard = token.grab().wait(PATIENCE).await.expect("it becomes free");
    let given = guard.give("servo").time(Duration::from_secs(60)).await;
    let given = given.expect("the agent is here");
    (guard, given)
}

/// Asks the agent, which accepts that.
async fn hire(channel: &Channel, events: &mut Events) {
    ask(channel, what("on")).await;
    assert_eq!(word(&said(events, "progress").await, "state"), "accepted");
}

fn what(what: &str) -> Map {
    Map::new().with("what", what)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_task_is_accepted_worked_at_and_cancelled_by_whose_it_is() {
    let (_broker, hub, _end) = hired().await;
    let (alice, bob) = (join(&hub, "alice").await, join(&hub, "bob").await);
    let (hers, mut events) = meet(&alice).await;
    let (his, mut seen_by_bob) = meet(&bob).await;
    ask(&hers, Map::new()).await;
    assert_eq!(
        word(&said(&mut events, "hold-refused").await, "name"),
        "bad-content"
    );
    ask(&hers, what("on")).await;
    let accepted = said(&mut events, "progress").await;
    let facts = ["by", "state", "agent"].map(|key| word(&accepted, key));
    assert_eq!(facts, ["alice", "accepted", "servo"]);
    // It has one task at a time, and only its peer ends it.
    ask(&his, what("off")).await;
    let busy = word(&said(&mut seen_by_bob, "hold-refused").await, "text");
    assert!(busy.starts_with("busy: alice has had it hold on for "), "{busy}");
    his.message("cancel").no_echo().send().await.expect("sent");
    let refused = word(&said(&mut seen_by_bob, "cancel-refused").await, "text");
    assert_eq!(refused, "the task is alice's; only alice cancels it");
    let (_guard, given) = lend(&alice).await;
    assert_eq!(
        word(&said(&mut seen_by_bob, "progress").await, "state"),
        "working"
    );
    hers.message("cancel").no_echo().send().await.expect("sent");
    let last = said(&mut seen_by_bob, "progress").await;
    let facts = ["by", "state", "text"].map(|key| word(&last, key));
    assert_eq!(facts, ["alice", "cancelled", "alice cancelled it"]);
    let back = timeout(PATIENCE, given.returned()).await;
    back.expect("the token returns").expect("to alice");
    hers.message("cancel").no_echo().send().await.expect("sent");
    let refused = word(&said(&mut events, "cancel-refused").await, "text");
    assert_eq!(refused, "there is no task to cancel");
}

#[tokio::test(flavor = "multi_thread")]
async fn it_takes_the_token_of_its_peer_only() {
    let (_broker, hub, _end) = hired().await;
    let (alice, bob) = (join(&hub, "alice").await, join(&hub, "bob").await);
    let (hers, mut events) = meet(&alice).await;
    hire(&hers, &mut events).await;
    let (guard, mut strangers) = lend(&bob).await;
    let declined = timeout(PATIENCE, strangers.accepted()).await;
    let declined = declined.expect("it is answered").expect_err("it is not hers");
    assert_eq!(declined.reason, "declined");
    guard.release().await.expect("his");
    let _lent = lend(&alice).await;
    assert_eq!(word(&said(&mut events, "progress").await, "state"), "working");
}

#[tokio::test(flavor = "multi_thread")]
async fn its_task_ends_with_its_peer_its_token_and_its_program() {
    let (_broker, hub, end) = hired().await;
    let carol = join(&hub, "carol").await;
    let (_seen, mut seen) = meet(&carol).await;
    let alice = join(&hub, "alice").await;
    for state in ["cancelled", "lost"] {
        let (hers, mut events) = meet(&alice).await;
        hire(&hers, &mut events).await;
        let _lent = lend(&alice).await;
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
        let last = said(&mut seen, "progress").await;
        assert_eq!(word(&last, "state"), state, "{}", word(&last, "text"));
    }
    let (hers, mut events) = meet(&alice).await;
    hire(&hers, &mut events).await;
    let _lent = lend(&alice).await;
    assert_eq!(word(&said(&mut seen, "progress").await, "state"), "working");
    end.send(()).expect("it lives");
    let last = said(&mut seen, "progress").await;
    assert_eq!(word(&last, "text"), "the agent's program ends");
}
