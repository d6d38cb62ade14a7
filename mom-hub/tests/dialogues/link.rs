//! A peer that loses its connection and may come back: its devices are safe at once, its places are kept for a while.

use mom_hub::{Effect, Input, Route};
use mom_proto::{Map, Value};

use crate::stage::{Stage, context, lab, level_or_lease, of};

/// ms
const GRACE: u64 = 30_000;

/// Alice drives the arm, which is a peer itself; bob looks on.
fn driven(lease: i64, expiry: &str) -> Stage {
    let mut stage = Stage::new(lab(level_or_lease(lease, expiry)));
    for name in ["alice", "arm", "bob"] {
        stage.enter(name, 1);
    }
    stage.say("alice", "token grab /lab/key");
    stage
}

fn gates(stage: &Stage) -> Vec<(usize, u64, u64)> {
    let gate = |(place, effect): (usize, &Effect)| match effect {
        Effect::Route(route) => {
            let Route { guard, .. } = &**route;
            let guard = guard.as_ref()?;
            Some((place, guard.fence & 0xFFFFF, guard.owner.as_ref()?.halts))
        }
        _ => None,
    };
    stage.effects.iter().enumerate().filter_map(gate).collect()
}

#[test]
fn a_lost_owner_halts_its_device_and_keeps_the_token() {
    let mut stage = driven(180_000, "lazy");
    let heard = stage.lost("alice", GRACE);
    assert_eq!(
        of(&heard, &["arm"]),
        ["arm< halt of hub", "arm< lost peer=alice"],
        "the safe state first, then who is lost where: {heard:?}"
    );
    assert_eq!(
        gates(&stage),
        [(0, 1, 1)],
        "before all else nothing of hers passes any more"
    );
    assert_eq!(stage.facts(), ["what=link-lost peer=alice user=alice level=1"]);
    let heard = stage.say("bob", "token grab /lab/key");
    assert_eq!(of(&heard, &["bob"]), ["bob< held rule=level-or-lease"]);
    let Some(Effect::Reply { parcel, .. }) = stage.effects.first() else {
        panic!("{:?}", stage.effects)
    };
    let content = parcel.value();
    assert_eq!(content.get("owner-lost"), Some(&Value::Int(30_000)));
    assert_eq!(
        content.get("retry-after"),
        Some(&Value::Int(30_000)),
        "before the lease is over"
    );
    let text = content.get("text").and_then(Value::as_str).unwrap_or_default();
    assert!(
        text.ends_with("; its connection is lost, and it may come back for 30 s"),
        "{text}"
    );
    stage.at(10_000);
    let heard = stage.resumed("alice");
    assert_eq!(of(&heard, &["arm"]), ["arm< resumed peer=alice"], "{heard:?}");
    let heard = stage.say("alice", "message command /lab/arm");
    assert_eq!(
        of(&heard, &["arm"]),
        ["arm< command of alice fence=1"],
        "{heard:?}"
    );
    stage.lost("alice", GRACE);
    assert_eq!(gates(&stage), [(0, 1, 2)], "each loss closes the gate");
}

#[test]
fn who_does_not_come_back_in_time_is_gone() {
    let mut stage = driven(180_000, "lazy");
    stage.lost("alice", GRACE);
    assert!(stage.at(29_999).is_empty());
    let heard = stage.at(30_000);
    assert_eq!(
        of(&heard, &["arm", "alice"])[..2],
        ["alice< halt of hub", "arm< halt of hub"],
        "{heard:?}"
    );
    let released = "arm< released owner=alice reason=disconnected fence=1";
    assert!(heard.iter().any(|line| line == released), "{heard:?}");
    assert_eq!(heard.last().map(String::as_str), Some("alice closed"));
    assert!(stage.at(40_000).is_empty());
    let heard = stage.say("bob", "token grab /lab/key");
    assert!(heard.contains(&"bob< ok fence=2".to_owned()), "{heard:?}");
}

#[test]
fn a_lease_runs_on_while_its_owner_is_lost() {
    let mut stage = driven(5000, "eager");
    stage.lost("alice", GRACE);
    let heard = stage.say("bob", "token grab /lab/key");
    assert_eq!(of(&heard, &["bob"]), ["bob< held rule=level-or-lease"]);
    let Some(Effect::Reply { parcel, .. }) = stage.effects.first() else {
        panic!("{:?}", stage.effects)
    };
    assert_eq!(
        parcel.value().get("retry-after"),
        Some(&Value::Int(5000)),
        "the lease is over before the grace time is"
    );
    let heard = stage.at(5000);
    assert_eq!(
        of(&heard, &["arm"])[1],
        "arm< released owner=alice reason=expired fence=1"
    );
    stage.resumed("alice");
    let heard = stage.say("alice", "message command /lab/arm");
    assert_eq!(
        of(&heard, &["alice"]),
        ["alice< not-owner rule=guard of /lab/arm"]
    );
}

