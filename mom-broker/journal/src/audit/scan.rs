//! Looking through an audit log from its newest fact on, a bounded part at a time.

use std::fs::File;
use std::io::{self, ErrorKind};
use std::path::PathBuf;
use std::sync::Arc;

use mom_proto::{Map, Path, Time, Value};
use mom_system::numbered;

use super::backwards::BackwardLines;
use super::ring::Ring;

/// Bytes of a log through which one scan looks at most.
const BUDGET: u64 = 8 * 1024 * 1024;

/// Files are kept one after the other; after so many missing ones there are no more.
const MISSING: u32 = 16;

/// The wall clock may have been set back: facts are looked for so much longer beyond the begin that was asked for, µs.
const SLACK: i64 = 24 * 3600 * 1_000_000;

/// Where the lines of a log are.
#[derive(Clone, Debug)]
pub(super) enum Kept {
    /// In a file, and in those before it.
    Files(PathBuf),
    /// In memory.
    Memory(Arc<Ring>),
}

/// Which facts are looked for.
#[derive(Clone, Debug)]
pub struct AuditQuery {
    /// Of this context and all below it; those without a context belong to the root.
    pub path: Path,
    /// The peer that acted, or the other one that was involved.
    pub peer: Option<String>,
    /// Its user.
    pub user: Option<String>,
    /// What happened: one of these; none = anything.
    pub what: Vec<String>,
    /// The requested verb.
    pub verb: Option<String>,
    /// The rule, or a manager and all its rules.
    pub rule: Option<String>,
    /// The word of the code.
    pub code: Option<String>,
    /// From then on.
    pub since: Option<Time>,
    /// Up to then.
    pub until: Option<Time>,
    /// What a text in it contains, in lower or upper case.
    pub text: Option<String>,
    /// Only facts with a smaller number.
    pub before: Option<u64>,
    /// Only facts with a greater number.
    pub after: Option<u64>,
}

impl AuditQuery {
    /// All facts of a context and below it.
    pub fn of(path: Path) -> AuditQuery {
        AuditQuery {
            path,
            peer: None,
            user: None,
            what: Vec::new(),
            verb: None,
            rule: None,
            code: None,
            since: None,
            until: None,
            text: None,
            before: None,
            after: None,
        }
    }

    fn fits(&self, fact: &Map, at: Option<Time>) -> bool {
        let text = |key: &str| fact.get(key).and_then(Value::as_str);
        let is = |key: &str, wanted: &Option<String>| wanted.is_none() || text(key) == wanted.as_deref();
        let here = match text("context") {
            Some(context) => Path::parse(context).is_ok_and(|context| context.is_within(&self.path)),
            None => self.path.is_root(),
        };
        let who = is("peer", &self.peer) || is("by", &self.peer);
        let what = self.what.is_empty() || self.what.iter().any(|what| text("what") == Some(what));
        let rule = self.rule.as_deref().is_none_or(|wanted| {
            let rest = text("rule").and_then(|rule| rule.strip_prefix(wanted));
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
        });
        let time = self.since.is_none_or(|since| at.is_some_and(|at| at >= since))
            && self.until.is_none_or(|until| at.is_some_and(|at| at <= until));
        let contains = self.text.as_deref().is_none_or(|wanted| {
            let wanted = wanted.to_lowercase();
            let mut texts = fact.iter().filter_map(|(_, value)| value.as_str());
            texts.any(|text| text.to_lowercase().contains(&wanted))
        });
        here && who
            && what
            && rule
            && time
            && contains
            && is("user", &self.user)
            && is("verb", &self.verb)
            && is("code", &self.code)
    }
}

/// A look through a log, the newest fact first.
#[derive(Debug)]
pub struct AuditScan {
    query: AuditQuery,
    kept: Kept,
    /// The lines that are read now.
    lines: Option<Lines>,
    /// The number of the file after that.
    next_file: u32,
    missing: u32,
    /// Only lines with smaller numbers are left to look at.
    before: u64,
    latest: Option<u64>,
    left: u64,
    ended: bool,
}

#[derive(Debug)]
enum Lines {
    File(BackwardLines),
    Memory(Vec<Arc<[u8]>>),
}

