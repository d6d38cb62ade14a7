//! The client in JavaScript: built, tested and packed by npm.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, bail};

use crate::command::{line, output, shows};
use crate::test::Counts;

/// Where it is, from the workspace's folder.
pub(crate) const FOLDER: &str = "clients/js";

fn npm(root: &Path, args: &[&str]) -> Command {
    let mut npm = Command::new("npm");
    npm.args(args).current_dir(root.join(FOLDER)).stdin(Stdio::null());
    npm
}

/// Builds what its tests, and the dialogues that go through it, run.
pub(crate) fn build(root: &Path) -> Result<()> {
    let mut build = npm(root, &["run", "--silent", "build"]);
    if !shows(&mut build)? {
        bail!("`{}` in {FOLDER} failed: see the messages above", line(&build));
    }
    Ok(())
}

/// Runs its tests against this broker.
pub(crate) fn test(root: &Path, broker: &Path) -> Result<Counts> {
    let mut test = npm(root, &["test", "--silent"]);
    test.env("MOM_BROKER", broker).stdout(Stdio::piped());
    println!("$ {} ({FOLDER})", line(&test));
    let said = test
        .output()
        .context("npm cannot be started: it comes with Node, from https://nodejs.org")?;
    let text = String::from_utf8_lossy(&said.stdout);
    print!("{text}");
    Ok(counted(&text).concluded(said.status.success()))
}

/// Writes it as a package for npm; says where.
pub(crate) fn pack(root: &Path, into: &Path) -> Result<()> {
    std::fs::create_dir_all(into).with_context(|| format!("{} cannot be made", into.display()))?;
    let mut pack = npm(root, &["pack", "--silent", "--pack-destination"]);
    let said = output(pack.arg(into))?;
    println!("{}", said.lines().last().unwrap_or_default());
    println!("in {}", into.display());
    Ok(())
}

/// What the last lines of Node's tests say: `# pass 41`, `# fail 0`.
fn counted(text: &str) -> Counts {
    let mut counts = Counts::default();
    for line in text.lines() {
        for (begin, kind) in [("# pass ", "passed"), ("# fail ", "failed")] {
            if let Some(number) = line.strip_prefix(begin).and_then(|number| number.parse().ok()) {
                counts.add(kind, number);
            }
        }
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_lines_of_node_are_counted() {
        for (text, counts) in [
            (
                "ok 1 - # pass 7\n# tests 42\n# pass 41\n# fail 1\n# skipped 0\n",
                "41 passed, 1 failed",
            ),
            ("npm error missing script\n", "0 passed, 0 failed"),
        ] {
            assert_eq!(counted(text).to_string(), counts, "{text}");
        }
    }
}
