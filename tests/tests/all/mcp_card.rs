//! `mom-mcp` drives a device that it has never heard of, by its card.

use std::time::Duration;

use mom_client::{Card, CardArg, CardVerb, Client, ClientError, Map, Value};
use mom_device::{Call, Device, DeviceError};
use mom_tests::assistant::Assistant;
use mom_tests::lab;
use serde_json::json;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

use crate::mcp::{ROBOT, alice, give, person};

/// A crane of which nothing here has heard: what it can do stands in its card only.
#[derive(Debug, Default)]
struct Crane {
    height: f64,
    told: Vec<f64>,
}

impl Device for Crane {
    const NAME: &str = "the crane";

    fn verbs() -> Vec<CardVerb> {
        let height = CardArg::number("height", "mm").within(0.0..=900.0);
        vec![
            CardVerb::motion("hoist", "Hoists the hook").args([height]),
            CardVerb::motion("up", "Hoists it by so much")
                .relative()
                .args([CardArg::number("way", "mm")]),
            CardVerb::motion("creep", "Goes on at a speed")
                .velocity()
                .args([CardArg::number("speed", "mm/s")]),
        ]
    }

    fn describe(card: Card) -> Card {
        card.measures("height", "mm", "Of the hook")
    }

    fn begin(&mut self, call: &Call) -> Result<(), DeviceError> {
        let number = call.numbers().next().unwrap_or_default();
        match call.name() {
            "hoist" => self.height = number,
            "up" => self.height += number,
            _ => {}
        }
        self.told.push(number);
        Ok(())
    }

    fn is_done(&mut self) -> Result<bool, DeviceError> {
        Ok(true)
    }

    fn halt(&mut self) {}

    fn position(&self) -> Map {
        Map::new().with("height", Value::Double(self.height))
    }
}

/// A crane at work in place of the lab's arm.
pub(crate) struct Working {
    client: Client,
    end: oneshot::Sender<()>,
    obeying: JoinHandle<Result<(), ClientError>>,
}

impl Working {
    /// Comes when its card is there.
    pub(crate) async fn start(hub: &str) -> Working {
        let client = person(hub, "arm").await;
        let (end, ended) = oneshot::channel::<()>();
        let arm = client.clone();
        let obeying = tokio::spawn(async move {
            let until = async { drop(ended.await) };
            mom_device::obey(&arm, ROBOT, Crane::default(), until).await
        });
        while client.card(ROBOT).await.expect("it may look").is_none() {
            tokio::task::yield_now().await;
        }
        Working { client, end, obeying }
    }

    pub(crate) async fn end(self) {
        drop(self.end);
        self.obeying.await.expect("it ends").expect("it obeyed");
        self.client.close().await;
    }
}

/// Whatever is a device is driven by its card: its statements are told, and checked before anything is sent.
#[tokio::test(flavor = "multi_thread")]
async fn a_device_that_nothing_has_heard_of_is_driven_by_its_card() {
    let broker = lab::start().await;
    let hub = format!("bin://{}", broker.local_addr());
    let crane = Working::start(&hub).await;
    let (_alice, _token, guard) = alice(&hub).await;
    let mut assistant = tokio::task::spawn_blocking({
        let hub = hub.clone();
        move || Assistant::at(&hub)
    })
    .await
    .expect("it starts");
    let _given = give(&guard, Some(Duration::from_secs(60)), Some(9)).await;
    tokio::task::spawn_blocking(move || {
        let tools = assistant.request("tools/list", &json!({}));
        let told = tools["tools"][3]["description"].to_string();
        assert!(
            told.contains("hoist height/mm: Hoists the hook; height 0 to 900"),
            "{told}"
        );
        assert!(
            told.contains("up way/mm: Hoists it by so much; relative"),
            "{told}"
        );

        let facts = assistant.good("where", &json!({}));
        assert_eq!(facts["robot"]["state"], json!({"height": 0.0}));
        assert!(
            facts["robot"]["statements"][0].to_string().contains("hoist"),
            "{facts}"
        );

        let said = assistant.bad("move", &json!({"script": "hoist 901"}), "syntax");
        assert!(
            said.contains("height is 901, `hoist` takes 0 to 900 mm"),
            "{said}"
        );
        let said = assistant.bad("move", &json!({"script": "hoit 5"}), "syntax");
        assert!(said.contains("did you mean `hoist`?"), "{said}");
        let facts = assistant.good("move", &json!({"script": "hoist 300; wait 10"}));
        assert_eq!(facts["state"], json!({"height": 300.0}));
        // Nothing that was refused here was a command of the scope.
        assert_eq!(facts["scope"]["commands_left"], 8);
        let facts = assistant.good("move", &json!({"script": "up 20"}));
        assert_eq!(facts["state"], json!({"height": 320.0}));
        let facts = assistant.good("stop", &json!({}));
        assert_eq!(
            (&facts["stands"], &facts["state"]),
            (&json!(true), &json!({"height": 320.0}))
        );
    })
    .await
    .expect("it drives");
    crane.end().await;
    broker.stop().await;
}
