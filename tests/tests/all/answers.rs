//! `tests/cases/answers.json`: what a stopped device says of itself, what the hub makes of it, and whether a client takes that for obeyed.

use std::time::Duration;

use mom_client::{Client, DeviceAnswer, Rest, Standing};
use mom_proto::{Family, Map, Value};
use mom_tests::raw::{Raw, message};
use serde_json::Value as Json;

use crate::losses::Lab;
use crate::stops::{ARM, mute};

#[tokio::test(flavor = "multi_thread")]
async fn the_hub_and_the_client_answer_by_the_cases() {
    let lab = Lab::start_with_several().await;
    let mut device = mute(&lab).await;
    both_are_there(&mut device).await;
    let hub = format!("bin://{}", lab.broker.local_addr());
    let alice = Client::builder(hub.as_str()).user("alice").password("alice");
    let alice = alice.connect().await.expect("she may");
    let cases: Vec<Json> = serde_json::from_str(include_str!("../../cases/answers.json")).expect("cases");
    assert!(cases.len() >= 12);
    for case in &cases {
        let name = case["name"].as_str().expect("a name");
        // Such a device cannot come back here; the hub's own tests have it.
        if case["says"] == "lost" {
            continue;
        }
        let stopping = alice.stop(ARM).only(["arm~2"]).within(Duration::from_millis(300));
        let says = async {
            let stop = device.next_of(Family::Message, "stop").await;
            let number = stop
                .extra
                .get("stop")
                .and_then(Value::as_int)
                .expect("its number");
            if let Json::Object(says) = &case["says"] {
                let mut content: Map = says
                    .iter()
                    .map(|(key, said)| (key.clone(), value_of(said)))
                    .collect();
                match case["number"].as_str() {
                    Some("none") => {}
                    Some("never given out") => content.set("stop", number + 1),
                    _ => content.set("stop", number),
                }
                device.send_parcel(&message("state", ARM, content)).await;
            }
        };
        let (report, ()) = tokio::join!(stopping.send(), says);
        let report = report.expect("it is answered");
        let [channel] = &report.channels[..] else {
            panic!("{name}: {report:?}");
        };
        assert_eq!(channel.is_obeyed(), case["obeyed"], "{name}: {channel:?}");
        let expected = answer_of(&case["answer"]);
        assert_eq!(channel.devices, [("arm~2".to_owned(), expected)], "{name}");
    }
    alice.close().await;
    lab.end().await;
}

/// Until the arm of the lab is in its channel as well: one that enters while a stop waits for words is told of it, and heard.
async fn both_are_there(device: &mut Raw) {
    loop {
        let members = device
            .ask_about(Family::Context, "members", ARM)
            .await
            .expect("a list");
        let members = members
            .get("members")
            .and_then(Value::as_list)
            .expect("members")
            .to_vec();
        if members
            .iter()
            .filter(|member| member.get("device").is_some())
            .count()
            == 2
        {
            return;
        }
        device.next_within(Duration::from_millis(100)).await;
    }
}

fn answer_of(answer: &Json) -> DeviceAnswer {
    match answer["word"].as_str() {
        Some("silent") => DeviceAnswer::Silent,
        Some("lost") => DeviceAnswer::Lost,
        _ => DeviceAnswer::Obeys(Standing {
            rest: match answer["rest"].as_str() {
                Some("measured") => Some(Rest::Measured),
                Some("not-measured") => Some(Rest::NotMeasured),
                _ => None,
            },
            moving: answer["moving"] == true,
            unreached: answer["reached"] == false,
            estop: answer["estop"] == true,
        }),
    }
}

fn value_of(said: &Json) -> Value {
    match said {
        Json::Bool(said) => Value::Bool(*said),
        Json::String(said) => said.as_str().into(),
        Json::Number(said) => said.as_i64().expect("whole").into(),
        other => panic!("{other} in the cases"),
    }
}
