//! Who is asked before a request is answered: nobody in vain, nobody twice, and the manager before anything is told.

use mom_hub::{Effect, Input, PeerClock, Settings};
use mom_managers::{Answer, Ask, Denial, Manager, Question, Registry, Scope, Verdict, Wait};
use mom_proto::{ClockOffset, Code, Map, Parcel, Time, Value, Verb};

use crate::stage::{EPOCH, MS, Stage, context, lab, of};

/// A channel that alice has made and answers for; bob is in it.
fn managed_by_alice() -> Stage {
    let mut stage = Stage::new(vec![context("/lab", "session").with("presence", "none")]);
    for name in ["alice", "bob"] {
        stage.enter(name, 1);
    }
    stage.say(
        "alice",
        "context create /lab/own kind=channel manager=self presence=none",
    );
    stage.say("alice", "context join /lab/own");
    stage.say("bob", "context join /lab/own");
    stage.say("alice", "manager verdict / consult=1 allow=true");
    stage
}

#[test]
fn what_stands_holds_for_the_messages_that_waited_behind_too() {
    let mut stage = managed_by_alice();
    for _ in 0..3 {
        stage.say("bob", "message say /lab/own");
    }
    let heard = stage.say("alice", "manager verdict / consult=2 allow=true stands=true");
    let asked = heard.iter().filter(|line| line.contains("consult")).count();
    assert_eq!(asked, 0, "asked once for all: {heard:?}");
    assert_eq!(of(&heard, &["bob"]), ["bob< say of bob"; 3], "{heard:?}");
    assert_eq!(
        of(&stage.say("bob", "message say /lab/own"), &["bob"]),
        ["bob< say of bob"]
    );
}

#[test]
fn what_does_not_stand_is_asked_for_each_message() {
    let mut stage = managed_by_alice();
    stage.say("bob", "message say /lab/own");
    stage.say("bob", "message say /lab/own");
    let heard = stage.say("alice", "manager verdict / consult=2 allow=true");
    assert_eq!(of(&heard, &["bob"]), ["bob< say of bob"], "{heard:?}");
    assert!(
        heard.iter().any(|line| line.starts_with("alice< consult")),
        "{heard:?}"
    );
}

#[test]
fn who_may_not_is_not_told_what_is_there() {
    let manager = |rule: &str| {
        let rule = Map::new()
            .with("name", "looking")
            .with("allow", vec![rule.into()]);
        Map::new()
            .with("kind", "roles")
            .with("rules", vec![Value::Map(rule)])
    };
    let mut contexts = lab(Map::new());
    contexts[0].set("manager", manager("join"));
    let mut stage = Stage::new(contexts);
    stage.enter("alice", 1);
    stage.say("alice", "context leave /lab");
    for verb in ["grab", "request", "accept", "inhibit"] {
        for path in ["/lab/key", "/lab/arm", "/lab", "/lab/none"] {
            let heard = stage.say("alice", &format!("token {verb} {path}"));
            let [line] = &heard[..] else {
                panic!("{verb} {path}: {heard:?}")
            };
            assert!(line.starts_with("alice< denied"), "{verb} {path}: {line}");
        }
    }
}

#[test]
fn who_may_is_told_what_is_wrong() {
    let mut stage = Stage::new(lab(Map::new().with("manager", "first-come")));
    stage.enter("alice", 1);
    stage.say("alice", "context leave /lab");
    for verb in ["grab", "request"] {
        let say = |path: &str| format!("token {verb} {path}");
        assert_eq!(stage.say("alice", &say("/lab/key")), ["alice< not-member"]);
        assert_eq!(stage.say("alice", &say("/lab/arm")), ["alice< wrong-kind"]);
    }
}

/// carol is a chair of the lab's token for these verbs.
fn moderated(verbs: &[&str]) -> Map {
    let verbs: Vec<Value> = verbs.iter().map(|verb| Value::from(*verb)).collect();
    let chairs = Map::new().with("users", vec!["carol".into()]);
    let manager = Map::new()
        .with("kind", "moderated")
        .with("chairs", chairs)
        .with("verbs", verbs);
    Map::new().with("manager", manager)
}

