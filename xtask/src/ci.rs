//! `cargo xtask ci`: everything that must hold before a change lands, the quick steps first.

use std::path::Path;
use std::time::Instant;

use anyhow::Result;

use crate::command::{cargo, line, shows, succeeds};
use crate::{console, instructions, measuring, test, tidy};

/// One step that is a cargo command.
struct Step {
    name: &'static str,
    args: &'static [&'static str],
    env: Option<(&'static str, &'static str)>,
}

/// Every step takes the whole workspace with the same features, so that the steps share what is built.
/// Warnings are turned into errors by arguments that reach only our crates; `RUSTFLAGS` would rebuild the others too.
const STEPS: &[Step] = &[
    Step {
        name: "format",
        args: &["fmt", "--all", "--", "--check"],
        env: None,
    },
    Step {
        name: "clippy",
        args: &[
            "clippy",
            "--workspace",
            test::FEATURES,
            "--all-targets",
            "--locked",
            "--",
            "-D",
            "warnings",
        ],
        env: None,
    },
    Step {
        name: "docs",
        args: &["doc", "--workspace", test::FEATURES, "--no-deps", "--locked"],
        env: Some(("RUSTDOCFLAGS", "-D warnings")),
    },
];

/// Runs the steps until one fails; whether all went well. Once the tests have run, the last line printed is their counts.
pub(crate) fn run(root: &Path) -> Result<bool> {
    for step in STEPS {
        let mut command = cargo(root);
        command.args(step.args).envs(step.env);
        if !timed(step.name, &line(&command), || shows(&mut command))? {
            return Ok(false);
        }
    }
    if !timed("tidy", "cargo xtask tidy", || tidy::run(root))? || !deny(root)? {
        return Ok(false);
    }
    let built = timed("console", "cargo xtask console", || {
        console::build(root).map(|()| true)
    })?;
    if !built {
        return Ok(false);
    }
    let mut counts = None;
    let passed = timed("test", "cargo xtask test", || {
        let result = test::run(root, &[])?;
        let passed = result.is_success();
        counts = Some(result);
        Ok(passed)
    })?;
    let measures = timed("measuring", "cargo xtask measuring", || {
        measuring::run_if_changed(root)
    })?;
    // Before the closing line, and also where a test failed: both are told in one run.
    let kept = timed("instructions", "cargo xtask instructions", || {
        instructions::run_if_changed(root)
    })?;
    if let Some(counts) = counts {
        counts.show_failures();
        println!("{counts}");
    }
    Ok(passed && measures && kept)
}

/// Licences, bans and sources. Advisories are left out: they need a download, and change while the code does not.
fn deny(root: &Path) -> Result<bool> {
    if !succeeds("cargo", &["deny", "--version"]) {
        println!("\n== deny: skipped, the tool is missing; to get it: cargo install cargo-deny --locked");
        return Ok(true);
    }
    let mut command = cargo(root);
    command.args([
        "deny",
        "--log-level",
        "error",
        "--locked",
        "check",
        "licenses",
        "bans",
        "sources",
    ]);
    timed("deny", &line(&command), || shows(&mut command))
}

/// Runs one step between its heading and its duration.
fn timed(name: &str, command: &str, step: impl FnOnce() -> Result<bool>) -> Result<bool> {
    println!("\n== {name}: {command}");
    let start = Instant::now();
    let passed = step()?;
    let seconds = start.elapsed().as_secs_f64();
    if passed {
        println!("-- {name}: passed in {seconds:.1} s");
    } else {
        println!("-- {name}: FAILED after {seconds:.1} s; to run it alone: {command}");
    }
    Ok(passed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_reports_what_it_did() {
        assert!(timed("good", "true", || Ok(true)).unwrap());
        assert!(!timed("bad", "false", || Ok(false)).unwrap());
        assert!(timed("broken", "x", || anyhow::bail!("cannot start")).is_err());
    }

    #[test]
    fn steps_share_what_is_built() {
        for step in STEPS {
            let same: [&[&str]; 2] = [&["--all"], &["--workspace", test::FEATURES]];
            let has = |args: &[&str]| args.iter().all(|arg| step.args.contains(arg));
            assert!(same.into_iter().any(has), "{}", step.name);
            let features = step.args.iter().filter(|arg| arg.contains("feature"));
            assert!(
                features.eq(step.args.iter().filter(|arg| **arg == test::FEATURES)),
                "{}",
                step.name
            );
            assert_ne!(step.env.map(|(key, _)| key), Some("RUSTFLAGS"), "{}", step.name);
        }
    }
}