impl AuditScan {
    pub(super) fn new(kept: Kept, query: AuditQuery) -> AuditScan {
        AuditScan {
            before: query.before.unwrap_or(u64::MAX),
            query,
            kept,
            lines: None,
            next_file: 0,
            missing: 0,
            latest: None,
            left: BUDGET,
            ended: false,
        }
    }

    /// Looks for so many more facts; fewer at the log's beginning, or when enough was looked at.
    ///
    /// # Errors
    /// What the system says.
    pub fn look(&mut self, most: usize) -> io::Result<Vec<Map>> {
        let mut found = Vec::new();
        while found.len() < most && !self.is_over() {
            let Some(line) = self.line()? else {
                self.ended = true;
                break;
            };
            found.extend(self.take(&line));
        }
        Ok(found)
    }

    /// Whether there is nothing more to look at, or enough was.
    pub fn is_over(&self) -> bool {
        self.ended || self.left == 0
    }

    /// The number below which another scan goes on; none at the log's beginning.
    pub fn next(&self) -> Option<u64> {
        (!self.ended).then_some(self.before)
    }

    /// The greatest number that was looked at.
    pub fn latest(&self) -> Option<u64> {
        self.latest
    }

    /// Whether it looks through files, and not through memory.
    pub fn is_of_files(&self) -> bool {
        matches!(self.kept, Kept::Files(_))
    }

    fn take(&mut self, line: &[u8]) -> Option<Map> {
        let fact: Value = serde_json::from_slice(line).ok()?;
        let Value::Map(mut fact) = fact else { return None };
        let seq = fact.get("seq").and_then(Value::as_int);
        let seq = seq.and_then(|seq| u64::try_from(seq).ok())?;
        // While it is read a new file may be begun: what was read is not told again.
        if seq >= self.before {
            return None;
        }
        if self.query.after.is_some_and(|after| seq <= after) {
            self.ended = true;
            return None;
        }
        self.before = seq;
        self.latest = self.latest.or(Some(seq));
        let at: Option<Time> = fact.get("at").and_then(|at| at.as_str()?.parse().ok());
        let oldest = self.query.since.map(|since| since.micros().saturating_sub(SLACK));
        if oldest.zip(at).is_some_and(|(oldest, at)| at.micros() < oldest) {
            self.ended = true;
            return None;
        }
        if !self.query.fits(&fact, at) {
            return None;
        }
        if let Some(at) = at {
            fact.set("at", at);
        }
        // Where people are is told to those who may hear of the whole hub.
        if !self.query.path.is_root() {
            fact.remove("from");
        }
        Some(fact)
    }

    /// The line before those that were read.
    fn line(&mut self) -> io::Result<Option<Vec<u8>>> {
        loop {
            match &mut self.lines {
                Some(Lines::File(lines)) => {
                    let (line, read) = lines.next()?;
                    self.left = self.left.saturating_sub(read);
                    if line.is_some() {
                        return Ok(line);
                    }
                }
                Some(Lines::Memory(lines)) => {
                    if let Some(line) = lines.pop() {
                        self.left = self.left.saturating_sub(line.len() as u64);
                        return Ok(Some(line.to_vec()));
                    }
                }
                None => {}
            }
            if !self.open_next()? {
                return Ok(None);
            }
        }
    }

