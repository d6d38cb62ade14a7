//! Stops have numbers: the order of causes counts, not that of networks, and nothing that a hub or a device has heard of is
//! forgotten (M43).

use mom_hub::{Effect, Latch, Settings, Stop, StopRecord};
use mom_managers::Registry;
use mom_proto::{Fence, Map, Path, Time, Value};

use crate::sessions::{answers, managed};
use crate::stage::{EPOCH, Stage, context, lab, level_or_lease, of};

/// A lab in which an arm is a device, and alice and bob are there.
pub(crate) fn stage() -> Stage {
    at(Stage::new(lab(level_or_lease(60_000, "lazy"))))
}

/// The same where stops are kept.
pub(crate) fn keeping() -> Stage {
    let settings = Settings {
        keeps_stops: true,
        ..Settings::default()
    };
    at(Stage::with(
        lab(level_or_lease(60_000, "lazy")),
        Registry::builtin(),
        settings,
    ))
}

pub(crate) fn at(mut stage: Stage) -> Stage {
    for name in ["alice", "bob", "arm"] {
        stage.enter(name, 1);
    }
    stage.say("arm", "context join /lab/arm device=true");
    stage
}

/// What the last reply of a peer tells of stops.
pub(crate) fn told(stage: &Stage) -> Map {
    let reply = stage.effects.iter().rev().find_map(|effect| match effect {
        Effect::Reply { parcel, .. } => Some(parcel.value()),
        _ => None,
    });
    let reply = reply.expect("a reply");
    reply.as_map().cloned().unwrap_or_default()
}

fn number(map: &Map, key: &str) -> i64 {
    map.get(key).and_then(Value::as_int).expect("an int") & ((1 << 20) - 1)
}

/// How a channel stands, by its info: its number and whether it is stopped.
pub(crate) fn stands(stage: &mut Stage, channel: &str) -> (i64, bool) {
    stage.say("alice", &format!("context info {channel}"));
    let info = told(stage);
    let stop = info.get("stop").and_then(Value::as_map).expect("a stop");
    (number(stop, "number"), stop.get("stopped") == Some(&true.into()))
}

fn record(number: u64) -> StopRecord {
    let stop = Stop {
        number: Fence::new(EPOCH, number),
        by: "bob".into(),
        user: "bob".into(),
        since: Time::default(),
        reason: Some("smoke".into()),
    };
    StopRecord {
        path: Path::parse("/lab/arm").expect("a path"),
        latch: Latch {
            newest: stop.number,
            all: Some(stop.into()),
            ..Latch::default()
        },
    }
}

#[test]
fn each_stop_has_the_next_number_and_an_unstop_lifts_what_it_names() {
    let mut stage = stage();
    let heard = stage.say("bob", "message stop /lab/arm");
    assert_eq!(of(&heard, &["arm"]), ["arm< stop of bob stop=1"]);
    let heard = stage.say("alice", "message stop /lab/arm");
    assert_eq!(of(&heard, &["arm"]), ["arm< stop of alice stop=2"]);
    let heard = stage.say("bob", "message unstop /lab/arm @stop=1");
    assert_eq!(heard, ["bob< newer-stop"], "he has not seen that of alice");
    assert_eq!(stands(&mut stage, "/lab/arm"), (2, true));
    let heard = stage.say("bob", "message unstop /lab/arm @stop=2");
    assert_eq!(of(&heard, &["arm"]), ["arm< unstop of bob stop=2"]);
    assert_eq!(stands(&mut stage, "/lab/arm"), (2, false));
}

#[test]
fn a_refused_unstop_says_which_stop_holds() {
    let mut stage = stage();
    stage.say_with("bob", "message stop /lab/arm", "reason", "smoke".into());
    stage.say("alice", "message unstop /lab/arm @stop=0");
    let error = told(&stage);
    assert_eq!(number(&error, "stop"), 1);
    let newer = error.get("newer").and_then(Value::as_list).expect("a list");
    let [newer] = newer else { panic!("{newer:?}") };
    assert_eq!(
        (newer.get("by"), newer.get("user"), newer.get("reason")),
        (Some(&"bob".into()), Some(&"bob".into()), Some(&"smoke".into()))
    );
    assert!(newer.get("since").is_some());
}

