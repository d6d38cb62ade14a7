//! `cargo xtask instructions`: what the hot path costs in instructions, held to a stored count.
//!
//! valgrind's callgrind counts instructions, which repeat to a few in a thousand whatever else the machine does; time
//! does not. Each case runs twice, the second time longer: the difference is what the case costs, without its start.
//!
//! The counts are stored with a hash of what they were counted of: as long as that is unchanged CI need not count again.

use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context as _, Result, bail};
use toml::{Table, Value};

use crate::command::line;
use crate::peers::build;
use crate::verdict::{self, BASELINE, SOURCES};

/// What the counts are of: these packages, with all that they are built from.
const PACKAGES: &[&str] = &[
    "mom-proto/",
    "managers/",
    "mom-hub/",
    "mom-net/",
    "mom-broker/",
    "mom-client/",
    "benches/src/",
];
/// What decides how they are built.
const SETTINGS: &[&str] = &["Cargo.toml", "benches/Cargo.toml", "benches/Cargo.lock"];
/// How far a count may be from the stored one, either way: one that fell is stored too, or the next rise is hidden.
const TOLERANCE: f64 = 0.05;

const HEAD: &str = "\
# Instructions of each case of the hot path, counted by callgrind in a release build (`cargo xtask instructions`).
# One count: decode, admit or encode one parcel with 16 bytes of content, in binary or XML; deliver = one parcel through a whole broker
# to ten receivers over sockets, with all that sender and receivers do in the same process.
# Another toolchain or C library may count differently: `cargo xtask instructions --write` stores what is counted now.
# `sources` is the hash of the code and the compiler of which they were counted: CI counts again only where it differs.
";

/// A case of `hot-path`, and how often it runs.
struct Case {
    name: &'static str,
    times: u64,
}

const CASES: [Case; 6] = [
    Case {
        name: "decode",
        times: 20_000,
    },
    Case {
        name: "decode-xml",
        times: 20_000,
    },
    Case {
        name: "admit",
        times: 20_000,
    },
    Case {
        name: "encode",
        times: 20_000,
    },
    Case {
        name: "encode-xml",
        times: 20_000,
    },
    Case {
        name: "deliver",
        times: 500,
    },
];

/// Counts all cases, unless the stored counts are of the very same code; whether each is within its bound.
pub(crate) fn run_if_changed(root: &Path) -> Result<bool> {
    if stored(root)?.get(SOURCES).and_then(Value::as_str) == Some(&*sources(root)?) {
        println!(
            "{BASELINE} has the counts of this code and this compiler: `cargo xtask instructions` counts them again"
        );
        return Ok(true);
    }
    run(root, false)
}

/// Counts all cases; whether each is within its bound, or they were stored.
pub(crate) fn run(root: &Path, write: bool) -> Result<bool> {
    let built = build(root, &[("mom-benches", &["hot-path"])])?;
    let mut counts = Table::new();
    for case in CASES {
        let count = |times| count(&built.join("hot-path"), case.name, times);
        let (short, long) = (count(case.times)?, count(3 * case.times)?);
        let each = long.saturating_sub(short) / (2 * case.times);
        counts.insert(case.name.to_owned(), Value::Integer(i64::try_from(each)?));
    }
    let file = root.join(BASELINE);
    if write {
        counts.insert(SOURCES.to_owned(), Value::String(sources(root)?));
        let text = format!("{HEAD}{counts}");
        fs::write(&file, text).with_context(|| format!("{BASELINE} cannot be written"))?;
        println!("{counts}stored in {BASELINE}");
        return Ok(true);
    }
    let findings = compare(&stored(root)?, &counts);
    findings.iter().for_each(|finding| println!("{}", finding.text));
    Ok(findings.iter().all(|finding| finding.good))
}

/// What is in the file of the counts.
fn stored(root: &Path) -> Result<Table> {
    let text =
        fs::read_to_string(root.join(BASELINE)).with_context(|| format!("{BASELINE} cannot be read"))?;
    text.parse()
        .with_context(|| format!("{BASELINE} holds no counts"))
}

/// A hash of the code of the hot path, of how it is built, and of the compiler.
fn sources(root: &Path) -> Result<String> {
    verdict::sources(root, counts_for)
}

