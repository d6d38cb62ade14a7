//! `cargo xtask mutants`: whether a package's own tests notice that its code was changed for the worse.
//!
//! cargo-mutants makes the mutants and runs the tests. This chooses a sample of them by a seed, so that everybody tries
//! the same ones, and holds the result to a goal and to the list of those that may live.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result, bail};
use serde_json::Value as Json;
use toml::Table;

use crate::command::{cargo, line, output, shows};

/// The packages that decide, and those whose faults would reach them.
pub(crate) const PACKAGES: [&str; 3] = ["mom-hub", "mom-managers", "mom-proto"];
/// The mutants that may live, by package, each with the reason.
const SURVIVORS: &str = "xtask/mutants.toml";
/// The part of the viable mutants that has to be caught.
const GOAL_PERCENT: usize = 95;

/// What to try.
pub(crate) struct Sample<'a> {
    pub(crate) packages: &'a [String],
    /// Mutants of each package; struct fields come on top, because cargo-mutants does not choose among them.
    pub(crate) count: usize,
    pub(crate) seed: u64,
    pub(crate) jobs: usize,
}

/// Tries a sample of the mutants of each package; whether enough were caught, and all others are listed.
pub(crate) fn run(root: &Path, sample: &Sample<'_>) -> Result<bool> {
    let survivors = fs::read_to_string(root.join(SURVIVORS));
    let survivors = survivors.with_context(|| format!("{SURVIVORS} cannot be read"))?;
    let survivors = survivors.parse::<Table>();
    let survivors = survivors.with_context(|| format!("{SURVIVORS} is not TOML"))?;
    let mut good = true;
    for package in sample.packages {
        let outcomes = outcomes(root, package, sample)?;
        let result = Tally::new(&outcomes, &reasons(&survivors, package)?);
        println!("{}", result.report(package, sample.seed));
        good &= result.is_good();
    }
    Ok(good)
}

/// Runs cargo-mutants on the sample of one package; what became of each mutant, by its name.
fn outcomes(root: &Path, package: &str, sample: &Sample<'_>) -> Result<BTreeMap<String, Outcome>> {
    let mut list = cargo(root);
    list.args(["mutants", "--list", "--json", "--package", package]);
    let all: Json = serde_json::from_str(&output(&mut list)?).context("cargo mutants lists no JSON")?;
    let named = named(all.as_array().map_or(&[], Vec::as_slice));
    if named.is_empty() {
        bail!("{package} has no mutants: is it a package of this workspace?");
    }
    let folder = root.join("target/mutants").join(package);
    fs::create_dir_all(&folder).with_context(|| format!("{} cannot be made", folder.display()))?;
    let config = folder.join("sample.toml");
    let chosen = choose(&named, sample.seed, sample.count);
    fs::write(&config, configuration(&chosen))
        .with_context(|| format!("{} cannot be written", config.display()))?;

    let mut mutants = cargo(root);
    mutants.args(["mutants", "--package", package]);
    mutants.arg("--config").arg(&config).arg("--output").arg(&folder);
    mutants.args(["--jobs", &sample.jobs.to_string(), "--", "--lib", "--tests"]);
    // Nobody debugs a mutant, nor reads the shortest case that finds it.
    for key in [
        "CARGO_PROFILE_DEV_DEBUG",
        "CARGO_PROFILE_TEST_DEBUG",
        "PROPTEST_MAX_SHRINK_ITERS",
    ] {
        mutants.env(key, "0");
    }
    println!("$ {}", line(&mutants));
    // It ends badly when a mutant lives; what it has written down says more. An older result must not pass for it.
    let written = folder.join("mutants.out/outcomes.json");
    if written.exists() {
        fs::remove_file(&written).with_context(|| format!("{} cannot be removed", written.display()))?;
    }
    shows(&mut mutants)?;
    let text = fs::read_to_string(&written);
    let text = text.with_context(|| format!("`{}` wrote no outcomes", line(&mutants)))?;
    let outcomes: Json = serde_json::from_str(&text).context("the outcomes are not JSON")?;
    read_outcomes(&outcomes, &named)
}

/// Each mutant's own name by the name that cargo-mutants gives it.
///
/// cargo-mutants names it by line and column, which move with each change above. The own name leaves them out and
/// counts those that are the same without.
fn named(mutants: &[Json]) -> Vec<(String, String)> {
    let mut known = BTreeMap::<String, usize>::new();
    let names = mutants.iter().filter_map(|mutant| mutant["name"].as_str());
    names
        .map(|name| {
            let mut own = without_position(name);
            let count = known.entry(own.clone()).or_default();
            *count += 1;
            if *count > 1 {
                let _ = write!(own, " #{count}");
            }
            (name.to_owned(), own)
        })
        .collect()
}

/// `a.rs: replace f with ()` of `a.rs:7:9: replace f with ()`.
fn without_position(name: &str) -> String {
    let Some((place, what)) = name.split_once(": ") else {
        return name.to_owned();
    };
    let file = place.split(':').next().unwrap_or(place);
    format!("{file}: {what}")
}

