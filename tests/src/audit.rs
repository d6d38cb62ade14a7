//! The audit log of a test's broker, read as anybody would.

use std::path::PathBuf;

use serde_json::Value as Json;

/// Where a broker writes who decided what; gone with the test.
#[derive(Debug)]
pub struct AuditLog {
    folder: tempfile::TempDir,
}

impl AuditLog {
    /// A place for one.
    ///
    /// # Panics
    /// If there is none.
    pub fn new() -> AuditLog {
        AuditLog {
            folder: tempfile::tempdir().expect("a folder"),
        }
    }

    /// The file, for the configuration.
    pub fn path(&self) -> PathBuf {
        self.folder.path().join("audit.jsonl")
    }

    /// All that is in it, once the broker has ended.
    ///
    /// # Panics
    /// If it is not a whole log: a line that is not a line, a gap, a beginning or an end that is missing.
    pub fn lines(&self) -> Lines {
        let text = std::fs::read_to_string(self.path()).expect("an audit log");
        let lines: Vec<Json> = text
            .lines()
            .map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}")))
            .collect();
        for (before, after) in lines.iter().zip(lines.iter().skip(1)) {
            let (before, after) = (&before["seq"], &after["seq"]);
            let follows = before
                .as_u64()
                .is_some_and(|before| after.as_u64() == Some(before + 1));
            assert!(follows, "{after} follows on {before}");
        }
        let lines = Lines(lines);
        assert_eq!(lines.0.first().map(|line| &line["what"]), Some(&"started".into()));
        assert_eq!(lines.0.last().map(|line| &line["what"]), Some(&"stopped".into()));
        assert_eq!(lines.count(&[("what", "audit-lost")]), 0);
        lines
    }
}

impl Default for AuditLog {
    fn default() -> AuditLog {
        AuditLog::new()
    }
}

/// The lines of an audit log.
#[derive(Debug)]
pub struct Lines(Vec<Json>);

impl Lines {
    /// How often something happened: lines with these values, each as often as it says that it stands for.
    pub fn count(&self, wanted: &[(&str, &str)]) -> u64 {
        let fits = |line: &&Json| wanted.iter().all(|(key, value)| line[key] == *value);
        let lines = self.0.iter().filter(fits);
        lines.map(|line| line["count"].as_u64().unwrap_or(1)).sum()
    }
}
