//! `cargo xtask advisories`: whether something that we depend upon has a known vulnerability.
//!
//! Not part of CI: the list of them changes while the code does not, and has to be downloaded.

use std::path::Path;

use anyhow::Result;

use crate::command::{cargo, line, shows, succeeds};

const TOOL: &[&str] = &["deny", "--version"];
const FETCH: &[&str] = &["deny", "--log-level", "error", "fetch", "db"];
const CHECK: &[&str] = &["deny", "--locked", "check", "--disable-fetch", "advisories"];

/// Runs the check where it can be run, and says so where it cannot; whether it was run and found nothing.
pub(crate) fn run(root: &Path) -> Result<bool> {
    let run = |args: &[&str]| {
        let mut command = cargo(root);
        command.args(args);
        println!("$ {}", line(&command));
        shows(&mut command)
    };
    let (passed, said) = check(succeeds("cargo", TOOL), run)?;
    println!("advisories: {said}");
    Ok(passed)
}

fn check(tool: bool, mut run: impl FnMut(&[&str]) -> Result<bool>) -> Result<(bool, &'static str)> {
    if !tool {
        let said = "NOT CHECKED, the tool is missing; to get it: cargo install cargo-deny --locked";
        return Ok((false, said));
    }
    if !run(FETCH)? {
        let said = "NOT CHECKED, RustSec's database cannot be fetched from here; run this on a machine with Internet";
        return Ok((false, said));
    }
    Ok(match run(CHECK)? {
        true => (true, "none that matters"),
        false => (
            false,
            "FOUND, see above; update the crate, or excuse it in deny.toml with the reason",
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_not_checked_has_not_passed() {
        let checked = |tool: bool, works: fn(&[&str]) -> bool| check(tool, |args| Ok(works(args))).unwrap();
        assert!(checked(true, |_| true).0);
        for (tool, works, words) in [
            (
                false,
                (|_| true) as fn(&[&str]) -> bool,
                "cargo install cargo-deny",
            ),
            (true, |args| args == CHECK, "cannot be fetched"),
            (true, |args| args == FETCH, "FOUND"),
        ] {
            let (passed, said) = checked(tool, works);
            assert!(!passed && said.contains(words), "{said}");
        }
    }
}
