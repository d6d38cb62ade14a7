//! Nobody has a device, or an owner, hear of nothing else than him.

use mom_proto::Map;

use crate::stage::{MS, Stage, context, lab, level_or_lease, of};

fn put_off(heard: &[String]) -> usize {
    usize::from(heard.iter().any(|line| line.contains("try-later")))
}

/// A lab with a device, whose channel says how fast it reads.
fn with_device(pace: Option<i64>) -> Stage {
    let mut contexts = lab(Map::new());
    if let Some(pace) = pace {
        contexts[2].set("pace", pace);
    }
    let mut stage = Stage::new(contexts);
    stage.arrive("arm", 1);
    stage.say("arm", "context join /lab");
    stage.say("arm", "context join /lab/arm device=true");
    stage
}

/// How often of 150 times at once a user may take the token.
fn grabs(stage: &mut Stage, name: &str) -> usize {
    let mut grabbed = 0;
    for _ in 0..150 {
        grabbed += 1 - put_off(&of(&stage.say(name, "token grab /lab/key"), &[name]));
        stage.say(name, "token release /lab/key");
    }
    grabbed
}

#[test]
fn a_slow_device_hears_less_often_of_who_takes_its_token() {
    for (pace, at_once, in_a_second) in [(None, 100, 20), (Some(60_000), 37, 9), (Some(6000), 4, 0)] {
        let mut stage = with_device(pace);
        stage.enter("alice", 1);
        stage.enter("bob", 1);
        assert_eq!(grabs(&mut stage, "alice"), at_once, "{pace:?}");
        assert_eq!(
            grabs(&mut stage, "bob"),
            at_once,
            "each user has his own, {pace:?}"
        );
        stage.at(1000);
        assert_eq!(grabs(&mut stage, "alice"), in_a_second, "{pace:?}");
        let error = stage.say("alice", "token grab /lab/key");
        assert_eq!(put_off(&error), 1);
        // As long as it says, and no longer.
        stage.at(2100);
        assert_eq!(put_off(&stage.say("alice", "token grab /lab/key")), 0, "{pace:?}");
    }
}

/// Hundreds of one user that wait for a token, and are gone when they have it, are not granted it all in one moment:
/// others have their turn.
#[test]
fn who_had_it_too_often_waits_behind_others() {
    let mut stage = with_device(None);
    stage.enter("carol", 1);
    stage.enter("bob", 1);
    stage.say("carol", "token grab /lab/key");
    for number in 0..300 {
        let name = format!("bob-{number}");
        stage.enter_for("bob", &name);
        stage.say(&name, "token grab /lab/key wait=60000");
    }
    stage.enter("dave", 1);
    stage.say("dave", "token grab /lab/key wait=60000");
    let mut heard = stage.say("carol", "token release /lab/key");
    let (mut grants, mut dave) = (0, 0);
    loop {
        let granted = |line: &&String| line.starts_with("bob-") && line.contains("< ok");
        let next = heard
            .iter()
            .find(granted)
            .map(|line| line.split('<').next().unwrap_or_default().to_owned());
        dave += usize::from(heard.iter().any(|line| line.starts_with("dave< ok")));
        let Some(name) = next else {
            break;
        };
        grants += 1;
        heard = stage.gone(&name);
    }
    assert_eq!((grants, dave), (100, 1), "{heard:?}");
    let heard = stage.say("dave", "token release /lab/key");
    assert!(!heard.iter().any(|line| line.contains("grabbed")), "{heard:?}");
    // They wait on, and have it when it is their turn again.
    let heard = stage.at_micros(51 * MS);
    assert_eq!(
        heard
            .iter()
            .filter(|line| line.starts_with("bob-") && line.contains("< ok"))
            .count(),
        1,
        "{heard:?}"
    );
}

