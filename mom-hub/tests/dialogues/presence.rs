//! Who hears of those who come and go: by name, and by count where they are many (M30).

use mom_hub::{Effect, Settings};
use mom_managers::Registry;
use mom_proto::{Family, Map, Value};

use crate::stage::{MS, Stage, context, lab, of};

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

/// As often as it may: whoever comes and goes all the time is counted, and nobody else.
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

/// A device hears of each change of its token before all commands: one user does not have it hear of nothing else.
#[test]
fn who_grabs_a_devices_token_all_the_time_is_told_to_try_later() {
    for is_device in [true, false] {
        let mut stage = Stage::new(lab(Map::new()));
        stage.enter("alice", 1);
        stage.enter("bob", 1);
        if is_device {
            stage.arrive("arm", 1);
            stage.say("arm", "context join /lab");
            stage.say("arm", "context join /lab/arm device=true");
        }
        let grabs = |stage: &mut Stage, name: &str, verb: &str| {
            let mut refused = 0;
            for _ in 0..150 {
                let heard = of(&stage.say(name, &format!("token {verb} /lab/key")), &[name]);
                refused += usize::from(heard.iter().any(|line| line.contains("try-later")));
                let back = if verb == "grab" { "release" } else { "uninhibit" };
                stage.say(name, &format!("token {back} /lab/key"));
            }
            refused
        };
        assert_eq!(grabs(&mut stage, "alice", "grab"), if is_device { 50 } else { 0 });
        assert_eq!(
            grabs(&mut stage, "bob", "inhibit"),
            if is_device { 50 } else { 0 }
        );
        stage.at(5000);
        assert_eq!(
            grabs(&mut stage, "alice", "grab"),
            if is_device { 50 } else { 0 },
            "and again"
        );
    }
}

/// What counts is that it changes hands, by whatever verb; what changes nothing does not count.
#[test]
fn a_devices_token_that_goes_to_and_fro_is_counted_and_a_refusal_is_not() {
    let mut stage = Stage::new(lab(Map::new()));
    for name in ["alice", "bob", "carol", "arm"] {
        stage.enter(name, 1);
    }
    stage.say("arm", "context join /lab/arm device=true");
    stage.say("alice", "token grab /lab/key");
    let put_off = |heard: &[String]| usize::from(heard.iter().any(|line| line.contains("try-later")));
    let mut refused = 0;
    for _ in 0..200 {
        refused += put_off(&of(&stage.say("carol", "token grab /lab/key"), &["carol"]));
        refused += put_off(&of(&stage.say("alice", "token grab /lab/key"), &["alice"]));
    }
    assert_eq!(refused, 0, "held, and renewed");
    // Nor does who comes and goes use up what he, or another guest, may take.
    stage.say("alice", "token release /lab/key");
    for _ in 0..200 {
        stage.say("carol", "context leave /lab/key");
        stage.say("carol", "context join /lab/key");
    }
    let heard = of(&stage.say("carol", "token grab /lab/key"), &["carol"]);
    assert_eq!(put_off(&heard), 0, "{heard:?}");
    stage.say("carol", "token release /lab/key");
    stage.say("alice", "token grab /lab/key");
    let mut given = 0;
    for (from, to) in [("alice", "bob"), ("bob", "alice")].into_iter().cycle().take(400) {
        stage.say(from, &format!("token give /lab/key to={to}"));
        let heard = of(&stage.say(to, "token accept /lab/key"), &[to]);
        given += usize::from(heard.iter().any(|line| line.starts_with(&format!("{to}< ok"))));
    }
    assert!((150..=200).contains(&given), "{given} of 400");
}