#[test]
fn a_request_about_which_somebody_is_asked_elsewhere_is_counted_once() {
    let limit = Map::new().with("verbs", vec!["create".into()]).with("parcels", 1);
    let quota = Map::new()
        .with("kind", "quota")
        .with("limits", vec![Value::Map(limit)]);
    let mut contexts = lab(moderated(&["join"]));
    contexts[0].set("manager", quota);
    let mut stage = Stage::new(contexts);
    for name in ["bob", "carol"] {
        stage.enter(name, 1);
    }
    let mut create = stage.request("bob", "context create /lab/own");
    if let Input::Request { parcel, .. } = &mut create {
        let guard = Map::new()
            .with("token", "/lab/key")
            .with("names", vec!["command".into()]);
        let content = Map::new()
            .with("kind", "channel")
            .with("presence", "none")
            .with("guard", guard);
        **parcel = (**parcel).clone().content(content);
    }
    let heard = stage.give(create);
    assert!(
        of(&heard, &["carol"])[0].starts_with("carol< consult"),
        "{heard:?}"
    );
    let heard = stage.say("carol", "manager verdict / consult=1 allow=true");
    assert!(heard.contains(&"bob< ok".to_owned()), "{heard:?}");
    let heard = stage.say("bob", "context create /lab/more kind=channel");
    assert!(heard[0].starts_with("bob< over-quota"), "{heard:?}");
}

#[test]
fn a_chairs_answer_is_kept_while_a_change_of_owner_is_stored() {
    let mut stage = Stage::durable(lab(moderated(&["grab"])));
    for name in ["bob", "carol"] {
        stage.enter(name, 1);
    }
    stage.say("bob", "token grab /lab/key");
    stage.say("carol", "token grab /lab/key");
    let heard = stage.say("carol", "manager verdict / consult=1 allow=true");
    assert_eq!(heard, ["carol< ok"], "bob's grab waits for the store");
    let heard = stage.answer(true);
    assert!(!heard.iter().any(|line| line.contains("consult")), "{heard:?}");
    assert!(
        of(&heard, &["bob"])
            .iter()
            .any(|line| line.starts_with("bob< held")),
        "{heard:?}"
    );
}

/// A grab that has waited is put to the chairs when the token can be granted.
#[test]
fn who_has_waited_is_put_to_the_chairs() {
    for (answer, expected) in [("true", "bob< ok"), ("false text=no", "bob< declined")] {
        let mut stage = Stage::new(lab(moderated(&["grab"])));
        for name in ["bob", "carol", "dave"] {
            stage.enter(name, 1);
        }
        stage.say("dave", "token grab /lab/key");
        stage.say("carol", "manager verdict / consult=1 allow=true");
        stage.say("bob", "token grab /lab/key wait=60000");
        let heard = stage.say("dave", "token release /lab/key");
        assert!(
            of(&heard, &["carol"])
                .iter()
                .any(|line| line.starts_with("carol< consult")),
            "{heard:?}"
        );
        assert_eq!(
            of(&heard, &["bob"])
                .iter()
                .filter(|line| line.starts_with("bob< denied"))
                .count(),
            0
        );
        let heard = stage.say("carol", &format!("manager verdict / consult=2 allow={answer}"));
        assert!(heard.iter().any(|line| line.starts_with(expected)), "{heard:?}");
    }
}

/// bob and erin wait for what dave owns, and carol is asked about each grab. What is asked of her at his release, and the
/// stage.
fn two_wait() -> (Stage, Vec<String>) {
    let mut stage = Stage::new(lab(moderated(&["grab"])));
    for name in ["bob", "carol", "dave", "erin"] {
        stage.enter(name, 1);
    }
    stage.say("dave", "token grab /lab/key");
    stage.say("carol", "manager verdict / consult=1 allow=true");
    stage.say("bob", "token grab /lab/key wait=1000");
    stage.say("erin", "token grab /lab/key wait=90000");
    let asked = stage.say("dave", "token release /lab/key");
    (stage, asked)
}

/// The peers about whose grabs carol is asked.
fn asked_about(heard: &[String]) -> Vec<String> {
    let mut peers = Vec::new();
    for line in of(heard, &["carol"]) {
        if let Some(rest) = line.strip_prefix("carol< consult") {
            let peer = rest
                .split_whitespace()
                .find_map(|word| word.strip_prefix("peer="));
            peers.push(peer.unwrap_or_default().to_owned());
        }
    }
    peers
}

