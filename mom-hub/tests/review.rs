//! Ways around the rules of tokens and managers that were once open.

use std::sync::Arc;

use mom_hub::{Effect, Hub, Input, PeerId, Settings, User};
use mom_managers::{Micros, Registry};
use mom_proto::{Family, Map, Parcel, Path, Value, from_value};

const ALICE: u64 = 1;
const BOB: u64 = 2;
const CAROL: u64 = 3;

fn login(hub: &mut Hub, peer: u64, name: &str, level: i32) {
    let user = User {
        name: name.to_owned(),
        level,
        groups: Vec::new(),
        details: Map::new(),
    };
    let login = Input::Login {
        peer: PeerId(peer),
        user,
        nickname: None,
        id: Some(1),
    };
    hub.handle(0, login, &mut Vec::new());
    hub.check();
}

/// A hub of this configuration with alice, bob and carol, all of level 1.
fn hub(contexts: &[Map]) -> Hub {
    let specs: Vec<_> = contexts
        .iter()
        .map(|spec| from_value(Value::Map(spec.clone())).expect("a context"))
        .collect();
    let mut hub = Hub::new(Settings::default(), Registry::builtin(), &"open".into(), &specs).expect("a hub");
    for (peer, name) in [(ALICE, "alice"), (BOB, "bob"), (CAROL, "carol")] {
        login(&mut hub, peer, name, 1);
    }
    hub
}

fn spec(path: &str, kind: &str) -> Map {
    Map::new().with("path", path).with("kind", kind)
}

fn ask_at(hub: &mut Hub, now: Micros, peer: u64, request: &str, path: &str, content: Map) -> Vec<Effect> {
    let (family, name) = request.split_once(' ').expect("family and name");
    let parcel = Parcel::new(Family::from_word(family).expect("a family"), name)
        .context(Path::parse(path).expect("a path"))
        .content(content)
        .id(7);
    let mut effects = Vec::new();
    let (peer, parcel) = (PeerId(peer), Box::new(parcel));
    hub.handle(now, Input::Request { peer, parcel }, &mut effects);
    hub.check();
    effects
}

fn ask(hub: &mut Hub, peer: u64, request: &str, path: &str, content: Map) -> Vec<Effect> {
    ask_at(hub, 0, peer, request, path, content)
}

/// The one answer that a peer got: `ok`, or the word of an error.
fn answer(effects: &[Effect], peer: u64) -> String {
    let mut answers = effects.iter().filter_map(|effect| match effect {
        Effect::Reply { to, parcel } if *to == PeerId(peer) => Some(parcel.name().to_owned()),
        _ => None,
    });
    let answer = answers.next().unwrap_or_else(|| "nothing".to_owned());
    assert_eq!(answers.next(), None, "answered once");
    answer
}

/// What a peer was told of: content of the events, or questions, of this name.
fn told(effects: &[Effect], peer: u64, name: &str) -> Vec<Arc<Parcel>> {
    let told = effects.iter().filter_map(|effect| match effect {
        Effect::Deliver { to, parcel } if to.contains(&PeerId(peer)) && parcel.name() == name => {
            Some(Arc::clone(parcel))
        }
        _ => None,
    });
    told.collect()
}

fn owner(hub: &mut Hub, now: Micros, path: &str) -> Option<String> {
    let effects = ask_at(hub, now, CAROL, "token info", path, Map::new());
    effects.iter().find_map(|effect| match effect {
        Effect::Reply { parcel, .. } => Some(parcel.value().get("owner")?.as_str()?.to_owned()),
        _ => None,
    })
}

fn ok(hub: &mut Hub, peer: u64, request: &str, path: &str, content: Map) -> Vec<Effect> {
    let effects = ask(hub, peer, request, path, content);
    assert_eq!(answer(&effects, peer), "ok", "{request} {path}: {effects:?}");
    effects
}

fn lab() -> Hub {
    let manager = Map::new().with("kind", "first-come");
    let mut hub = hub(&[
        spec("/lab", "session"),
        spec("/lab/key", "token").with("manager", manager),
    ]);
    for peer in [ALICE, BOB, CAROL] {
        ok(&mut hub, peer, "context join", "/lab", Map::new());
    }
    hub
}

/// Alice owns the key and lends it to Bob for a minute.
fn lent() -> Hub {
    let mut hub = lab();
    ok(&mut hub, ALICE, "token grab", "/lab/key", Map::new());
    let give = Map::new().with("to", "bob").with("for", 60_000);
    ok(&mut hub, ALICE, "token give", "/lab/key", give);
    ok(&mut hub, BOB, "token accept", "/lab/key", Map::new());
    assert_eq!(owner(&mut hub, 0, "/lab/key").as_deref(), Some("bob"));
    hub
}

#[test]
fn what_is_lent_is_not_handed_on_to_who_asks() {
    let mut hub = lent();
    let asked = ask(&mut hub, CAROL, "token request", "/lab/key", Map::new());
    assert_eq!(answer(&asked, CAROL), "nothing", "yet");
    let accepted = ask(
        &mut hub,
        BOB,
        "token accept",
        "/lab/key",
        Map::new().with("peer", "carol"),
    );
    assert_eq!(answer(&accepted, BOB), "denied");
    assert_eq!(owner(&mut hub, 0, "/lab/key").as_deref(), Some("bob"));
}

