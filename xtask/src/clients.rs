//! The client in Python, tested by its language's own tool and counted with the others; clients in other languages, packed.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, bail};

use crate::command::{cargo, line, output, output_within, shows};
use crate::counts::{Counts, LIMIT};
use crate::javascript;

/// Where the packages for the client in Python are, from the workspace's folder; `cargo xtask test --install` makes it.
pub(crate) const PYTHON: &str = "target/python/bin/python";

/// Runs the tests of the client in Python against this broker; gives what they say, and their counts.
pub(crate) fn test(root: &Path, broker: &Path) -> Result<(String, Counts)> {
    let mut pytest = Command::new(root.join(PYTHON));
    pytest
        .args(["-m", "pytest"])
        .current_dir(root.join("clients/python"))
        .env("MOM_BROKER", broker)
        .stdin(Stdio::null());
    println!("$ {} (clients/python)", line(&pytest));
    let (text, status) = output_within(&mut pytest, LIMIT)
        .with_context(|| format!("`cargo xtask test --install` makes {PYTHON}"))?;
    let counts = counted(&text).concluded(status.success());
    Ok((text, counts))
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
        "rust" => pack_crates(root),
        other => bail!("there is no client in {other:?} to be packed: python, javascript, rust"),
    }
}

/// The packages of a device's or a client's program in Rust, each behind those that it needs.
const CRATES: [&str; 7] = [
    "mom-nearest",
    "mom-proto",
    "mom-net",
    "mom-client",
    "mom-pages",
    "mom-device",
    "mom-program",
];

/// Packs them, and builds each from what was packed.
fn pack_crates(root: &Path) -> Result<()> {
    let folder = target(root).join("packages");
    let mut packing = cargo(root);
    packing
        .args(["package", "--locked", "--allow-dirty", "--target-dir"])
        .arg(&folder)
        .args(CRATES.iter().flat_map(|name| ["-p", name]));
    if !shows(&mut packing)? {
        bail!("`{}` failed", line(&packing));
    }
    println!("in {}", folder.join("package").display());
    Ok(())
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
    text.lines().for_each(|line| counts.add_failure(line));
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
