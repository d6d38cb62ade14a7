//! Who may do which verb where.

use mom_proto::{Map, Value, Verb};

use super::{Ask, GRAB, ask, build, of, short, words};
use crate::{Answer, Registry, Scope, Standing, Verdict};

fn rule(name: &str, what: &str, verbs: &[&str]) -> Map {
    Map::new().with("name", name).with(what, words(verbs))
}

fn roles(rules: Vec<Map>) -> Map {
    let rules: Vec<Value> = rules.into_iter().map(Value::from).collect();
    of("roles").with("rules", rules)
}

/// The rules of a lab, each of another kind.
fn lab() -> Map {
    roles(vec![
        rule("nobody breaks the glass", "deny", &["*"]).with("where", words(&["/glass/**"])),
        rule("mallory is out", "deny", &["send", "grab"]).with("users", words(&["mallory"])),
        rule("operators may all", "allow", &["*"]).with("groups", words(&["operator", "owner"])),
        rule("states are the arm's", "deny", &["send"])
            .with("messages", words(&["state"]))
            .with("min-level", 1),
        rule("people drive", "allow", &["grab", "send"])
            .with("min-level", 1)
            .with("where", words(&["/robot/*"])),
        rule("bob and devices send", "allow", &["send"])
            .with("users", words(&["bob"]))
            .with("groups", words(&["device"])),
    ])
}

const DEVICE: Ask<'_> = Ask {
    user: "arm",
    level: 0,
    groups: &["device"],
    ..send("state")
};
const OPERATOR: Ask<'_> = Ask {
    user: "carol",
    level: 5,
    groups: &["operator"],
    ..GRAB
};

const fn send(message: &str) -> Ask<'_> {
    Ask {
        verb: Verb::Send,
        message: Some(message),
        path: "/robot/arm",
        ..GRAB
    }
}

