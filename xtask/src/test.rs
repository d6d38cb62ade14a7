//! `cargo xtask test`: every test and doctest of the workspace, of the clients in other languages and of the console,
//! added up into one line.

use std::collections::BTreeSet;
use std::fmt;
use std::io::{BufRead, BufReader, Read};
use std::num::NonZero;
use std::path::Path;
use std::process::{Child, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, anyhow};

use crate::command::{cargo, end_with_children, line, shows};
use crate::counts::{Counts, STALL};
use crate::{clients, console, javascript};

/// How many tests run side by side, as the runner knows it.
const THREADS: &str = "RUST_TEST_THREADS";

/// The seed of properties, as their runner knows it.
pub(crate) const SEED: &str = "PROPTEST_RNG_SEED";

/// Says to tests where the programs are that they start, so that they do not build them.
pub(crate) const PROGRAMS: &str = "MOM_PROGRAMS";

/// What is off by default and yet built, linted and tested with the whole workspace: nobody else in CI would.
pub(crate) const FEATURES: &str = "--features=mom-broker/otlp";

/// Builds the tests, and all programs and examples from what the tests are built from: with the features that a package's own build would
/// have, most of it would be compiled once more.
pub(crate) const WHOLE: [&str; 7] = [
    "build",
    "--locked",
    "--workspace",
    FEATURES,
    "--bins",
    "--tests",
    "--examples",
];

/// Runs the tests with their output shown. The caller prints the counts, because they have to be the last line.
pub(crate) fn run(root: &Path, args: &[String]) -> Result<Counts> {
    // Dialogues run through it.
    javascript::build(root)?;
    // The programs that are tested have it.
    console::build(root)?;
    // A user who wants a part of the tests asks cargo for it, and the tests build the programs that they start.
    let whole = args.is_empty();
    let programs = clients::target(root).join("debug");
    // Before, because nothing is printed for long while it builds.
    let mut build = cargo(root);
    build.args(if whole {
        WHOLE.map(str::to_owned).to_vec()
    } else {
        building(args)
    });
    println!("$ {}", line(&build));
    if !shows(&mut build)? {
        return Ok(Counts::default().concluded(false));
    }
    if !whole {
        return run_cargo(root, args, None, show);
    }
    let computing = run_cargo(root, &Part::Computing.targets(), Some(&programs), show)?;
    let (system, others) = std::thread::scope(|scope| {
        let others = scope.spawn(|| run_others(root, &programs));
        let system = run_cargo(root, &Part::System.targets(), Some(&programs), show);
        (system, others.join())
    });
    let (said, others) =
        others.map_err(|_| anyhow!("what runs beside those tests ended by a fault of its runner"))??;
    print!("{said}");
    Ok(computing.and(system?).and(others))
}

/// Which of the Rust tests run by themselves, and which side by side with those of the console and of other languages.
///
/// Tests that only compute fill all cores. Those that start programs wait for them a third of their time, and browsers half of it: side by
/// side they take 900 s on two cores instead of 1220.
enum Part {
    Computing,
    System,
}

impl Part {
    /// Its integration tests, each by its name, which may be that of several packages.
    fn names(&self) -> &'static [&'static str] {
        match self {
            Part::Computing => &[
                "all_faults",
                "allocations",
                "bare",
                "binary_golden",
                "c",
                "c_library",
                "c_robot",
                "cameras",
                "declared",
                "dialogues",
                "differential",
                "drawn",
                "edges",
                "elements",
                "faults",
                "file",
                "footprint",
                "generated",
                "golden",
                "json_golden",
                "json_refused",
                "layouts",
                "lives",
                "marker",
                "mime_refused",
                "models",
                "network",
                "paper",
                "properties",
                "random",
                "render",
                "rest",
                "sessions",
                "typed",
                "verb",
                "xmi",
                "xml_golden",
                "xml_lexemes",
                "xml_refused",
            ],
            Part::System => &[
                "all",
                "api",
                "base_station",
                "c_session",
                "choice",
                "client",
                "external",
                "linuxbot",
                "peer",
                "program",
                "stops",
                "store",
                "wire",
                "witness",
            ],
        }
    }

    /// What cargo is told to run.
    fn targets(&self) -> Vec<String> {
        let units: &[&str] = match self {
            Part::Computing => &["--lib", "--bins", "--examples"],
            Part::System => &[],
        };
        let names = self.names().iter().flat_map(|name| ["--test", name]);
        units.iter().copied().chain(names).map(str::to_owned).collect()
    }
}

