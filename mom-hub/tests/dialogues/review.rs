//! Ways around the rules of tokens and managers that were once open.

use std::sync::Arc;

use mom_hub::{Configuration, ContextSpec, Effect, Hub, Input, PeerId, Settings, Ticket, User};
use mom_managers::Registry;
use mom_proto::{Family, Map, Micros, Parcel, Path, Value, from_value};

const ALICE: u64 = 1;
const BOB: u64 = 2;
const CAROL: u64 = 3;

fn login(hub: &mut Hub, peer: u64, name: &str, level: i32) -> Vec<Effect> {
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
    let mut effects = Vec::new();
    hub.handle(0, login, &mut effects);
    hub.check();
    effects
}

/// A hub of this configuration with alice, bob and carol, all of level 1.
fn hub(contexts: &[Map]) -> Hub {
    hub_with(Settings::default(), contexts)
}

fn specs(contexts: &[Map]) -> Vec<ContextSpec> {
    let spec = |spec: &Map| from_value(Value::Map(spec.clone())).expect("a context");
    contexts.iter().map(spec).collect()
}

fn hub_with(settings: Settings, contexts: &[Map]) -> Hub {
    let specs = specs(contexts);
    let mut hub = Hub::new(settings, Registry::builtin(), &"open".into(), &specs).expect("a hub");
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
    hub.handle(
        now,
        Input::Request {
            peer,
            parcel,
            clock: None,
        },
        &mut effects,
    );
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
    lab_with(Settings::default())
}

/// As [`lab`], where a grant has to be stored before.
fn durable_lab() -> Hub {
    lab_with(Settings {
        durable: true,
        ..Settings::default()
    })
}

