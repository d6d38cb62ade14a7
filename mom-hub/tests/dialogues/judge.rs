//! What would be said is what is said: a judgement against the reply to the same request.

use mom_hub::{Case, ContextSpec, Effect, Hub, Input, Judgement, PeerClock, PeerId, Settings, User};
use mom_managers::{Answer, Ask, Denial, Manager, Question, Registry, Setup, Terms, Verdict, Wait};
use mom_proto::{
    ClockOffset, Code, ContextKind, Map, Parcel, Path, Time, Value, Verb, WireError, from_value,
};

use crate::stage::{Stage, context};

/// Asks chairs before a `join`, lets a `grab` of a held token wait, denies `delete` and allows the rest.
#[derive(Debug)]
struct Careful;

impl Manager for Careful {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let owner = question.token.and_then(|token| token.owner);
        let denial = |code: Code| Denial {
            code,
            text: format!("{} waits", question.peer.user),
            rule: "careful/turns".to_owned(),
            earliest: None,
        };
        match question.verb {
            Verb::Join => {
                let ask = Ask::Chairs {
                    users: ["carol".to_owned()].into(),
                    groups: [].into(),
                    min_level: None,
                };
                Verdict::defer("careful", ask, 5_000_000)
            }
            Verb::Grab if owner.is_some_and(|owner| !owner.asks) => Verdict {
                answer: Answer::Queue(Wait {
                    denial: denial(Code::HELD),
                    expected: None,
                }),
                ..Verdict::allow()
            },
            Verb::Delete => Verdict::deny(Code::DENIED, "careful/stay", "it stays"),
            _ => Verdict::allow(),
        }
    }

    fn terms(&self) -> Terms {
        Terms {
            lease: Some(60_000_000),
            ..Terms::default()
        }
    }
}

#[expect(clippy::unnecessary_wraps, reason = "a factory may fail")]
fn make(_: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    Ok(Box::new(Careful))
}

fn hub() -> Hub {
    let mut registry = Registry::builtin();
    registry.add_kind("careful", make);
    let contexts: Vec<ContextSpec> = [
        Map::new().with("path", "/t").with("kind", "token"),
        Map::new()
            .with("path", "/open")
            .with("kind", "token")
            .with("manager", "open"),
        Map::new().with("path", "/c").with("kind", "channel").with(
            "guard",
            Map::new()
                .with("token", "/t")
                .with("names", vec![Value::from("go")]),
        ),
    ]
    .into_iter()
    .map(|spec| from_value(spec.into()).expect("a context"))
    .collect();
    Hub::new(Settings::default(), registry, &"careful".into(), &contexts).expect("right")
}

fn user(name: &str, level: i32) -> User {
    User {
        name: name.to_owned(),
        level,
        groups: Vec::new(),
        details: Map::new(),
    }
}

fn judge(verb: Verb, path: &str, message: Option<&str>, owner: Option<&User>) -> Judgement {
    let path = Path::parse(path).expect("a path");
    let owners: Vec<(Path, User)> = owner
        .map(|owner| (path.clone(), owner.clone()))
        .into_iter()
        .collect();
    hub().judge(&Case {
        user: &user("alice", 1),
        verb,
        path: &path,
        kind: None,
        message,
        owners: &owners,
        invited: false,
    })
}

/// What alice is told, once bob owns both tokens.
fn ask(verb: Verb, path: &str) -> WireError {
    let mut hub = hub();
    let mut effects = Vec::new();
    for (peer, user) in [(PeerId(2), user("bob", 3)), (PeerId(1), user("alice", 1))] {
        let login = Input::Login {
            peer,
            user,
            nickname: None,
            id: None,
        };
        hub.handle(0, login, &mut effects);
    }
    let request = |peer, verb: Verb, path: &str| Input::Request {
        peer,
        clock: None,
        parcel: Box::new(
            Parcel::new(verb.family(), verb.word())
                .context(Path::parse(path).expect("a path"))
                .id(7),
        ),
    };
    hub.handle(0, request(PeerId(2), Verb::Grab, "/t"), &mut effects);
    hub.handle(0, request(PeerId(2), Verb::Grab, "/open"), &mut effects);
    effects.clear();
    hub.handle(0, request(PeerId(1), verb, path), &mut effects);
    hub.check();
    let reply = effects.iter().find_map(|effect| match effect {
        Effect::Reply {
            to: PeerId(1),
            parcel,
        } => Some(WireError::from_parcel(parcel)),
        _ => None,
    });
    reply.expect("an answer")
}

