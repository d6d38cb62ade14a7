//! Packages in JavaScript and TypeScript: their scripts, run by npm, and the tests of Node counted.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, bail};

use crate::command::{line, output_within, program, shows};
use crate::counts::{Counts, LIMIT};

/// npm in this folder of the workspace.
pub(crate) fn npm(root: &Path, folder: &str, args: &[&str]) -> Command {
    let mut npm = program("npm");
    npm.args(args).current_dir(root.join(folder)).stdin(Stdio::null());
    npm
}

/// Runs a script of its `package.json`.
pub(crate) fn run(root: &Path, folder: &str, script: &str) -> Result<()> {
    let mut run = npm(root, folder, &["run", "--silent", script]);
    println!("$ {} ({folder})", line(&run));
    if !shows(&mut run)? {
        bail!("`{}` in {folder} failed: see the messages above", line(&run));
    }
    Ok(())
}

/// Runs its tests by this script, with what this variable names; gives what they say, and their counts.
pub(crate) fn test(
    root: &Path,
    folder: &str,
    script: &str,
    (name, value): (&str, &Path),
) -> Result<(String, Counts)> {
    let mut test = npm(root, folder, &["run", "--silent", script]);
    test.env(name, value);
    println!("$ {} ({folder})", line(&test));
    let (text, status) =
        output_within(&mut test, LIMIT).context("`cargo xtask test --install` installs npm")?;
    let counts = counted(&text);
    let ran = counts != Counts::default();
    if !ran {
        eprintln!("no test of {folder} ran: see the messages above");
    }
    Ok((text, counts.concluded(status.success() && ran)))
}

/// What the last lines of Node's tests say: `# pass 41`, `# fail 0`.
fn counted(text: &str) -> Counts {
    let mut counts = Counts::default();
    for line in text.lines() {
        counts.add_failure(line);
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