#[test]
fn an_unstop_without_a_number_is_told_what_to_add() {
    let mut stage = stage();
    stage.say("bob", "message stop /lab/arm");
    for line in ["message unstop /lab/arm", "message unstop /lab/arm @stop=7"] {
        assert_eq!(stage.say("bob", line), ["bob< bad-slot"], "{line}");
        assert_eq!(told(&stage).get("slot"), Some(&"stop".into()));
    }
    assert_eq!(stands(&mut stage, "/lab/arm"), (1, true));
}

#[test]
fn stops_of_single_devices_are_their_own() {
    let mut stage = stage();
    stage.enter("belt", 1);
    stage.say("belt", "context join /lab/arm device=true");
    stage.say("alice", "message stop /lab/arm");
    let heard = stage.say("bob", "message stop /lab/arm @to=belt");
    assert_eq!(of(&heard, &["arm", "belt"]), ["belt< stop of bob stop=2"]);
    // The one whose newest stop is not above it may move; the other is named.
    let heard = stage.say("alice", "message unstop /lab/arm @stop=1");
    assert_eq!(
        of(&heard, &["arm", "belt", "alice"]),
        [
            "alice< unstop of alice stop=1",
            "arm< unstop of alice stop=1",
            "belt< unstopped by=bob",
            "alice< newer-stop"
        ]
    );
    assert_eq!(stands(&mut stage, "/lab/arm"), (2, true));
    let heard = stage.say("alice", "message unstop /lab/arm @stop=2 @to=belt");
    assert_eq!(of(&heard, &["belt"]), ["belt< unstop of alice stop=2"]);
    assert_eq!(stands(&mut stage, "/lab/arm"), (2, false));
}

/// It is started again while the hub still keeps its lost connection, and its name, for it.
#[test]
fn a_stop_of_one_device_holds_for_it_under_its_next_name() {
    let mut stage = stage();
    stage.say("bob", "message stop /lab/arm @to=arm");
    stage.lost("arm", 30_000);
    stage.enter("arm~2", 1);
    let heard = stage.say("arm~2", "context join /lab/arm device=true");
    assert_eq!(
        of(&heard, &["arm~2", "alice"]),
        [
            "alice< stopped by=bob",
            "arm~2< ok",
            "arm~2< stop of hub stop=1 by=bob"
        ]
    );
    // Each is let go by its name, and stays so.
    stage.say("alice", "message unstop /lab/arm @stop=1 @to=arm~2");
    let heard = stage.say("arm~2", "context join /lab/arm device=true");
    assert_eq!(heard, ["arm~2< ok"]);
    assert_eq!(stands(&mut stage, "/lab/arm"), (1, true), "the one that is away");
    // Another name is another device.
    stage.enter("armour", 1);
    let heard = stage.say("armour", "context join /lab/arm device=true");
    assert_eq!(of(&heard, &["armour"]), ["armour< ok"]);
}

/// One that has left does not keep the others moving, and finds the stop when it comes.
#[test]
fn a_stop_of_several_devices_is_for_those_that_are_there() {
    let mut stage = stage();
    let heard = stage.say("bob", "message stop /lab/arm @to=ghost,arm");
    assert_eq!(
        of(&heard, &["arm", "bob"]),
        ["arm< stop of bob stop=1", "bob< stopped by=bob"]
    );
    stage.enter("ghost", 1);
    let heard = stage.say("ghost", "context join /lab/arm device=true");
    assert_eq!(
        of(&heard, &["ghost"]),
        ["ghost< ok", "ghost< stop of hub stop=1 by=bob"]
    );
    let heard = stage.say("bob", "message stop /lab/arm @to=nobody");
    assert_eq!(heard, ["bob< unknown-peer"]);
}

#[test]
fn who_does_not_hear_the_stop_is_told_of_it() {
    let mut stage = stage();
    let heard = stage.say("bob", "message stop /lab/arm @to=arm");
    assert_eq!(
        of(&heard, &["alice", "bob", "arm"]),
        [
            "arm< stop of bob stop=1",
            "alice< stopped by=bob",
            "bob< stopped by=bob"
        ]
    );
    assert_eq!(
        stage.facts(),
        ["what=stopped peer=bob user=bob context=/lab/arm level=1 stop=1"]
    );
    let heard = stage.say("bob", "message stop /lab/arm @to=arm");
    assert_eq!(heard, ["arm< stop of bob stop=2"], "that it stands is known");
    assert_eq!(stage.facts(), [""; 0]);
}

