//! How many tests passed and failed, by the words of the tools that run them.

use std::fmt;
use std::time::Duration;

/// Tests of which none ends for so long have come to a standstill; the longest takes two minutes on two cores.
pub(crate) const STALL: Duration = Duration::from_secs(900);

/// What the tests of another language take at most.
pub(crate) const LIMIT: Duration = STALL;

/// How many tests passed and failed; shown as `N passed, N failed`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Counts {
    pub(crate) passed: u64,
    pub(crate) failed: u64,
    /// The lines that name a test that failed, or say where it panicked and why.
    failures: Vec<String>,
    /// The next line says why.
    panicked: bool,
    /// A line of what follows says why, as Node tells it.
    untold: bool,
}

impl Counts {
    /// Something ran, and nothing failed.
    pub(crate) fn is_success(&self) -> bool {
        self.passed > 0 && self.failed == 0
    }

    /// Shows the failed tests once more: at the end of a long output, where people look, and before the counts.
    pub(crate) fn show_failures(&self) {
        for line in &self.failures {
            println!("failed: {line}");
        }
    }

    /// Keeps a line that names a test that failed: of cargo, of pytest, of Node; or that says where one panicked, and the next.
    pub(crate) fn add_failure(&mut self, line: &str) {
        let line = line.trim();
        let named = (line.starts_with("test ") && line.ends_with("... FAILED"))
            || line.starts_with("FAILED ")
            || line.starts_with("ERROR ")
            || line.starts_with("not ok ");
        let panicked = line.starts_with("thread '") && line.contains(" panicked at ");
        let told = self.untold && line.starts_with("error: ");
        if named || panicked || told || self.panicked {
            self.failures.push(line.chars().take(300).collect());
        }
        // A text of several lines begins below.
        self.panicked = panicked || (told && line.ends_with("|-"));
        self.untold = line.starts_with("not ok ") || (self.untold && !told && line != "...");
    }

    /// Adds what a line `test result: ok. 3 passed; 1 failed; …` says; any other line says nothing.
    pub(crate) fn add_line(&mut self, line: &str) {
        self.add_failure(line);
        let Some(result) = line.trim_end().strip_prefix("test result: ") else {
            return;
        };
        let counts = result.split_once(". ").map_or(result, |(_, counts)| counts);
        for part in counts.split(';') {
            let mut words = part.split_whitespace();
            let (Some(number), Some(kind)) = (words.next(), words.next()) else {
                continue;
            };
            let Ok(number) = number.parse::<u64>() else {
                continue;
            };
            self.add(kind, number);
        }
    }

    /// Adds so many tests of a kind, by the words of the languages' tools.
    pub(crate) fn add(&mut self, kind: &str, number: u64) {
        match kind {
            "passed" => self.passed += number,
            "failed" | "error" | "errors" => self.failed += number,
            _ => {}
        }
    }

    /// Both together.
    pub(crate) fn and(mut self, other: Counts) -> Counts {
        self.passed += other.passed;
        self.failed += other.failed;
        self.failures.extend(other.failures);
        self
    }

    /// The counts once cargo has ended. A build that fails or a test program that dies leaves no line of results,
    /// and must not look like a success to who reads only the last line: it counts as one failure.
    pub(crate) fn concluded(mut self, cargo_succeeded: bool) -> Counts {
        if !cargo_succeeded && self.failed == 0 {
            self.failed = 1;
        }
        self
    }
}

impl fmt::Display for Counts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} passed, {} failed", self.passed, self.failed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(lines: &[&str], expected: &str, success: bool) {
        let mut counts = Counts::default();
        for line in lines {
            counts.add_line(line);
        }
        assert_eq!(
            (counts.to_string().as_str(), counts.is_success()),
            (expected, success),
            "{lines:?}"
        );
    }

    #[test]
    fn result_lines_are_added_up() {
        check(
            &[
                "running 3 tests",
                "test a ... ok",
                "test result: ok. 3 passed; 0 failed; 1 ignored; 0 measured; 0 filtered out; finished in 0.00s\n",
                "test result: ok. 14 passed; 0 failed; 0 ignored; 0 measured; 0 filtered out; finished in 1.50s",
            ],
            "17 passed, 0 failed",
            true,
        );
        check(
            &[
                "test result: FAILED. 2 passed; 1 failed; 0 ignored; 0 measured; 0 filtered out",
                "test result: ok. 1 passed; 0 failed; 0 ignored",
            ],
            "3 passed, 1 failed",
            false,
        );
        check(&[], "0 passed, 0 failed", false);
        check(
            &["the test result: ok. 3 passed; 0 failed"],
            "0 passed, 0 failed",
            false,
        );
        check(
            &[
                "test result: ",
                "test result: ok. x passed; failed",
                "test result: ok.",
            ],
            "0 passed, 0 failed",
            false,
        );
    }

    #[test]
    fn failed_tests_are_named_with_the_cause() {
        let mut counts = Counts::default();
        for line in [
            "test a ... ok",
            "test rest::b ... FAILED",
            "---- rest::b stdout ----",
            "",
            "thread 'rest::b' (77) panicked at tests/rest.rs:5:9:",
            "it moved",
            "note: run with RUST_BACKTRACE=1",
            "FAILED tests/test_wire.py::test_it - assert 1 == 2",
            "    not ok 3 - the page stops",
            "      ---",
            "      error: 'it went on for 320 ms'",
            "      code: 'ERR_ASSERTION'",
            "      ...",
            "ok 4 - not ok",
            "error: that of another tool",
            "not ok 5 - it says so",
            "  error: |-",
            "    it does not",
            "    at all",
        ] {
            counts.add_line(line);
        }
        let expected = [
            "test rest::b ... FAILED",
            "thread 'rest::b' (77) panicked at tests/rest.rs:5:9:",
            "it moved",
            "FAILED tests/test_wire.py::test_it - assert 1 == 2",
            "not ok 3 - the page stops",
            "error: 'it went on for 320 ms'",
            "not ok 5 - it says so",
            "error: |-",
            "it does not",
        ];
        assert_eq!(counts.failures, expected);
        assert_eq!(Counts::default().and(counts).failures, expected);
    }

    #[test]
    fn cargo_failing_without_a_result_counts_as_a_failure() {
        let counts = Counts {
            passed: 4,
            ..Counts::default()
        };
        assert_eq!(counts.clone().concluded(true).to_string(), "4 passed, 0 failed");
        assert_eq!(counts.clone().concluded(false).to_string(), "4 passed, 1 failed");
        let counts = Counts {
            passed: 4,
            failed: 2,
            ..Counts::default()
        };
        assert_eq!(counts.clone().concluded(false).to_string(), "4 passed, 2 failed");
    }
}
