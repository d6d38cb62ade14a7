//! What is large is done in steps, and what one user has made is counted.

use mom_hub::{Effect, Input, Settings, User};
use mom_managers::Registry;
use mom_proto::{Family, Limit, Limits, Map, Parcel, Path, Value};

use crate::stage::{MS, Stage, context, of};

/// What one input may cost, in contexts touched and peers told.
const MOST: usize = 800;

fn lab(limits: Limits) -> Stage {
    let settings = Settings {
        limits,
        ..Settings::default()
    };
    let contexts = vec![context("/lab", "session").with("presence", "none")];
    let mut stage = Stage::with(contexts, Registry::builtin(), settings);
    stage.enter("alice", 1);
    stage.enter("bob", 1);
    stage
}

/// Sessions of tokens, of which alice owns some.
fn yard(stage: &mut Stage, sessions: usize, tokens: usize) {
    stage.say("alice", "context create /lab/yard kind=session");
    stage.say("alice", "context join /lab/yard");
    stage.say("bob", "context join /lab/yard");
    for session in 0..sessions {
        stage.say(
            "alice",
            &format!("context create /lab/yard/s{session} kind=session"),
        );
        stage.say("alice", &format!("context join /lab/yard/s{session}"));
        for token in 0..tokens {
            let path = format!("/lab/yard/s{session}/t{token}");
            stage.say("alice", &format!("context create {path} kind=token"));
            if token % 10 == 0 {
                stage.say("alice", &format!("token grab {path}"));
            }
        }
    }
}

/// Peers told, members routed, and other effects of the last input.
fn cost(stage: &Stage) -> usize {
    let one = |effect: &Effect| match effect {
        Effect::Deliver { to, .. } => to.len(),
        Effect::Route(route) => route.members.len(),
        _ => 1,
    };
    stage.effects.iter().map(one).sum()
}

#[test]
fn much_is_deleted_in_steps_and_closed_meanwhile() {
    let mut stage = lab(Limits::default());
    yard(&mut stage, 10, 100);
    let mut heard = of(&stage.say("alice", "context delete /lab/yard"), &["alice"]);
    assert!(!heard.contains(&"alice< ok".to_owned()), "not at once");
    assert_eq!(
        stage.say("bob", "context lookup /lab/yard"),
        ["bob< unknown-path"]
    );
    assert_eq!(
        stage.say("bob", "token grab /lab/yard/s9/t9"),
        ["bob< unknown-path"]
    );
    let create = "context create /lab/yard/new kind=channel";
    assert_eq!(stage.say("bob", create), ["bob< unknown-path"]);
    let mut steps = 0;
    while !heard.contains(&"alice< ok".to_owned()) {
        let deadline = stage.hub.deadline().expect("it goes on");
        heard.extend(of(&stage.at_micros(deadline), &["alice"]));
        steps += 1;
        assert!(cost(&stage) <= MOST, "step {steps} costs {}", cost(&stage));
        assert!(steps < 500);
    }
    assert!(steps >= 10, "{steps} steps");
    let place = |word: &str| heard.iter().position(|line| line.starts_with(word));
    let count = |word: &str| heard.iter().filter(|line| line.starts_with(word)).count();
    assert_eq!((count("alice< released"), count("alice< deleted")), (100, 1_011));
    let last = heard.iter().rposition(|line| line.contains("released"));
    assert!(
        last < place("alice< deleted"),
        "all tokens are lost before the first context goes"
    );
}

#[test]
fn a_long_list_comes_in_pages() {
    let mut stage = lab(Limits::default());
    for number in 0..600 {
        stage.say("alice", &format!("context create /lab/c{number:03} kind=channel"));
    }
    let mut names = Vec::new();
    let mut after: Option<Value> = None;
    for _ in 0..6 {
        let mut list = Parcel::new(Family::Context, "list").context(Path::parse("/lab").expect("a path"));
        if let Some(after) = &after {
            list = list.content(Map::new().with("after", after.clone()));
        }
        let content = ask(&mut stage, list);
        let children = content
            .get("children")
            .and_then(Value::as_list)
            .expect("children");
        assert!(children.len() <= 128);
        names.extend(
            children
                .iter()
                .filter_map(|child| child.get("name")?.as_str().map(str::to_owned)),
        );
        after = content.get("next").cloned();
        assert_eq!(content.get("more"), after.as_ref().map(|_| &Value::Bool(true)));
        if after.is_none() {
            break;
        }
    }
    let all: Vec<String> = (0..600).map(|number| format!("c{number:03}")).collect();
    assert_eq!(names, all);
}