#[rustfmt::skip]
const TABLE: [(&str, Ask<'_>, &str); 20] = [
    ("people grab in the robot's session", GRAB, "allow"),
    ("but not below it", Ask { path: "/robot/arm/token", ..GRAB }, "roles: denied"),
    ("nor elsewhere", Ask { path: "/camera/token", ..GRAB }, "roles: denied"),
    ("nor below the level", Ask { level: 0, ..GRAB }, "roles: denied"),
    ("nor by another verb", Ask { verb: Verb::Delete, ..GRAB }, "roles: denied"),
    ("stop is not a send", Ask { verb: Verb::Stop, ..send("stop") }, "roles: denied"),
    ("people send", send("command"), "allow"),
    ("but no states", send("state"), "roles/states are the arm's: denied"),
    ("which the arm does", DEVICE, "allow"),
    ("bob sends everywhere by his name", Ask { user: "bob", path: "/chat", ..send("say") }, "allow"),
    ("alice does not", Ask { path: "/chat", ..send("say") }, "roles: denied"),
    ("a user and a group are alternatives", Ask { path: "/chat", ..DEVICE }, "allow"),
    ("a denial before an allowance", Ask { user: "mallory", ..GRAB }, "roles/mallory is out: denied"),
    ("of its own verbs only", Ask { user: "mallory", groups: &["operator"], verb: Verb::Join, ..GRAB }, "allow"),
    ("operators may all", Ask { verb: Verb::Delete, path: "/", ..OPERATOR }, "allow"),
    ("any of the groups", Ask { groups: &["staff", "owner"], ..OPERATOR }, "allow"),
    ("but for what nobody may", Ask { path: "/glass", ..OPERATOR }, "roles/nobody breaks the glass: denied"),
    ("with all below", Ask { path: "/glass/a/b", ..OPERATOR }, "roles/nobody breaks the glass: denied"),
    ("which is all below only", Ask { path: "/glasses", ..OPERATOR }, "allow"),
    ("giving up is nobody's to refuse", Ask { user: "mallory", verb: Verb::Release, ..GRAB }, "allow"),
];

#[test]
fn the_first_rule_that_covers_decides() {
    let mut manager = build(lab());
    for (why, question, expected) in &TABLE {
        assert_eq!(short(&ask(&mut *manager, question)), *expected, "{why}");
    }
}

#[test]
fn refusals_say_who_and_what() {
    for (question, expected) in [
        (
            Ask {
                user: "arm",
                level: 0,
                ..GRAB
            },
            "arm may not grab /robot/token",
        ),
        (
            Ask {
                verb: Verb::Send,
                message: Some("say"),
                path: "/chat",
                ..GRAB
            },
            "alice may not send say to /chat",
        ),
    ] {
        match ask(&mut *build(lab()), &question).answer {
            Answer::Deny(denial) => assert_eq!(denial.text, expected),
            allowed => panic!("{allowed:?}"),
        }
    }
}

#[test]
fn a_rule_without_a_name_has_a_number() {
    let nameless = Map::new().with("deny", words(&["grab"]));
    let mut manager = build(roles(vec![rule("lookers", "allow", &["lookup"]), nameless]));
    assert_eq!(short(&ask(&mut *manager, &GRAB)), "roles/rule 2: denied");
}

#[test]
fn verdicts_stand_for_the_messages_they_know_of() {
    let all = rule("all send", "allow", &["send"]);
    let some = rule("some send", "allow", &["send"]).with("messages", words(&["say"]));
    for (rules, message, scope) in [
        (vec![all.clone()], "say", Scope::AnyName),
        (vec![some.clone(), all], "say", Scope::ThisName),
        (vec![some], "shout", Scope::ThisName),
        // The words of a refusal name the message.
        (vec![], "say", Scope::ThisName),
    ] {
        let question = Ask {
            verb: Verb::Send,
            message: Some(message),
            ..GRAB
        };
        let verdict = ask(&mut *build(roles(rules)), &question);
        assert_eq!(
            verdict.standing,
            Standing::Stands {
                scope,
                until: None,
                rate: None,
                max_age: None
            },
            "{verdict:?}"
        );
    }
}

#[test]
#[rustfmt::skip]
fn an_invitation_opens_what_a_rule_says() {
    let rules = || {
        roles(vec![
            rule("guests", "allow", &["join"]).with("invited", true),
            rule("no strangers", "deny", &["join"])
                .with("invited", false)
                .with("where", words(&["/back/**"])),
            rule("all look", "allow", &["lookup", "send"]),
        ])
    };
    let join = |path, invited| Ask { verb: Verb::Join, path, invited, ..GRAB };
    super::check(
        rules(),
        &[
            ("a guest", join("/back", true), "allow"),
            ("a stranger", join("/back", false), "roles/no strangers: denied"),
            ("a stranger elsewhere", join("/front", false), "roles: denied"),
            ("what invitations are not about", Ask { verb: Verb::Lookup, ..GRAB }, "allow"),
        ],
    );
    for (question, standing) in [
        (join("/back", true), Standing::Once),
        (join("/back", false), Standing::Once),
        (send("state"), Verdict::allow_always().standing),
    ] {
        assert_eq!(ask(&mut *build(rules()), &question).standing, standing, "{question:?}");
    }
}

#[test]
fn allowances_name_their_rule_too() {
    let mut manager = build(lab());
    for (question, rule) in [
        (GRAB, "roles/people drive"),
        (DEVICE, "roles/bob and devices send"),
        (Ask { level: 0, ..GRAB }, "roles"),
        (send("state"), "roles/states are the arm's"),
    ] {
        assert_eq!(
            ask(&mut *manager, &question).rule.as_deref(),
            Some(rule),
            "{question:?}"
        );
    }
}

#[test]
fn every_verb_can_be_given_by_its_word() {
    for verb in Verb::ALL.into_iter().filter(|verb| !verb.gives_up()) {
        let mut manager = build(roles(vec![rule("one", "allow", &[verb.word()])]));
        for asked in Verb::ALL.into_iter().filter(|asked| !asked.gives_up()) {
            let allowed = ask(&mut *manager, &Ask { verb: asked, ..GRAB }).is_allow();
            assert_eq!(allowed, asked == verb, "{asked} by a rule for {verb}");
        }
    }
}

/// "Left" is wrong where it comes late (M35).
#[test]
fn a_rule_may_allow_messages_up_to_an_age() {
    let young = rule("steps", "allow", &["send", "stop", "grab"])
        .with("messages", words(&["step", "stop"]))
        .with("max-age", 500);
    let grabs = rule("grabs", "allow", &["grab"]).with("max-age", 500);
    let rest = rule("all else", "allow", &["send"]);
    let mut manager = build(roles(vec![young, grabs, rest]));
    let step = |age| Ask { age, ..send("step") };
    for (question, expected, max_age) in [
        (step(Some((500_000, 0))), "allow", Some(500_000)),
        (step(Some((-3, 4))), "allow", Some(500_000)),
        (step(Some((499_000, 1_001))), "roles/steps: denied", None),
        (step(Some((i64::MAX, u64::MAX))), "roles/steps: denied", None),
        (step(None), "roles/steps: try-later", None),
        (send("say"), "allow", None),
        (GRAB, "allow", None),
        (
            Ask {
                verb: Verb::Stop,
                age: Some((9_000_000, 0)),
                ..send("stop")
            },
            "allow",
            None,
        ),
    ] {
        let verdict = ask(&mut *manager, &question);
        assert_eq!(short(&verdict), expected, "{question:?}");
        let standing = match verdict.standing {
            Standing::Once => None,
            Standing::Stands { max_age, .. } => max_age,
        };
        assert_eq!(standing, max_age, "{question:?}");
        // What is refused for its age says nothing of the next message.
        assert_eq!(
            verdict.is_allow(),
            verdict.standing != Standing::Once,
            "{question:?}"
        );
    }
    let Answer::Deny(denial) = ask(&mut *manager, &step(Some((620_400, 2_100)))).answer else {
        panic!("too old");
    };
    let text =
        "alice may send step to /robot/arm only up to an age of 500 ms, and this one is 620 ms old, ± 3 ms";
    assert_eq!(denial.text, text);
}

#[test]
fn an_age_limits_only_what_is_allowed() {
    let error = |rule: Map| {
        let error = crate::Registry::builtin()
            .build(&roles(vec![rule]).into())
            .unwrap_err();
        error.get("slot").and_then(Value::as_str).map(str::to_owned)
    };
    let place = Some("rules/0/max-age".to_owned());
    assert_eq!(error(rule("no", "deny", &["send"]).with("max-age", 500)), place);
    assert_eq!(error(rule("never", "allow", &["send"]).with("max-age", 0)), place);
}

#[test]
fn a_rule_says_how_urgent_messages_may_be_and_0_if_it_does_not() {
    let urgent = rule("alarms", "allow", &["send", "grab"])
        .with("messages", words(&["alarm", "GRAB"]))
        .with("priority", 50);
    let later = rule("logs", "allow", &["send"])
        .with("messages", words(&["log"]))
        .with("priority", -10);
    let rest = rule("all else", "allow", &["send", "stop", "grab"]);
    let mut manager = build(roles(vec![urgent, later, rest]));
    let stop = Ask {
        verb: Verb::Stop,
        ..send("stop")
    };
    for (question, priority) in [
        (send("alarm"), Some(50)),
        (send("log"), Some(-10)),
        (send("say"), Some(0)),
        (stop, None),
        (GRAB, None),
    ] {
        let Answer::Allow(grant) = ask(&mut *manager, &question).answer else {
            panic!("{question:?} is allowed");
        };
        assert_eq!(grant.priority, priority, "{question:?}");
    }
    let error = |rule: Map| {
        let error = crate::Registry::builtin()
            .build(&roles(vec![rule]).into())
            .unwrap_err();
        error.get("slot").and_then(Value::as_str).map(str::to_owned)
    };
    let place = Some("rules/0/priority".to_owned());
    assert_eq!(error(rule("no", "deny", &["send"]).with("priority", 5)), place);
    assert_eq!(
        error(rule("high", "allow", &["send"]).with("priority", 101)),
        place
    );
}

/// Each question checks them in order, so that a peer's own manager must not have tens of thousands.
#[test]
fn rules_are_counted() {
    let rules = |number: usize| roles(vec![rule("one", "allow", &["join"]); number]);
    let build = |number| Registry::builtin().build(&Value::Map(rules(number)));
    assert!(build(1000).is_ok());
    let error = build(1001).expect_err("one too many");
    assert_eq!(error.text, "in the manager roles: roles have at most 1000 rules");
    assert_eq!(error.get("slot").and_then(Value::as_str), Some("rules"));
}
