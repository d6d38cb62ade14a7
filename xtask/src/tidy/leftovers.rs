//! Nothing half-done stays: no stubs, no notes to oneself, no lint or test switched off without a reason, and no
//! test that waits by sleeping, which is slow where it holds and fails where the machine is busy.

use std::collections::BTreeMap;

use anyhow::Result;

use super::Report;
use super::modules::{Use, packages, reached};
use super::rust_text::{RustText, attributes, words};
use super::tree::{Tree, line_at};

/// Notes to oneself; in pieces, so that this file passes its own check wherever the words stand.
const NOTES: &[&str] = &[concat!("TO", "DO"), concat!("FIX", "ME"), concat!("XX", "X")];
const STUBS: &[&str] = &["todo", "unimplemented", "dbg"];

pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    let reached: BTreeMap<String, Use> = packages(tree)
        .into_iter()
        .flat_map(|package| reached(tree, package))
        .collect();
    for (path, source) in tree.with_extension(&["rs"]) {
        let Some(text) = tree.rust_text(path) else {
            continue;
        };
        let mut report = |at: usize, message: String| report(path, line_at(source, at), message);
        notes(&text.comments, &mut report);
        stubs(&text.code, &mut report);
        switched_off(text, &mut report);
        let all_is_test = is_test_file(path) || reached.get(path) == Some(&Use::TestOnly);
        let tests = if all_is_test {
            std::iter::once(0..source.len()).collect()
        } else {
            text.test_regions()
        };
        sleeps(source, &text.code, &mut |at, message| {
            if tests.iter().any(|region| region.contains(&at)) {
                report(at, message);
            }
        });
    }
    for (path, source) in tree.with_extension(&["py", "ts", "sh"]) {
        let mut report = |at: usize, message: String| report(path, line_at(source, at), message);
        notes(source, &mut report);
        if is_test_file(path) && !path.ends_with(".sh") {
            sleeps(source, source, &mut report);
        }
    }
    Ok(())
}

fn is_test_file(path: &str) -> bool {
    path.split('/').any(|part| part == "tests")
}

fn notes(text: &str, report: &mut dyn FnMut(usize, String)) {
    for (at, word) in words(text).filter(|(_, word)| NOTES.contains(word)) {
        report(at, format!("`{word}`: do it, or write an issue"));
    }
}

fn stubs(code: &str, report: &mut dyn FnMut(usize, String)) {
    for (at, word) in words(code) {
        if STUBS.contains(&word) && code[at + word.len()..].starts_with('!') {
            report(at, format!("`{word}!` is for the time before a change lands"));
        }
    }
}

/// Tests and lints that an attribute switches off without saying why.
fn switched_off(text: &RustText, report: &mut dyn FnMut(usize, String)) {
    for range in attributes(&text.code) {
        let code = &text.code[range.clone()];
        let has_reason = text.with_strings[range.clone()]
            .split("reason")
            .skip(1)
            .any(|rest| {
                rest.trim_start()
                    .strip_prefix('=')
                    .is_some_and(|rest| !rest.trim_start().starts_with("\"\""))
            });
        for (at, word) in words(code) {
            let next = code[at + word.len()..].trim_start().chars().next();
            match (word, next) {
                ("allow" | "expect", Some('(')) if !has_reason => {
                    report(
                        range.start,
                        format!("`{word}` without a reason: add `reason = \"…\"` or mend the code"),
                    );
                }
                ("ignore", Some(']' | ')' | ',')) => {
                    report(
                        range.start,
                        "`ignore` without a reason: write `#[ignore = \"…\"]` or mend the test".to_owned(),
                    );
                }
                _ => {}
            }
        }
    }
}

/// Calls of a sleep, unless the line ends in a comment `tidy: reason`.
fn sleeps(source: &str, code: &str, report: &mut dyn FnMut(usize, String)) {
    for (at, word) in words(code) {
        let is_call =
            matches!(word, "sleep" | "sleep_until" | "sleep_ms") && code[at + word.len()..].starts_with('(');
        // A function of this name that is defined here is judged by what it calls.
        let is_definition = code[..at].ends_with("fn ") || code[..at].ends_with("def ");
        if is_call && !is_definition && !is_excused(source, at) {
            report(
                at,
                "a sleep in a test: wait for the event itself, or excuse the line with `// tidy: reason`"
                    .to_owned(),
            );
        }
    }
}