#[test]
fn a_command_that_waits_for_a_verdict_is_refused_at_the_loss() {
    let contexts = vec![context("/lab", "session").with("presence", "none")];
    let mut stage = Stage::new(contexts);
    for name in ["alice", "bob"] {
        stage.enter(name, 1);
    }
    stage.say("bob", "context create /lab/key kind=token");
    let guard = Map::new()
        .with("token", "/lab/key")
        .with("names", vec!["command".into()]);
    stage.say_with(
        "bob",
        "context create /lab/arm kind=channel manager=self presence=none",
        "guard",
        Value::Map(guard),
    );
    stage.say("bob", "context join /lab/arm");
    stage.say("alice", "context join /lab/arm");
    stage.say("bob", "manager verdict / consult=1 allow=true");
    stage.say("alice", "token grab /lab/key");
    stage.say("alice", "message command /lab/arm");
    stage.say("alice", "message chat /lab/arm");
    stage.say("alice", "message command /lab/arm");
    let heard = stage.lost("alice", GRACE);
    assert_eq!(
        of(&heard, &["alice"])[..4],
        [
            "alice< halt of hub",
            "alice< lost peer=alice",
            "alice< older-fence",
            "alice< older-fence"
        ],
        "devices are safe, then commands are refused, and the sender told: {heard:?}"
    );
    let asked = heard.iter().filter(|line| line.starts_with("bob< consult"));
    assert_eq!(asked.count(), 1, "about the chat, which is next: {heard:?}");
    let heard = stage.say("bob", "manager verdict / consult=3 allow=true");
    assert_eq!(of(&heard, &["bob"])[0], "bob< chat of alice", "{heard:?}");
}

/// What moves a device is of its moment, whether a token guards it or not.
#[test]
fn what_moves_a_device_and_waits_for_a_verdict_is_refused_at_the_loss() {
    let contexts = vec![context("/lab", "session").with("presence", "none")];
    let mut stage = Stage::new(contexts);
    for name in ["alice", "bob"] {
        stage.enter(name, 1);
    }
    stage.say(
        "bob",
        "context create /lab/arm kind=channel manager=self presence=none",
    );
    stage.say("bob", "context join /lab/arm");
    stage.say("alice", "context join /lab/arm");
    stage.say("bob", "manager verdict / consult=1 allow=true");
    for name in ["command", "unstop", "chat"] {
        stage.say("alice", &format!("message {name} /lab/arm"));
    }
    let heard = of(&stage.lost("alice", GRACE), &["alice"]);
    let refused = heard.iter().filter(|line| *line == "alice< too-late");
    assert_eq!(refused.count(), 2, "{heard:?}");
    let heard = stage.say("bob", "manager verdict / consult=4 allow=true");
    assert_eq!(of(&heard, &["bob"])[0], "bob< chat of alice", "{heard:?}");
}

/// A release may have been under way for long: it ends the ownership that it names, and no later one.
#[test]
fn a_release_ends_the_ownership_that_it_names() {
    let mut stage = driven(180_000, "lazy");
    let heard = stage.say("alice", "token release /lab/key @fence=1");
    assert_eq!(
        of(&heard, &["alice"]).last().map(String::as_str),
        Some("alice< ok")
    );
    stage.say("alice", "token grab /lab/key");
    let heard = stage.say("alice", "token release /lab/key @fence=1");
    assert_eq!(heard, ["alice< older-fence fence=2"]);
    let heard = stage.say("alice", "token release /lab/key @fence=3");
    assert_eq!(heard, ["alice< bad-fence fence=2"]);
    let heard = stage.say("bob", "token release /lab/key @fence=2");
    assert_eq!(heard, ["bob< not-owner rule=one owner at most"]);
    let heard = stage.say("alice", "message command /lab/arm");
    assert_eq!(
        of(&heard, &["arm"]),
        ["arm< command of alice fence=2"],
        "still hers"
    );
    let heard = stage.say("alice", "token release /lab/key");
    assert_eq!(
        of(&heard, &["alice"]).last().map(String::as_str),
        Some("alice< ok")
    );
}

#[test]
fn a_list_says_who_is_lost() {
    let mut stage = driven(180_000, "lazy");
    stage.lost("alice", GRACE);
    stage.at(1000);
    stage.say("bob", "context members /lab/arm");
    let Some(Effect::Reply { parcel, .. }) = stage.effects.first() else {
        panic!("{:?}", stage.effects)
    };
    let members = parcel.value();
    let lost = |member: &Value| member.as_map().and_then(|member| member.get("lost").cloned());
    let lost: Vec<_> = members
        .get("members")
        .and_then(Value::as_list)
        .unwrap_or_default()
        .iter()
        .map(lost)
        .collect();
    assert_eq!(lost, [Some(Value::Int(29_000)), None, None]);
}

