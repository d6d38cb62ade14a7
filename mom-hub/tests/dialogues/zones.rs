//! Zones of which no two that overlap have different owners, also while a grant is being stored (M40).

use mom_hub::Settings;
use mom_managers::Registry;
use mom_proto::{Map, Value};

use crate::stage::{Stage, context};

/// A hub with two zones that overlap, and two who may grab them.
fn stage(durable: bool) -> Stage {
    let zone = |token: &str, from: f64, to: f64| {
        let corner = |x: f64, rest: f64| Value::from([x, rest, rest].map(Value::Double).to_vec());
        Map::new()
            .with("token", token)
            .with("from", corner(from, 0.0))
            .with("to", corner(to, 1.0))
    };
    let zones = Map::new().with("kind", "zones").with(
        "zones",
        vec![
            zone("/zone/left", -300.0, 20.0).into(),
            zone("/zone/right", -20.0, 300.0).into(),
        ],
    );
    let mut registry = Registry::builtin();
    registry.define("boxes", zones.into());
    let chain = Map::new()
        .with("kind", "chain")
        .with("of", vec!["first-come".into(), "boxes".into()]);
    registry.define("zones", chain.into());
    let contexts = vec![
        context("/zone", "session"),
        context("/zone/left", "token").with("manager", "zones"),
        context("/zone/right", "token").with("manager", "zones"),
    ];
    let settings = Settings {
        durable,
        ..Settings::default()
    };
    let mut stage = Stage::with(contexts, registry, settings);
    for name in ["alice", "bob"] {
        stage.arrive(name, 1);
        stage.say(name, "context join /zone");
    }
    stage
}

#[test]
fn who_holds_a_zone_keeps_others_out_of_those_that_overlap_it() {
    let mut stage = stage(false);
    stage.say("alice", "token grab /zone/left");
    assert_eq!(
        stage.say("bob", "token grab /zone/right"),
        ["bob< held rule=boxes"]
    );
    let heard = stage.say("alice", "token grab /zone/right");
    assert!(
        heard.iter().any(|line| line.starts_with("alice< ok")),
        "her own: {heard:?}"
    );
    for zone in ["left", "right"] {
        stage.say("alice", &format!("token release /zone/{zone}"));
    }
    let heard = stage.say("bob", "token grab /zone/right");
    assert!(heard.iter().any(|line| line.starts_with("bob< ok")), "{heard:?}");
}

#[test]
fn a_grant_that_is_being_stored_counts() {
    let mut stage = stage(true);
    stage.say("alice", "token grab /zone/left");
    assert_eq!(
        stage.say("bob", "token grab /zone/right"),
        ["bob< held rule=boxes"]
    );
    let heard = stage.answer(true);
    assert!(
        heard.iter().any(|line| line.starts_with("alice< ok")),
        "{heard:?}"
    );
}