#[test]
fn a_device_that_comes_finds_the_stop() {
    let mut stage = stage();
    stage.gone("arm");
    stage.say("bob", "message stop /lab/arm");
    stage.enter("arm", 1);
    let heard = stage.say("arm", "context join /lab/arm device=true");
    assert_eq!(
        heard,
        ["arm< ok", "arm< stop of hub stop=1 by=bob"],
        "also one that knows no numbers"
    );
    let stop = told(&stage);
    let stop = stop.get("stop").expect("how it stands");
    assert_eq!(stop.get("stopped"), Some(&true.into()));
    assert_eq!(stop.get("by"), Some(&"bob".into()));
}

#[test]
fn a_device_that_has_come_back_is_told_how_it_stands_before_anything_else() {
    let mut stage = stage();
    stage.lost("arm", 10_000);
    assert_eq!(
        stage.resumed("arm").first().map(String::as_str),
        Some("arm< unstopped")
    );
    stage.lost("arm", 10_000);
    stage.say("bob", "message stop /lab/arm");
    let heard = stage.resumed("arm");
    assert_eq!(
        heard.first().map(String::as_str),
        Some("arm< stop of hub stop=1 by=bob")
    );
}

/// What one device says of a stop says nothing of another that stands by the same, nor does a stop of a third.
#[test]
fn each_device_stands_by_a_stop_that_the_hub_does_not_know() {
    // Of a hub before this one.
    let stop = ((EPOCH.cast_signed() - 1) << 20) + 9;
    let word = || Value::from(Map::new().with("stop", stop).with("stopped", true));
    for first in ["arm", "alice"] {
        let mut stage = stage();
        stage.enter("belt", 1);
        match first {
            "arm" => drop(stage.say_with("arm", "context join /lab/arm", "device", word())),
            other => drop(stage.say("bob", &format!("message stop /lab/arm @to={other}"))),
        }
        let heard = stage.say_with("belt", "context join /lab/arm", "device", word());
        assert!(
            heard
                .iter()
                .any(|line| line.starts_with("belt< stop of hub") && line.contains("by=belt")),
            "{first}: {heard:?}"
        );
        // It is known from then on: what was lifted stays so.
        stage.say("bob", "message stop /lab/arm");
        let newest = stands(&mut stage, "/lab/arm").0;
        stage.say("bob", &format!("message unstop /lab/arm @stop={newest}"));
        let heard = stage.say_with("belt", "context join /lab/arm", "device", word());
        assert_eq!(heard, ["belt< ok"], "{first}");
    }
}

#[test]
fn a_stop_that_the_device_knows_of_and_the_hub_does_not_holds() {
    let mut stage = stage();
    let word = |number: i64, stopped: bool| {
        let number = (EPOCH.cast_signed() << 20) + number;
        Value::from(Map::new().with("stop", number).with("stopped", stopped))
    };
    let heard = stage.say_with("arm", "context join /lab/arm", "device", word(7, true));
    assert_eq!(
        of(&heard, &["alice", "arm"]),
        [
            "alice< stopped by=arm reason=it was stopped when it joined",
            "arm< ok",
            "arm< stop of hub stop=7 by=arm reason=it was stopped when it joined"
        ]
    );
    assert_eq!(stands(&mut stage, "/lab/arm"), (7, true));
    // The hub numbers above it from then on.
    let heard = stage.say("bob", "message stop /lab/arm");
    assert_eq!(of(&heard, &["arm"]), ["arm< stop of bob stop=8"]);
    stage.say("bob", "message unstop /lab/arm @stop=8");
    // What it says of older ones changes nothing: an unstop has come since.
    let heard = stage.say_with("arm", "context join /lab/arm", "device", word(7, true));
    assert_eq!(heard, ["arm< ok"]);
    assert_eq!(stands(&mut stage, "/lab/arm"), (8, false));
    let beyond = word(1 << 51, true);
    let heard = stage.say_with("arm", "context join /lab/arm", "device", beyond);
    assert_eq!(heard, ["arm< bad-content"]);
    for wrong in [
        Value::from(7),
        Map::new().with("stopped", 1).into(),
        Map::new().with("since", 1).into(),
    ] {
        let heard = stage.say_with("arm", "context join /lab/arm", "device", wrong);
        assert_eq!(heard, ["arm< bad-content"]);
    }
}

