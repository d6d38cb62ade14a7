//! Who may ask for audit, explain and what-if, and what the hub would answer now.

use mom_hub::{About, Case, Effect, Inquiry};
use mom_proto::{Code, ContextKind, Map, Path, Value, Verb};

use crate::stage::{Stage, context, lab, level_or_lease, user};

/// Alice and bob look and drive, carol may all; only carol may know of `/lab/secret`.
fn stage() -> Stage {
    let rule = |users: &[&str], allow: &[&str]| {
        let list = |words: &[&str]| words.iter().map(|word| Value::from(*word)).collect::<Vec<_>>();
        Value::Map(Map::new().with("users", list(users)).with("allow", list(allow)))
    };
    let all = rule(&["carol"], &["*"]);
    let look = rule(&["alice", "bob"], &["lookup", "info", "join", "grab"]);
    let people = Map::new()
        .with("kind", "roles")
        .with("rules", vec![all.clone(), look]);
    let secret = Map::new().with("kind", "roles").with("rules", vec![all]);
    let lease = level_or_lease(60_000, "lazy");
    let lease = lease.get("manager").cloned().expect("a manager");
    let drive = Map::new()
        .with("kind", "chain")
        .with("of", vec![Value::Map(people.clone()), lease]);
    let mut contexts = lab(Map::new().with("manager", drive));
    contexts[0] = contexts[0].clone().with("manager", people);
    contexts.push(context("/lab/secret", "session").with("manager", secret));
    let mut stage = Stage::new(contexts);
    for name in ["alice", "bob", "carol"] {
        stage.enter(name, 1);
    }
    stage
}

fn inquiry(stage: &Stage) -> Option<Inquiry> {
    stage.effects.iter().find_map(|effect| match effect {
        Effect::Inquire { inquiry, .. } => Some((**inquiry).clone()),
        _ => None,
    })
}

/// Whether it is let through.
fn may(stage: &mut Stage, who: &str, line: &str) -> bool {
    let heard = stage.say(who, line);
    match inquiry(stage) {
        Some(_) => true,
        None => {
            assert!(heard.iter().any(|line| line.contains("denied")), "{heard:?}");
            false
        }
    }
}

#[test]
fn each_is_a_right_of_its_own() {
    let mut stage = stage();
    for line in ["context audit /lab", "context explain /lab user=bob"] {
        assert!(may(&mut stage, "carol", line), "{line}");
        assert!(!may(&mut stage, "alice", line), "{line}");
    }
    let heard = stage.say("carol", "context what-if /lab");
    assert!(heard[0].contains("bad-slot"), "{heard:?}");
}

#[test]
fn everybody_may_ask_about_itself() {
    let mut stage = stage();
    let alice = stage.peer("alice");
    for line in [
        "context explain /lab",
        "context explain /lab user=alice",
        "context explain /lab peer=alice verb=grab",
    ] {
        assert!(may(&mut stage, "alice", line), "{line}");
        let Some(Inquiry::Explain(asked)) = inquiry(&stage) else {
            panic!("it asks")
        };
        assert_eq!(asked.about, [About::Peer(alice)]);
    }
    assert!(may(&mut stage, "carol", "context explain /lab user=dora"));
    let Some(Inquiry::Explain(asked)) = inquiry(&stage) else {
        panic!("it asks")
    };
    assert_eq!(asked.about, [About::User("dora".to_owned())]);
}

#[test]
fn what_cannot_be_explained_is_told() {
    let mut stage = stage();
    for (line, code) in [
        ("context explain /lab verb=ping", "bad-content"),
        ("context explain /lab verb=grib", "bad-content"),
        ("context explain /lab message=x", "bad-content"),
        ("context explain /lab kind=token", "bad-content"),
        ("context explain /lab verb=create kind=castle", "bad-content"),
        ("context explain /lab user=bob peer=bob", "bad-content"),
        ("context explain /lab peer=nobody", "unknown-peer"),
        ("context explain /lab colour=red", "bad-content"),
        ("context explain /nowhere", "unknown-path"),
    ] {
        let heard = stage.say("carol", line);
        assert!(heard[0].contains(code), "{line}: {heard:?}");
    }
    assert!(may(&mut stage, "carol", "context explain /lab/new verb=create"));
}

#[test]
fn what_is_hidden_is_explained_as_if_nothing_were_there() {
    let mut stage = stage();
    let mut hear = |line: &str, path: &str| {
        let heard = stage.say("alice", &format!("{line} {path}"));
        heard.join(" ").replace(path, "…")
    };
    assert_eq!(
        hear("context explain", "/lab/secret"),
        hear("context explain", "/lab/nobody")
    );
    let mut judge = |path: &str| {
        let (alice, path) = (stage.peer("alice"), Path::parse(path).expect("a path"));
        let who = user("alice", 1);
        let case = case(&who, Verb::Create, &path);
        let judged = stage
            .hub
            .appraise(0, alice, Some(alice), &case)
            .expect("it can be made");
        let text = judged
            .refusal
            .map(|error| error.to_string().replace(path.as_str(), "…"));
        (judged.place, judged.manager, text)
    };
    assert_eq!(judge("/lab/secret"), judge("/lab/nobody"));
    assert_eq!(judge("/lab/secret/new"), judge("/lab/nobody/new"));
    let (alice, carol) = (stage.peer("alice"), stage.peer("carol"));
    let mut hears = |peer, path: &str| stage.hub.may_audit(0, peer, &Path::parse(path).expect("a path"));
    assert!(hears(carol, "/lab/secret") && hears(carol, "/lab/gone"));
    assert!(!hears(alice, "/lab/secret") && !hears(alice, "/lab"));
}

fn case<'a>(user: &'a mom_hub::User, verb: Verb, path: &'a Path) -> Case<'a> {
    Case {
        user,
        verb,
        path,
        kind: Some(ContextKind::Session),
        message: None,
        owners: &[],
        invited: false,
    }
}

#[test]
fn the_hub_as_it_is_now_answers_and_stays_as_it_is() {
    let mut stage = stage();
    stage.say("bob", "token grab /lab/key");
    let path = Path::parse("/lab/key").expect("a path");
    let (alice, carol) = (stage.peer("alice"), stage.peer("carol"));
    let (who, dora) = (user("alice", 1), user("dora", 9));
    let before = format!("{:?}", stage.hub);
    let held = stage
        .hub
        .appraise(20_000_000, carol, Some(alice), &case(&who, Verb::Grab, &path));
    let held = held.and_then(|judged| judged.refusal).expect("bob has it");
    assert_eq!(held.code, Code::HELD);
    assert_eq!(held.get("owner"), Some(&"bob".into()));
    assert_eq!(held.retry_in(), Some(std::time::Duration::from_secs(40)));
    let denied = stage
        .hub
        .appraise(0, carol, None, &case(&dora, Verb::Grab, &path));
    let denied = denied
        .and_then(|judged| judged.refusal)
        .expect("no rule is for dora");
    assert_eq!(denied.code, Code::DENIED);
    assert_eq!(format!("{:?}", stage.hub), before);
    stage.hub.check();
    let nowhere = Path::parse("/lab/nowhere").expect("a path");
    assert_eq!(
        stage
            .hub
            .appraise(0, carol, None, &case(&dora, Verb::Join, &nowhere)),
        None
    );
}