/// Whether the hot path is built from this file.
fn counts_for(path: &str) -> bool {
    let is_source = path.ends_with(".rs") || path.ends_with("/Cargo.toml");
    let is_test = path.contains("/tests/") || path.ends_with("tests.rs");
    let is_part = PACKAGES.iter().any(|package| path.starts_with(package));
    SETTINGS.contains(&path) || (is_part && is_source && !is_test)
}

/// The instructions of one run of a case.
fn count(program: &Path, case: &str, times: u64) -> Result<u64> {
    let mut command = Command::new("valgrind");
    command.args(["--tool=callgrind", "--callgrind-out-file=/dev/null"]);
    command.arg(program).args([case, &times.to_string()]);
    let out = command
        .output()
        .with_context(|| format!("`{}` cannot be started", line(&command)))?;
    let said = String::from_utf8_lossy(&out.stderr);
    if !out.status.success() {
        bail!("`{}` failed:\n{said}", line(&command));
    }
    collected(&said).with_context(|| format!("`{}` told no count:\n{said}", line(&command)))
}

/// The count in what callgrind says at its end.
fn collected(said: &str) -> Option<u64> {
    let (_, after) = said.rsplit_once("Collected :")?;
    after.split_whitespace().next()?.parse().ok()
}

/// One case beside its stored count.
struct Finding {
    text: String,
    good: bool,
}

fn compare(stored: &Table, counts: &Table) -> Vec<Finding> {
    let one = |(name, now): (&String, &Value)| {
        let now = now.as_integer().unwrap_or_default() as f64;
        let Some(before) = stored
            .get(name)
            .and_then(Value::as_integer)
            .filter(|count| *count > 0)
        else {
            return Finding {
                text: format!(
                    "{name}: {now} instructions, and no stored count: cargo xtask instructions --write"
                ),
                good: false,
            };
        };
        let change = now / before as f64 - 1.0;
        let good = change.abs() <= TOLERANCE;
        let advice = match (good, change > 0.0) {
            (true, _) => "",
            (false, true) => "; if it has to be so, store it: cargo xtask instructions --write",
            (false, false) => "; store what was won: cargo xtask instructions --write",
        };
        Finding {
            text: format!(
                "{name}: {now} instructions, stored {before}, {:+.1} %{advice}",
                100.0 * change
            ),
            good,
        }
    };
    counts.iter().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_count_is_found_in_what_callgrind_says() {
        let said =
            "==1== Events    : Ir\n==1== Collected : 123456789\n==1== \n==1== I   refs:      123,456,789\n";
        assert_eq!(collected(said), Some(123_456_789));
        assert_eq!(collected("valgrind: not found"), None);
    }

    #[test]
    fn a_change_of_more_than_the_tolerance_is_told_either_way() {
        let table = |count: i64| Table::from_iter([("decode".to_owned(), Value::Integer(count))]);
        let good = |now| {
            compare(&table(1000), &table(now))
                .iter()
                .all(|finding| finding.good)
        };
        assert!(good(1000) && good(1049) && good(951));
        assert!(!good(1051) && !good(949));
        let missing = compare(&Table::new(), &table(1000));
        assert!(!missing[0].good && missing[0].text.contains("--write"));
    }

    #[test]
    fn counts_hold_for_the_code_that_they_are_of() {
        for same in [
            "docs/design.md",
            "mom-hub/tests/random/main.rs",
            "mom-hub/src/tree/tests.rs",
            "lab/arm/src/lib.rs",
        ] {
            assert!(!counts_for(same), "{same}");
        }
        for other in [
            "mom-hub/src/lib.rs",
            "benches/Cargo.lock",
            "benches/Cargo.toml",
            "benches/src/hub.rs",
        ] {
            assert!(counts_for(other), "{other}");
        }
    }

    #[test]
    fn every_case_has_a_stored_count() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let stored: Table = fs::read_to_string(root.join(BASELINE)).unwrap().parse().unwrap();
        for case in CASES {
            assert!(
                stored.get(case.name).is_some_and(Value::is_integer),
                "{}",
                case.name
            );
        }
    }
}