#[test]
fn many_members_come_in_pages() {
    let mut stage = lab(Limits::default());
    for number in 0..172 {
        stage.enter(&format!("peer{number}"), 1);
    }
    let members = |content: &Value| {
        content
            .get("members")
            .and_then(Value::as_list)
            .map(<[Value]>::len)
    };
    let list = || Parcel::new(Family::Context, "members").context(Path::parse("/lab").expect("a path"));
    let first = ask(&mut stage, list());
    assert_eq!(members(&first), Some(128));
    let next = first.get("next").cloned().expect("there are more");
    let second = ask(&mut stage, list().content(Map::new().with("after", next)));
    assert_eq!((members(&second), second.get("more")), (Some(46), None));
}

/// The content of the answer to a request of alice.
fn ask(stage: &mut Stage, parcel: Parcel) -> Value {
    let mut request = stage.request("alice", "context list /lab");
    if let Input::Request { parcel: asked, .. } = &mut request {
        **asked = parcel;
    }
    stage.give(request);
    let answer = stage.effects.iter().find_map(|effect| match effect {
        Effect::Reply { parcel, .. } => Some(parcel.value()),
        _ => None,
    });
    answer.expect("an answer")
}

#[test]
fn one_user_makes_so_many_contexts_and_others_may_go_on() {
    let mut stage = lab(Limits {
        user_contexts: Limit::At(3),
        ..Limits::default()
    });
    for number in 0..3 {
        stage.say("alice", &format!("context create /lab/c{number} kind=channel"));
    }
    assert_eq!(
        stage.say("alice", "context create /lab/more kind=channel"),
        ["alice< full rule=user-contexts"]
    );
    let heard = stage.say("bob", "context create /lab/more kind=channel");
    assert_eq!(of(&heard, &["bob"]).last().map(String::as_str), Some("bob< ok"));
    stage.say("alice", "context delete /lab/c0");
    let heard = stage.say("alice", "context create /lab/again kind=channel");
    assert_eq!(
        of(&heard, &["alice"]).last().map(String::as_str),
        Some("alice< ok")
    );
}

/// alice and others in many channels; alice owns some tokens there. Presence is told.
fn crowd(stage: &mut Stage) {
    stage.say("alice", "context create /lab/hall kind=session");
    let others: Vec<String> = (0..20).map(|number| format!("peer{number}")).collect();
    for other in &others {
        stage.enter(other, 1);
    }
    let mut all: Vec<&str> = others.iter().map(String::as_str).collect();
    all.extend(["alice", "bob"]);
    for peer in &all {
        stage.say(peer, "context join /lab/hall");
    }
    for channel in 0..200 {
        let path = format!("/lab/hall/c{channel}");
        stage.say("alice", &format!("context create {path} kind=channel"));
        for peer in &all {
            stage.say(peer, &format!("context join {path}"));
        }
    }
    for token in 0..20 {
        let path = format!("/lab/hall/t{token}");
        stage.say("alice", &format!("context create {path} kind=token"));
        stage.say("alice", &format!("token grab {path}"));
        stage.say("bob", &format!("context join {path}"));
    }
}

/// Goes on until `who` has heard `last`; gives what it has heard, and how many steps it took.
fn go_on(stage: &mut Stage, who: &str, mut heard: Vec<String>, last: &str) -> (Vec<String>, usize) {
    let mut steps = 0;
    while !heard.iter().any(|line| line.starts_with(last)) {
        assert!(cost(stage) <= MOST, "step {steps} costs {}", cost(stage));
        let deadline = stage.hub.deadline().expect("it goes on");
        heard.extend(of(&stage.at_micros(deadline), &[who]));
        steps += 1;
        assert!(steps < 500, "{heard:?}");
    }
    (heard, steps)
}

