//! Recordings of a broker whose tokens outlive it.

use mom_proto::Verb;

use crate::lab::{Lab, PASSWORD, Peer};
use crate::program::Running;
use crate::what_if::{steps, what_if};

async fn come(running: &Running, user: &str) -> Peer {
    let mut peer = Peer::at(&running.address, "bin").await;
    assert_eq!(peer.login(user, PASSWORD).await.name(), "ok");
    assert_eq!(peer.verb(Verb::Join, "/robot").await, "ok");
    peer
}

/// What was durable before the start is in the head, and what became durable later is among the inputs.
#[tokio::test]
async fn what_a_store_keeps_is_replayed_too() {
    let lab = Lab::new("store = { path = \"store\" }\nrecord = { path = \"control.jsonl\" }");
    let first = Running::start(&lab, &[]);
    let mut alice = come(&first, "alice").await;
    assert_eq!(alice.verb(Verb::Grab, "/robot/token").await, "ok");
    first.kill();

    let second = Running::start(&lab, &[]);
    let mut carol = come(&second, "carol").await;
    assert_eq!(
        carol.verb(Verb::Grab, "/robot/token").await,
        "held",
        "it is alice's"
    );
    let mut alice = come(&second, "alice").await;
    assert_eq!(alice.verb(Verb::Grab, "/robot/token").await, "ok");
    assert_eq!(carol.verb(Verb::Grab, "/robot/token").await, "ok", "by her level");
    second.stop();

    let head = &lab.lines("control.jsonl")[0]["head"];
    assert_eq!(head["durable"], true, "{head}");
    assert_eq!(head["records"][0]["path"], "/robot/token", "{head}");
    let steps = steps(&lab);
    let stored = steps.iter().filter(|step| step["input"].get("stored").is_some());
    assert!(stored.count() >= 2, "{steps:#?}");
    let same = what_if(&lab, "lab.toml", &["--rules"]);
    assert_eq!(same.status.code(), Some(0), "{same:?}");
    // The recording of the one that was killed ends as it was cut.
    std::fs::rename(lab.path("control.jsonl.1"), lab.path("control.jsonl")).expect("it was kept");
    let same = what_if(&lab, "lab.toml", &["--rules"]);
    assert_eq!(same.status.code(), Some(0), "{same:?}");
}
