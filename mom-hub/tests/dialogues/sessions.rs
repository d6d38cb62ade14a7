//! Stops of whole sessions: one request, where its user may, and the word of each device (M43).

use mom_hub::{Effect, Input, Route};
use mom_proto::{Map, Value};

use crate::stage::{EPOCH, MS, Stage, context, lab, of};
use crate::stops::{at, keeping, stage, stands, told};

/// A managed hub: alice may stop in the lab but not in its cell, which carol does not even see.
pub(crate) fn managed() -> Stage {
    let rule = |verb: &str, users: &[&str], places: &[&str]| {
        let list = |words: &[&str]| words.iter().map(|word| Value::from(*word)).collect::<Vec<_>>();
        let map = Map::new().with(verb, list(&["*"])).with("where", list(places));
        Value::Map(if users.is_empty() {
            map
        } else {
            map.with("users", list(users))
        })
    };
    let deny = |verb: &str, users: &[&str], places: &[&str]| {
        let list = |words: &[&str]| words.iter().map(|word| Value::from(*word)).collect::<Vec<_>>();
        Value::Map(
            Map::new()
                .with("deny", list(&[verb]))
                .with("where", list(places))
                .with("users", list(users)),
        )
    };
    let mut rules = vec![
        deny("stop", &["alice"], &["/lab/cell"]),
        deny("device", &["alice"], &["/**"]),
    ];
    for verb in ["stop", "lookup", "info", "join"] {
        rules.push(deny(verb, &["carol"], &["/lab/cell"]));
    }
    rules.push(rule("allow", &[], &["/**"]));
    let manager = Map::new().with("kind", "roles").with("rules", rules);
    let mut contexts = lab(Map::new());
    contexts[0].set("manager", manager);
    contexts.push(context("/lab/cell", "channel").with("guard", guard()));
    contexts.push(context("/lab/chat", "channel"));
    at(Stage::new(contexts))
}

fn guard() -> Map {
    Map::new()
        .with("token", "/lab/key")
        .with("names", vec!["command".into()])
}

/// The channels of the last reply: path, and device with its word.
pub(crate) fn answers(stage: &Stage) -> Vec<String> {
    let reply = told(stage);
    let channels = reply.get("channels").and_then(Value::as_list).expect("channels");
    let mut lines: Vec<String> = channels
        .iter()
        .map(|channel| {
            let text = |key: &str| {
                channel
                    .get(key)
                    .and_then(Value::as_str)
                    .unwrap_or_default()
                    .to_owned()
            };
            let devices = channel.get("devices").and_then(Value::as_list).expect("devices");
            let words = devices.iter().map(|device| {
                let text = |key: &str| {
                    device
                        .get(key)
                        .and_then(Value::as_str)
                        .unwrap_or_default()
                        .to_owned()
                };
                format!(" {}={}", text("peer"), text("word"))
            });
            format!("{}{}", text("path"), words.collect::<String>())
        })
        .collect();
    let denied = reply.get("denied").and_then(Value::as_list).expect("denied");
    lines.extend(
        denied
            .iter()
            .map(|path| format!("denied {}", path.as_str().unwrap_or_default())),
    );
    lines
}

#[test]
fn one_request_stops_a_session_where_its_user_may() {
    let mut stage = managed();
    let heard = stage.say("alice", "context stop /lab reason=smoke");
    assert_eq!(of(&heard, &["arm"]), ["arm< stop of alice stop=1 reason=smoke"]);
    assert!(
        !heard.iter().any(|line| line.starts_with("alice< ok")),
        "the arm has not said so"
    );
    let heard = stage.say("arm", "message state /lab/arm stopped=true number=1");
    assert_eq!(of(&heard, &["alice"]), ["alice< ok", "alice< state of arm"]);
    stage.say("arm", "message state /lab/arm stopped=true number=1");
    // What its user may see and not stop is named.
    stage.say("alice", "context stop /lab");
    stage.say("arm", "message state /lab/arm stopped=true number=2");
    assert_eq!(answers(&stage), ["/lab/arm arm=stopped", "denied /lab/cell"]);
    assert_eq!(stands(&mut stage, "/lab/chat"), (2, true));
    assert_eq!(stands(&mut stage, "/lab/cell"), (0, false));
    // And what it may not see is not.
    stage.arrive("carol", 1);
    stage.say("carol", "context stop /lab within=1");
    stage.at(2);
    assert_eq!(answers(&stage), ["/lab/arm arm=silent"]);
}

