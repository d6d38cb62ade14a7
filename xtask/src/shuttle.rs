//! `cargo xtask shuttle`: the tests that try the broker's threads in many orders of their steps.
//!
//! They are unit tests of `mom-broker`, built once more with `--cfg shuttle`, which reaches that package alone: what it
//! depends on is shared with the other tests.

use std::path::Path;
use std::process::Stdio;

use anyhow::{Context as _, Result};
use serde_json::Value;

use crate::command::{cargo, line, output, shows};

/// Part of the names of all of them, and of no other test.
const NAME: &str = "interleaved";

/// How to start it by hand.
pub(crate) const COMMAND: &str = "cargo xtask shuttle";

/// Builds and runs them; whether all orders went well. `orders` and `seed` as the tests have them if not said.
pub(crate) fn run(root: &Path, orders: Option<u64>, seed: Option<u64>) -> Result<bool> {
    let mut build = cargo(root);
    build
        .args([
            "rustc",
            "--locked",
            "--package",
            "mom-broker",
            "--lib",
            "--profile",
            "test",
        ])
        .args([
            "--message-format",
            "json-render-diagnostics",
            "--",
            "--cfg",
            "shuttle",
        ])
        .stderr(Stdio::inherit());
    println!("$ {}", line(&build));
    let messages = output(&mut build)?;
    let program = messages
        .lines()
        .filter_map(program_of)
        .next_back()
        .context("cargo names no test program that it has built")?;
    let mut tests = std::process::Command::new(&program);
    tests.arg(NAME).current_dir(root).stdin(Stdio::null());
    for (name, number) in [("MOM_ORDERS", orders), ("MOM_SEED", seed)] {
        if let Some(number) = number {
            tests.env(name, number.to_string());
        }
    }
    shows(&mut tests)
}

/// The program that one of cargo's messages says it has built.
fn program_of(message: &str) -> Option<String> {
    let message: Value = serde_json::from_str(message).ok()?;
    Some(message.get("executable")?.as_str()?.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_program_is_found_among_messages() {
        let messages = [
            (r#"{"reason":"compiler-artifact","executable":null}"#, None),
            (
                r#"{"reason":"compiler-artifact","executable":"/t/mom_broker-1"}"#,
                Some("/t/mom_broker-1"),
            ),
            (r#"{"reason":"build-finished","success":true}"#, None),
            ("running 3 tests", None),
        ];
        for (message, program) in messages {
            assert_eq!(program_of(message).as_deref(), program, "{message}");
        }
    }
}