    /// Opens what was written before; false if there is no more.
    fn open_next(&mut self) -> io::Result<bool> {
        let path = match &self.kept {
            Kept::Memory(ring) => {
                let first = self.lines.is_none();
                self.lines = Some(Lines::Memory(if first { ring.lines() } else { Vec::new() }));
                return Ok(first);
            }
            Kept::Files(path) => path,
        };
        while self.missing < MISSING {
            let file = match self.next_file {
                0 => File::open(path),
                number => File::open(numbered(path, number)),
            };
            self.next_file += 1;
            match file {
                Ok(file) => {
                    self.missing = 0;
                    self.lines = Some(Lines::File(BackwardLines::open(file, self.before)?));
                    return Ok(true);
                }
                Err(error) if error.kind() == ErrorKind::NotFound => self.missing += 1,
                Err(error) => return Err(error),
            }
        }
        Ok(false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tempfile::TempDir;

    fn line(seq: u64, more: &str) -> String {
        format!("{{\"at\":\"2026-11-21T10:00:00Z\",\"seq\":{seq},\"what\":\"refused\"{more}}}\n")
    }

    fn query(path: &str) -> AuditQuery {
        AuditQuery::of(Path::parse(path).unwrap())
    }

    fn seqs(kept: &Kept, query: AuditQuery, most: usize) -> Vec<i64> {
        let mut scan = AuditScan::new(kept.clone(), query);
        let found = scan.look(most).unwrap();
        let seq = |fact: &Map| fact.get("seq").and_then(Value::as_int).unwrap();
        found.iter().map(seq).collect()
    }

    #[test]
    fn facts_are_found_across_files_page_by_page() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("audit.jsonl");
        let text = |from, to| (from..to).map(|seq| line(seq, "")).collect::<String>();
        std::fs::write(numbered(&path, 3), text(1, 40)).unwrap();
        std::fs::write(numbered(&path, 1), text(40, 60)).unwrap();
        std::fs::write(&path, text(60, 70) + "{\"at\":\"20").unwrap();
        let kept = Kept::Files(path);
        let mut found = Vec::new();
        let mut before = None;
        loop {
            let mut scan = AuditScan::new(kept.clone(), AuditQuery { before, ..query("/") });
            let page = scan.look(7).unwrap();
            found.extend(page.iter().map(|fact| fact.get("seq").unwrap().as_int().unwrap()));
            before = scan.next();
            if before.is_none() {
                break;
            }
        }
        assert!(found.into_iter().eq((1..70).rev()));
        let after = AuditQuery {
            after: Some(66),
            ..query("/")
        };
        assert_eq!(seqs(&kept, after, 100), [69, 68, 67]);
    }

    #[test]
    fn only_what_is_asked_for_is_found() {
        let ring = Arc::new(Ring::default());
        let kept = Kept::Memory(Arc::clone(&ring));
        let lines = [
            line(
                1,
                ",\"context\":\"/robot/token\",\"rule\":\"lab/people\",\"peer\":\"bob\",\"from\":\"10.0.0.1\"",
            ),
            line(
                2,
                ",\"context\":\"/robots\",\"rule\":\"laboratory\",\"by\":\"bob\",\"user\":\"alice\"",
            ),
            line(3, ",\"from\":\"10.0.0.2\",\"text\":\"Late\",\"code\":\"held\""),
        ];
        lines.iter().for_each(|line| {
            let (written, result) = super::super::sink::LineSink::append(
                &mut super::super::ring::RingSink(Arc::clone(&ring)),
                &[line.clone().into_bytes()],
            );
            assert!(written == 1 && result.is_ok());
        });
        check_choices(&kept);
        let mut scan = AuditScan::new(kept, query("/robot/token"));
        let found = scan.look(1).unwrap();
        assert!(!found[0].contains_key("from"), "{found:?}");
        assert_eq!(scan.latest(), Some(3));
    }

    fn check_choices(kept: &Kept) {
        let text = |text: &str| Some(text.to_owned());
        let all = |query| seqs(kept, query, 100);
        assert_eq!(all(query("/")), [3, 2, 1]);
        assert_eq!(all(query("/robot")), [1]);
        assert_eq!(
            all(AuditQuery {
                rule: text("lab"),
                ..query("/")
            }),
            [1]
        );
        assert_eq!(
            all(AuditQuery {
                peer: text("bob"),
                ..query("/")
            }),
            [2, 1]
        );
        assert_eq!(
            all(AuditQuery {
                user: text("alice"),
                ..query("/")
            }),
            [2]
        );
        assert_eq!(
            all(AuditQuery {
                text: text("lATE"),
                ..query("/")
            }),
            [3]
        );
        assert_eq!(
            all(AuditQuery {
                code: text("held"),
                ..query("/")
            }),
            [3]
        );
        assert_eq!(
            all(AuditQuery {
                what: vec!["lost".into()],
                ..query("/")
            }),
            [0; 0]
        );
        let time = |text: &str| Some(text.parse().unwrap());
        let since = |at| AuditQuery {
            since: time(at),
            ..query("/")
        };
        assert_eq!(all(since("2026-11-21T10:00:00Z")).len(), 3);
        assert!(all(since("2026-11-21T10:00:01Z")).is_empty());
        assert!(
            all(AuditQuery {
                until: time("2026-11-21T09:00:00Z"),
                ..query("/")
            })
            .is_empty()
        );
    }
}