#[test]
fn a_refusal_is_foretold_to_the_word() {
    let bob = user("bob", 3);
    for (verb, path, owner, code) in [
        (Verb::Grab, "/t", Some(&bob), Code::HELD),
        // Its manager allows, and the hub still takes nothing from an owner.
        (Verb::Grab, "/open", Some(&bob), Code::HELD),
        (Verb::Delete, "/t", None, Code::DENIED),
        (Verb::Delete, "/open", None, Code::PERMANENT),
        (Verb::Grab, "/c", None, Code::WRONG_KIND),
        (Verb::Lookup, "/d", None, Code::UNKNOWN_PATH),
        (Verb::List, "/t", None, Code::WRONG_KIND),
    ] {
        let told = ask(verb, path);
        assert_eq!(told.code, code, "{verb} {path}");
        let foretold = judge(verb, path, None, owner).refusal;
        assert_eq!(foretold, Some(told), "{verb} {path}");
    }
}

#[test]
fn what_is_not_refused_is_told_apart() {
    let own = judge(Verb::Grab, "/t", None, Some(&user("alice", 1)));
    assert_eq!(
        (own.verdict.is_allow(), own.refusal),
        (true, None),
        "grabbing again renews"
    );
    let waits = judge(Verb::Grab, "/t", None, Some(&user("bob", 3)));
    assert!(matches!(waits.verdict.answer, Answer::Queue(_)), "{waits:?}");
    let asks = judge(Verb::Join, "/c", None, None);
    assert!(
        matches!(asks.verdict.answer, Answer::Defer(_)) && asks.refusal.is_none(),
        "{asks:?}"
    );
    for path in ["/c", "/t"] {
        assert_eq!(
            judge(Verb::Lookup, path, None, None).refusal,
            None,
            "{path} need be no session"
        );
    }
    let guarded = judge(Verb::Send, "/c", Some("go"), None);
    assert_eq!(guarded.guard, Some(Path::parse("/t").expect("a path")));
    assert_eq!(judge(Verb::Send, "/c", Some("chat"), None).guard, None);
    let new = judge(Verb::Create, "/new", None, None);
    assert_eq!(
        (new.place, new.refusal, new.managed_at),
        (None, None, Path::root())
    );
}

#[test]
fn places_say_who_manages_them() {
    let hub = hub();
    let place = |path: &str| hub.place(&Path::parse(path).expect("a path"));
    let token = place("/t").expect("there");
    assert_eq!(
        (token.kind, token.manager.as_str()),
        (ContextKind::Token, "careful")
    );
    assert_eq!(
        (token.managed_at, token.terms.and_then(|terms| terms.lease)),
        (Path::root(), Some(60_000_000))
    );
    let open = place("/open").expect("there");
    assert_eq!(
        (open.manager.as_str(), open.managed_at.as_str()),
        ("open", "/open")
    );
    assert_eq!(place("/nowhere"), None);
}

/// Denies all but `join` and `lookup` by a rule that says what it was asked.
#[derive(Debug)]
struct Telling;

impl Manager for Telling {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let Question {
            verb,
            context,
            kind,
            message,
            size,
            age,
            ..
        } = question;
        let asked = format!("{verb} {context} {kind} {message:?} {size} {age:?}");
        match question.verb {
            Verb::Join | Verb::Lookup => Verdict::allow(),
            _ => Verdict::deny(Code::DENIED, asked, "no"),
        }
    }
}

/// A hub that knows this kind of manager.
fn telling(contexts: Vec<Map>) -> Stage {
    let mut registry = Registry::builtin();
    registry.add_kind("telling", |_| Ok(Box::new(Telling)));
    Stage::with(contexts, registry, Settings::default())
}

