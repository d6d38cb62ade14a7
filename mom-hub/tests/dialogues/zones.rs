//! Zones of which no two that overlap have different owners, also while a grant is being stored (M40).

use mom_hub::Settings;
use mom_managers::Registry;
use mom_proto::{Map, Value};

use crate::stage::{Stage, context};

/// Two zones, one that ends and one that begins there on x.
fn zones(left_to: f64, right_from: f64) -> (Registry, Vec<Map>) {
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
            zone("/zone/left", -300.0, left_to).into(),
            zone("/zone/right", right_from, 300.0).into(),
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
    (registry, contexts)
}

/// A hub with two zones that overlap, and two who may grab them.
fn stage(durable: bool) -> Stage {
    let (registry, contexts) = zones(20.0, -20.0);
    let settings = Settings {
        durable,
        ..Settings::default()
    };
    there(contexts, registry, settings)
}

fn there(contexts: Vec<Map>, registry: Registry, settings: Settings) -> Stage {
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

#[test]
fn who_waits_for_a_zone_gets_it_when_the_one_that_overlaps_it_is_free() {
    for durable in [false, true] {
        let mut stage = stage(durable);
        stage.say("alice", "token grab /zone/left");
        if durable {
            stage.answer(true);
        }
        let waits = stage.say("bob", "token grab /zone/right wait=60000");
        assert!(
            waits.iter().any(|line| line.starts_with("bob< queued")),
            "{waits:?}"
        );
        let mut heard = stage.say("alice", "token release /zone/left");
        if durable {
            heard.extend(stage.answer(true));
        }
        assert!(heard.iter().any(|line| line.starts_with("bob< ok")), "{heard:?}");
    }
}

#[test]
fn a_lent_zone_does_not_come_back_into_anothers() {
    let mut stage = stage(false);
    stage.say("alice", "token grab /zone/left");
    stage.say("alice", "token give /zone/left to=bob for=1000");
    let heard = stage.say("bob", "token accept /zone/left");
    assert!(heard.iter().any(|line| line.starts_with("bob< ok")), "{heard:?}");
    let heard = stage.say("bob", "token grab /zone/right");
    assert!(
        heard.iter().any(|line| line.starts_with("bob< ok")),
        "both are his now: {heard:?}"
    );
    let heard = stage.at(1_001);
    assert!(
        !heard.iter().any(|line| line.contains("owner=alice")),
        "{heard:?}"
    );
    stage.say("bob", "token release /zone/right");
    let heard = stage.say("alice", "token grab /zone/left");
    assert!(
        heard.iter().any(|line| line.starts_with("alice< ok")),
        "{heard:?}"
    );
}

fn gets(heard: &[String], name: &str) -> bool {
    heard.iter().any(|line| line.starts_with(&format!("{name}< ok")))
}

#[test]
fn who_waits_for_a_zone_gets_it_when_the_other_becomes_its_own() {
    let mut stage = stage(false);
    stage.say("alice", "token grab /zone/left");
    stage.say("bob", "token grab /zone/right wait=60000");
    stage.say("alice", "token give /zone/left to=bob for=60000");
    let heard = stage.say("bob", "token accept /zone/left");
    let ok = heard.iter().filter(|line| line.starts_with("bob< ok"));
    assert_eq!(ok.count(), 2, "left, and with it right: {heard:?}");
}

#[test]
fn who_waits_for_a_zone_gets_it_when_the_other_is_deleted() {
    let (registry, mut contexts) = zones(20.0, -20.0);
    contexts.retain(|context| context.get("path") != Some(&"/zone/left".into()));
    let mut stage = there(contexts, registry, Settings::default());
    stage.say("alice", "context create /zone/left kind=token manager=zones");
    stage.say("alice", "token grab /zone/left");
    stage.say("bob", "token grab /zone/right wait=60000");
    let heard = stage.say("alice", "context delete /zone/left");
    assert!(gets(&heard, "bob"), "{heard:?}");
}

#[test]
fn who_waits_for_a_zone_gets_it_when_a_configuration_moves_the_other() {
    let mut stage = stage(false);
    stage.say("alice", "token grab /zone/left");
    stage.say("bob", "token grab /zone/right wait=60000");
    let (registry, contexts) = zones(-30.0, -20.0);
    let heard = stage.configure_with(registry, contexts, Vec::new());
    assert!(gets(&heard, "bob"), "{heard:?}");
}

#[test]
fn who_waits_for_anothers_zone_is_in_nobodys_way() {
    let mut stage = stage(false);
    stage.arrive("carol", 1);
    stage.say("carol", "context join /zone");
    stage.say("carol", "token grab /zone/left");
    stage.say("alice", "token inhibit /zone/right");
    stage.say("bob", "token grab /zone/right wait=60000");
    stage.say("carol", "token grab /zone/right wait=60000");
    let heard = stage.say("alice", "token uninhibit /zone/right");
    assert!(gets(&heard, "carol") && !gets(&heard, "bob"), "{heard:?}");
}