/// Alice owns a hundred tokens, each for a channel of the arm's.
fn crowd() -> Stage {
    let mut contexts = vec![context("/lab", "session")];
    for number in 0..100 {
        let (key, arm) = (format!("/lab/key{number}"), format!("/lab/arm{number}"));
        contexts.push(context(&key, "token"));
        let guard = Map::new()
            .with("token", key.as_str())
            .with("names", vec!["command".into()]);
        contexts.push(context(&arm, "channel").with("guard", guard));
    }
    let mut stage = Stage::new(contexts);
    for name in ["alice", "arm"] {
        stage.arrive(name, 1);
        stage.say(name, "context join /lab");
    }
    for number in 0..100 {
        stage.say("alice", &format!("token grab /lab/key{number}"));
        stage.say("arm", &format!("context join /lab/arm{number}"));
    }
    stage
}

#[test]
fn much_is_made_safe_and_told_in_steps() {
    let mut stage = crowd();
    let halts = |heard: &[String]| heard.iter().filter(|line| *line == "arm< halt of hub").count();
    let first = stage.lost("alice", GRACE);
    assert_eq!(halts(&first), 32, "one step");
    stage.resumed("alice");
    let mut all = halts(&first);
    for step in 1..20 {
        all += halts(&stage.at(step));
    }
    assert_eq!(all, 100, "also of one that came back meanwhile");
}

#[test]
fn who_logs_out_or_is_put_out_while_lost_is_gone_at_once() {
    let mut stage = driven(180_000, "lazy");
    stage.enter("chief", 9);
    stage.lost("alice", GRACE);
    let heard = stage.say("chief", "context expel / peer=alice for=0");
    assert!(heard.contains(&"alice closed".to_owned()), "{heard:?}");
    stage.lost("bob", GRACE);
    stage.gone("bob");
    assert!(stage.at(40_000).is_empty(), "no timer is left");
}

/// As [`driven`], where a device keeps doing what it does while its token is handed over.
fn handed(safe_on_give: bool) -> Stage {
    let token = level_or_lease(180_000, "lazy").with("safe-on-give", safe_on_give);
    let mut stage = Stage::new(lab(token));
    for name in ["alice", "arm", "bob"] {
        stage.enter(name, 1);
    }
    stage.say("alice", "token grab /lab/key");
    stage
}

#[test]
fn a_device_that_is_handed_to_a_lost_peer_is_made_safe() {
    let halts = |heard: &[String]| heard.iter().filter(|line| *line == "arm< halt of hub").count();
    for (lost, expected) in [(false, 0), (true, 1)] {
        let mut stage = handed(false);
        stage.say("bob", "token request /lab/key");
        if lost {
            stage.lost("bob", GRACE);
        }
        let heard = stage.say("alice", "token accept /lab/key peer=bob");
        assert!(
            heard.contains(&"arm< grabbed owner=bob fence=2".to_owned()),
            "{heard:?}"
        );
        assert_eq!(halts(&heard), expected, "given, lost={lost}: {heard:?}");
    }
    for (lost, expected) in [(false, 0), (true, 1)] {
        let mut stage = handed(false);
        stage.say("alice", "token give /lab/key to=bob for=60000");
        stage.say("bob", "token accept /lab/key");
        if lost {
            stage.lost("alice", GRACE);
        }
        let heard = stage.say("bob", "token release /lab/key");
        assert!(
            heard.contains(&"arm< grabbed owner=alice fence=3".to_owned()),
            "{heard:?}"
        );
        assert_eq!(halts(&heard), expected, "returned, lost={lost}: {heard:?}");
    }
}

#[test]
fn who_leaves_in_steps_while_lost_is_closed_once() {
    // ms in which the way out takes its steps, all but the first
    let (steps, grace) = (20, 2);
    let ways = [
        ("expel", 1),
        ("gone", 0), // The broker knows.
        ("nothing", 1),
    ];
    for (way, closed) in ways {
        let mut stage = crowd();
        stage.arrive("chief", 9);
        stage.lost("alice", grace);
        let mut heard = match way {
            "expel" => stage.say("chief", "context expel / peer=alice for=0"),
            "gone" => {
                let peer = stage.peer("alice");
                stage.give(Input::Gone { peer })
            }
            _ => Vec::new(),
        };
        for step in 1..steps {
            heard.extend(stage.at(step));
        }
        let times = heard.iter().filter(|line| *line == "alice closed").count();
        assert_eq!(times, closed, "{way}");
        let released = heard.iter().filter(|line| line.starts_with("arm< released"));
        assert_eq!(released.count(), 100, "{way}: each token once");
    }
}