#[test]
fn deleting_a_channel_frees_no_device() {
    let mut stage = stage();
    stage.say("alice", "context create /lab/new kind=channel");
    stage.say("alice", "context join /lab/new");
    stage.say("alice", "message stop /lab/new");
    stage.say("alice", "context delete /lab/new");
    stage.say("alice", "context create /lab/new kind=channel");
    assert_eq!(stands(&mut stage, "/lab/new"), (1, true));
    stage.say("arm", "context join /lab/new");
    let heard = stage.say("arm", "context join /lab/new device=true");
    assert_eq!(heard, ["arm< ok", "arm< stop of hub stop=1 by=alice"]);
    let heard = stage.say("arm", "message stop /lab/new");
    assert_eq!(heard, ["arm< stop of arm stop=2"]);
}

#[test]
fn a_restart_knows_what_was_stopped_and_numbers_above_it() {
    let settings = Settings {
        keeps_stops: true,
        stops: vec![record(41)],
        ..Settings::default()
    };
    let mut stage = at(Stage::with(lab(Map::new()), Registry::builtin(), settings));
    assert_eq!(stands(&mut stage, "/lab/arm"), (41, true));
    let heard = stage.say("alice", "message stop /lab/arm");
    assert_eq!(of(&heard, &["arm"]), ["arm< stop of alice stop=42"]);
}

#[test]
fn where_what_was_kept_cannot_be_read_all_is_stopped() {
    let settings = Settings {
        keeps_stops: true,
        stops_unread: true,
        ..Settings::default()
    };
    let mut contexts = lab(Map::new());
    contexts.push(context("/lab/other", "channel"));
    let mut stage = at(Stage::with(contexts, Registry::builtin(), settings));
    assert_eq!(stands(&mut stage, "/lab/arm"), (1, true));
    assert_eq!(stands(&mut stage, "/lab/other"), (1, true));
    let heard = stage.say("alice", "message unstop /lab/arm @stop=1");
    assert_eq!(heard, [""; 0], "it is kept first");
    stage.answer_kept(true);
    assert_eq!(stands(&mut stage, "/lab/arm"), (1, false));
    assert_eq!(stands(&mut stage, "/lab/other"), (1, true));
}

#[test]
fn a_stop_is_handed_out_before_it_is_kept_and_an_unstop_after() {
    let mut stage = keeping();
    let heard = stage.say("bob", "message stop /lab/arm");
    assert_eq!(of(&heard, &["arm"]), ["arm< stop of bob stop=1"]);
    assert!(
        stage
            .kept
            .last()
            .is_some_and(|(record, _)| record.latch.is_stopped())
    );
    assert_eq!(stage.say("bob", "message unstop /lab/arm @stop=1"), [""; 0]);
    assert!(
        stage
            .kept
            .last()
            .is_some_and(|(record, _)| !record.latch.is_stopped())
    );
    assert_eq!(stands(&mut stage, "/lab/arm"), (1, true));
    let heard = stage.answer_kept(true);
    assert_eq!(of(&heard, &["arm"]), ["arm< unstop of bob stop=1"]);
    // One that cannot be kept frees nobody.
    stage.say("bob", "message stop /lab/arm");
    stage.say("bob", "message unstop /lab/arm @stop=2");
    assert_eq!(stage.answer_kept(false), ["bob< storage-failed"]);
    assert_eq!(stands(&mut stage, "/lab/arm"), (2, true));
    assert!(
        stage
            .kept
            .last()
            .is_some_and(|(record, _)| record.latch.is_stopped()),
        "as it is again"
    );
}

#[test]
fn a_stop_while_an_unstop_is_being_kept_holds() {
    let mut stage = keeping();
    stage.say("bob", "message stop /lab/arm");
    stage.say("bob", "message unstop /lab/arm @stop=1");
    let heard = stage.say("alice", "message stop /lab/arm");
    assert_eq!(of(&heard, &["arm"]), ["arm< stop of alice stop=2"]);
    assert_eq!(stage.answer_kept(true), ["bob< newer-stop"]);
    assert_eq!(stands(&mut stage, "/lab/arm"), (2, true));
    assert!(
        stage
            .kept
            .last()
            .is_some_and(|(record, _)| record.latch.is_stopped())
    );
}

