//! A configuration that guards a channel from now on: what runs there by nobody's leave ends, and the next owner drives alone.

use mom_client::{Client, Event, Events, Value};
use mom_tests::programs::{PATIENCE, Running};
use mom_tests::service::Home;
use tokio::task::spawn_blocking;
use tokio::time::timeout;

const ARM: &str = "/robot/arm";
const TOKEN: &str = "/robot/token";
/// The arm's guard in the lab's configuration.
const GUARD: &str = "guard = { token = \"/robot/token\", names = [\"command\"] }\n";

async fn join(hub: &str, user: &str) -> Client {
    let client = Client::builder(hub).user(user).password(user);
    client.connect().await.expect("the lab knows its users")
}

/// The states of the commands of this user, in order, until one of these comes.
async fn statuses(events: &mut Events, user: &str, until: &str) -> Vec<String> {
    let mut told = Vec::new();
    let wanted = async {
        while told.last().is_none_or(|last| last != until) {
            let event = events.next().await.expect("the client lives");
            let Event::Message(parcel) = event else { continue };
            let content = parcel.value();
            let word = |key: &str| content.get(key).and_then(Value::as_str).map(str::to_owned);
            if parcel.name() == "status" && word("peer").is_some_and(|peer| peer.starts_with(user)) {
                let error = content.get("error").and_then(|error| error.get("name")?.as_str());
                told.push(error.map_or_else(|| word("state").expect("a state"), str::to_owned));
            }
        }
    };
    let in_time = timeout(PATIENCE, wanted).await;
    assert!(in_time.is_ok(), "`{until}` does not come after {told:?}");
    told
}

#[tokio::test(flavor = "multi_thread")]
async fn a_guard_that_a_reload_adds_ends_what_runs_without_a_fence() {
    let home = Home::new("");
    let guarded = home.config();
    let open = guarded.replacen(&format!("kind = \"channel\"\n{GUARD}"), "kind = \"channel\"\n", 1);
    assert_ne!(guarded, open, "the lab's arm is guarded");
    home.write_config(&open);
    let service = home.start().await;
    let hub = format!("bin://{}", service.address());
    let (alice, bob) = (join(&hub, "alice").await, join(&hub, "bob").await);
    let hers = alice.channel(ARM).await.expect("she may join");
    let his = bob.channel(ARM).await.expect("he may join");
    let (mut her_events, mut his_events) = (hers.events(), his.events());
    assert_eq!(hers.gate().guard(), None);
    let place = hub.clone();
    let start = move || Running::start("mom-arm", &["--hub", &place], &[("MOM_PASSWORD", "arm")]);
    let _arm = spawn_blocking(start).await.expect("it starts");
    let stands = async {
        while !matches!(her_events.next().await, Some(Event::Message(parcel)) if parcel.name() == "state") {}
    };
    timeout(PATIENCE, stands).await.expect("the arm comes");
    let script = "move 200 0 300 0 0; move -200 0 300 0 0; move 200 0 300 0 0";
    hers.send("command", script).await.expect("it is not guarded");
    let begun = statuses(&mut his_events, "alice", "executing").await;
    assert_eq!(begun, ["waiting", "executing"]);

    home.write_config(&guarded);
    service.signal("HUP");
    let ended = statuses(&mut his_events, "alice", "halted").await;
    assert!(ended.len() <= 2, "at once: {ended:?}");
    let guard = his.gate().guard().expect("who is there has learned the guard");
    assert_eq!((guard.token.as_str(), guard.owner), (TOKEN, None));
    let refused = hers.message("command").content("home").send_acknowledged().await;
    assert!(refused.is_err(), "it is guarded now: {refused:?}");
    let token = bob.token(TOKEN).await.expect("he may join");
    let _held = token.grab().await.expect("it is free");
    his.send("command", "move 0 0 250 0 0").await.expect("he owns it");
    let all = statuses(&mut his_events, "bob", "finished").await;
    assert_eq!(all, ["waiting", "executing", "finished"]);
}
