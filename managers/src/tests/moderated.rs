//! What chairs approve.

use mom_proto::{Code, Map, Verb};

use super::{Ask, GRAB, ask, build, check, of, short, text, words};
use crate::{self as managers, Answer, GivenAnswer, PeerFacts, Scope, Standing};

fn moderated() -> Map {
    let chairs = Map::new()
        .with("users", words(&["dora"]))
        .with("groups", words(&["staff"]))
        .with("min-level", 2);
    of("moderated").with("chairs", chairs)
}

fn given(label: &str, by: Option<&str>, allow: bool, stands: bool, text: &str) -> GivenAnswer {
    GivenAnswer {
        label: label.into(),
        by: by.map(Into::into),
        allow,
        stands,
        text: text.to_owned(),
    }
}

const HELD: Ask<'_> = Ask {
    owner: Some(("bob", 1, false)),
    lease_end: Some(7),
    ..GRAB
};

const SEND: Ask<'_> = Ask {
    verb: Verb::Send,
    message: Some("say"),
    ..GRAB
};

const CHAIR: Ask<'_> = Ask {
    user: "dora",
    level: 2,
    ..GRAB
};

#[test]
#[rustfmt::skip]
fn chairs_are_asked_about_what_they_moderate() {
    let verb = |verb| Ask { verb, ..GRAB };
    check(
        moderated(),
        &[
            ("a grab", GRAB, "ask by moderated"),
            ("taking what is given", verb(Verb::Accept), "ask by moderated"),
            ("holding with others", verb(Verb::Inhibit), "ask by moderated"),
            ("a renewal is not a new control", verb(Verb::Renew), "allow"),
            ("messages are free by default", SEND, "allow"),
            ("a chair by name", CHAIR, "allow"),
            ("a chair by group", Ask { user: "erik", groups: &["staff"], ..CHAIR }, "allow"),
            ("of too low a level", Ask { level: 1, ..CHAIR }, "ask by moderated"),
            ("a level alone is not a chair", Ask { user: "erik", ..CHAIR }, "ask by moderated"),
            ("giving up", verb(Verb::Release), "allow"),
            ("what is held is not asked about", HELD, "queue: moderated: held at 7 expected 7"),
            ("nor to be held with others", Ask { verb: Verb::Inhibit, ..HELD }, "moderated: held at 7"),
            (
                "also not for a chair",
                Ask { level: 2, user: "dora", ..HELD },
                "queue: moderated: held at 7 expected 7",
            ),
            ("a lease that is over is asked about", Ask { now: 7, ..HELD }, "ask by moderated"),
        ],
    );
}

#[test]
#[rustfmt::skip]
fn an_approved_grab_displaces_only_where_the_file_says_so() {
    let yes = [given("moderated", Some("dora"), true, false, "")];
    check(
        moderated().with("displace", true),
        &[
            ("held and not asked yet", HELD, "ask by moderated"),
            ("held and approved", Ask { answers: &yes, ..HELD }, "displace"),
            ("held and a chair", Ask { level: 2, user: "dora", ..HELD }, "displace"),
            ("an offer has no owner in the way", Ask { answers: &yes, verb: Verb::Accept, ..HELD }, "allow"),
            (
                "to be held with others",
                Ask { answers: &yes, verb: Verb::Inhibit, ..HELD },
                "moderated: held at 7",
            ),
        ],
    );
    check(
        moderated(),
        &[
            ("free and approved", Ask { answers: &yes, ..GRAB }, "allow"),
            ("held and approved", Ask { answers: &yes, ..HELD }, "queue: moderated: held at 7 expected 7"),
        ],
    );
}

#[test]
#[rustfmt::skip]
fn only_its_own_answer_counts_and_the_last_holds() {
    let yes = |label| given(label, Some("dora"), true, false, "");
    let no = given("moderated", Some("dora"), false, false, "not now");
    for (answers, expected) in [
        (vec![yes("other")], "ask by moderated"),
        (vec![yes("moderated")], "allow"),
        (vec![yes("moderated"), no.clone()], "moderated: declined"),
        (vec![no, yes("moderated"), yes("other")], "allow"),
        (vec![given("moderated", None, false, false, "")], "moderated: timed-out"),
        // Nobody said yes, so nobody did.
        (vec![given("moderated", None, true, true, "")], "moderated: timed-out"),
    ] {
        let question = Ask { answers: &answers, ..GRAB };
        assert_eq!(short(&ask(&mut *build(moderated()), &question)), expected, "{answers:?}");
    }
}

