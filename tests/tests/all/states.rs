//! Commands that are based on a state of the robot (M35), through a real broker, over both forms.

use mom_arm::{ArmOptions, CommandState, Status, peer};
use mom_broker::Broker;
use mom_client::{Client, Event, Events, Parcel, Value, from_value};
use mom_tests::lab;
use mom_tests::programs::PATIENCE;
use tokio::sync::oneshot;
use tokio::time::timeout;

async fn log_in(broker: &Broker, scheme: &str, name: &str) -> Client {
    let builder = Client::builder(format!("{scheme}://{}", broker.local_addr()));
    let connected = builder.user(name).password(name).connect().await;
    connected.expect("a user of the lab")
}

/// The next message of the arm with this name.
async fn next(events: &mut Events, name: &str) -> Parcel {
    let found = timeout(PATIENCE, async {
        loop {
            match events.next().await.expect("the channel stays") {
                Event::Message(parcel) if parcel.name() == name => return parcel,
                _ => {}
            }
        }
    });
    found.await.unwrap_or_else(|_| panic!("no {name} came"))
}

/// How a command ended, and the last state told before that.
async fn end(events: &mut Events) -> (Status, Option<u64>) {
    let mut newest = None;
    let ended = timeout(PATIENCE, async {
        loop {
            let Event::Message(parcel) = events.next().await.expect("the channel stays") else {
                continue;
            };
            match parcel.name() {
                "state" => newest = parcel.id,
                "status" => {
                    let status: Status = from_value(parcel.value()).expect("a status");
                    if matches!(status.state, CommandState::Finished | CommandState::Error) {
                        return status;
                    }
                }
                _ => {}
            }
        }
    });
    (ended.await.expect("the command ends"), newest)
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_meant_for_an_earlier_state_is_refused_by_the_robot() {
    let broker = lab::start().await;
    let (stop, stopped) = oneshot::channel::<()>();
    let arm = log_in(&broker, "bin", "arm").await;
    let running = tokio::spawn(peer::run(arm, ArmOptions::default(), async {
        // Its sender going is a reason to stop too.
        let _ = stopped.await;
    }));
    for (scheme, script) in [("bin", "grip close"), ("tcp", "grip open")] {
        let alice = log_in(&broker, scheme, "alice").await;
        let channel = alice.channel("/robot/arm").await.expect("people may");
        let mut events = channel.events();
        // The arm tells its state to who joins, or when it joins itself.
        let first = next(&mut events, "state").await.id.expect("states have ids");
        let token = alice.token("/robot/token").await.expect("people may");
        let guard = token.grab().await.expect("free");
        let command = |state| channel.message("command").content(script).based_on(state);
        command(first).send().await.expect("the link is up");
        let (done, newest) = end(&mut events).await;
        assert_eq!(done.state, CommandState::Finished, "{done:?}");
        assert!(newest.is_some_and(|newest| newest > first), "{scheme}: it moved");

        command(first).send().await.expect("the link is up");
        let (refused, _) = end(&mut events).await;
        let error = refused.error.expect("it moved since");
        assert_eq!(error.get("name").and_then(Value::as_str), Some("stale-state"));
        let state = error.get("state").and_then(Value::as_int);
        let state = state.and_then(|state| u64::try_from(state).ok());
        assert_eq!(state, newest, "{scheme}: the newest state is named");
        let again = command(state.expect("just now")).send().await;
        again.expect("the link is up");
        assert_eq!(end(&mut events).await.0.state, CommandState::Finished);
        guard.release().await.expect("alice owns it");
        alice.close().await;
    }
    drop(stop);
    let ended = timeout(PATIENCE, running).await.expect("the arm ends in time");
    ended.expect("it did not panic").expect("its channel stays");
    broker.stop().await;
}