/// The first `count` in an order that the seed and the own names alone decide: a change of the code leaves most of a
/// sample as it was.
fn choose(named: &[(String, String)], seed: u64, count: usize) -> Vec<&str> {
    let mut ranked: Vec<_> = named
        .iter()
        .map(|(name, own)| (rank(own, seed), name.as_str()))
        .collect();
    ranked.sort_unstable();
    ranked.into_iter().take(count).map(|(_, name)| name).collect()
}

/// FNV-1a with a last mixing step: the same on all machines and in all versions.
fn rank(text: &str, seed: u64) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325 ^ seed;
    for byte in text.bytes() {
        hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    }
    hash = (hash ^ (hash >> 32)).wrapping_mul(0xd6e8_feb8_6659_fd93);
    hash ^ (hash >> 32)
}

/// A configuration of cargo-mutants that names these mutants and no others.
fn configuration(chosen: &[&str]) -> String {
    let mut text = String::from("examine_re = [\n");
    for name in chosen {
        let mut escaped = String::new();
        for letter in name.chars() {
            if r"\.+*?()|[]{}^$#&-~".contains(letter) {
                escaped.push('\\');
            }
            escaped.push(letter);
        }
        let _ = writeln!(text, "  '''^{escaped}$''',");
    }
    text.push_str("]\n");
    text
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    /// A test failed, or ran without an end.
    Caught,
    /// It lives.
    Missed,
    /// It does not build.
    Unviable,
}

fn read_outcomes(outcomes: &Json, named: &[(String, String)]) -> Result<BTreeMap<String, Outcome>> {
    let own: BTreeMap<&str, &str> = named
        .iter()
        .map(|(name, own)| (name.as_str(), own.as_str()))
        .collect();
    let mut read = BTreeMap::new();
    for outcome in outcomes["outcomes"].as_array().map_or(&[][..], Vec::as_slice) {
        let summary = outcome["summary"].as_str().unwrap_or_default();
        let Some(name) = outcome["scenario"]["Mutant"]["name"].as_str() else {
            if summary != "Success" {
                bail!("the tests fail before anything is changed; run them by themselves first");
            }
            continue;
        };
        let became = match summary {
            "CaughtMutant" | "Timeout" => Outcome::Caught,
            "MissedMutant" => Outcome::Missed,
            "Unviable" => Outcome::Unviable,
            other => bail!("{name}: the outcome {other:?} is not known"),
        };
        let own = own.get(name).copied().unwrap_or(name);
        read.insert(own.to_owned(), became);
    }
    Ok(read)
}

/// The reasons for the mutants of a package that may live.
fn reasons<'a>(survivors: &'a Table, package: &str) -> Result<BTreeMap<&'a str, &'a str>> {
    let Some(listed) = survivors.get(package) else {
        return Ok(BTreeMap::new());
    };
    let listed = listed.as_table();
    let listed = listed.with_context(|| format!("{SURVIVORS}: {package} is not a table"))?;
    listed
        .iter()
        .map(|(mutant, reason)| {
            let reason = reason.as_str().filter(|reason| !reason.is_empty());
            let reason = reason.with_context(|| format!("{SURVIVORS}: {mutant:?} has no reason"))?;
            Ok((mutant.as_str(), reason))
        })
        .collect()
}

/// What became of the sample of a package.
struct Tally {
    caught: usize,
    unviable: usize,
    /// Those that live, with the reason for which they may.
    missed: Vec<(String, Option<String>)>,
    /// Those that are listed, and were caught.
    needless: Vec<String>,
}

impl Tally {
    fn new(outcomes: &BTreeMap<String, Outcome>, reasons: &BTreeMap<&str, &str>) -> Tally {
        let count = |wanted| outcomes.values().filter(|outcome| **outcome == wanted).count();
        let those = |wanted| {
            let mutants = outcomes.iter();
            mutants.filter_map(move |(mutant, outcome)| (*outcome == wanted).then_some(mutant))
        };
        let reason = |mutant: &String| reasons.get(mutant.as_str()).map(|reason| (*reason).to_owned());
        let missed = those(Outcome::Missed).map(|mutant| (mutant.clone(), reason(mutant)));
        let needless = those(Outcome::Caught).filter(|mutant| reasons.contains_key(mutant.as_str()));
        Tally {
            caught: count(Outcome::Caught),
            unviable: count(Outcome::Unviable),
            missed: missed.collect(),
            needless: needless.cloned().collect(),
        }
    }

    fn viable(&self) -> usize {
        self.caught + self.missed.len()
    }

    /// Whether enough were caught and every other one is listed.
    fn is_good(&self) -> bool {
        self.caught * 100 >= self.viable() * GOAL_PERCENT
            && self.missed.iter().all(|(_, reason)| reason.is_some())
    }