/// The last word that is kept is what holds.
#[test]
fn an_unstop_of_a_channel_that_goes_meanwhile_is_not_kept() {
    let mut stage = keeping();
    stage.say("alice", "context create /lab/rover kind=channel");
    for name in ["alice", "bob"] {
        stage.say(name, "context join /lab/rover");
    }
    stage.say("bob", "message stop /lab/rover");
    let kept = |stage: &Stage| stage.kept.last().map(|(record, _)| record.latch.is_stopped());
    assert_eq!(kept(&stage), Some(true));
    stage.say("alice", "message unstop /lab/rover @stop=1");
    assert_eq!(kept(&stage), Some(false));
    stage.say("alice", "context delete /lab/rover");
    stage.answer_kept(true);
    assert_eq!(kept(&stage), Some(true));
}

#[test]
fn who_has_gone_meanwhile_frees_nobody() {
    let mut stage = keeping();
    stage.say("bob", "message stop /lab/arm");
    stage.say("bob", "message unstop /lab/arm @stop=1");
    stage.gone("bob");
    assert_eq!(stage.answer_kept(true), [""; 0]);
    assert_eq!(stands(&mut stage, "/lab/arm"), (1, true));
    assert!(
        stage
            .kept
            .last()
            .is_some_and(|(record, _)| record.latch.is_stopped())
    );
}

#[test]
fn a_device_needs_a_right_and_may_always_stop_itself() {
    let mut stage = managed();
    let heard = stage.say("alice", "context join /lab/arm device=true");
    assert_eq!(heard, ["alice< denied rule=roles/rule 2"]);
    let mut contexts = lab(Map::new());
    let list = |words: &[&str]| words.iter().map(|word| Value::from(*word)).collect::<Vec<_>>();
    let rules = vec![
        Value::Map(Map::new().with("deny", list(&["stop"]))),
        Value::Map(Map::new().with("allow", list(&["*"]))),
    ];
    contexts[0].set("manager", Map::new().with("kind", "roles").with("rules", rules));
    let mut stage = at(Stage::new(contexts));
    assert_eq!(
        stage.say("arm", "message stop /lab/arm"),
        ["arm< denied rule=roles/rule 1"]
    );
    assert_eq!(
        stage.say("bob", "message stop /lab/arm @to=bob"),
        ["bob< denied rule=roles/rule 1"]
    );
    let heard = stage.say("arm", "message stop /lab/arm @to=arm");
    assert_eq!(of(&heard, &["arm"]), ["arm< stop of arm stop=1"]);
    assert_eq!(stands(&mut stage, "/lab/arm"), (1, true));
}

#[test]
fn a_device_that_loses_the_right_is_one_no_more() {
    let mut stage = stage();
    let list = |words: &[&str]| words.iter().map(|word| Value::from(*word)).collect::<Vec<_>>();
    let rules = vec![
        Value::Map(Map::new().with("deny", list(&["device"]))),
        Value::Map(Map::new().with("allow", list(&["*"]))),
    ];
    let mut contexts = lab(level_or_lease(60_000, "lazy"));
    contexts[0].set("manager", Map::new().with("kind", "roles").with("rules", rules));
    stage.configure(contexts, Vec::new());
    stage.say("bob", "context stop /lab/arm");
    assert_eq!(answers(&stage), ["/lab/arm"]);
}

#[test]
fn a_token_may_say_that_a_stop_ends_its_grant() {
    for (ends, after) in [(false, "alice"), (true, "nobody")] {
        let token = level_or_lease(60_000, "lazy").with("stop-ends-grant", ends);
        let mut stage = at(Stage::new(lab(token)));
        stage.say("alice", "token grab /lab/key");
        let heard = stage.say("bob", "message stop /lab/arm");
        let released =
            heard.contains(&"alice< released owner=alice by=bob reason=stopped fence=1".to_owned());
        assert_eq!(released, ends, "{heard:?}");
        stage.say("bob", "token info /lab/key");
        let info = told(&stage);
        let owner = info.get("owner").and_then(Value::as_str).unwrap_or("nobody");
        assert_eq!(owner, after);
        let stopped = info
            .get("stopped")
            .and_then(Value::as_list)
            .expect("what it guards");
        assert_eq!(stopped[0].get("by"), Some(&"bob".into()));
    }
}

#[test]
fn a_list_shows_what_is_stopped() {
    let mut stage = stage();
    stage.say("bob", "message stop /lab/arm");
    stage.say("alice", "context list /lab");
    let reply = told(&stage);
    let children = reply.get("children").and_then(Value::as_list).expect("children");
    let stops: Vec<bool> = children.iter().map(|child| child.get("stop").is_some()).collect();
    assert_eq!(stops, [true, false]);
}
