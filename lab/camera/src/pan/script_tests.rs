//! Scripts of the mount, in the language that all devices share.

use mom_device::{ErrorName, MAX_BYTES, MAX_STATEMENTS, Script, Statement};
use proptest::prelude::*;

use super::aim::HOME;
use super::*;

#[test]
fn statements_are_read() {
    let look = Statement::Do(MountAction::To(Aim::new(20.0, -10.5)));
    for (text, expected) in [
        ("look 20 -10.5", vec![look]),
        (
            "\n;; look 2e1 -10.5\r\n;home\t;# turn",
            vec![look, Statement::Do(MountAction::Home)],
        ),
        (
            "turn -5 +0.5; wait 0; wait 60000",
            vec![
                Statement::Do(MountAction::By(Aim::new(-5.0, 0.5))),
                Statement::Wait(0),
                Statement::Wait(60_000),
            ],
        ),
    ] {
        let read = Mount::script(text);
        assert_eq!(
            read.as_ref().map(Script::statements),
            Ok(&expected[..]),
            "{text:?}"
        );
    }
}

#[test]
fn mistakes_are_told_with_statement_line_and_column() {
    for (text, place, words) in [
        (
            "lok 1 2",
            (1, 1),
            "statement 1: there is no `lok`; did you mean `look`?",
        ),
        (
            "HOME",
            (1, 1),
            "statement 1: there is no `HOME`; did you mean `home`?",
        ),
        (
            "home\n  look 1",
            (2, 9),
            "statement 2: `look` takes two angles, pan tilt; tilt is missing",
        ),
        (
            "look NaN 0",
            (1, 6),
            "statement 1: pan is `NaN`, which is not a number",
        ),
        (
            "turn 0 1e999",
            (1, 8),
            "statement 1: dtilt is `1e999`, which is not a number",
        ),
        (
            "look 1 2 3",
            (1, 10),
            "statement 1: `look` ends before `3`; is a `;` or a new line missing?",
        ),
        (
            "home; wait 60001",
            (1, 12),
            "statement 2: `wait` takes a whole number of ms from 0 to 60000, not `60001`",
        ),
        (" # nothing", (1, 1), "the script has no statement"),
    ] {
        let error = Mount::script(text).expect_err(text);
        assert_eq!((error.text(), error.place()), (words, Some(place)), "{text:?}");
    }
    let long = Mount::script(&"home;".repeat(MAX_STATEMENTS + 1));
    assert_eq!(
        long.expect_err("too long").text(),
        "the script has more than 1000 statements"
    );
    let long = Mount::script(&" ".repeat(MAX_BYTES + 1));
    assert_eq!(
        long.expect_err("too long").text(),
        "the script has 65537 bytes, at most 65536 are read"
    );
}

#[test]
fn a_script_is_relative_by_its_first_turn() {
    for (text, relative) in [
        ("turn 1 0", true),
        ("wait 5; turn 1 0", true),
        ("home; turn 1 0", false),
        ("look 1 0; turn 1 0", false),
        ("wait 5", false),
    ] {
        assert_eq!(
            Mount::script(text).map(|script| script.is_relative::<Mount>()),
            Ok(relative),
            "{text}"
        );
    }
}

#[test]
fn each_turn_is_checked_from_where_the_one_before_ends() {
    let end = |text: &str| Mount::script(text).and_then(|script| Mount::end(&script, HOME));
    assert_eq!(end("turn 100 0; turn 70 5; wait 5"), Ok(Aim::new(170.0, -15.0)));
    let error = end("turn 100 0; turn 70.5 0").expect_err("too far");
    assert!(error.text().starts_with("statement 2: pan is 170.5°"), "{error}");
    assert_eq!(error.reachable(), Some(&Aim::new(170.0, -20.0).to_map().into()));
    let huge = end("look 1e308 0").expect_err("too far");
    assert_eq!(huge.name(), ErrorName::JointLimit);
}

proptest! {
    #[test]
    fn no_text_breaks_the_reader(text in "([a-z#;. \n0-9é-]|look|turn|home|wait){0,60}") {
        if let Err(error) = Mount::script(&text) {
            prop_assert!(!error.text().is_empty());
        }
    }
}