#[test]
fn a_device_that_says_nothing_is_waited_for_so_long() {
    let mut stage = stage();
    stage.say("bob", "context stop /lab/arm within=200");
    // What it says of an older stop, or that it moves, is not an answer.
    stage.say("arm", "message state /lab/arm stopped=true number=0");
    stage.say("arm", "message state /lab/arm stopped=false");
    stage.say("arm", "message state /lab/arm stopped=true stop=newest");
    stage.say("arm", "message state /lab/arm stopped=true stop=-1");
    stage.say("alice", "message state /lab/arm stopped=true");
    assert_eq!(stage.at(199), [""; 0]);
    assert_eq!(stage.at(200), ["bob< ok"]);
    assert_eq!(answers(&stage), ["/lab/arm arm=silent"]);
    // A device of protocol 1.1 names no number.
    stage.say("bob", "context stop /lab/arm");
    stage.say("arm", "message state /lab/arm stopped=true");
    assert_eq!(answers(&stage), ["/lab/arm arm=stopped"]);
    stage.lost("arm", 60_000);
    stage.say("bob", "context stop /lab/arm");
    assert_eq!(answers(&stage), ["/lab/arm arm=lost"]);
    stage.say("bob", "context stop /lab/key");
    assert_eq!(told(&stage).get("code"), Some(&Value::Int(215)));
}

/// The devices of the first channel of the last reply.
fn standing(stage: &Stage) -> Vec<Value> {
    let reply = told(stage);
    let channels = reply.get("channels").and_then(Value::as_list).expect("channels");
    let devices = channels[0].get("devices").and_then(Value::as_list);
    devices.expect("devices").to_vec()
}

/// Three that joined while a session was being stopped: below it, in a channel that nothing was known of, and elsewhere.
#[test]
fn a_device_that_joins_below_a_session_that_is_being_stopped_is_waited_for() {
    let mut contexts = lab(Map::new());
    contexts.push(context("/lab/chat", "channel"));
    let mut stage = at(Stage::new(contexts));
    stage.say("bob", "context stop /lab within=900");
    stage.arrive("cam", 1);
    stage.say("cam", "context join /lab");
    stage.say("cam", "context join /lab/chat device=true");
    stage.say("arm", "message state /lab/arm stopped=true number=1");
    assert_eq!(stage.at(899), [""; 0], "it waits for the other");
    let heard = stage.say("cam", "message state /lab/chat stopped=true number=1");
    assert_eq!(of(&heard, &["bob"]), ["bob< ok"]);
    assert_eq!(answers(&stage), ["/lab/arm arm=stopped", "/lab/chat cam=stopped"]);
    // One that says nothing is named.
    stage.say("bob", "context stop /lab within=900");
    stage.arrive("deaf", 1);
    stage.say("deaf", "context join /lab");
    stage.say("deaf", "context join /lab/arm device=true");
    stage.say("arm", "message state /lab/arm stopped=true number=2");
    stage.say("cam", "message state /lab/chat stopped=true number=2");
    stage.at(1800);
    assert_eq!(
        answers(&stage),
        ["/lab/arm arm=stopped deaf=silent", "/lab/chat cam=stopped"]
    );
}