#[test]
fn those_who_wait_are_asked_about_one_after_the_other() {
    let (mut stage, asked) = two_wait();
    assert_eq!(asked_about(&asked), ["bob"], "whose turn it is: {asked:?}");
    let heard = stage.say("carol", "manager verdict / consult=2 allow=false");
    assert!(
        heard.iter().any(|line| line.starts_with("bob< declined")),
        "{heard:?}"
    );
    assert_eq!(asked_about(&heard), ["erin"], "{heard:?}");
    let heard = stage.say("carol", "manager verdict / consult=3 allow=true");
    assert!(heard.iter().any(|line| line.starts_with("erin< ok")), "{heard:?}");

    for end in ["release", "leave", "logout", "time", "gone"] {
        let (mut stage, _) = two_wait();
        let heard = match end {
            "release" => stage.say("bob", "token release /lab/key"),
            "leave" => stage.say("bob", "context leave /lab"),
            "logout" => stage.say("bob", "login logout /"),
            "gone" => stage.gone("bob"),
            _ => stage.at(1_001),
        };
        assert_eq!(asked_about(&heard), ["erin"], "{end}: {heard:?}");
        let heard = stage.say("carol", "manager verdict / consult=2 allow=true");
        assert!(
            !heard.iter().any(|line| line.starts_with("bob< ok")),
            "{end}: {heard:?}"
        );
    }
}

#[test]
fn who_is_asked_about_keeps_its_place() {
    let (mut stage, _) = two_wait();
    // dave comes back, and carol is quicker about him than about bob.
    stage.say("dave", "token grab /lab/key");
    let heard = stage.say("carol", "manager verdict / consult=3 allow=true");
    assert!(heard.iter().any(|line| line.starts_with("dave< ok")), "{heard:?}");
    let heard = stage.say("carol", "manager verdict / consult=2 allow=true");
    assert!(!heard.iter().any(|line| line.contains("bob< ok")), "{heard:?}");
    let heard = stage.say("dave", "token release /lab/key");
    let asked: Vec<String> = asked_about(&heard);
    assert!(!asked.contains(&"erin".to_owned()), "{heard:?}");
    // Whatever number the question about bob has by now.
    let heard: Vec<String> = (4..7)
        .flat_map(|consult| {
            stage.say(
                "carol",
                &format!("manager verdict / consult={consult} allow=true"),
            )
        })
        .collect();
    assert!(heard.iter().any(|line| line.starts_with("bob< ok")), "{heard:?}");
    assert!(
        !heard.iter().any(|line| line.starts_with("erin< ok")),
        "{heard:?}"
    );
}

/// What a chair said about a token before it changed hands holds no more: it may stand elsewhere now.
#[test]
fn an_answer_holds_until_the_next_grant() {
    let mut stage = Stage::new(lab(moderated(&["grab"])));
    for name in ["bob", "carol", "dave"] {
        stage.enter(name, 1);
    }
    stage.say("bob", "token grab /lab/key wait=60000");
    stage.say("dave", "token grab /lab/key");
    stage.say("carol", "manager verdict / consult=2 allow=true");
    let heard = stage.say("carol", "manager verdict / consult=1 allow=true");
    assert!(
        heard.iter().any(|line| line.starts_with("bob< queued")),
        "{heard:?}"
    );
    let heard = stage.say("dave", "token release /lab/key");
    assert!(
        of(&heard, &["carol"])
            .iter()
            .any(|line| line.starts_with("carol< consult")),
        "{heard:?}"
    );
    assert!(!heard.iter().any(|line| line.starts_with("bob< ok")), "{heard:?}");
}

#[test]
fn chairs_are_asked_and_nobody_else() {
    let mut stage = Stage::new(lab(moderated(&["grab"])));
    for name in ["bob", "carol", "dave"] {
        stage.enter(name, 1);
    }
    let heard = stage.say("bob", "token grab /lab/key");
    assert_eq!(heard.len(), 1, "{heard:?}");
    assert!(heard[0].starts_with("carol< consult"), "{heard:?}");
    let heard = stage.say("dave", "manager verdict / consult=1 allow=true");
    assert_eq!(heard, ["dave< too-late"], "dave was not asked");
}

#[test]
fn so_many_requests_of_one_peer_wait_and_no_more() {
    let mut stage = Stage::new(lab(moderated(&["grab"])));
    for name in ["bob", "carol", "dave"] {
        stage.enter(name, 1);
    }
    for _ in 0..16 {
        let heard = stage.say("bob", "token grab /lab/key");
        assert_eq!(of(&heard, &["bob"]), [""; 0]);
    }
    let refused = stage.say("bob", "token grab /lab/key");
    assert!(refused[0].starts_with("bob< try-later"), "{refused:?}");
    let heard = stage.say("dave", "token grab /lab/key");
    assert_eq!(of(&heard, &["dave"]), [""; 0], "another one waits all the same");
}