#[test]
fn a_refusal_says_who_declined_what_and_why() {
    for (question, answer, code, expected) in [
        (
            GRAB,
            given("moderated", Some("dora"), false, false, "not now"),
            Code::DECLINED,
            "a chair, dora, declined grab of /robot/token: not now",
        ),
        (
            Ask {
                path: "/chat",
                ..SEND
            },
            given("moderated", Some("dora"), false, false, ""),
            Code::DECLINED,
            "a chair, dora, declined say to /chat",
        ),
        (
            GRAB,
            given("moderated", None, false, false, "no chair is here"),
            Code::TIMED_OUT,
            "a chair did not decide on grab of /robot/token in time, or is gone: no chair is here",
        ),
    ] {
        let mut manager = build(moderated().with("verbs", words(&["grab", "send"])));
        let verdict = ask(
            &mut *manager,
            &Ask {
                answers: &[answer],
                ..question
            },
        );
        assert_eq!(text(&verdict), expected);
        assert!(
            matches!(&verdict.answer, Answer::Deny(denial) if denial.code == code),
            "{verdict:?}"
        );
        assert_eq!(verdict.rule.as_deref(), Some("moderated"));
    }
}

#[test]
#[rustfmt::skip]
fn messages_are_moderated_by_name() {
    let spec = || moderated().with("verbs", words(&["send"])).with("messages", words(&["command"]));
    let command = Ask { message: Some("command"), ..SEND };
    let stands = |scope| Standing::Stands { scope, until: None, rate: None, max_age: None };
    let once = [given("moderated", Some("dora"), true, false, "")];
    let always = [given("moderated", Some("dora"), true, true, "")];
    let never = [given("moderated", Some("dora"), false, true, "")];
    let silence = [given("moderated", None, false, true, "")];
    for (question, expected, standing) in [
        (SEND, "allow", stands(Scope::ThisName)),
        (command, "ask by moderated", Standing::Once),
        (Ask { answers: &once, ..command }, "allow", Standing::Once),
        (Ask { answers: &always, ..command }, "allow", stands(Scope::ThisName)),
        (Ask { answers: &never, ..command }, "moderated: declined", stands(Scope::ThisName)),
        (Ask { answers: &silence, ..command }, "moderated: timed-out", Standing::Once),
        (Ask { message: Some("command"), verb: Verb::Send, ..CHAIR }, "allow", stands(Scope::AnyName)),
        (Ask { verb: Verb::Stop, message: Some("stop"), ..SEND }, "allow", stands(Scope::AnyName)),
    ] {
        let verdict = ask(&mut *build(spec()), &question);
        assert_eq!((short(&verdict).as_str(), verdict.standing), (expected, standing), "{question:?}");
    }
}

#[test]
fn a_stop_waits_for_no_chair_unless_it_is_listed() {
    let stop = Ask {
        verb: Verb::Stop,
        message: Some("stop"),
        ..GRAB
    };
    for (verbs, expected) in [(vec!["*"], "allow"), (vec!["stop"], "ask by moderated")] {
        let mut manager = build(moderated().with("verbs", words(&verbs)));
        assert_eq!(short(&ask(&mut *manager, &stop)), expected, "{verbs:?}");
    }
    // The names of messages are those of sends.
    let listed = moderated().with("verbs", words(&["send", "stop", "release"]));
    let mut manager = build(listed.with("messages", words(&["command"])));
    assert_eq!(short(&ask(&mut *manager, &stop)), "ask by moderated");
    let release = Ask {
        verb: Verb::Release,
        ..GRAB
    };
    assert_eq!(
        short(&ask(&mut *manager, &release)),
        "allow",
        "giving up is not a chair's business"
    );
    let mut manager = build(moderated().with("verbs", words(&["*"])));
    for verb in Verb::ALL {
        let free = verb.gives_up() || verb == Verb::Stop;
        let expected = if free { "allow" } else { "ask by moderated" };
        assert_eq!(
            short(&ask(&mut *manager, &Ask { verb, ..GRAB })),
            expected,
            "{verb}"
        );
    }
}

#[test]
fn the_hub_is_told_whom_to_ask() {
    let verdict = ask(&mut *build(moderated().with("within", 50)), &GRAB);
    let Answer::Defer(managers::Defer {
        label,
        ask: whom,
        within,
    }) = verdict.answer
    else {
        panic!("{verdict:?}")
    };
    assert_eq!((&*label, within), ("moderated", 50_000));
    for (user, level, groups, expected) in [
        ("dora", 2, vec![], true),
        ("erik", 2, vec!["staff".to_owned()], true),
        ("dora", 1, vec![], false),
        ("erik", 9, vec!["lab".to_owned()], false),
    ] {
        let facts = PeerFacts {
            name: "x".into(),
            user: user.into(),
            level,
            groups: groups.into(),
        };
        assert_eq!(whom.is_chair(&facts), expected, "{facts:?}");
        assert!(!managers::Ask::Creator.is_chair(&facts));
    }
}

#[test]
fn a_chair_has_half_a_minute_unless_the_file_says_otherwise() {
    for (file, within) in [(moderated(), 30_000_000), (moderated().with("within", 7), 7_000)] {
        let Answer::Defer(defer) = ask(&mut *build(file), &GRAB).answer else {
            panic!("a grab is asked about")
        };
        assert_eq!(defer.within, within);
    }
}