#[test]
fn who_spoke_of_its_rest_and_does_so_no_more_is_not_known_to_stand() {
    let mut stage = stage();
    stage.say("bob", "context stop /lab/arm within=900");
    stage.say(
        "arm",
        "message state /lab/arm stopped=true moving=true reached=true number=1",
    );
    stage.say("arm", "message state /lab/arm stopped=true number=1");
    assert_eq!(stage.at(899), [""; 0]);
    assert_eq!(stage.at(900), ["bob< ok"]);
    let device = Map::new()
        .with("peer", "arm")
        .with("word", "stopped")
        .with("moving", true);
    assert_eq!(standing(&stage), [device.into()]);
}

#[test]
fn an_answer_waits_until_the_devices_rest() {
    let mut stage = stage();
    let device = || Map::new().with("peer", "arm").with("word", "stopped");
    stage.say("bob", "context stop /lab/arm within=900");
    // It obeys, and rolls; it stands by what was meant; it stands.
    let heard = stage.say(
        "arm",
        "message state /lab/arm stopped=true moving=true reached=true number=1",
    );
    assert_eq!(of(&heard, &["bob"]), ["bob< state of arm"]);
    let heard = stage.say(
        "arm",
        "message state /lab/arm stopped=true moving=false reached=true number=1",
    );
    assert_eq!(of(&heard, &["bob"]), ["bob< state of arm"]);
    let rests = "message state /lab/arm stopped=true moving=false reached=true rest=measured number=1";
    assert_eq!(
        of(&stage.say("arm", rests), &["bob"]),
        ["bob< ok", "bob< state of arm"]
    );
    assert_eq!(standing(&stage), [device().with("rest", "measured").into()]);
    // One that does not come to rest, or cannot be reached, is told of when the time is over.
    for (state, known) in [
        ("moving=true reached=true", device().with("moving", true)),
        (
            "moving=true reached=false",
            device().with("moving", true).with("reached", false),
        ),
        (
            "moving=false reached=true rest=sure",
            device().with("moving", true),
        ),
    ] {
        let mut stage = self::stage();
        stage.say("bob", "context stop /lab/arm within=900");
        stage.say(
            "arm",
            &format!("message state /lab/arm stopped=true number=1 {state}"),
        );
        assert_eq!(stage.at(899), [""; 0], "{state}");
        assert_eq!(stage.at(900), ["bob< ok"], "{state}");
        assert_eq!(standing(&stage), [known.into()], "{state}");
    }
}

#[test]
fn an_answer_waits_until_the_stop_is_kept() {
    let mut stage = keeping();
    stage.say("bob", "context stop /lab/arm");
    let heard = stage.say("arm", "message state /lab/arm stopped=true number=1");
    assert_eq!(of(&heard, &["bob"]), ["bob< state of arm"]);
    assert_eq!(stage.answer_kept(true), ["bob< ok"]);
    let kept = |stage: &Stage| {
        let reply = told(stage);
        let channels = reply
            .get("channels")
            .and_then(Value::as_list)
            .unwrap_or_default()
            .to_vec();
        ["kept", "error"].map(|key| channels[0].get(key).cloned())
    };
    assert_eq!(kept(&stage), [Some(true.into()), None]);
    stage.say("bob", "context stop /lab/arm");
    stage.say("arm", "message state /lab/arm stopped=true number=2");
    assert_eq!(stage.answer_kept(false), ["bob< ok"]);
    assert_eq!(kept(&stage), [Some(false.into()), Some("storage-failed".into())]);
}

