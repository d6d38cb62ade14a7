//! What a member asks to be spared of, at join and after.

use mom_hub::{Effect, Route};
use mom_proto::{Map, Thinning, Value};

use crate::stage::{Stage, lab, user};

fn stage() -> Stage {
    let mut stage = Stage::new(lab(Map::new()));
    for name in ["alice", "bob"] {
        stage.enter(name, 1);
    }
    stage
}

fn thinning(newest: bool, rate: &str) -> Thinning {
    Thinning {
        newest,
        rate: (!rate.is_empty()).then(|| rate.parse().expect("a rate")),
    }
}

/// What bob's route to the arm says, if the last input gave one, and whether it came before all else.
fn routed(stage: &Stage) -> Option<(Thinning, bool)> {
    let bob = stage.peer("bob");
    let route = |effect: &Effect| match effect {
        Effect::Route(route) if route.path.as_str() == "/lab/arm" => Some((**route).clone()),
        _ => None,
    };
    let place = stage.effects.iter().position(|effect| route(effect).is_some())?;
    let found: Route = route(&stage.effects[place]).expect("it was found");
    Some((found.member(bob).expect("a member").thinning, place == 0))
}

/// What a reply, or a list in it, says of the one who asks.
fn told(stage: &Stage) -> (Option<bool>, Option<String>) {
    let reply = stage.effects.iter().find_map(|effect| match effect {
        Effect::Reply { parcel, .. } => Some(parcel.value()),
        _ => None,
    });
    let reply = reply.expect("every request is answered");
    let listed = reply.get("members").and_then(Value::as_list).map(|members| {
        let bob = |member: &&Value| member.get("peer").and_then(Value::as_str) == Some("bob");
        members.iter().find(bob).expect("bob is a member").clone()
    });
    let of = listed.unwrap_or(reply);
    (
        of.get("newest").and_then(Value::as_bool),
        of.get("rate").and_then(Value::as_str).map(str::to_owned),
    )
}

#[test]
fn joining_again_changes_what_one_is_spared_of() {
    let mut stage = stage();
    for (line, route) in [
        ("", None),
        (" rate=5/s", Some(thinning(false, "5/s"))),
        ("", None),
        (" rate=5", None),
        (" newest=true", Some(thinning(true, ""))),
        (" newest=true rate=6/min", Some(thinning(true, "6/min"))),
        (" newest=false", Some(thinning(false, ""))),
    ] {
        stage.say("bob", &format!("context join /lab/arm{line}"));
        assert_eq!(routed(&stage), route.map(|thinning| (thinning, true)), "{line:?}");
    }
}

#[test]
fn it_is_told_where_members_are_shown() {
    let mut stage = stage();
    stage.say("bob", "context join /lab/arm newest=true rate=5");
    let expected = (Some(true), Some("5/s".to_owned()));
    assert_eq!(told(&stage), expected);
    stage.say("bob", "context join /lab/arm");
    assert_eq!(told(&stage), expected, "it stays as it was");
    stage.say("alice", "context members /lab/arm");
    assert_eq!(told(&stage), expected);
    stage.say("bob", "context info /lab/arm");
    assert_eq!(told(&stage), expected);
    stage.say("alice", "context info /lab/arm");
    assert_eq!(told(&stage), (None, None), "nothing of others");
}

#[test]
fn it_ends_with_the_membership_and_outlives_all_else() {
    let mut stage = stage();
    stage.say("bob", "context join /lab/arm rate=5");
    let bob = stage.peer("bob");
    stage.login(bob, user("bob", 3));
    assert_eq!(
        routed(&stage),
        Some((thinning(false, "5/s"), true)),
        "a repeated login"
    );
    stage.configure(lab(Map::new()), Vec::new());
    assert_eq!(
        routed(&stage),
        Some((thinning(false, "5/s"), true)),
        "a new configuration"
    );
    stage.say("bob", "token grab /lab/key");
    assert_eq!(
        routed(&stage),
        Some((thinning(false, "5/s"), true)),
        "another owner"
    );
    stage.say("bob", "context leave /lab/arm");
    stage.say("bob", "context join /lab/arm");
    assert_eq!(routed(&stage), Some((thinning(false, ""), false)));
    stage.say("bob", "context leave /lab/arm");
    stage.say("bob", "context join /lab/arm newest=true");
    assert_eq!(
        routed(&stage),
        Some((thinning(true, ""), false)),
        "told of the join before it hears"
    );
}

#[test]
fn what_makes_no_sense_is_refused_and_changes_nothing() {
    let mut stage = stage();
    stage.say("bob", "context join /lab/arm rate=5");
    for (line, code) in [
        ("/lab/arm rate=0", "bad-content"),
        ("/lab/arm rate=5/h", "bad-content"),
        ("/lab/arm newest=5", "bad-content"),
        ("/lab/arm newst=true", "bad-content"),
        ("/lab rate=5", "wrong-kind"),
        ("/lab/key newest=true", "wrong-kind"),
    ] {
        let heard = stage.say("bob", &format!("context join {line}"));
        assert_eq!(heard, [format!("bob< {code}")], "{line}");
    }
    assert_eq!(stage.say("bob", "context join /lab newest=false"), ["bob< ok"]);
    stage.say("bob", "context info /lab/arm");
    assert_eq!(told(&stage), (None, Some("5/s".to_owned())));
}
