//! The tests of the clients in other languages, run by their languages' own tools and counted with the others.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, bail};

use crate::command::{line, output};
use crate::javascript;
use crate::test::Counts;

/// Where the packages for the client in Python are, from the workspace's folder; `cargo xtask test --install` makes it.
pub(crate) const PYTHON: &str = "target/python/bin/python";

/// Runs the tests of all clients against the broker in this folder.
pub(crate) fn test(root: &Path, programs: &Path) -> Result<Counts> {
    let broker = programs.join("mom-broker");
    let mut pytest = Command::new(root.join(PYTHON));
    pytest
        .args(["-m", "pytest"])
        .current_dir(root.join("clients/python"))
        .env("MOM_BROKER", &broker)
        .stdin(Stdio::null())
        .stdout(Stdio::piped());
    println!("$ {} (clients/python)", line(&pytest));
    let said = pytest
        .output()
        .with_context(|| format!("{PYTHON} cannot be started: `cargo xtask test --install` makes it"))?;
    let text = String::from_utf8_lossy(&said.stdout);
    print!("{text}");
    let python = counted(&text).concluded(said.status.success());
    Ok(python.and(javascript::test(root, &broker)?))
}

/// Writes the client of this language as a package; says where it is.
pub(crate) fn pack(root: &Path, language: &str) -> Result<()> {
    match language {
        "python" => {
            let mut build = Command::new(root.join(PYTHON));
            build
                .args(["-m", "build", "--no-isolation", "--outdir"])
                .arg(target(root).join("packages"))
                .current_dir(root.join("clients/python"));
            let said = output(&mut build)?;
            println!("{}", said.lines().last().unwrap_or_default());
            println!("in {}", target(root).join("packages").display());
            Ok(())
        }
        "javascript" => javascript::pack(root, &target(root).join("packages")),
        other => bail!("there is no client in {other:?} to be packed: python, javascript"),
    }
}

/// The folder that cargo builds into.
pub(crate) fn target(root: &Path) -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), |folder| root.join(folder))
}

/// What the last line of pytest says: `2 failed, 79 passed, 1 error in 1.2s`.
fn counted(text: &str) -> Counts {
    let last = text
        .lines()
        .rev()
        .find(|line| line.contains(" in "))
        .unwrap_or_default();
    let mut counts = Counts::default();
    for part in last.trim_matches(|c| c == '=' || c == ' ').split(", ") {
        let mut words = part.split_whitespace();
        if let (Some(Ok(number)), Some(kind)) = (words.next().map(str::parse), words.next()) {
            counts.add(kind, number);
        }
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_line_of_pytest_is_counted() {
        for (text, counts) in [
            ("......\n79 passed in 1.20s\n", "79 passed, 0 failed"),
            (
                "..F\n= 2 failed, 79 passed, 1 error in 1.2s =\n",
                "79 passed, 3 failed",
            ),
            ("usage: pytest\n", "0 passed, 0 failed"),
        ] {
            assert_eq!(counted(text).to_string(), counts, "{text}");
        }
    }
}
