use std::collections::BTreeMap;
use std::fs;

use mom_hub::{ContextSpec, Hub, Input, PeerId, Settings, Ticket, User};
use mom_managers::Registry;
use mom_proto::{Content, Family, Limits, Map, Parcel, Path, Value, Verb, WireError};
use serde::Deserialize;
use tempfile::TempDir;

use super::line::{RecordedLine, RecordedStep, RecordingHead, Told};
use super::outcome::outcomes;
use super::{Outcome, Replay, Summary};
use crate::ConfigFile;

const CONTEXTS: &str = r#"
[[contexts]]
path = "/robot"
kind = "session"
[[contexts]]
path = "/robot/token"
kind = "token"
[[contexts]]
path = "/robot/arm"
kind = "channel"
guard = { token = "/robot/token", names = ["command"] }
"#;

/// A hub whose inputs are recorded, without a broker.
struct Recording {
    folder: TempDir,
    hub: Hub,
    now: u64,
    lines: Vec<RecordedLine>,
}

impl Recording {
    fn new(rules: &str, durable: bool) -> Recording {
        let folder = TempDir::new().expect("a folder");
        let settings = Settings {
            durable,
            epoch: 1,
            ..Settings::default()
        };
        let head = RecordingHead::new(&settings, &ConfigFile::default());
        Recording {
            folder,
            hub: hub(rules, settings).expect("right"),
            now: 0,
            lines: vec![RecordedLine::Head(Box::new(head))],
        }
    }

    fn tell(&mut self, input: Input) -> Vec<Outcome> {
        self.now += 1000;
        let told = Told::of(&input, &self.hub);
        let asked = match &input {
            Input::Request { peer, parcel, .. } => Some((peer.0, Verb::of(parcel.family, &parcel.name).ok())),
            _ => None,
        };
        let mut effects = Vec::new();
        self.hub.handle(self.now, input, &mut effects);
        let decided = outcomes(&effects, asked);
        self.lines.push(RecordedLine::Step(Box::new(RecordedStep {
            now: self.now,
            input: told,
            decided: decided.clone(),
            deadline: self.hub.deadline(),
        })));
        decided
    }

    fn login(&mut self, peer: u64, user: &str) {
        self.tell(Input::Login {
            peer: PeerId(peer),
            user: User {
                name: user.to_owned(),
                level: 1,
                groups: vec![],
                details: Map::new(),
            },
            nickname: None,
            id: None,
        });
        for path in ["/robot", "/robot/arm"] {
            self.ask(peer, Verb::Join, path);
        }
    }

    fn ask(&mut self, peer: u64, verb: Verb, path: &str) -> Vec<Outcome> {
        self.say(peer, Parcel::new(verb.family(), verb.word()), path)
    }

    fn say(&mut self, peer: u64, parcel: Parcel, path: &str) -> Vec<Outcome> {
        let parcel = parcel.context(Path::parse(path).expect("a path")).id(self.now);
        self.tell(Input::Request {
            peer: PeerId(peer),
            parcel: Box::new(parcel),
            clock: None,
        })
    }

    /// The differences by these rules, in words, with the time left out.
    fn by(&self, rules: &str) -> (Vec<String>, Summary) {
        let lines = self.lines.iter();
        let lines = lines.map(|line| serde_json::to_string(line).expect("JSON") + "\n");
        let log = self.folder.path().join("control.jsonl");
        fs::write(&log, lines.collect::<String>()).expect("written");
        let replay = Replay::open(&log, Limits::default(), Vec::new(), |settings| {
            hub(rules, settings)
        });
        let mut replay = replay.expect("a recording");
        let mut differences = Vec::new();
        while let Some(more) = replay.step().expect("not damaged") {
            let words = |words: String| words.split_once("Z ").map(|(_, words)| words.to_owned());
            differences.extend(more.iter().filter_map(|difference| words(difference.to_string())));
        }
        (differences, replay.summary().clone())
    }
}