/// A turn that ends a little later than the owner was told is not told each time.
#[test]
fn who_waits_and_gives_up_again_and_again_does_not_fill_what_waits_for_the_owner() {
    let mut token = level_or_lease(60_000, "lazy");
    let mut manager = token
        .get("manager")
        .and_then(|manager| manager.as_map().cloned())
        .expect("a map");
    manager = manager.with("hold", 1000).with("notice", 10);
    token.set("manager", manager);
    let mut stage = Stage::new(lab(token));
    stage.enter("alice", 1);
    stage.enter("bob", 1);
    stage.say("alice", "token grab /lab/key");
    stage.at(5000);
    let mut notices = 0;
    for round in 0..4000 {
        stage.at(5000 + round);
        let heard = of(&stage.say("bob", "token grab /lab/key wait=1"), &["alice"]);
        notices += heard.iter().filter(|line| line.contains("notice")).count();
    }
    assert!((1..=5).contains(&notices), "{notices} in 4 s");
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

/// It does not matter whether the token moves a device: a peer that is told may be one elsewhere, or own something.
#[test]
fn a_token_that_moves_nothing_is_counted_where_a_device_or_an_owner_hears_of_it() {
    let mut contexts = lab(Map::new());
    contexts.push(context("/lab/other", "token"));
    contexts[2].set("pace", 6000);
    let all = |stage: &mut Stage, name: &str| {
        let mut grabbed = 0;
        for _ in 0..150 {
            grabbed += 1 - put_off(&of(&stage.say(name, "token grab /lab/other"), &[name]));
            stage.say(name, "token release /lab/other");
        }
        grabbed
    };
    let mut stage = Stage::new(contexts);
    for name in ["alice", "bob", "carol"] {
        stage.enter(name, 1);
    }
    stage.say("alice", "context join /lab/other");
    assert_eq!(
        all(&mut stage, "bob"),
        150,
        "nobody hears of it to whom it matters"
    );
    stage.at(60_000);
    stage.say("alice", "token grab /lab/key");
    assert_eq!(all(&mut stage, "bob"), 100, "alice owns something");
    stage.say("alice", "token release /lab/key");
    stage.arrive("arm", 1);
    stage.say("arm", "context join /lab");
    stage.say("arm", "context join /lab/other");
    stage.say("arm", "context join /lab/arm device=true");
    assert_eq!(all(&mut stage, "carol"), 4, "and it reads 6000 bytes a second");
    stage.say("arm", "context leave /lab/arm");
    assert_eq!(all(&mut stage, "carol"), 150, "it is none any more");
}

/// What one user wants of one peer, by whatever verb, by whatever peer of his and about whatever token.
#[test]
fn wishes_of_one_user_to_one_peer_are_counted_together() {
    let mut contexts = lab(Map::new());
    contexts[2].set("pace", 6000);
    contexts.extend((0..150).map(|number| context(&format!("/lab/token-{number}"), "token")));
    let mut stage = Stage::new(contexts);
    stage.enter("alice", 1);
    stage.arrive("arm", 1);
    stage.say("arm", "context join /lab");
    stage.say("arm", "context join /lab/arm device=true");
    let mut offered = 0;
    for number in 0..150 {
        let (name, token) = (format!("bob-{number}"), format!("/lab/token-{number}"));
        stage.enter_for("bob", &name);
        stage.say(&name, &format!("token grab {token}"));
        let heard = stage.say(&name, &format!("token give {token} to=arm within=1"));
        offered += of(&heard, &["arm"])
            .iter()
            .filter(|line| line.contains("offer"))
            .count();
    }
    assert_eq!(offered, 100);
    stage.enter("carol", 1);
    stage.say("carol", "token grab /lab/key");
    let heard = stage.say("carol", "token give /lab/key to=arm");
    assert!(
        of(&heard, &["arm"]).iter().any(|line| line.contains("offer")),
        "{heard:?}"
    );
}

/// A stop is never put off; an unstop is, and the device stands meanwhile.
#[test]
fn who_lifts_stops_all_the_time_is_told_to_try_later() {
    let mut stage = with_device(Some(6000));
    stage.enter("bob", 1);
    let (mut stops, mut unstops) = (0, 0);
    for number in 1..=50 {
        let heard = of(&stage.say("bob", "context stop /lab/arm within=0"), &["bob"]);
        stops += usize::from(heard.iter().any(|line| line.starts_with("bob< ok")));
        let unstop = format!("context unstop /lab/arm within=0 number={number}");
        let heard = of(&stage.say("bob", &unstop), &["bob"]);
        unstops += usize::from(heard.iter().any(|line| line.starts_with("bob< ok")));
    }
    assert_eq!((stops, unstops), (50, 15));
}

/// A slow device hears no more of a user for being a member of many tokens, whatever he does there.
#[test]
fn a_slow_device_at_many_tokens_hears_as_much_as_at_one() {
    let mut contexts = lab(Map::new());
    contexts[2].set("pace", 6000);
    contexts.extend((0..18).map(|number| context(&format!("/lab/token-{number}"), "token")));
    let mut stage = Stage::new(contexts);
    stage.arrive("arm", 1);
    stage.say("arm", "context join /lab");
    stage.say("arm", "context join /lab/arm device=true");
    for number in 0..18 {
        stage.say("arm", &format!("context join /lab/token-{number}"));
    }
    stage.enter("bob", 1);
    stage.at(60_000);
    let mut grabbed = 0;
    for round in 0..100_u64 {
        stage.at(60_000 + 100 * round);
        for number in 0..18 {
            let heard = of(
                &stage.say("bob", &format!("token grab /lab/token-{number}")),
                &["arm"],
            );
            grabbed += heard.iter().filter(|line| line.contains("grabbed")).count();
            stage.say("bob", &format!("token release /lab/token-{number}"));
        }
    }
    // Of ten seconds: half a second's at once, and an eighth then.
    assert!((4..=14).contains(&grabbed), "{grabbed}");
}
