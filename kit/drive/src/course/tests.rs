//! The dialogues of `tests/cases/commander.txt`.

use mom_client::{Lost, Map, Path, Value, WireError};

use super::Course;
use crate::end::Whose;
use crate::heard::{Report, StateNews};
use crate::step::{Basis, Progress, Step};

const DIALOGUES: &str = include_str!("../../../../tests/cases/commander.txt");

fn path(text: &str) -> Path {
    text.parse().expect(text)
}

/// A course, and its clock.
struct Stage {
    course: Course,
    now: u64,
    says: Vec<String>,
    /// Which device speaks.
    by: &'static str,
}

impl Stage {
    fn new() -> Stage {
        let whose = Whose {
            place: path("/robot/arm"),
            token: Some(path("/robot/token")),
        };
        Stage {
            course: Course::new("alice".to_owned(), whose, 5),
            now: 0,
            says: Vec::new(),
            by: "robot",
        }
    }

    /// Something happens.
    fn act(&mut self, line: &str) {
        let words: Vec<&str> = line.split(' ').collect();
        if let Some((head, text)) = line.split_once(": ")
            && let Some(command) = head.strip_prefix("command").or_else(|| head.strip_prefix("pull"))
        {
            let basis = match command.trim() {
                "" | "once" => Basis::Nothing,
                "relative" => Basis::Newest,
                on => Basis::State(on.trim_start_matches("on ").parse().expect(line)),
            };
            self.course
                .begin(text, basis, head == "pull", head == "command once");
            return self.gather();
        }
        self.by = if words[0] == "other" { "other" } else { "robot" };
        match words[usize::from(self.by == "other")..] {
            ["after", ms] => self.pass(ms.parse().expect(line)),
            ["sent", id] => self.course.sent(Some(id.parse().expect(line))),
            ["nobody"] => self.course.sent(None),
            ["refused", name, number] => self.course.refused(error(name, number)),
            ["unanswered", ..] => self
                .course
                .unanswered(line.split_once(' ').expect(line).1.to_owned()),
            ["old", "state", ..] => self.state(&words[2..], true),
            ["state", ..] => self.state(&words[usize::from(self.by == "other") + 1..], false),
            // Who feeds a course leaves old reports out.
            ["old", "status", ..] => {}
            ["status", ..] => self.status(&words[usize::from(self.by == "other") + 1..]),
            ["dropped", reason, ref by @ ..] => self.course.dropped(reason, by.last().copied()),
            ["next", id] => self.course.asks(id.parse().expect(line)),
            [peer, "leaves"] => self.course.gone(peer, false),
            [peer, "is", "lost"] => self.course.gone(peer, true),
            ["down"] => self.course.link_down(),
            ["lagged", count] => self.course.lagged(count.parse().expect(line)),
            ["lost", reason, ref by @ ..] => {
                let by = by.last().map(|by| (*by).to_owned());
                self.course.lost(Lost {
                    reason: reason.to_owned(),
                    by,
                });
            }
            ["asked"] => self.course.asked(),
            ["cancel"] => self.course.cancel(),
            ["released"] => self.course.released(),
            _ => panic!("{line}"),
        }
        self.gather();
    }

    fn state(&mut self, words: &[&str], is_old: bool) {
        let fence = words.iter().position(|word| *word == "under");
        let news = StateNews {
            id: words[0].parse().ok(),
            moving: words.contains(&"moving"),
            stopped: words.contains(&"stopped"),
            linked: !words.contains(&"unlinked"),
            fence: fence.map(|place| words[place + 1].parse().expect("a fence")),
        };
        self.course.state_told(news, Some(self.by), is_old);
    }

    fn status(&mut self, words: &[&str]) {
        let (peer, id) = words[0].split_once('/').unwrap_or(("alice", words[0]));
        let (statement, of) = words[2].split_once('/').expect("statements");
        let mut rest = words[3..].iter().copied();
        let mut fence = None;
        let mut error = None;
        match rest.next() {
            Some("under") => fence = rest.next().map(|fence| fence.parse().expect("a fence")),
            Some(name) => {
                let code: i64 = rest.next().expect("a number").parse().expect("a number");
                let mut map = Map::new()
                    .with("name", name)
                    .with("code", code)
                    .with("text", format!("the words of {name}"));
                if rest.next() == Some("retry") {
                    map.set("retry", true);
                }
                error = Some(Value::from(map));
            }
            None => {}
        }
        let report = Report {
            id: id.parse().ok(),
            peer: peer.to_owned(),
            fence,
            state: words[1].to_owned(),
            statement: statement.parse().expect("a statement"),
            of: of.parse().expect("statements"),
            error,
        };
        self.course.reported(report, Some(self.by));
    }