#[test]
fn another_user_on_the_same_connection_inherits_nothing() {
    let mut hub = lent();
    let managed = Map::new().with("kind", "session").with("manager", "self");
    ok(&mut hub, ALICE, "context create", "/hers", managed);
    let rule = |verb: &str| Map::new().with("allow", vec![Value::from(verb)]);
    let rules = vec![
        Value::from(rule("join").with("invited", true)),
        Value::from(rule("*").with("users", vec![Value::from("bob")])),
    ];
    let manager = Map::new().with("kind", "roles").with("rules", rules);
    let club = Map::new().with("kind", "session").with("manager", manager);
    ok(&mut hub, BOB, "context create", "/club", club);
    ok(&mut hub, BOB, "context join", "/club", Map::new());
    let alice = Map::new().with("peer", "alice");
    ok(&mut hub, BOB, "context invite", "/club", alice);
    login(&mut hub, ALICE, "mallory", 1);
    let joined = ask(&mut hub, ALICE, "context join", "/club", Map::new());
    assert_eq!(answer(&joined, ALICE), "denied", "she was not invited");
    let joined = ask(&mut hub, ALICE, "context join", "/hers", Map::new());
    assert_ne!(answer(&joined, ALICE), "ok", "she did not make it");
    ok(&mut hub, ALICE, "context join", "/lab", Map::new());
    ok(&mut hub, BOB, "token release", "/lab/key", Map::new());
    assert_eq!(owner(&mut hub, 0, "/lab/key"), None, "she lent nothing");
}

/// Bob owns a token on whose handing over a chair has a say, and Carol asks him for it.
fn moderated(chairs: &str) -> Hub {
    let chairs = Map::new().with("users", vec![Value::from(chairs)]);
    let verbs = vec![Value::from("accept")];
    let manager = Map::new()
        .with("kind", "moderated")
        .with("chairs", chairs)
        .with("verbs", verbs);
    let mut hub = hub(&[
        spec("/lab", "session"),
        spec("/lab/key", "token").with("manager", manager),
    ]);
    for peer in [ALICE, BOB, CAROL] {
        ok(&mut hub, peer, "context join", "/lab", Map::new());
    }
    ok(&mut hub, BOB, "token grab", "/lab/key", Map::new());
    ask(&mut hub, CAROL, "token request", "/lab/key", Map::new());
    hub
}

#[test]
fn a_chair_is_asked_about_who_gains_the_token() {
    let mut hub = moderated("alice");
    let carol = Map::new().with("peer", "carol");
    let accepted = ask(&mut hub, BOB, "token accept", "/lab/key", carol.clone());
    assert_eq!(answer(&accepted, BOB), "nothing", "yet");
    let asked = told(&accepted, ALICE, "consult");
    assert_eq!(asked.len(), 1);
    let about = asked[0].value();
    assert_eq!(about.get("peer").and_then(Value::as_str), Some("carol"));
    let done = answer_yes(&mut hub, ALICE, &accepted);
    assert_eq!(
        (answer(&done, BOB), answer(&done, CAROL)),
        ("ok".into(), "ok".into())
    );
    assert_eq!(owner(&mut hub, 0, "/lab/key").as_deref(), Some("carol"));
    // The owner is the chair, and says so itself.
    let mut hub = moderated("bob");
    let accepted = ask(&mut hub, BOB, "token accept", "/lab/key", carol);
    let done = answer_yes(&mut hub, BOB, &accepted);
    assert_eq!(answer(&done, CAROL), "ok");
}

#[test]
fn the_answer_of_one_managing_peer_is_none_of_another() {
    let mut hub = hub(&[]);
    let managed = |kind: &str| Map::new().with("kind", kind).with("manager", "self");
    ok(&mut hub, ALICE, "context create", "/hers", managed("session"));
    ok(&mut hub, ALICE, "context join", "/hers", Map::new());
    ok(
        &mut hub,
        ALICE,
        "context create",
        "/hers/key",
        Map::new().with("kind", "token"),
    );
    ok(&mut hub, BOB, "context create", "/his", managed("session"));
    let join = ask(&mut hub, CAROL, "context join", "/his", Map::new());
    answer_yes(&mut hub, BOB, &join);
    // Carol makes a channel at Bob's that Alice's key guards: that concerns Alice, too.
    let guard = Map::new()
        .with("token", "/hers/key")
        .with("names", vec![Value::from("command")]);
    let channel = Map::new().with("kind", "channel").with("guard", guard);
    let made = ask(&mut hub, CAROL, "context create", "/his/channel", channel);
    let made = answer_yes(&mut hub, BOB, &made);
    assert_eq!(answer(&made, CAROL), "nothing", "yet");
    let made = answer_yes(&mut hub, ALICE, &made);
    assert_eq!(answer(&made, CAROL), "ok");
}

/// A peer says yes to the one question that it was asked.
fn answer_yes(hub: &mut Hub, peer: u64, effects: &[Effect]) -> Vec<Effect> {
    let asked = told(effects, peer, "consult");
    assert_eq!(asked.len(), 1, "{effects:?}");
    let number = i64::try_from(asked[0].id.expect("a number")).expect("a small one");
    let verdict = Map::new().with("consult", number).with("allow", true);
    ask(hub, peer, "manager verdict", "/", verdict)
}