/// Where everybody hears of everybody, who leaves costs as much as there are members and contexts.
#[test]
fn who_is_in_many_contexts_goes_in_steps() {
    let mut stage = lab(Limits::default());
    crowd(&mut stage);
    let heard = of(&stage.say("alice", "login logout /"), &["bob"]);
    let count = |heard: &[String], word: &str| heard.iter().filter(|line| line.starts_with(word)).count();
    assert_eq!(count(&heard, "bob< released"), 20, "first all is safe: {heard:?}");
    assert!(count(&heard, "bob< left") < 200, "{heard:?}");
    // The way is free for others at once, and a leaving peer may do nothing more.
    let grabbed = stage.say("bob", "token grab /lab/hall/t7");
    assert!(
        grabbed.iter().any(|line| line.starts_with("bob< ok")),
        "{grabbed:?}"
    );
    assert_eq!(
        stage.say("alice", "token grab /lab/hall/t8"),
        ["alice< try-later"]
    );
    let (_, steps) = go_on(&mut stage, "alice", heard, "alice< ok");
    assert!(steps >= 4, "{steps} steps");
    assert_eq!(
        stage.say("alice", "context lookup /lab"),
        ["alice< not-logged-in"]
    );
}

#[test]
fn much_is_left_in_steps() {
    let mut stage = lab(Limits::default());
    crowd(&mut stage);
    let heard = of(&stage.say("alice", "context leave /lab/hall"), &["alice"]);
    assert!(!heard.contains(&"alice< ok".to_owned()), "not at once");
    assert_eq!(
        stage.say("alice", "context join /lab/hall/c7"),
        ["alice< try-later"]
    );
    assert_eq!(stage.say("alice", "context lookup /lab"), ["alice< ok"]);
    let (_, steps) = go_on(&mut stage, "alice", heard, "alice< ok");
    assert!(steps >= 4, "{steps} steps");
    let again = stage.say("alice", "context join /lab/hall");
    assert!(again.contains(&"alice< ok".to_owned()), "{again:?}");
}

#[test]
fn whoever_puts_out_is_answered_at_the_end() {
    let mut stage = lab(Limits::default());
    crowd(&mut stage);
    let heard = of(&stage.say("bob", "context expel / peer=alice"), &["bob"]);
    assert!(!heard.contains(&"bob< ok".to_owned()), "not at once");
    assert_eq!(stage.say("alice", "context lookup /lab"), ["alice< try-later"]);
    let (heard, steps) = go_on(&mut stage, "bob", heard, "bob< ok");
    assert!(steps >= 4, "{steps} steps");
    assert!(
        heard.iter().any(|line| line.starts_with("bob< expelled")),
        "{heard:?}"
    );
    assert_eq!(
        stage.say("alice", "context lookup /lab"),
        ["alice< not-logged-in"]
    );
}

/// A peer that is cut off while it leaves is gone in the end, too, and its name is free again.
#[test]
fn who_is_cut_off_on_its_way_out_is_gone() {
    let mut stage = lab(Limits::default());
    crowd(&mut stage);
    let heard = of(&stage.say("alice", "context leave /lab/hall"), &["alice"]);
    assert!(!heard.contains(&"alice< ok".to_owned()), "not at once");
    let alice = stage.peer("alice");
    stage.gone("alice");
    assert!(stage.hub.peer_name(alice).is_some(), "not at once");
    for _ in 0..500 {
        match stage.hub.deadline() {
            Some(deadline) => drop(stage.at_micros(deadline)),
            None => break,
        }
    }
    stage.hub.check();
    assert_eq!(stage.hub.peer_name(alice), None);
    stage.enter("alice", 1);
    let again = stage.peer("alice");
    assert_eq!(stage.hub.peer_name(again).as_deref(), Some("alice"));
}

/// Another user must inherit nothing, so it does not come before all is left.
#[test]
fn who_is_in_many_contexts_becomes_nobody_else_at_once() {
    let mut stage = lab(Limits::default());
    crowd(&mut stage);
    let alice = stage.peer("alice");
    let carol = User {
        name: "carol".to_owned(),
        level: 1,
        groups: Vec::new(),
        details: Map::new(),
    };
    let heard = of(&stage.login(alice, carol), &["carol"]);
    assert_eq!(heard.last().map(String::as_str), Some("carol< try-later"));
    let closes = |effect: &Effect| matches!(effect, Effect::Close { peer, .. } if *peer == alice);
    assert!(stage.effects.iter().any(closes));
    assert_eq!(stage.hub.peer_name(alice).as_deref(), Some("alice"));
}