    fn report(&self, package: &str, seed: u64) -> String {
        let percent = 100.0 * self.caught as f64 / self.viable().max(1) as f64;
        let mut text = format!(
            "{package}: {} of {} viable mutants caught ({percent:.1} %), {} not viable, seed {seed}",
            self.caught,
            self.viable(),
            self.unviable
        );
        for (mutant, reason) in &self.missed {
            let reason = match reason {
                Some(reason) => format!("may live: {reason}"),
                None => format!("no test notices; write one, or list it in {SURVIVORS} with the reason"),
            };
            let _ = write!(text, "\n  {mutant}\n    {reason}");
        }
        for mutant in &self.needless {
            let _ = write!(text, "\n  {mutant}\n    was caught: strike it from {SURVIVORS}");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn names(texts: &[&str]) -> Vec<(String, String)> {
        let listed: Vec<Json> = texts.iter().map(|text| json!({ "name": text })).collect();
        named(&listed)
    }

    #[test]
    fn a_mutant_keeps_its_name_when_lines_move() {
        let before = names(&[
            "a.rs:7:9: replace f -> u8 with 1",
            "a.rs:9:1: replace == with != in f",
            "a.rs:9:8: replace == with != in f",
        ]);
        let after = names(&[
            "a.rs:17:9: replace f -> u8 with 1",
            "a.rs:19:1: replace == with != in f",
            "a.rs:19:8: replace == with != in f",
        ]);
        let own = |named: &[(String, String)]| named.iter().map(|(_, own)| own.clone()).collect::<Vec<_>>();
        assert_eq!(own(&before), own(&after));
        assert_eq!(own(&before)[2], "a.rs: replace == with != in f #2");
    }

    #[test]
    fn a_seed_chooses_the_same_ones_and_another_seed_others() {
        let texts: Vec<String> = (0..100)
            .map(|line| format!("a.rs:{line}:1: replace f{line}"))
            .collect();
        let named = names(&texts.iter().map(String::as_str).collect::<Vec<_>>());
        let one = choose(&named, 1, 10);
        assert_eq!((one.len(), &one), (10, &choose(&named, 1, 10)));
        assert_ne!(one, choose(&named, 2, 10));
        // One mutant more changes at most one of the chosen.
        let more = [&named[..], &names(&["b.rs:1:1: replace g"])].concat();
        let kept = choose(&more, 1, 10)
            .into_iter()
            .filter(|name| one.contains(name))
            .count();
        assert!(kept >= 9, "{kept} of 10 are chosen again");
        // What everybody tries: this changes for all if the order does.
        assert_eq!(rank("a.rs: replace f", 1), 15_447_406_254_584_976_617);
    }

    #[test]
    fn the_configuration_is_toml_and_takes_names_as_they_are() {
        let text = configuration(&["a.rs:1:2: replace <impl F for G>::f -> Vec<u8> with vec![]"]);
        let read: Table = text.parse().unwrap();
        assert_eq!(
            read["examine_re"][0].as_str(),
            Some(r"^a\.rs:1:2: replace <impl F for G>::f \-> Vec<u8> with vec!\[\]$")
        );
    }

    #[test]
    fn what_lives_without_a_reason_fails_and_so_does_too_much_that_lives() {
        let named = names(&["a.rs:1:1: one", "a.rs:2:1: two", "a.rs:3:1: three"]);
        let of = |name: &str, summary: &str| json!({ "summary": summary, "scenario": { "Mutant": { "name": name } } });
        let written = |second: &str| {
            json!({ "outcomes": [
                { "summary": "Success", "scenario": "Baseline" },
                of("a.rs:1:1: one", "CaughtMutant"),
                of("a.rs:2:1: two", second),
                of("a.rs:3:1: three", "Unviable"),
            ] })
        };
        let tally = |second: &str, listed: &str| {
            let survivors: Table = format!("[p]\n{listed}").parse().unwrap();
            let outcomes = read_outcomes(&written(second), &named).unwrap();
            Tally::new(&outcomes, &reasons(&survivors, "p").unwrap())
        };
        let listed = "\"a.rs: two\" = \"the same\"";
        let good = tally("Timeout", "");
        assert!(good.is_good() && good.viable() == 2 && good.unviable == 1);
        assert!(
            !tally("MissedMutant", "").is_good(),
            "nobody said why it may live"
        );
        let half = tally("MissedMutant", listed);
        assert!(!half.is_good(), "half is too little");
        assert!(
            half.report("p", 1)
                .contains("1 of 2 viable mutants caught (50.0 %)")
        );
        assert!(half.report("p", 1).contains("a.rs: two\n    may live: the same"));
        assert!(tally("CaughtMutant", listed).report("p", 1).contains("strike it"));
    }

    #[test]
    fn tests_that_fail_by_themselves_are_an_error() {
        let written = json!({ "outcomes": [{ "summary": "Failure", "scenario": "Baseline" }] });
        let error = read_outcomes(&written, &[]).unwrap_err().to_string();
        assert!(error.contains("before anything is changed"), "{error}");
        assert!(read_outcomes(&json!({ "outcomes": [] }), &[]).unwrap().is_empty());
    }

    #[test]
    fn a_survivor_has_a_reason() {
        let survivors: Table = "[p]\n\"a.rs: two\" = \"\"".parse().unwrap();
        let error = reasons(&survivors, "p").unwrap_err().to_string();
        assert!(error.contains("\"a.rs: two\" has no reason"), "{error}");
    }
}