fn lab_with(settings: Settings) -> Hub {
    let manager = Map::new().with("kind", "first-come");
    let contexts = [
        spec("/lab", "session"),
        spec("/lab/key", "token").with("manager", manager),
    ];
    let mut hub = hub_with(settings, &contexts);
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
    assert_eq!(answer(&joined, ALICE), "unknown-path", "she was not invited");
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

/// The record that a grant waits for.
fn storing(effects: &[Effect]) -> Ticket {
    let ticket = effects.iter().find_map(|effect| match effect {
        Effect::Store { ticket, .. } => *ticket,
        _ => None,
    });
    ticket.expect("a record to be stored")
}

fn stored(hub: &mut Hub, ticket: Ticket) -> Vec<Effect> {
    let mut effects = Vec::new();
    hub.handle(0, Input::Stored { ticket, ok: true }, &mut effects);
    hub.check();
    effects
}

#[test]
fn who_leaves_while_its_grant_is_stored_does_not_have_it_when_it_is_back() {
    let mut hub = durable_lab();
    let grabbed = ask(&mut hub, ALICE, "token grab", "/lab/key", Map::new());
    let ticket = storing(&grabbed);
    let left = ask(&mut hub, ALICE, "context leave", "/lab", Map::new());
    let refused = left
        .iter()
        .filter(|effect| matches!(effect, Effect::Reply { parcel, .. } if parcel.name() == "not-member"));
    assert_eq!(refused.count(), 1, "the grab");
    ok(&mut hub, ALICE, "context join", "/lab", Map::new());
    stored(&mut hub, ticket);
    assert_eq!(owner(&mut hub, 0, "/lab/key"), None);
}

fn configure(hub: &mut Hub, manager: Map) -> Vec<Effect> {
    let key = spec("/lab/key", "token").with("manager", manager);
    configure_with(hub, &[spec("/lab", "session"), key])
}

fn configure_with(hub: &mut Hub, contexts: &[Map]) -> Vec<Effect> {
    let configuration = Configuration {
        registry: Registry::builtin(),
        root: "open".into(),
        contexts: specs(contexts),
        limits: Settings::default().limits,
        users: Vec::new(),
    };
    let mut effects = Vec::new();
    hub.handle(0, Input::Configure(Box::new(configuration)), &mut effects);
    hub.check();
    effects
}

#[test]
fn a_right_that_ends_while_a_grant_is_stored_ends_the_grant() {
    let mut hub = durable_lab();
    let grabbed = ask(&mut hub, ALICE, "token grab", "/lab/key", Map::new());
    let ticket = storing(&grabbed);
    let effects = configure(&mut hub, Map::new().with("kind", "closed"));
    assert_eq!(answer(&effects, ALICE), "denied");
    let effects = stored(&mut hub, ticket);
    assert_eq!(answer(&effects, ALICE), "nothing", "more");
    let manager = Map::new().with("kind", "first-come");
    configure(&mut hub, manager);
    assert_eq!(owner(&mut hub, 0, "/lab/key"), None);
}

#[test]
fn a_deadman_time_of_a_new_configuration_holds_for_the_owner_of_now() {
    let mut hub = lab();
    ok(&mut hub, ALICE, "token grab", "/lab/key", Map::new());
    configure(&mut hub, Map::new().with("kind", "queue").with("deadman", 1000));
    assert_eq!(hub.deadline(), Some(1_000_000));
    hub.handle(1_000_000, Input::Tick, &mut Vec::new());
    hub.check();
    assert_eq!(owner(&mut hub, 1_000_000, "/lab/key"), None);
}

#[test]
fn a_longer_lease_of_a_new_configuration_is_stored() {
    let mut hub = durable_lab();
    let grabbed = ask(&mut hub, ALICE, "token grab", "/lab/key", Map::new());
    let ticket = storing(&grabbed);
    stored(&mut hub, ticket);
    let effects = configure(
        &mut hub,
        Map::new().with("kind", "first-come").with("lease", 600_000),
    );
    let lease = effects.iter().find_map(|effect| match effect {
        Effect::Store { record, .. } => record.lease,
        _ => None,
    });
    assert_eq!(lease, Some(600_000_000));
}

/// A thousand wait, and all of them are refused at once.
#[test]
fn a_great_queue_ends_without_a_storm() {
    for ending in ["delete", "closed"] {
        let mut hub = lab();
        let token = Map::new().with("kind", "token").with("manager", "queue");
        ok(&mut hub, ALICE, "context create", "/lab/other", token);
        ok(&mut hub, ALICE, "token grab", "/lab/other", Map::new());
        for peer in 10..1010 {
            login(&mut hub, peer, &format!("peer{peer}"), 1);
            ok(&mut hub, peer, "context join", "/lab", Map::new());
            let wait = Map::new().with("wait", "unlimited");
            ask(&mut hub, peer, "token grab", "/lab/other", wait);
        }
        let (effects, word) = match ending {
            "delete" => (
                ask(&mut hub, ALICE, "context delete", "/lab/other", Map::new()),
                "unknown-path",
            ),
            _ => {
                let closed = spec("/lab/other", "token").with("manager", "closed");
                (
                    configure_with(&mut hub, &[spec("/lab", "session"), closed]),
                    "denied",
                )
            }
        };
        assert!(effects.len() < 3500, "{ending}: {} effects", effects.len());
        assert!((10..1010).all(|peer| answer(&effects, peer) == word), "{ending}");
    }
}

#[test]
fn a_channel_that_another_token_guards_from_now_on_is_safe_first() {
    let guarded = |token: &str| {
        let guard = Map::new()
            .with("token", token)
            .with("names", vec![Value::from("command")]);
        [
            spec("/lab", "session"),
            spec("/lab/key", "token").with("manager", "first-come"),
            spec("/lab/other", "token").with("manager", "first-come"),
            spec("/lab/arm", "channel").with("guard", guard),
        ]
    };
    let mut hub = hub(&guarded("/lab/key"));
    for peer in [ALICE, CAROL] {
        ok(&mut hub, peer, "context join", "/lab", Map::new());
    }
    ok(&mut hub, BOB, "context join", "/lab", Map::new());
    ok(&mut hub, BOB, "context join", "/lab/arm", Map::new());
    ok(&mut hub, ALICE, "token grab", "/lab/key", Map::new());
    let same = configure_with(&mut hub, &guarded("/lab/key"));
    assert!(told(&same, BOB, "halt").is_empty(), "nothing has changed");
    let effects = configure_with(&mut hub, &guarded("/lab/other"));
    let halts = told(&effects, BOB, "halt");
    assert_eq!(
        (halts.len(), guard_in(&halts[1])),
        (2, Some("/lab/other".to_owned()))
    );
    assert_eq!(owner(&mut hub, 0, "/lab/key"), None);
}

/// The token that a `halt` says guards the channel from now on; empty if none does.
fn guard_in(halt: &Parcel) -> Option<String> {
    let content = halt.value();
    let guard = content.get("guard")?;
    let token = guard.get("token").and_then(Value::as_str);
    Some(token.unwrap_or_default().to_owned())
}

#[test]
fn what_runs_where_a_guard_appears_is_halted_and_who_is_there_learns_the_guard() {
    let guarded = |names: &[&str]| {
        let names: Vec<Value> = names.iter().map(|name| Value::from(*name)).collect();
        let arm = spec("/lab/arm", "channel");
        [
            spec("/lab", "session"),
            spec("/lab/key", "token").with("manager", "first-come"),
            match names.is_empty() {
                true => arm,
                false => arm.with("guard", Map::new().with("token", "/lab/key").with("names", names)),
            },
        ]
    };
    let mut hub = hub(&guarded(&[]));
    for peer in [ALICE, BOB] {
        ok(&mut hub, peer, "context join", "/lab", Map::new());
    }
    ok(&mut hub, BOB, "context join", "/lab/arm", Map::new());
    ok(&mut hub, ALICE, "token grab", "/lab/key", Map::new());
    let effects = configure_with(&mut hub, &guarded(&["command"]));
    let halts = told(&effects, BOB, "halt");
    assert_eq!(
        (halts.len(), guard_in(&halts[0])),
        (1, Some("/lab/key".to_owned()))
    );
    let content = halts[0].value();
    let guard = content.get("guard").expect("a guard");
    assert_eq!(guard.get("owner").and_then(Value::as_str), Some("alice"));
    assert!(guard.get("fence").is_some() && halts[0].fence.is_none());
    assert!(
        told(&configure_with(&mut hub, &guarded(&["command"])), BOB, "halt").is_empty(),
        "nothing has changed"
    );
    // More messages need the token from now on; then none does.
    let more = told(
        &configure_with(&mut hub, &guarded(&["command", "grip"])),
        BOB,
        "halt",
    );
    assert_eq!(more.len(), 1);
    let none = told(&configure_with(&mut hub, &guarded(&[])), BOB, "halt");
    assert_eq!(none.last().and_then(|halt| guard_in(halt)), Some(String::new()));
}

#[test]
fn what_waits_is_answered_before_another_user_is_there() {
    let mut hub = hub(&[]);
    let managed = Map::new().with("kind", "session").with("manager", "self");
    ok(&mut hub, ALICE, "context create", "/hers", managed);
    let join = ask(&mut hub, BOB, "context join", "/hers", Map::new());
    assert_eq!(answer(&join, BOB), "nothing", "yet");
    let effects = login(&mut hub, BOB, "mallory", 1);
    let replies = effects.iter().filter_map(|effect| match effect {
        Effect::Reply { parcel, .. } => Some(parcel.name()),
        _ => None,
    });
    assert_eq!(replies.collect::<Vec<_>>(), ["withdrawn", "ok"]);
}

/// Of one peer only a little waits, whatever its size.
#[test]
fn great_requests_do_not_wait_by_the_dozen() {
    let mut hub = hub(&[]);
    let managed = |kind: &str| Map::new().with("kind", kind).with("manager", "self");
    ok(&mut hub, ALICE, "context create", "/hers", managed("session"));
    let great = || Map::new().with("text", "x".repeat(1 << 20));
    let first = ask(&mut hub, BOB, "context join", "/hers", great());
    assert_eq!(answer(&first, BOB), "nothing", "yet");
    let second = ask(&mut hub, BOB, "context join", "/hers", great());
    assert_eq!(answer(&second, BOB), "try-later");
    let other = ask(&mut hub, CAROL, "context join", "/hers", great());
    assert_eq!(answer(&other, CAROL), "nothing", "yet");
}

/// While a change of owner is stored, nobody fills the place where requests wait.
#[test]
fn one_peer_does_not_crowd_out_the_others() {
    let mut hub = durable_lab();
    let grabbed = ask(&mut hub, ALICE, "token grab", "/lab/key", Map::new());
    let ticket = storing(&grabbed);
    let refused = (0..100).filter(|_| {
        let effects = ask(&mut hub, BOB, "token renew", "/lab/key", Map::new());
        answer(&effects, BOB) == "try-later"
    });
    assert_eq!(refused.count(), 84);
    let renewed = ask(&mut hub, ALICE, "token renew", "/lab/key", Map::new());
    assert_eq!(answer(&renewed, ALICE), "nothing", "yet");
    let effects = stored(&mut hub, ticket);
    let told = effects.iter().filter(|effect| {
        matches!(effect, Effect::Reply { to, parcel } if *to == PeerId(ALICE) && parcel.name() == "ok")
    });
    assert_eq!(told.count(), 2, "the grab and the renewal");
}

/// Threat 42: all guests are one user, whose questions are a few; so they cannot take the place of others' questions,
/// in whatever channel.
#[test]
fn guests_do_not_use_up_the_questions_of_others() {
    let mut hub = hub(&[]);
    let managed = Map::new().with("kind", "session").with("manager", "self");
    ok(&mut hub, ALICE, "context create", "/hers", managed.clone());
    ok(&mut hub, CAROL, "context create", "/other", managed);
    let mut waiting = 0;
    for guest in 100..356 {
        login(&mut hub, guest, "guest", 0);
        for number in 0..20 {
            let path = if number % 2 == 0 { "/hers" } else { "/other" };
            let asked = ask(&mut hub, guest, "context join", path, Map::new());
            match &*answer(&asked, guest) {
                "nothing" => waiting += 1,
                "try-later" => {}
                other => panic!("{other}"),
            }
        }
    }
    assert_eq!(waiting, 256);
    for (peer, path) in [(BOB, "/hers"), (BOB, "/other"), (ALICE, "/other")] {
        let asked = ask(&mut hub, peer, "context join", path, Map::new());
        assert_eq!(answer(&asked, peer), "nothing", "it waits for its answer");
    }
    // A guest that goes makes way for others.
    let mut effects = Vec::new();
    hub.handle(0, Input::Gone { peer: PeerId(100) }, &mut effects);
    hub.check();
    let asked = ask(&mut hub, 200, "context join", "/hers", Map::new());
    assert_eq!(answer(&asked, 200), "nothing");
}