/// Part of threat 38: ten thousand contexts, each with a manager of 60 KiB, would be more than half a gigabyte.
#[test]
fn one_user_writes_so_many_bytes_of_managers() {
    let mut stage = lab(Limits::default());
    let mut users: Vec<Value> = (0..6_000)
        .map(|user| Value::from(format!("user{user}")))
        .collect();
    users.push("alice".into());
    let rule = Map::new().with("allow", vec!["*".into()]).with("users", users);
    let manager = Map::new()
        .with("kind", "roles")
        .with("rules", vec![Value::Map(rule)]);
    let create = |stage: &mut Stage, who: &str, number: usize| {
        let mut request = stage.request(who, &format!("context create /lab/c{number} kind=channel"));
        if let Input::Request { parcel, .. } = &mut request {
            let content = Map::new()
                .with("kind", "channel")
                .with("manager", manager.clone());
            parcel.content = Some(content.into());
        }
        stage.give(request)
    };
    let mut made = 0;
    while create(&mut stage, "alice", made).contains(&"alice< ok".to_owned()) {
        made += 1;
        assert!(made < 100);
    }
    assert!((50..100).contains(&made), "{made}");
    assert_eq!(create(&mut stage, "alice", made), ["alice< full"]);
    let plain = stage.say("alice", "context create /lab/plain kind=channel");
    assert!(plain.contains(&"alice< ok".to_owned()), "{plain:?}");
    let others = create(&mut stage, "bob", made);
    assert!(others.contains(&"bob< ok".to_owned()), "{others:?}");
    stage.say("alice", "context delete /lab/c0");
    let again = create(&mut stage, "alice", 0);
    assert!(again.contains(&"alice< ok".to_owned()), "{again:?}");
}

/// Hundreds of one channel are cut off in one moment: all of them cost a few new routes, and who had a token gives it up at once.
#[test]
fn many_that_go_at_once_go_together() {
    let mut stage = lab(Limits::default());
    let make = "context create /lab/talk kind=channel presence=counts";
    stage.say("alice", make);
    stage.say("bob", "context join /lab/talk");
    stage.say("alice", "context create /lab/key kind=token");
    stage.say("bob", "context join /lab/key");
    let guests: Vec<String> = (0..600).map(|number| format!("guest{number}")).collect();
    for guest in &guests {
        stage.enter(guest, 1);
        stage.say(guest, "context join /lab/talk");
    }
    stage.say("guest500", "context join /lab/key");
    stage.say("guest500", "token grab /lab/key");
    stage.at(60_000);
    let mut all = 0;
    for guest in &guests {
        let heard = of(&stage.gone(guest), &["bob"]);
        all += cost(&stage);
        assert!(
            cost(&stage) <= MOST + guests.len(),
            "{guest} costs {}",
            cost(&stage)
        );
        let released = heard.iter().any(|line| line.starts_with("bob< released"));
        assert_eq!(released, guest == "guest500", "{guest}: {heard:?}");
    }
    let mut steps = 0;
    while stage
        .hub
        .deadline()
        .is_some_and(|deadline| deadline < 60_500 * MS)
    {
        let deadline = stage.hub.deadline().expect("it goes on");
        stage.at_micros(deadline);
        all += cost(&stage);
        assert!(
            cost(&stage) <= MOST + guests.len(),
            "step {steps} costs {}",
            cost(&stage)
        );
        steps += 1;
    }
    assert!((10..150).contains(&steps), "{steps} steps");
    // One new route for each would be 180 000.
    assert!(all < 50_000, "they cost {all}");
    let here = ask(
        &mut stage,
        Parcel::new(Family::Context, "info").context(Path::parse("/lab/talk").expect("a path")),
    );
    assert_eq!(here.get("members"), Some(&Value::Int(1)));
}