#[test]
fn unstop_of_a_session_names_what_it_lifts() {
    let mut contexts = lab(Map::new());
    contexts.push(context("/lab/belt", "channel"));
    let mut stage = at(Stage::new(contexts));
    stage.say("bob", "context stop /lab within=1");
    stage.at(5);
    let number = |number: i64| Value::from((EPOCH.cast_signed() << 20) + number);
    stage.say("bob", "context unstop /lab");
    assert_eq!(told(&stage).get("slot"), Some(&"content/stops".into()));
    let stops = Map::new().with("/lab/arm", number(1));
    let heard = stage.say_with("alice", "context unstop /lab", "stops", stops.into());
    assert_eq!(of(&heard, &["arm"]), ["arm< unstop of alice stop=1"]);
    stage.say("arm", "message state /lab/arm stopped=false number=1");
    assert_eq!(answers(&stage), ["/lab/arm arm=unstopped"]);
    assert_eq!(stands(&mut stage, "/lab/arm"), (1, false));
    assert_eq!(stands(&mut stage, "/lab/belt"), (1, true));
    // An older number lifts nothing, and says what holds.
    stage.say("bob", "message stop /lab/arm");
    let heard = stage.say("alice", "context unstop /lab/arm number=1");
    assert_eq!(heard, ["alice< ok"]);
    let reply = told(&stage);
    let channels = reply.get("channels").and_then(Value::as_list).expect("channels");
    let newer = channels[0].get("newer").and_then(Value::as_list).expect("newer");
    assert_eq!(newer[0].get("by"), Some(&"bob".into()));
    assert_eq!(stands(&mut stage, "/lab/arm"), (2, true));
}

#[test]
fn channels_made_while_a_session_is_stopped_are_stopped_too() {
    let mut contexts = vec![context("/hall", "session").with("presence", "none")];
    contexts.extend((0..100).map(|at| context(&format!("/hall/robot-{at}"), "channel")));
    let mut stage = Stage::new(contexts);
    stage.arrive("alice", 1);
    stage.say("alice", "context join /hall");
    stage.say("alice", "context stop /hall within=1");
    // Before and behind where the walk is.
    stage.say("alice", "context create /hall/aaa kind=channel");
    stage.say("alice", "context create /hall/zzz kind=channel");
    let mut now = 0;
    while !stage.at(now).contains(&"alice< ok".to_owned()) {
        now += 1;
        assert!(now < 1000, "it comes to an end");
    }
    for channel in ["aaa", "robot-0", "robot-99", "zzz"] {
        assert!(stands(&mut stage, &format!("/hall/{channel}")).1, "{channel}");
    }
}

/// The walk is over, and an arm's word is waited for.
#[test]
fn channels_made_before_the_answer_are_stopped_too() {
    let mut stage = stage();
    assert!(
        !stage
            .say("alice", "context stop /lab")
            .contains(&"alice< ok".to_owned())
    );
    stage.say("bob", "context create /lab/new kind=channel");
    assert!(stands(&mut stage, "/lab/new").1);
    assert!(stage.at(1000).contains(&"alice< ok".to_owned()));
}

/// What a gateway has made goes with it; its return must not move a device.
#[test]
fn a_stop_of_a_session_is_for_devices_that_are_away_with_their_channels() {
    let mut stage = stage();
    for name in ["rover", "chat"] {
        stage.say("alice", &format!("context create /lab/{name} kind=channel"));
    }
    stage.say("arm", "context join /lab/rover device=true");
    for name in ["rover", "chat"] {
        stage.say("alice", &format!("context delete /lab/{name}"));
    }
    stage.say("bob", "context stop /lab within=0");
    let channels = told(&stage)
        .get("channels")
        .and_then(Value::as_list)
        .expect("channels")
        .to_vec();
    let paths: Vec<_> = channels
        .iter()
        .filter_map(|channel| channel.get("path"))
        .collect();
    assert_eq!(paths, [&Value::from("/lab/arm"), &"/lab/rover".into()]);
    assert_eq!(
        channels[1].get("guard"),
        Some(&true.into()),
        "a device is meant to be there"
    );
    for name in ["rover", "chat"] {
        stage.say("alice", &format!("context create /lab/{name} kind=channel"));
    }
    let heard = stage.say("arm", "context join /lab/rover device=true");
    let stop = "arm< stop of hub stop=1 by=bob".to_owned();
    assert!(heard.contains(&stop), "{heard:?}");
    let heard = stage.say("arm", "context join /lab/chat device=true");
    assert!(!heard.contains(&stop), "no device was there");
}