fn is_excused(source: &str, at: usize) -> bool {
    let line = source[at..].lines().next().unwrap_or_default();
    ["// tidy: ", "# tidy: "].iter().any(|mark| {
        line.split(mark)
            .nth(1)
            .is_some_and(|reason| !reason.trim().is_empty())
    })
}

#[cfg(test)]
mod tests {
    use super::super::found;
    use super::*;

    /// Checks one file: the lines of the findings with the beginning of each message.
    fn check_file(path: &str, source: &str, expected: &[&str]) {
        let found = found(check, &[("p/Cargo.toml", ""), (path, source)]);
        assert_eq!(found.len(), expected.len(), "{source}: {found:?}");
        for (line, expected) in found.iter().zip(expected) {
            assert!(
                line.starts_with(&format!("{path}:{expected}")),
                "{source}: {line}"
            );
        }
    }

    #[test]
    fn notes_to_oneself_are_found_in_comments() {
        let note = NOTES[0];
        check_file(
            "p/src/lib.rs",
            &format!("a\n// {note}: later"),
            &[&format!("2: `{note}`")],
        );
        check_file(
            "p/src/lib.rs",
            &format!("const A: &str = \"{note}\"; // {note}S"),
            &[],
        );
        check_file(
            "x/run.sh",
            &format!("# {}\n", NOTES[1]),
            &[&format!("1: `{}`", NOTES[1])],
        );
        check_file("x/a.md", &format!("{note}\n"), &[]);
    }

    #[test]
    fn stubs_are_found_in_code() {
        check_file("p/src/lib.rs", "fn a() {\n    todo!()\n}", &["2: `todo!`"]);
        check_file(
            "p/src/lib.rs",
            "unimplemented!(); dbg!(x);",
            &["1: `dbg!`", "1: `unimplemented!`"],
        );
        check_file(
            "p/src/lib.rs",
            "// todo!()\nlet a = \"dbg!(x)\"; todo(!x); my_todo!()",
            &[],
        );
    }

    #[test]
    fn a_lint_or_test_switched_off_needs_a_reason() {
        check_file(
            "p/src/lib.rs",
            "#[allow(dead_code)]\nfn a() {}",
            &["1: `allow` without a reason"],
        );
        check_file(
            "p/src/lib.rs",
            "\n#![expect(\n    unused,\n)]",
            &["2: `expect` without a reason"],
        );
        check_file(
            "p/src/lib.rs",
            "#[cfg_attr(unix, allow(unused))] a",
            &["1: `allow`"],
        );
        check_file(
            "p/src/lib.rs",
            "#[allow(unused, reason = \"\")] a",
            &["1: `allow`"],
        );
        check_file(
            "p/src/lib.rs",
            "#[allow(unused, reason = \"generated\")] a.expect(\"x\");",
            &[],
        );
        check_file(
            "p/src/lib.rs",
            "#[test]\n#[ignore]\nfn a() {}",
            &["2: `ignore` without a reason"],
        );
        check_file("p/src/lib.rs", "#[ignore = \"takes an hour: nightly\"] a", &[]);
        check_file("p/src/lib.rs", "#[arg(allow_hyphen_values = true)] a", &[]);
    }

    #[test]
    fn sleeps_are_found_in_tests_only() {
        let found = &["1: a sleep in a test"];
        check_file("tests/src/lib.rs", "tokio::time::sleep(SECOND).await;", found);
        check_file("p/tests/a.rs", "thread::sleep(SECOND);", found);
        check_file(
            "p/src/lib.rs",
            "#[cfg(test)] mod tests { fn a() { std::thread::sleep(S); } }",
            found,
        );
        check_file("tests/peer.py", "time.sleep(1)", found);
        check_file("p/src/lib.rs", "thread::sleep(SECOND);", &[]);
        check_file(
            "p/tests/a.rs",
            "// sleep(1)\nlet a = \"sleep(1)\"; fn sleep(s: u8) {}",
            &[],
        );
    }

    #[test]
    fn a_sleep_is_excused_by_a_reason() {
        check_file(
            "p/tests/a.rs",
            "sleep(TICK); // tidy: the clock under test is the real one",
            &[],
        );
        check_file("p/tests/a.rs", "sleep(TICK); // tidy: ", &["1: a sleep"]);
        check_file(
            "tests/peer.py",
            "time.sleep(1)  # tidy: a slow reader is the point",
            &[],
        );
    }
}