    /// Time passes, and the course is woken whenever it asked to be.
    fn pass(&mut self, ms: u64) {
        let until = self.now + ms;
        while let Some(due) = self.course.next_wake().filter(|due| *due <= until) {
            self.now = due.max(self.now);
            self.course.wake(self.now);
            self.gather();
        }
        self.now = until;
        self.course.wake(until);
    }

    fn gather(&mut self) {
        while let Some(step) = self.course.poll() {
            self.tell(step);
        }
    }

    fn tell(&mut self, step: Step) {
        let line = match step {
            Step::Send { on, to } => {
                let on = on.map(|on| format!(" on {on}")).unwrap_or_default();
                let to = to.map(|to| format!(" for {to}")).unwrap_or_default();
                format!("send {}{on}{to}", self.course.text)
            }
            Step::Tell(Progress::Device { state, statement, of }) => {
                format!("tells {state} {statement}/{of}")
            }
            Step::Tell(Progress::Again { why, .. }) => format!("tells again {why}"),
            Step::Ask => "ask".to_owned(),
            Step::Release => "release".to_owned(),
            Step::Stop => "stop".to_owned(),
            Step::End(end) => {
                let kind = match &end.how {
                    super::How::Failed(_) => format!("error {}", end.name()),
                    super::How::Refused(_) => format!("refused {}", end.name()),
                    super::How::Lost { lost, .. } => match &lost.by {
                        Some(by) => format!("lost {} by {by}", lost.reason),
                        None => format!("lost {}", lost.reason),
                    },
                    _ => end.name().to_owned(),
                };
                self.says.push(format!("end {kind}"));
                if !end.is_finished() {
                    self.says.push(format!("says {}", end.text));
                    self.says.extend(end.hint.map(|hint| format!("hint {hint}")));
                }
                return;
            }
            Step::Halted(halt) => {
                self.says.push(format!("halted {halt:?}").to_lowercase());
                if let Err(crate::VerbFailure::Failed { text, hint }) = halt.verdict("/robot/arm") {
                    self.says.push(format!("says {text}"));
                    self.says.extend(hint.map(|hint| format!("hint {hint}")));
                }
                return;
            }
        };
        self.says.push(line);
    }
}

fn error(name: &str, number: &str) -> WireError {
    let map = Map::new()
        .with("name", name)
        .with("code", number.parse::<i64>().expect("a number"))
        .with("text", format!("the words of {name}"));
    let error = WireError::from_map(&map);
    assert_eq!(error.code.word(), name);
    error
}

/// What is said is what a dialogue expects; a line that ends in `*` leaves open the rest of it, and the last one also what follows.
fn fits(says: &[String], expected: &[&str]) -> bool {
    let is_open = expected.last().is_some_and(|line| line.ends_with('*'));
    let as_expected = |(said, line): (&String, &&str)| match line.strip_suffix('*') {
        Some(begin) => said.starts_with(begin),
        None => said == line,
    };
    (says.len() == expected.len() || is_open && says.len() > expected.len())
        && says.iter().zip(expected).all(as_expected)
}

#[test]
fn dialogues() {
    let text: Vec<&str> = DIALOGUES.lines().filter(|line| !line.starts_with('#')).collect();
    let mut played = 0;
    for dialogue in text.join("\n").split("\n== ").skip(1) {
        let (title, lines) = dialogue.split_once('\n').expect(dialogue);
        let (each, lines): (Vec<&str>, Vec<&str>) = lines.lines().partition(|line| line.starts_with("each "));
        let each = each.first().map_or("", |each| each.trim_start_matches("each "));
        for one in each.split(" | ") {
            let (one, says) = one.split_once(": ").unwrap_or((one, ""));
            let lines = lines.join("\n").replace("{each}", one).replace("{says}", says);
            play(&format!("{title} ({one})"), &lines);
            played += 1;
        }
    }
    assert!(played >= 50, "{played} dialogues");
}

fn play(title: &str, lines: &str) {
    let mut stage = Stage::new();
    let mut lines = lines.lines().filter(|line| !line.is_empty()).peekable();
    while let Some(line) = lines.next() {
        stage.act(line);
        let mut expected = Vec::new();
        while let Some(said) = lines.next_if(|line| line.starts_with("> ")) {
            expected.push(said.trim_start_matches("> "));
        }
        let says = std::mem::take(&mut stage.says);
        assert!(
            fits(&says, &expected),
            "{title}: after `{line}`\n said {says:#?}\n instead of {expected:#?}"
        );
    }
}