/// What these tests need of a configuration.
#[derive(Deserialize)]
struct Rules {
    managers: BTreeMap<String, Value>,
    contexts: Vec<ContextSpec>,
}

/// A hub by these rules.
fn hub(rules: &str, settings: Settings) -> Result<Hub, WireError> {
    let text = format!(
        "[managers.lab]\nkind = \"roles\"\n{rules}\n\
         [[managers.lab.rules]]\nname = \"all\"\nallow = [\"*\"]\n{CONTEXTS}"
    );
    let Rules { managers, contexts } = toml::from_str(&text).expect("TOML");
    let mut registry = Registry::builtin();
    for (name, spec) in managers {
        registry.define(&name, spec);
    }
    Hub::new(settings, registry, &"lab".into(), &contexts).map_err(|error| error.error)
}

const NOT_BOB: &str = "[[managers.lab.rules]]\nname = \"not bob\"\nusers = [\"bob\"]\ndeny = [\"grab\"]\n";

fn command(fence: Option<u64>) -> Parcel {
    let mut parcel = Parcel::new(Family::Message, "command").content(Content::Encoded(vec![0xc0].into()));
    parcel.fence = fence;
    parcel
}

/// Bob drives, then alice does and names her fence: without bob hers is another number, and still hers.
#[test]
fn fences_are_those_of_the_replay() {
    let mut recording = Recording::new("", false);
    recording.login(1, "alice");
    recording.login(2, "bob");
    recording.ask(2, Verb::Grab, "/robot/token");
    recording.ask(2, Verb::Release, "/robot/token");
    let granted = recording.ask(1, Verb::Grab, "/robot/token");
    let fence = granted.iter().find_map(|outcome| match outcome {
        Outcome::Ok { fence, .. } => *fence,
        _ => None,
    });
    assert_eq!(fence, Some((1 << 20) + 2));
    let passed = recording.say(1, command(fence), "/robot/arm");
    assert!(matches!(&passed[..], [Outcome::Passed { .. }]), "{passed:?}");
    let older = recording.say(1, command(fence.map(|fence| fence - 1)), "/robot/arm");
    assert!(
        matches!(&older[..], [Outcome::Refused { code, .. }] if code == "older-fence"),
        "{older:?}"
    );
    let (same, summary) = recording.by("");
    assert_eq!(same, Vec::<String>::new());
    assert_eq!((summary.inputs, summary.differ), (11, 0));
    let (differences, _) = recording.by(NOT_BOB);
    assert_eq!(
        differences[..2],
        [
            "bob: grab /robot/token: bob owns /robot/token by \"lab/all\", ok -> refused denied by \"lab/not bob\"",
            "bob: release /robot/token: bob loses /robot/token (released), ok -> refused not-owner \
             by \"one owner at most\"",
        ]
    );
    // What was an older fence there is none that was ever given out here, or the present one.
    assert!(
        differences[2..]
            .iter()
            .all(|words| words.contains("refused older-fence ->")),
        "{differences:?}"
    );
}

/// What was stored then is stored now; what is stored only now need not wait for a disk that is not there.
#[test]
fn tickets_are_those_of_the_replay() {
    let mut recording = Recording::new(NOT_BOB, true);
    recording.login(1, "alice");
    recording.login(2, "bob");
    recording.ask(2, Verb::Grab, "/robot/token");
    let waits = recording.ask(1, Verb::Grab, "/robot/token");
    let ticket = waits.iter().find_map(|outcome| match outcome {
        Outcome::Stored { ticket, .. } => Some(Ticket(*ticket)),
        _ => None,
    });
    assert!(waits.contains(&Outcome::Waits { peer: 1 }), "{waits:?}");
    let ticket = ticket.expect("it is stored first");
    let stored = recording.tell(Input::Stored { ticket, ok: true });
    assert!(
        stored
            .iter()
            .any(|outcome| matches!(outcome, Outcome::Ok { to: 1, .. })),
        "{stored:?}"
    );
    assert_eq!(recording.by(NOT_BOB).0, Vec::<String>::new());

    let (differences, _) = recording.by("");
    assert!(
        differences[0].starts_with("bob: grab /robot/token: refused denied by \"lab/not bob\" -> bob owns"),
        "{differences:?}"
    );
    assert_eq!(
        differences[1],
        "alice: grab /robot/token: waits -> refused held by \"one owner at most\""
    );
    assert!(
        differences[2].starts_with("stored: ") && differences[2].ends_with(" -> nothing"),
        "{differences:?}"
    );
    assert_eq!(differences.len(), 3);
}