/// bob says something of so many bytes; whether it waits.
fn waits(stage: &mut Stage, bytes: usize) -> bool {
    let mut say = stage.request("bob", "message say /lab/own");
    if let Input::Request { parcel, .. } = &mut say {
        **parcel = (**parcel)
            .clone()
            .content(Map::new().with("text", "x".repeat(bytes)));
    }
    let heard = stage.give(say);
    let refused = heard.iter().any(|line| line.starts_with("bob< try-later"));
    assert_eq!(of(&heard, &["bob"]).len(), usize::from(refused), "{heard:?}");
    !refused
}

#[test]
fn so_many_messages_wait_behind_one_and_no_more() {
    let mut stage = managed_by_alice();
    for _ in 0..17 {
        assert!(waits(&mut stage, 1), "one, and sixteen behind it");
    }
    assert!(!waits(&mut stage, 1));
    let mut stage = managed_by_alice();
    assert!(waits(&mut stage, 1));
    assert!(waits(&mut stage, 1 << 20), "an empty place takes one of any size");
    assert!(!waits(&mut stage, 1));
}

/// Says how many wait, as far as managers are told.
#[derive(Debug)]
struct Counting;

impl Manager for Counting {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let token = question.token.unwrap_or_default();
        let owned = token.owner.is_some_and(|owner| !owner.asks);
        match question.verb {
            Verb::Grab if owned => Verdict {
                answer: Answer::Queue(Wait {
                    denial: Denial {
                        code: Code::HELD,
                        text: "it is taken".to_owned(),
                        rule: "counting".to_owned(),
                        earliest: None,
                    },
                    expected: None,
                }),
                ..Verdict::allow()
            },
            Verb::Inhibit => Verdict::deny(Code::DENIED, format!("{} wait", token.waiting), "no"),
            _ => Verdict::allow(),
        }
    }
}

#[test]
fn managers_are_told_how_many_others_wait() {
    let mut registry = Registry::builtin();
    registry.add_kind("counting", |_| Ok(Box::new(Counting)));
    let contexts = lab(Map::new().with("manager", "counting"));
    let mut stage = Stage::with(contexts, registry, Settings::default());
    for name in ["alice", "bob", "carol"] {
        stage.enter(name, 1);
        stage.say(name, "token grab /lab/key wait=unlimited");
    }
    for (name, count) in [("alice", 2), ("bob", 1), ("carol", 1)] {
        let told = stage.say(name, "token inhibit /lab/key");
        assert_eq!(told, [format!("{name}< denied rule={count} wait")]);
    }
}

#[test]
fn nobody_is_asked_about_a_message_that_is_refused_in_any_case() {
    let said = |change: &dyn Fn(&mut Parcel)| {
        let mut stage = managed_by_alice();
        let mut say = stage.request("bob", "message say /lab/own");
        if let Input::Request { parcel, clock, .. } = &mut say {
            change(parcel);
            *clock = Some(PeerClock {
                offset: ClockOffset { micros: 0, error: 0 },
                future: 0,
            });
        }
        stage.give(say)
    };
    let consulted = said(&|_| {});
    assert!(consulted[0].starts_with("alice< consult"), "{consulted:?}");
    let to_nobody = said(&|parcel| parcel.address = Some(vec!["dave".into()]));
    assert_eq!(to_nobody, ["bob< unknown-peer"]);
    let to_come = said(&|parcel| parcel.timestamp = Time::from_micros(1));
    assert_eq!(to_come, ["bob< bad-slot"]);
    let over = said(&|parcel| (parcel.timestamp, parcel.expires) = (Time::from_micros(-5000), Some(5)));
    assert_eq!(over, ["bob< expired"]);
}

/// Asks who made the channel about `other` messages, and allows the rest once for all.
#[derive(Debug)]
struct AskingSome;

impl Manager for AskingSome {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let asked = question.message == Some("other") && question.answers.is_empty();
        match (question.verb, asked) {
            (Verb::Send, true) => Verdict::defer("asking-some", Ask::Creator, 5_000_000),
            (Verb::Send, false) => Verdict::allow().stands(Scope::ThisName),
            _ => Verdict::allow(),
        }
    }
}

