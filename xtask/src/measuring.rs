//! `cargo xtask measuring`: format, lints and tests of the measurements, which are a workspace of their own below `benches`.
//!
//! They measure nearly all of the product, so they are checked again when its code has changed; the verdict is stored with a hash of that.

use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context as _, Result, ensure};
use toml::Table;

use crate::clients;
use crate::command::{cargo, line, shows};
use crate::test::{PROGRAMS, SEED, WHOLE};
use crate::verdict::{self, BASELINE, SOURCES};

/// The workspace.
pub(crate) const FOLDER: &str = "benches";
/// The stored verdict.
const FILE: &str = "benches/checked.toml";

const HEAD: &str = "\
# The measurements passed their lints and tests with the code of this hash, by this compiler (`cargo xtask measuring`).
# CI checks them again only where it differs: `cargo xtask measuring --write` stores that they pass.
";

/// Checks them, unless they passed with the very same code; whether they pass.
pub(crate) fn run_if_changed(root: &Path) -> Result<bool> {
    if stored(root)? == verdict::sources(root, counts_for)? {
        println!("{FILE} has the verdict on this code: `cargo xtask measuring` checks again");
        return Ok(true);
    }
    run(root, false)
}

/// Checks them; whether they pass, which is stored if asked for.
pub(crate) fn run(root: &Path, write: bool) -> Result<bool> {
    let before = verdict::sources(root, counts_for)?;
    let mut whole = cargo(root);
    whole.args(WHOLE);
    println!("$ {}", line(&whole));
    if !shows(&mut whole)? {
        return Ok(false);
    }
    for mut step in steps(root) {
        println!("$ {} ({FOLDER})", line(&step));
        if !shows(&mut step)? {
            return Ok(false);
        }
    }
    if write {
        ensure!(
            verdict::sources(root, counts_for)? == before,
            "the code has changed meanwhile: check it again"
        );
        let text = format!("{HEAD}{SOURCES} = \"{before}\"\n");
        fs::write(root.join(FILE), text).with_context(|| format!("{FILE} cannot be written"))?;
        println!("stored in {FILE}");
    }
    Ok(true)
}

fn steps(root: &Path) -> [Command; 4] {
    [
        &["fmt", "--all", "--", "--check"][..],
        &[
            "clippy",
            "--workspace",
            "--all-targets",
            "--locked",
            "--",
            "-D",
            "warnings",
        ],
        // The programs that their tests start.
        &["build", "--workspace", "--bins", "--locked"],
        &["test", "--workspace", "--locked", "--no-fail-fast"],
    ]
    .map(|args| {
        let mut step = cargo(&root.join(FOLDER));
        // What fails in CI is what a change did.
        step.args(args).env(SEED, "1");
        // Those of the product as all its tests have them, built once; with the features that a measurement's own build would have, most of
        // it would be compiled once more.
        step.env(PROGRAMS, clients::target(root).join("debug"));
        step
    })
}

fn stored(root: &Path) -> Result<String> {
    let text = fs::read_to_string(root.join(FILE)).unwrap_or_default();
    let table: Table = text.parse().with_context(|| format!("{FILE} is not TOML"))?;
    Ok(table
        .get(SOURCES)
        .and_then(toml::Value::as_str)
        .unwrap_or_default()
        .to_owned())
}

/// Whether the measurements are built from this file.
fn counts_for(path: &str) -> bool {
    const APART: &[&str] = &[
        "docs", "console", "clients", "pages", "packages", "xtask", ".ci", ".github",
    ];
    let (top, _) = path.split_once('/').unwrap_or(("", path));
    let is_test = path.contains("/tests/") || path.ends_with("/tests.rs");
    let is_own = top == FOLDER;
    let is_text = path.ends_with(".md") || path.contains("/fuzz/");
    // What was found is no part of what it was found of.
    let is_verdict = [FILE, BASELINE].contains(&path);
    !APART.contains(&top) && (is_own || !is_test) && !is_text && !is_verdict
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use super::*;

    fn table(path: &str) -> Table {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let text = fs::read_to_string(root.join(path)).expect(path);
        text.parse().expect(path)
    }

    /// Versions of each package of a lock file.
    fn versions(path: &str) -> BTreeMap<String, BTreeSet<String>> {
        let mut versions: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        for package in table(path)["package"].as_array().expect("packages") {
            let text = |key: &str| package[key].as_str().expect(key).to_owned();
            versions.entry(text("name")).or_default().insert(text("version"));
        }
        versions
    }

    /// What both workspaces need is built once for both, and measured as it is shipped.
    #[test]
    fn profiles_and_versions_are_those_of_the_product() {
        let (product, measuring) = (versions("Cargo.lock"), versions("benches/Cargo.lock"));
        for (name, own) in &measuring {
            let shared = product.get(name).is_none_or(|theirs| !theirs.is_disjoint(own));
            assert!(
                shared,
                "{name} {own:?} is not the product's: cargo update in benches"
            );
        }
        let mut profiles = table("Cargo.toml")["profile"].clone();
        // Cargo warns of a profile of what is not there.
        profiles["dev"]["package"]
            .as_table_mut()
            .expect("packages")
            .retain(|name, _| name == "*" || measuring.contains_key(name));
        assert_eq!(profiles, table("benches/Cargo.toml")["profile"]);
    }

    #[test]
    fn what_they_are_built_from_counts() {
        for path in [
            "Cargo.toml",
            "benches/Cargo.lock",
            "benches/tests/smoke.rs",
            "mom-hub/src/lib.rs",
            "tests/src/lib.rs",
            "lab/servo/src/control.rs",
            "clippy.toml",
            "config/cubo.toml",
            ".cargo/config.toml",
        ] {
            assert!(counts_for(path), "{path}");
        }
        for path in [
            "xtask/src/main.rs",
            "tests/tests/all/main.rs",
            "mom-hub/src/tree/tests.rs",
            "docs/design.md",
            "benches/checked.toml",
            "benches/instructions.toml",
            "protocols/brs/fuzz/Cargo.toml",
            "console/src/panels.ts",
        ] {
            assert!(!counts_for(path), "{path}");
        }
    }
}