/// A device that took its number for one of a stop would hold none of the stops below it.
#[test]
fn an_unstop_of_a_stop_that_was_never_given_out_is_refused_in_any_form() {
    let mut stage = stage();
    stage.say("bob", "message stop /lab/arm");
    let error = |stage: &Stage| {
        let channels = told(stage)
            .get("channels")
            .and_then(Value::as_list)
            .expect("channels")
            .to_vec();
        channels[0].get("error").cloned()
    };
    let heard = stage.say("alice", "context unstop /lab/arm number=2");
    assert_eq!(of(&heard, &["alice", "arm"]), ["alice< ok"]);
    assert_eq!(error(&stage), Some("bad-slot".into()));
    let stops = Map::new().with("/lab/arm", i64::MAX);
    let heard = stage.say_with("alice", "context unstop /lab", "stops", stops.into());
    assert_eq!(of(&heard, &["arm"]), [""; 0]);
    assert_eq!(error(&stage), Some("bad-slot".into()));
    assert_eq!(stands(&mut stage, "/lab/arm"), (1, true));
}

#[test]
fn a_device_that_is_away_is_let_go_by_its_name() {
    let mut stage = stage();
    stage.say("bob", "message stop /lab/arm");
    stage.gone("arm");
    let only = Value::List(vec!["arm".into()]);
    stage.say_with("alice", "context unstop /lab/arm number=1", "only", only);
    let channels = told(&stage)
        .get("channels")
        .and_then(Value::as_list)
        .expect("channels")
        .to_vec();
    assert_eq!(channels[0].get("error"), None);
    stage.say("alice", "context info /lab/arm");
    let info = told(&stage);
    let stop = info.get("stop").expect("a stop");
    assert_eq!(stop.get("stopped"), Some(&true.into()), "any other is");
    assert_eq!(stop.get("except"), Some(&Value::List(vec!["arm".into()])));
    stage.enter("arm", 1);
    assert_eq!(stage.say("arm", "context join /lab/arm device=true"), ["arm< ok"]);
}

#[test]
fn who_stops_much_at_once_is_told_to_wait_and_holds_nobody_up() {
    let mut contexts = vec![context("/hall", "session").with("presence", "none")];
    contexts.extend((0..200).map(|at| context(&format!("/hall/robot-{at}"), "channel")));
    let mut stage = Stage::new(contexts);
    for name in ["alice", "bob"] {
        stage.arrive(name, 1);
    }
    for _ in 0..2 {
        assert_eq!(stage.say("alice", "context stop /hall"), [""; 0]);
    }
    assert_eq!(stage.say("alice", "context stop /hall"), ["alice< try-later"]);
    assert_eq!(stage.say("bob", "context stop /hall"), [""; 0]);
    for now in 0..100 {
        stage.at(now);
    }
    assert_eq!(stage.say("alice", "context stop /hall"), [""; 0]);
}

#[test]
fn routes_are_awaited_only_while_somebody_waits() {
    let mut stage = stage();
    let awaited = |stage: &Stage| {
        stage.effects.iter().find_map(|effect| match effect {
            Effect::Route(route) => {
                let Route { path, awaited, .. } = &**route;
                (path.as_str() == "/lab/arm").then_some(*awaited)
            }
            _ => None,
        })
    };
    stage.say("bob", "context stop /lab/arm");
    assert_eq!(awaited(&stage), Some(true), "before the stop goes out");
    assert!(matches!(stage.effects.first(), Some(Effect::Route(_))));
    stage.say("arm", "message state /lab/arm stopped=true");
    assert_eq!(awaited(&stage), Some(false));
    // Also when nobody says anything, or who waits has gone.
    stage.say("bob", "context stop /lab/arm within=10");
    stage.now += 10 * MS;
    stage.give(Input::Tick);
    assert_eq!(awaited(&stage), Some(false));
    stage.say("bob", "context stop /lab/arm within=10");
    stage.gone("bob");
    stage.now += 10 * MS;
    assert_eq!(stage.give(Input::Tick), [""; 0]);
    assert_eq!(awaited(&stage), Some(false));
}