#[test]
fn what_stands_does_not_overtake_a_message_that_waits() {
    let mut registry = Registry::builtin();
    registry.add_kind("asking-some", |_| Ok(Box::new(AskingSome)));
    let contexts = vec![context("/lab", "session").with("presence", "none")];
    let mut stage = Stage::with(contexts, registry, Settings::default());
    for name in ["alice", "bob"] {
        stage.enter(name, 1);
    }
    stage.say(
        "alice",
        "context create /lab/own kind=channel manager=asking-some presence=none",
    );
    for name in ["alice", "bob"] {
        stage.say(name, "context join /lab/own");
    }
    let bob = stage.peer("bob");
    let stands = |stage: &Stage| {
        let mut routes = stage.effects.iter().filter_map(|effect| match effect {
            Effect::Route(route) => route
                .member(bob)
                .map(|member| member.standing("say", 0).is_some()),
            _ => None,
        });
        routes.next_back()
    };
    stage.say("bob", "message say /lab/own");
    assert_eq!(stands(&stage), Some(true));
    let exact = ClockOffset { micros: 0, error: 0 };
    let by_its_clock = |stage: &mut Stage, line: &str| {
        let mut input = stage.request("bob", line);
        if let Input::Request { parcel, clock, .. } = &mut input {
            parcel.timestamp = Time::from_micros(0);
            let offset = exact;
            *clock = Some(PeerClock { offset, future: 0 });
        }
        stage.give(input)
    };
    let heard = by_its_clock(&mut stage, "message other /lab/own");
    assert!(heard[0].starts_with("alice< consult"), "{heard:?}");
    assert_eq!(stands(&stage), Some(false), "the next one has to wait behind it");
    let heard = by_its_clock(&mut stage, "message stop /lab/own");
    assert_eq!(
        of(&heard, &["alice"]),
        ["alice< stop of bob stop=1"],
        "but never a stop"
    );
    stage.at(400);
    stage.say("alice", "manager verdict / consult=1 allow=true");
    assert_eq!(stands(&stage), Some(true));
    let sent = stage.effects.iter().find_map(|effect| match effect {
        Effect::Send { parcel, .. } => Some((parcel.age, parcel.age_error)),
        _ => None,
    });
    let error = exact.later(400 * MS).error;
    assert!(error > 0, "clocks drift apart");
    assert_eq!(sent, Some((Some(400_000), Some(error))));
}

#[test]
fn who_waits_says_for_how_long() {
    let mut stage = Stage::new(lab(Map::new().with("manager", "queue")));
    for name in ["alice", "bob"] {
        stage.enter(name, 1);
    }
    stage.say("alice", "token grab /lab/key");
    for wait in ["-1", "true", "sometimes"] {
        let heard = stage.say("bob", &format!("token grab /lab/key wait={wait}"));
        assert_eq!(heard, ["bob< bad-content"], "{wait}");
    }
    for wait in ["", " wait=0"] {
        let heard = stage.say("bob", &format!("token grab /lab/key{wait}"));
        assert!(heard[0].starts_with("bob< held"), "{wait}: {heard:?}");
    }
    let heard = stage.say("bob", "token grab /lab/key wait=5");
    assert!(
        heard.iter().any(|line| line.starts_with("bob< queued place=1")),
        "{heard:?}"
    );
    assert_eq!(of(&stage.at(4), &["bob"]), [""; 0]);
    let heard = of(&stage.at(5), &["bob"]);
    assert!(
        heard.iter().any(|line| line.starts_with("bob< timed-out")),
        "{heard:?}"
    );
}

#[test]
fn a_fence_that_was_never_given_out_is_refused_before_anybody_is_asked() {
    let mut contexts = lab(Map::new());
    let chairs = Map::new().with("users", vec!["alice".into()]);
    let manager = Map::new()
        .with("kind", "moderated")
        .with("chairs", chairs)
        .with("verbs", vec!["send".into()]);
    contexts[2].set("manager", manager);
    for (fence, wanted) in [(1, "alice< consult"), (2, "bob< bad-fence")] {
        let mut stage = Stage::new(contexts.clone());
        for name in ["alice", "bob"] {
            stage.enter(name, 1);
        }
        stage.say("bob", "token grab /lab/key");
        let heard = stage.say("bob", &format!("message command /lab/arm @fence={fence}"));
        assert!(
            heard[0].starts_with(wanted),
            "{fence} of epoch {EPOCH}: {heard:?}"
        );
    }
}

#[test]
fn an_owner_may_hold_together_with_others_and_nobody_else_may() {
    let mut stage = Stage::new(lab(Map::new().with("manager", "first-come")));
    for name in ["alice", "bob"] {
        stage.enter(name, 1);
    }
    stage.say("alice", "token grab /lab/key");
    let heard = stage.say("bob", "token inhibit /lab/key");
    assert!(heard[0].starts_with("bob< held"), "{heard:?}");
    let heard = stage.say("alice", "token inhibit /lab/key");
    assert!(heard.contains(&"alice< ok".to_owned()), "{heard:?}");
    let heard = stage.say("bob", "token inhibit /lab/key");
    assert!(heard.contains(&"bob< ok".to_owned()), "{heard:?}");
}
