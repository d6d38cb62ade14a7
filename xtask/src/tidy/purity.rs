//! The deciding crates do no IO, read no clock and start no thread: the same inputs must give the same effects.
//! What only their tests compile is free.

use anyhow::Result;

use super::Report;
use super::modules::{Use, reached};
use super::rust_text::group_end;
use super::tree::{Tree, line_at};

/// The folders of `mom-proto`, `mom-managers` and `mom-hub`.
const PURE: &[&str] = &["mom-proto", "managers", "mom-hub"];

/// The modules of `std` that such a crate does not need, with what to do instead.
const MODULES: &[(&str, &str)] = &[
    ("net", "the broker does IO; an address alone is `core::net`"),
    ("fs", "the broker reads files and hands on their text"),
    ("thread", "the broker has the threads"),
    ("process", "the broker is the process"),
    ("env", "the broker reads the environment"),
];
const CLOCKS: &[&str] = &[
    "SystemTime::now",
    "Instant::now",
    "DateTime::now_utc",
    "DateTime::now_local",
    "UtcDateTime::now",
];

pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    for package in PURE {
        for (path, how) in reached(tree, package) {
            if how == Use::Shipped && !path.ends_with("build.rs") {
                check_file(tree, &path, report);
            }
        }
    }
    Ok(())
}

fn check_file(tree: &Tree, path: &str, report: &mut Report<'_>) {
    let Some(text) = tree.rust_text(path) else { return };
    let source = &text.with_strings;
    let tests = text.test_regions();
    let mut fault = |at: usize, message: String| {
        if !tests.iter().any(|region| region.contains(&at)) {
            report(path, line_at(source, at), message);
        }
    };
    for (at, module) in std_modules(&text.code) {
        if let Some((_, instead)) = MODULES.iter().find(|(name, _)| *name == module) {
            fault(
                at,
                format!("`std::{module}` in a crate that only decides: {instead}"),
            );
        }
    }
    for clock in CLOCKS {
        for (at, _) in text.code.match_indices(clock) {
            fault(
                at,
                format!("`{clock}` in a crate that only decides: time is an argument"),
            );
        }
    }
}

/// The modules of `std` that the code names, alone or in a group `std::{a, b::c}`.
fn std_modules(code: &str) -> Vec<(usize, &str)> {
    let mut found = Vec::new();
    for (at, prefix) in code.match_indices("std::") {
        if code[..at].ends_with(|before: char| before.is_alphanumeric() || before == '_') {
            continue;
        }
        let start = at + prefix.len();
        if !code[start..].starts_with('{') {
            found.push((at, first_word(&code[start..])));
            continue;
        }
        let group = &code[start + 1..group_end(code.as_bytes(), start).max(start + 2) - 1];
        let (mut depth, mut from) = (0_usize, 0);
        for (place, byte) in group.bytes().chain([b',']).enumerate() {
            match byte {
                b'{' => depth += 1,
                b'}' => depth = depth.saturating_sub(1),
                b',' if depth == 0 => {
                    let item = group[from..place].trim_start();
                    found.push((start + 1 + place - item.len(), first_word(item)));
                    from = place + 1;
                }
                _ => {}
            }
        }
    }
    found
}

fn first_word(text: &str) -> &str {
    let end = text
        .find(|next: char| !next.is_alphanumeric() && next != '_')
        .unwrap_or(text.len());
    &text[..end]
}

#[cfg(test)]
mod tests {
    use super::super::found;
    use super::*;

    fn check_source(source: &str, expected: &[&str]) {
        let files = [
            ("mom-hub/src/lib.rs", source),
            ("mom-net/src/lib.rs", "use std::net::TcpStream;"),
        ];
        let found = found(check, &files);
        let places: Vec<String> = found
            .iter()
            .map(|line| {
                let line = line
                    .strip_prefix("mom-hub/src/lib.rs:")
                    .expect("only the hub is checked here");
                line.split(" in a crate").next().unwrap().to_owned()
            })
            .collect();
        assert_eq!(places, expected, "{source}");
    }

    #[test]
    fn io_clocks_and_threads_are_found() {
        check_source("use std::net::IpAddr;", &["1: `std::net`"]);
        check_source("\nfn a() { std::fs::read(\"x\"); }", &["2: `std::fs`"]);
        check_source(
            "use std::{\n  collections::{BTreeMap, fs},\n  thread,\n  net::{IpAddr},\n};",
            &["3: `std::thread`", "4: `std::net`"],
        );
        check_source(
            "let a = std::time::Instant::now();\nlet b = SystemTime::now();",
            &["1: `Instant::now`", "2: `SystemTime::now`"],
        );
    }

    #[test]
    fn the_clocks_of_other_crates_are_found() {
        check_source(
            "let a = time::OffsetDateTime::now_utc();",
            &["1: `DateTime::now_utc`"],
        );
        check_source("let a = UtcDateTime::now();", &["1: `UtcDateTime::now`"]);
    }

    #[test]
    fn what_is_pure_or_for_tests_is_free() {
        check_source(
            "use std::time::Duration; use core::net::IpAddr; use std::fmt;",
            &[],
        );
        check_source(
            "// std::fs\nconst A: &str = \"std::fs and Instant::now\"; use my_std::fs;",
            &[],
        );
        check_source(
            "#[cfg(test)]\nmod tests { use std::fs; fn a() { Instant::now(); } }",
            &[],
        );
    }

    #[test]
    fn a_file_of_tests_is_free_and_another_is_not() {
        let files = [
            ("managers/src/lib.rs", "#[cfg(test)]\nmod tests;\nmod real;"),
            ("managers/src/tests.rs", "use std::fs;"),
            ("managers/src/real.rs", "use std::env;"),
        ];
        let found = found(check, &files);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(
            found[0].starts_with("managers/src/real.rs:1: `std::env`"),
            "{found:?}"
        );
    }
}