/// A disk that failed then fails now, if it is asked.
#[test]
fn a_failed_store_is_replayed() {
    let mut recording = Recording::new("", true);
    recording.login(1, "alice");
    recording.ask(1, Verb::Grab, "/robot/token");
    let failed = recording.tell(Input::Stored {
        ticket: Ticket(1),
        ok: false,
    });
    assert!(
        failed
            .iter()
            .any(|outcome| matches!(outcome, Outcome::Refused { code, .. } if code == "storage-failed")),
        "{failed:?}"
    );
    assert_eq!(recording.by("").0, Vec::<String>::new());
}

/// A wall clock that was set is set again, and calendars decide by it as they did.
#[test]
fn a_step_of_the_wall_clock_is_replayed() {
    let mut recording = Recording::new("", false);
    recording.login(1, "alice");
    let slot = Map::new()
        .with("from", "2026-11-21T10:00:00Z")
        .with("to", "2026-11-21T11:00:00Z");
    let manager = Map::new()
        .with("kind", "schedule")
        .with("free", "deny")
        .with("slots", vec![Value::from(slot)]);
    let spec = Map::new().with("kind", "token").with("manager", manager);
    let create = Parcel::new(Family::Context, "create").content(spec);
    recording.say(1, create, "/robot/room");
    let before = recording.ask(1, Verb::Grab, "/robot/room");
    assert!(matches!(&before[..], [Outcome::Refused { .. }]), "{before:?}");
    recording.tell(Input::Wall {
        ahead: 1_795_255_300_000_000,
    });
    let after = recording.ask(1, Verb::Grab, "/robot/room");
    let granted = |outcome: &Outcome| matches!(outcome, Outcome::Ok { fence: Some(_), .. });
    assert!(after.iter().any(granted), "{after:?}");
    assert_eq!(recording.by("").0, Vec::<String>::new());
}

/// No line of a recording is more than its reader takes, and each comes back as it was.
#[test]
fn lines_come_back() {
    let mut recording = Recording::new("", false);
    recording.login(1, "alice");
    let spec = Map::new()
        .with("kind", "channel")
        .with("lease", mom_proto::Value::Double(0.5));
    recording.say(
        1,
        Parcel::new(Family::Context, "create").content(spec),
        "/robot/other",
    );
    let mut addressed = command(Some(3));
    addressed.address = Some(vec!["bob".into()]);
    recording.say(1, addressed, "/robot/arm");
    let mut odd = Parcel::new(Family::Login, "logon").content("a secret");
    odd.number = Some(mom_proto::ContextNumber(99));
    recording.tell(Input::Request {
        peer: PeerId(1),
        parcel: Box::new(odd),
        clock: None,
    });
    recording.tell(Input::Gone { peer: PeerId(1) });
    recording.tell(Input::Tick);
    recording.tell(Input::Wall { ahead: -5 });
    for line in &recording.lines {
        let text = serde_json::to_string(line).expect("JSON");
        assert!(!text.contains("a secret"), "{text}");
        let back: RecordedLine = serde_json::from_str(&text).expect("a line");
        match (line, back) {
            (RecordedLine::Head(line), RecordedLine::Head(back)) => assert_eq!(*line, back),
            (RecordedLine::Step(line), RecordedLine::Step(back)) => assert_eq!(*line, back),
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(recording.by("").0, Vec::<String>::new());
}