/// Runs the tests of the console and of the clients in other languages, then the examples of the documentation, one after the other; gives
/// what they say, and their counts.
fn run_others(root: &Path, programs: &Path) -> Result<(String, Counts)> {
    let broker = programs.join("mom-broker");
    let (mut said, pages) = console::test(root, &programs.join("mom"))?;
    let (python, others) = clients::test(root, &broker)?;
    let (js, more) = javascript::test(root, &broker)?;
    said += &python;
    said += &js;
    let examples = run_cargo(root, &["--doc".to_owned()], None, |text| said += text)?;
    Ok((said, pages.and(others).and(more).and(examples)))
}

fn show(text: &str) {
    print!("{text}");
}

/// Runs what cargo runs, and says its output; the programs are built already if it is said where they are.
fn run_cargo(root: &Path, args: &[String], programs: Option<&Path>, say: impl FnMut(&str)) -> Result<Counts> {
    let mut command = cargo(root);
    command.args(arguments(args));
    command.stdout(Stdio::piped());
    if std::env::var_os(THREADS).is_none() {
        // Those of the whole system wait for their programs more than they compute.
        let cores = std::thread::available_parallelism().map_or(1, NonZero::get);
        command.env(THREADS, (cores + 1).to_string());
    }
    println!("$ {}", line(&command));
    if let Some(programs) = programs {
        command.env(PROGRAMS, programs);
        if std::env::var_os(SEED).is_none() {
            // What fails here is what a change did. `cargo xtask long` and `cargo test` try others each time.
            command.env(SEED, "1");
        }
    }
    let mut child = command.spawn().context("cargo cannot be started")?;
    let stdout = child.stdout.take().context("cargo's output cannot be read")?;
    let (sender, lines) = channel();
    std::thread::spawn(move || read_lines(stdout, &sender));
    let (counts, status) = follow(&mut child, &lines, STALL, say)?;
    if !status.success() && counts.failed == 0 {
        eprintln!("cargo test failed without a failed test ({status}): see the messages above");
    }
    let counts = counts.concluded(status.success());
    if counts.passed + counts.failed == 0 {
        eprintln!("no test ran: the filter fits none; `cargo xtask test` runs all");
    }
    Ok(counts)
}

/// The same without running anything.
fn building(extra: &[String]) -> Vec<String> {
    let own = extra.iter().take_while(|arg| *arg != "--");
    let mut args = arguments(&own.cloned().collect::<Vec<_>>());
    args.push("--no-run".to_owned());
    args
}

/// The whole workspace, unless the caller names packages; every program runs even when one has failed.
fn arguments(extra: &[String]) -> Vec<String> {
    let own = extra.iter().take_while(|arg| *arg != "--");
    let names_packages = own
        .into_iter()
        .any(|arg| arg.starts_with("-p") || arg == "--package" || arg.starts_with("--package="));
    let mut args = vec![
        "test".to_owned(),
        "--locked".to_owned(),
        "--no-fail-fast".to_owned(),
    ];
    if !names_packages {
        args.extend(["--workspace", FEATURES].map(str::to_owned));
    }
    args.extend(extra.iter().cloned());
    args
}

fn read_lines(stdout: impl Read, sender: &Sender<String>) {
    let mut reader = BufReader::new(stdout);
    let mut bytes = Vec::new();
    while reader.read_until(b'\n', &mut bytes).is_ok_and(|read| read > 0) {
        if sender.send(String::from_utf8_lossy(&bytes).into_owned()).is_err() {
            return;
        }
        bytes.clear();
    }
}

