//! `mom top`: who is connected and who owns what, from a real broker, for scripts and for who may not ask.

use std::process::Output;

use mom_broker::Broker;
use mom_client::{Client, TokenGuard};
use mom_proto::Map;
use mom_tests::lab;
use mom_tests::programs::{program, text};
use tokio::process::Command;
use tokio::task::spawn_blocking;

async fn mom_top(hub: &str, user: &str, args: &[&str]) -> Output {
    let built = spawn_blocking(|| program("mom")).await.expect("it is built");
    let mut command = Command::new(&built);
    command.arg("top").args(args).kill_on_drop(true);
    command
        .env("MOM_HUB", hub)
        .env("MOM_USER", user)
        .env("MOM_PASSWORD", user);
    command.output().await.expect("it runs")
}

async fn owner(broker: &Broker) -> (Client, TokenGuard) {
    let bob = Client::builder(format!("ws://{}", broker.local_addr()));
    let bob = bob.user("bob").password("bob").connect().await;
    let bob = bob.expect("a user of the lab");
    let token = bob.token("/robot/token").await.expect("people may");
    let guard = token.grab().await.expect("it is free");
    (bob, guard)
}

#[tokio::test(flavor = "multi_thread")]
async fn once_for_people_and_for_scripts() {
    let broker = lab::start().await;
    let hub = format!("tcp://{}", broker.local_addr());
    let (client, _guard) = owner(&broker).await;
    let shown = mom_top(&hub, "alice", &["--once"]).await;
    let shown = text(&shown.stdout);
    let row = |name: &str| -> Vec<&str> {
        let row = shown.lines().find(|line| line.starts_with(name));
        row.unwrap_or_else(|| panic!("{name} in {shown}"))
            .split_whitespace()
            .collect()
    };
    assert_eq!(
        row("bob")[..5],
        ["bob", "bob", "websocket", "binary", "127.0.0.1"],
        "{shown}"
    );
    assert_eq!(row("bob").last(), Some(&"/robot/token"), "{shown}");
    assert_eq!(row("alice")[2..4], ["tcp", "xml"], "{shown}");
    assert!(
        shown.contains("2 connections   hub keeps ") && shown.contains(&hub),
        "{shown}"
    );

    let shown = mom_top(&hub, "alice", &["--once", "--json"]).await;
    let json: serde_json::Value = serde_json::from_slice(&shown.stdout).expect("one object");
    assert_eq!(json["connections"], 2, "{json}");
    let bob = &json["peers"][0];
    assert_eq!(
        (&bob["door"], &bob["tokens"][0]),
        (&"websocket".into(), &"/robot/token".into()),
        "{json}"
    );
    assert_eq!(json["stopped"], serde_json::json!([]), "{json}");
    let stop = client.stop("/robot/arm").reason("smoke").send().await;
    let stop = stop.expect("anybody may").channels[0].number;
    let shown = mom_top(&hub, "alice", &["--once"]).await;
    let shown = text(&shown.stdout);
    assert!(
        shown.contains("\n/robot/arm: stopped by bob (smoke)\n"),
        "{shown}"
    );
    let channel = mom_top(&hub, "alice", &["--once", "--json", "/robot/arm"]).await;
    let json: serde_json::Value = serde_json::from_slice(&channel.stdout).expect("one object");
    assert_eq!(json["stopped"][0]["number"], stop, "{json}");
    let elsewhere = mom_top(&hub, "alice", &["--once", "--json", "/camera"]).await;
    let json: serde_json::Value = serde_json::from_slice(&elsewhere.stdout).expect("one object");
    assert_eq!(json["peers"][0]["tokens"], serde_json::json!([]), "{json}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_shown_is_told() {
    let broker = lab::start_with(|config| {
        let secret = Map::new().with("kind", "roles").with(
            "rules",
            vec![
                Map::new()
                    .with("deny", lab::words(&["stats"]))
                    .with("users", lab::words(&["bob"]))
                    .into(),
                Map::new().with("allow", lab::words(&["*"])).into(),
            ],
        );
        config.root = secret.into();
    })
    .await;
    let hub = format!("bin://{}", broker.local_addr());
    let refused = mom_top(&hub, "bob", &["--once"]).await;
    assert_eq!(refused.status.code(), Some(1));
    let said = text(&refused.stderr);
    assert!(
        said.contains("refused: ask for the statistics of / and its peers"),
        "{said}"
    );
    let piped = mom_top(&hub, "alice", &[]).await;
    let said = text(&piped.stderr);
    assert_eq!(piped.status.code(), Some(2), "{said}");
    assert!(said.contains("no terminal") && said.contains("--once"), "{said}");
}
