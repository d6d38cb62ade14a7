//! Who hears of those who come and go: by name, and by count where they are many (M30).

use mom_hub::{Effect, Settings};
use mom_managers::Registry;
use mom_proto::{Family, Value};

use crate::stage::{MS, Stage, context};

fn stage(presence: &str) -> Stage {
    let settings = Settings {
        counts_above: 2,
        counts_every: 1000 * MS,
        ..Settings::default()
    };
    let mut stage = Stage::with(
        vec![context("/lab", "session").with("presence", presence)],
        Registry::builtin(),
        settings,
    );
    for name in ["a", "b", "c", "d", "e", "f"] {
        stage.arrive(name, 1);
    }
    stage
}

/// The events of the last input: joined or left, and whom or how many.
fn told(stage: &Stage) -> Vec<(String, Value)> {
    let events = stage.effects.iter().filter_map(|effect| match effect {
        Effect::Deliver { parcel, .. } if parcel.family == Family::Event => {
            let content = parcel.value();
            let whom = content.get("peer").or(content.get("count")).cloned();
            Some((parcel.name().to_owned(), whom.unwrap_or_default()))
        }
        _ => None,
    });
    events.collect()
}

fn joins(stage: &mut Stage, name: &str) -> Vec<(String, Value)> {
    stage.say(name, "context join /lab");
    told(stage)
}

fn one(name: &str, whom: impl Into<Value>) -> Vec<(String, Value)> {
    vec![(name.to_owned(), whom.into())]
}

#[test]
fn many_are_counted_once_a_second() {
    let mut stage = stage("counts");
    assert_eq!(joins(&mut stage, "a"), one("joined", "a"));
    assert_eq!(
        joins(&mut stage, "b"),
        one("joined", "b"),
        "two are not above two"
    );
    assert_eq!(joins(&mut stage, "c"), one("joined", 3));
    assert_eq!(joins(&mut stage, "d"), [], "within the second");
    assert_eq!(joins(&mut stage, "e"), []);
    stage.at(999);
    assert_eq!(told(&stage), []);
    stage.at(1000);
    assert_eq!(told(&stage), one("joined", 5), "all of them in one");
    assert_eq!(joins(&mut stage, "f"), [], "the next second begins");
    stage.at(1999);
    assert_eq!(told(&stage), []);
    stage.at(2000);
    assert_eq!(told(&stage), one("joined", 6));
    stage.at(3000);
    assert_eq!(told(&stage), [], "nothing has changed");
    stage.say("f", "context leave /lab");
    assert_eq!(told(&stage), one("left", 5), "a second has passed");
    stage.at(3500);
    stage.say("e", "context leave /lab");
    assert_eq!(told(&stage), []);
    stage.at(4000);
    assert_eq!(told(&stage), one("joined", 4));
}

#[test]
fn few_are_told_by_name_whatever_the_time() {
    let mut stage = stage("counts");
    for name in ["a", "b", "c"] {
        joins(&mut stage, name);
    }
    stage.say("c", "context leave /lab");
    assert_eq!(told(&stage), one("left", "c"), "two are left");
}

#[test]
fn all_and_none_are_what_they_say() {
    let mut all = stage("all");
    for name in ["a", "b", "c", "d"] {
        assert_eq!(joins(&mut all, name), one("joined", name));
    }
    let mut none = stage("none");
    assert_eq!(joins(&mut none, "a"), []);
}

/// As often as it may: a user who comes and goes all the time is counted, and nobody else.
#[test]
fn who_comes_and_goes_again_and_again_is_counted_and_nobody_else() {
    let mut stage = stage("all");
    joins(&mut stage, "a");
    let mut named = 0;
    let mut counted = 0;
    for round in 0..2000 {
        stage.at(round);
        stage.say(
            "b",
            if round % 2 == 0 {
                "context join /lab"
            } else {
                "context leave /lab"
            },
        );
        for (_, whom) in told(&stage) {
            match whom {
                Value::Int(_) => counted += 1,
                _ => named += 1,
            }
        }
        if round == 1500 {
            assert_eq!(joins(&mut stage, "c"), one("joined", "c"));
            stage.say("c", "context leave /lab");
            assert_eq!(told(&stage), one("left", "c"));
        }
    }
    assert!(
        (100..=140).contains(&named),
        "100 at once and 20 a second: {named}"
    );
    assert!((1..=2).contains(&counted), "one a second: {counted}");
    stage.at(3000);
    assert_eq!(told(&stage), one("joined", 1), "and what has come of it");
    stage.at(9000);
    assert_eq!(
        joins(&mut stage, "b"),
        one("joined", "b"),
        "after a rest by name again"
    );
}