/// Says and counts the lines until cargo has ended and said all. Tests that have come to a standstill are ended, and fail.
///
/// The end of the output alone is not waited for: a program that a test has left behind holds the pipe open, and
/// this would wait as long as that lives.
fn follow(
    child: &mut Child,
    lines: &Receiver<String>,
    stall: Duration,
    mut say: impl FnMut(&str),
) -> Result<(Counts, ExitStatus)> {
    let mut counts = Counts::default();
    let mut slow = Slow::default();
    let (mut ended, mut heard) = (None, Instant::now());
    loop {
        match lines.recv_timeout(Duration::from_millis(500)) {
            Ok(text) => {
                say(&text);
                counts.add_line(&text);
                slow.add_line(&text);
                heard = Instant::now();
            }
            Err(RecvTimeoutError::Timeout) => {
                if let Some(status) = ended {
                    eprintln!("note: a test left a program running that still holds the output");
                    return Ok((counts, status));
                }
                if heard.elapsed() > stall {
                    eprintln!("no test has ended for {} s: {slow}", stall.as_secs());
                    end_with_children(child.id());
                }
                ended = child.try_wait().context("cargo cannot be waited for")?;
            }
            Err(RecvTimeoutError::Disconnected) => {
                let status = child.wait().context("cargo cannot be waited for")?;
                return Ok((counts, status));
            }
        }
    }
}

/// The tests of which the runner says that they take long, as long as they have not ended.
#[derive(Default)]
struct Slow(BTreeSet<String>);

impl Slow {
    fn add_line(&mut self, line: &str) {
        let Some((name, state)) = line.strip_prefix("test ").and_then(|rest| rest.split_once(' ')) else {
            return;
        };
        match state.starts_with("has been running") {
            true => self.0.insert(name.to_owned()),
            false => self.0.remove(name),
        };
    }
}

impl fmt::Display for Slow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = self.0.iter().map(String::as_str).collect();
        match names.is_empty() {
            true => f.write_str("see which one began last"),
            false => write!(f, "{} did not", names.join(", ")),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    #[test]
    fn tests_at_a_standstill_are_named_and_ended() {
        let mut child = Command::new("sh")
            .args([
                "-c",
                "echo 'test a has been running for over 60 seconds'; sleep 600 & wait",
            ])
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let stdout = child.stdout.take().unwrap();
        let (sender, lines) = channel();
        std::thread::spawn(move || read_lines(stdout, &sender));
        let (counts, status) = follow(&mut child, &lines, Duration::from_secs(1), show).unwrap();
        assert!(!status.success());
        assert_eq!(
            counts.concluded(status.success()).to_string(),
            "0 passed, 1 failed"
        );
        // The grandchild held the pipe: its end is the end of the lines.
        assert_eq!(
            lines.recv_timeout(Duration::from_secs(60)),
            Err(RecvTimeoutError::Disconnected)
        );

        let mut slow = Slow::default();
        for line in [
            "test a has been running for over 60 seconds",
            "test b has been running for over 60 seconds",
            "test a ... ok",
        ] {
            slow.add_line(line);
        }
        assert_eq!(slow.to_string(), "b did not");
    }

    #[test]
    fn each_integration_test_is_in_one_part() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        let metadata = cargo(root)
            .args(["metadata", "--no-deps", "--offline", "--format-version", "1"])
            .output()
            .unwrap();
        let metadata: serde_json::Value = serde_json::from_slice(&metadata.stdout).unwrap();
        let packages = metadata["packages"].as_array().unwrap().iter();
        let targets = packages.flat_map(|package| package["targets"].as_array().unwrap());
        let tests: BTreeSet<&str> = targets
            .filter(|target| target["kind"][0] == "test")
            .map(|target| target["name"].as_str().unwrap())
            .collect();
        let mut named: Vec<&str> = [Part::Computing, Part::System]
            .iter()
            .flat_map(|part| part.names().iter().copied())
            .collect();
        named.sort_unstable();
        assert_eq!(named, Vec::from_iter(tests));
    }

    #[test]
    fn the_workspace_is_meant_unless_packages_are_named() {
        let check = |extra: &[&str], whole: bool| {
            let extra: Vec<String> = extra.iter().map(|arg| (*arg).to_owned()).collect();
            let args = arguments(&extra);
            for arg in ["--workspace", FEATURES] {
                assert_eq!(args.contains(&arg.to_owned()), whole, "{args:?}");
            }
            assert!(
                args.ends_with(&extra) && args.contains(&"--locked".to_owned()),
                "{args:?}"
            );
        };
        check(&[], true);
        check(&["grab"], true);
        check(&["-p", "mom-hub"], false);
        check(&["-pmom-hub", "grab"], false);
        check(&["--package=mom-hub"], false);
        check(&["grab", "--", "-p"], true);
    }
}
