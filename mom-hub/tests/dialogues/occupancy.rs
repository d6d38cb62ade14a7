//! One device obeys in a guarded channel: two would both move.

use mom_proto::{Map, Time, Value};

use crate::stage::{Stage, lab, of};
use crate::stops::told;

/// What a device says of itself: which installation it is, and in which second it was started.
fn word(installation: &str, begun: i64) -> Value {
    let begun = Time::from_micros(begun * 1_000_000).expect("a time");
    let word = Map::new().with("installation", installation).with("begun", begun);
    word.into()
}

/// A lab whose arm's channel has as many devices as this says, with `arm` and its namesake `arm~2` of one user, and `other` of another one.
fn stage(devices: Option<&str>) -> Stage {
    let mut contexts = lab(Map::new());
    contexts[2].remove("devices");
    if let Some(devices) = devices {
        contexts[2].set("devices", devices);
    }
    let mut stage = Stage::new(contexts);
    for name in ["arm", "other", "alice"] {
        stage.enter(name, 1);
    }
    stage.enter_for("arm", "arm~2");
    stage
}

const JOIN: &str = "context join /lab/arm";

#[test]
fn a_device_takes_the_place_of_its_own_earlier_start_and_of_no_other() {
    let cases = [
        // Who joins, as what, and what becomes of `arm`, which is "one", started in the 10th second.
        ("arm~2", word("one", 20), true),
        ("arm~2", word("one", 10), true),
        // The later start is there: the earlier one that comes back does not put it out.
        ("arm~2", word("one", 9), false),
        ("arm~2", word("two", 20), false),
        ("arm~2", true.into(), false),
        // A name that another user's program has, too, is not proof.
        ("other", word("one", 20), false),
        ("other", true.into(), false),
    ];
    for (who, said, takes) in cases {
        let mut stage = stage(None);
        stage.say_with("arm", JOIN, "device", word("one", 10));
        stage.say(who, JOIN);
        let heard = stage.say_with(who, JOIN, "device", said.clone());
        let (own, first) = (of(&heard, &[who]), of(&heard, &["arm"]));
        match takes {
            true => {
                let told = [format!("{who}< expelled peer=arm"), format!("{who}< ok")];
                assert_eq!(own, told, "{who} {said:?}");
                assert_eq!(first, ["arm< expelled peer=arm"]);
                // It neither hears nor obeys there any more.
                assert_eq!(
                    of(&stage.say("alice", "message hello /lab/arm"), &["arm"]),
                    [""; 0]
                );
            }
            false => {
                assert_eq!(own.len(), 1, "{who} {said:?}: {heard:?}");
                assert!(own[0].starts_with(&format!("{who}< occupied")), "{own:?}");
                assert_eq!(first, [""; 0], "{who} {said:?}");
            }
        }
    }
}

#[test]
fn a_lost_link_occupies_nothing() {
    let mut stage = stage(None);
    stage.say_with("arm", JOIN, "device", word("one", 10));
    stage.lost("arm", 10_000);
    let heard = stage.say_with("other", JOIN, "device", word("two", 1));
    assert_eq!(of(&heard, &["other"]), ["other< expelled peer=arm", "other< ok"]);
    // What comes back hears of it, and does not get the place back.
    stage.resumed("arm");
    let heard = stage.say_with("arm", JOIN, "device", word("one", 10));
    assert!(heard[0].starts_with("arm< occupied"), "{heard:?}");
}

#[test]
fn who_joins_again_as_a_device_has_its_own_place() {
    let mut stage = stage(None);
    for _ in 0..2 {
        let heard = stage.say_with("arm", JOIN, "device", word("one", 10));
        assert_eq!(of(&heard, &["arm"]), ["arm< ok"]);
    }
    // Who is not a device any more is in nobody's way.
    stage.say_with("arm", JOIN, "device", false.into());
    let heard = stage.say_with("other", JOIN, "device", true.into());
    assert_eq!(of(&heard, &["other"]), ["other< ok"]);
}

#[test]
fn a_channel_says_how_many_devices_it_has() {
    for (devices, guarded, several) in [
        (None, true, false),
        (Some("one"), true, false),
        (Some("several"), true, true),
        (None, false, true),
        (Some("one"), false, false),
    ] {
        let mut contexts = lab(Map::new());
        contexts[2].remove("devices");
        if let Some(devices) = devices {
            contexts[2].set("devices", devices);
        }
        if !guarded {
            contexts[2].remove("guard");
        }
        let mut stage = Stage::new(contexts);
        for name in ["arm", "other"] {
            stage.enter(name, 1);
        }
        stage.say_with("arm", JOIN, "device", true.into());
        let heard = stage.say_with("other", JOIN, "device", true.into());
        assert_eq!(
            heard[0] == "other< ok",
            several,
            "{devices:?} {guarded}: {heard:?}"
        );
        let heard = stage.say("other", "context info /lab/arm");
        assert_eq!(heard, ["other< ok"]);
        let word = if several { "several" } else { "one" };
        assert_eq!(told(&stage).get("devices"), Some(&word.into()));
    }
}

/// A configuration that lets one device be there, or guards the channel, leaves the one that was there first.
#[test]
fn a_new_configuration_leaves_one_device() {
    let several = |contexts: &mut Vec<Map>| contexts[2].set("devices", "several");
    let unguarded = |contexts: &mut Vec<Map>| drop(contexts[2].remove("guard"));
    for before in [several as fn(&mut Vec<Map>), unguarded as fn(&mut Vec<Map>)] {
        let mut contexts = lab(Map::new());
        contexts[2].remove("devices");
        let after = contexts.clone();
        before(&mut contexts);
        let mut stage = Stage::new(contexts);
        for name in ["lost", "arm", "other"] {
            stage.enter(name, 1);
            stage.say_with(name, JOIN, "device", true.into());
        }
        stage.lost("lost", 60_000);
        let heard = stage.configure(after, Vec::new());
        let put_out = |name: &str| {
            let line = format!("{name}< expelled peer={name}");
            heard.contains(&line)
        };
        assert_eq!(
            [put_out("lost"), put_out("arm"), put_out("other")],
            [true, false, true],
            "{heard:?}"
        );
    }
}

#[test]
fn what_a_device_says_of_itself_is_checked() {
    let mut stage = stage(None);
    let long = "x".repeat(65);
    let time = Time::from_micros(1).expect("a time");
    for wrong in [
        Map::new().with("installation", "one"),
        Map::new().with("begun", time),
        Map::new().with("installation", 7).with("begun", time),
        Map::new().with("installation", &*long).with("begun", time),
        Map::new().with("installation", "one").with("begun", "today"),
    ] {
        let heard = stage.say_with("arm", JOIN, "device", wrong.into());
        assert_eq!(heard, ["arm< bad-content"]);
    }
}