#[test]
fn a_manager_is_asked_about_what_is_wished() {
    let told = || {
        let contexts = vec![
            context("/lab", "session")
                .with("manager", "telling")
                .with("presence", "none"),
            context("/lab/key", "token"),
            context("/lab/arm", "channel").with("presence", "none"),
        ];
        let mut stage = telling(contexts);
        stage.enter("alice", 1);
        stage
    };
    let mut stage = told();
    for (line, verb, path, kind, message, size) in [
        (
            "context create /lab/new kind=token",
            Verb::Create,
            "/lab/new",
            Some(ContextKind::Token),
            None,
            0,
        ),
        ("context delete /lab/arm", Verb::Delete, "/lab/arm", None, None, 0),
        ("token grab /lab/key", Verb::Grab, "/lab/key", None, None, 0),
        (
            "message say /lab/arm",
            Verb::Send,
            "/lab/arm",
            None,
            Some("say"),
            "say".len(),
        ),
    ] {
        let heard = stage.say("alice", line);
        let path = Path::parse(path).expect("a path");
        let alice = user("alice", 1);
        let judged = told().hub.judge(&Case {
            user: &alice,
            verb,
            path: &path,
            kind,
            message,
            owners: &[],
            invited: false,
        });
        let shown = match verb {
            Verb::Create => ContextKind::Token,
            _ => judged.place.as_ref().expect("it is there").kind,
        };
        let asked = |age: &str| format!("{verb} {path} {shown} {message:?} {size} {age}");
        assert_eq!(heard, [format!("alice< denied rule={}", asked("None"))], "{line}");
        // Where a message is supposed, it is supposed to be new.
        let age = if message.is_some() { "Some((0, 0))" } else { "None" };
        assert_eq!(
            judged.refusal.and_then(|error| error.get("rule").cloned()),
            Some(asked(age).into())
        );
    }
}

#[test]
fn a_manager_is_asked_about_every_verb_of_tokens() {
    let contexts = vec![
        context("/lab", "session").with("presence", "none"),
        context("/lab/key", "token").with("manager", "telling"),
    ];
    let mut stage = telling(contexts);
    stage.enter("alice", 1);
    let heard = stage.say("alice", "token grab /lab/other");
    assert_eq!(
        heard,
        ["alice< unknown-path"],
        "the lab's own manager allows to know"
    );
    // A request is for what its sender would gain.
    for (verb, asked) in [
        ("grab", "grab"),
        ("give", "give"),
        ("request", "grab"),
        ("inhibit", "inhibit"),
        ("break", "break"),
    ] {
        let heard = stage.say("alice", &format!("token {verb} /lab/key"));
        let asked = format!("{asked} /lab/key token None 0 None");
        assert_eq!(heard, [format!("alice< denied rule={asked}")], "{verb}");
    }
}

#[test]
fn a_manager_is_told_how_large_and_how_old_a_message_is() {
    let contexts = vec![
        context("/lab", "session").with("presence", "none"),
        context("/lab/arm", "channel")
            .with("manager", "telling")
            .with("presence", "none"),
    ];
    let mut stage = telling(contexts);
    stage.enter("alice", 1);
    stage.at(70);
    let mut say = stage.request("alice", "message say /lab/arm text=hello");
    let mut size = 0;
    if let Input::Request { parcel, clock, .. } = &mut say {
        parcel.timestamp = Time::from_micros(50_000);
        size = parcel.size();
        let offset = ClockOffset { micros: 0, error: 9 };
        *clock = Some(PeerClock { offset, future: 0 });
    }
    assert!(size > 5, "{size}");
    let asked = format!("send /lab/arm channel Some(\"say\") {size} Some((20000, 9))");
    assert_eq!(stage.give(say), [format!("alice< denied rule={asked}")]);
}

#[test]
fn a_manager_is_asked_about_the_path_that_is_named_also_where_nothing_is() {
    let lab = context("/lab", "session").with("manager", "telling");
    let mut stage = telling(vec![lab]);
    stage.arrive("alice", 1);
    for path in ["/lab/none", "/lab/none/deeper"] {
        let heard = stage.say("alice", &format!("context info {path}"));
        let [line] = &heard[..] else { panic!("{heard:?}") };
        assert!(
            line.starts_with(&format!("alice< denied rule=info {path} ")),
            "{line}"
        );
    }
}
