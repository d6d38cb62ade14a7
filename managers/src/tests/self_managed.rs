//! Contexts whose creator decides.

use mom_proto::Verb;

use super::{Ask, GRAB, ask, build, check, of, short, text, words};
use crate::{self as managers, Answer, GivenAnswer, Scope, Standing};

fn given(by: Option<&str>, allow: bool, stands: bool, text: &str) -> GivenAnswer {
    GivenAnswer {
        label: "self".into(),
        by: by.map(Into::into),
        allow,
        stands,
        text: text.to_owned(),
    }
}

const SEND: Ask<'_> = Ask {
    verb: Verb::Send,
    message: Some("say"),
    ..GRAB
};

#[test]
fn the_creator_is_asked_about_all_but_giving_up() {
    let (mut own, mut other) = (build("self"), build("self"));
    for verb in Verb::ALL {
        let made = Ask {
            verb,
            created: true,
            ..GRAB
        };
        assert_eq!(short(&ask(&mut *own, &made)), "allow", "{verb}");
        let expected = if verb.gives_up() { "allow" } else { "ask by self" };
        assert_eq!(
            short(&ask(&mut *other, &Ask { verb, ..GRAB })),
            expected,
            "{verb}"
        );
    }
}

#[test]
fn only_about_the_verbs_that_the_file_lists() {
    check(
        of("self").with("verbs", words(&["join"])),
        &[
            (
                "listed",
                Ask {
                    verb: Verb::Join,
                    ..GRAB
                },
                "ask by self",
            ),
            ("not listed", GRAB, "allow"),
        ],
    );
}

#[test]
#[rustfmt::skip]
fn its_word_counts_and_its_silence_is_a_no() {
    let stands = Standing::Stands { scope: Scope::ThisName, until: None, rate: None, max_age: None };
    for (answer, expected, standing) in [
        (given(Some("carol"), true, false, ""), "allow", Standing::Once),
        (given(Some("carol"), true, true, ""), "allow", stands),
        (given(Some("carol"), false, false, ""), "self: declined", Standing::Once),
        (given(Some("carol"), false, true, ""), "self: declined", stands),
        (given(None, false, false, ""), "self: timed-out", Standing::Once),
        (given(None, true, true, ""), "self: timed-out", Standing::Once),
    ] {
        let verdict = ask(&mut *build("self"), &Ask { answers: std::slice::from_ref(&answer), ..SEND });
        assert_eq!((short(&verdict).as_str(), verdict.standing), (expected, standing), "{answer:?}");
        assert_eq!(verdict.rule.as_deref(), Some("self"));
    }
}

#[test]
fn a_refusal_says_what_the_managing_peer_said() {
    for (answer, expected) in [
        (
            given(Some("carol"), false, false, "later"),
            "the managing peer, carol, declined say to /chat: later",
        ),
        (
            given(None, false, false, ""),
            "the managing peer did not decide on say to /chat in time, or is gone",
        ),
    ] {
        let verdict = ask(
            &mut *build("self"),
            &Ask {
                answers: &[answer],
                path: "/chat",
                ..SEND
            },
        );
        assert_eq!(text(&verdict), expected);
    }
}

#[test]
fn the_creator_has_so_long_to_answer() {
    for (spec, expected) in [(of("self"), 5_000_000), (of("self").with("within", 70), 70_000)] {
        match ask(&mut *build(spec), &GRAB).answer {
            Answer::Defer(managers::Defer {
                ask: whom, within, ..
            }) => {
                assert_eq!((whom, within), (managers::Ask::Creator, expected));
            }
            other => panic!("{other:?}"),
        }
    }
}
