//! `mom stop` and `mom unstop`: the real program, broker and arm.

use std::process::Output;

use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel};
use mom_tests::programs::{self, text};
use mom_tests::raw::{Raw, at, message};
use serde_json::{Value as Json, json};
use tokio::task::spawn_blocking;

use crate::losses::Lab;

const ARM: &str = "/robot/arm";

/// Runs a command as a user.
async fn mom(lab: &Lab, user: &'static str, arguments: &'static [&'static str]) -> Output {
    let hub = format!("bin://{}", lab.broker.local_addr());
    let run = move || {
        let environment = [("MOM_HUB", &*hub), ("MOM_USER", user), ("MOM_PASSWORD", user)];
        programs::run("mom", arguments, &environment)
    };
    spawn_blocking(run).await.expect("it runs")
}

/// The exit code, and what was printed on standard output.
fn told(output: &Output) -> (Option<i32>, String) {
    (output.status.code(), text(&output.stdout))
}

fn join(terms: Map) -> Parcel {
    let join = Parcel::new(Family::Context, "join");
    join.context(at(ARM)).content(terms)
}

/// A device that hears all and says nothing.
async fn mute(lab: &Lab) -> Raw {
    let mut mute = Raw::login(lab.broker.local_addr(), Form::Binary, "bob").await;
    mute.join(&["/robot"]).await;
    let terms = Map::new().with("device", true);
    let joined = mute.ask(join(terms)).await.expect("people may");
    assert_eq!(joined.value().get("device"), Some(&true.into()));
    mute
}

#[tokio::test(flavor = "multi_thread")]
async fn every_device_says_that_it_stands_and_that_it_may_move() {
    let lab = Lab::start().await;
    // The second finds it stopped, and hears so all the same.
    for _ in 0..2 {
        let output = mom(&lab, "alice", &["stop", ARM]).await;
        assert_eq!(told(&output), (Some(0), "/robot/arm: arm stands\n".to_owned()));
    }
    let all = mom(&lab, "bob", &["unstop"]).await;
    assert_eq!(
        told(&all),
        (
            Some(0),
            "/calibrate: no device; sent to 0 members\n/camera/pan: no device; sent to 0 members\n\
             /camera/top: no device; sent to 0 members\n/camera/wrist: no device; sent to 0 members\n\
             /camera/x: no device; sent to 0 members\n/camera/y: no device; sent to 0 members\n\
             /chat: no device; sent to 0 members\n/model/objects: no device; sent to 0 members\n\
             /robot/arm: arm may move\n/servo: no device; sent to 0 members\n"
                .to_owned()
        )
    );
    let session = mom(&lab, "carol", &["stop", "--json", "/robot"]).await;
    let line: Json = serde_json::from_slice(&session.stdout).expect("one line of JSON");
    let arm = json!({"path": ARM, "delivered": 1, "obeyed": ["arm"], "silent": []});
    assert_eq!((session.status.code(), line), (Some(0), arm));
    lab.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_says_nothing_is_named() {
    let lab = Lab::start().await;
    let mut mute = mute(&lab).await;
    let output = mom(&lab, "alice", &["stop", ARM]).await;
    let expected = "/robot/arm: bob said nothing within 1s; arm stands\n";
    assert_eq!(told(&output), (Some(1), expected.to_owned()));
    // Its word is what counts, not that it took the message.
    mute.next_of(Family::Message, "stop").await;
    let word = Map::new().with("stopped", true);
    mute.send_parcel(&message("state", ARM, word)).await;
    // Whoever is a device no more is not waited for.
    mute.ask(join(Map::new())).await.expect("a member");
    let output = mom(&lab, "alice", &["stop", ARM]).await;
    assert_eq!(told(&output), (Some(0), "/robot/arm: arm stands\n".to_owned()));
    lab.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_stopped_is_told() {
    let lab = Lab::start().await;
    // Devices look around, and stop nobody.
    let denied = mom(&lab, "camera", &["stop", ARM]).await;
    assert_eq!(denied.status.code(), Some(1), "{denied:?}");
    assert!(text(&denied.stdout).contains("denied"), "{denied:?}");
    let nothing = mom(&lab, "camera", &["stop"]).await;
    assert_eq!(nothing.status.code(), Some(1), "{nothing:?}");
    let words = "there is nothing here that you may stop";
    assert!(text(&nothing.stderr).contains(words), "{nothing:?}");
    let token = mom(&lab, "alice", &["stop", "/robot/token"]).await;
    assert_eq!(token.status.code(), Some(2), "{token:?}");
    let unknown = mom(&lab, "alice", &["stop", "/robot/leg"]).await;
    assert_eq!(unknown.status.code(), Some(1), "{unknown:?}");
    lab.end().await;
}
