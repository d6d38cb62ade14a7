//! `context what-if`: the running recording decided again by a configuration that a peer tries; and the configuration that holds,
//! to begin from.

use std::path::{Path as FilePath, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use mom_config::{Config, ConfigErrors};
use mom_hub::PeerId;
use mom_journal::{Difference, RecordError, Replay};
use mom_proto::{Code, Content, Map, Path, Value, WireError};
use serde::Deserialize;

use super::{Answering, MOST_BYTES, bad, int, on, read, size};

/// Differences of one reply.
const MOST: usize = 200;

/// Faults of a configuration of which one error tells.
const FAULTS: usize = 20;

/// What-ifs that wait or are decided.
const WAITING: usize = 4;

/// For so long one is decided; what comes later is not.
const LONGEST: Duration = Duration::from_secs(30);

/// After so many inputs the time is looked at.
const STRIDE: u64 = 64;

/// How often it is looked whether the peer is still there.
const LOOK: Duration = Duration::from_millis(250);

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Args {
    config: Option<String>,
    rules: bool,
}

/// Gives the place in the queue back.
struct Tried<'a>(&'a AtomicUsize);

impl Drop for Tried<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Tells the thread that decides that nobody waits for it any more.
struct Cancel(Arc<AtomicBool>);

impl Drop for Cancel {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}

impl Answering {
    pub(super) async fn what_if(&self, to: PeerId, content: Option<Content>) -> Result<Map, WireError> {
        let args: Args = read(content.as_ref())?;
        let Some(text) = args.config else {
            let recorded = self.board.tap.records();
            return self.with_config(move |config| running(config, recorded)).await;
        };
        let tried = Tried(&self.tried);
        if self.tried.fetch_add(1, Ordering::AcqRel) >= WAITING {
            let text = format!("{WAITING} what-if requests are already pending, the limit");
            return Err(WireError::new(Code::TRY_LATER, text).retry_after(Duration::from_secs(1)));
        }
        let Some(log) = self.board.tap.recording().await.map(FilePath::to_owned) else {
            let text = "nothing is recorded that could be decided again: write [record] path = \"control.jsonl\" into the \
                        configuration, or start mom-broker with --record FILE";
            return Err(WireError::new(Code::NOT_RECORDED, text));
        };
        let cancel = Cancel(Arc::default());
        let trial = Trial {
            text,
            rules: args.rules,
            log,
            cancelled: Arc::clone(&cancel.0),
        };
        let running = Arc::clone(&self.running);
        let decided = on(&self.trying, move || {
            let config = running.lock().clone();
            trial.run(&config)
        });
        let gone = async {
            while self.board.outbox(to).is_some() {
                tokio::time::sleep(LOOK).await;
            }
        };
        let result = tokio::select! {
            result = decided => result?,
            () = gone => Err(WireError::new(Code::WITHDRAWN, "the peer that asked is gone")),
        };
        drop((cancel, tried));
        result
    }
}

/// The configuration that holds.
fn running(config: &Config, recorded: bool) -> Map {
    let file = config.file();
    let mut reply = Map::new().with("config", config.text().unwrap_or_default());
    for (key, text) in [("file", file.name), ("sha256", file.sha256)] {
        if let Some(text) = text {
            reply.set(key, text);
        }
    }
    reply.with("recorded", recorded)
}

/// A configuration, and what it is tried on.
struct Trial {
    text: String,
    rules: bool,
    log: PathBuf,
    cancelled: Arc<AtomicBool>,
}

impl Trial {
    fn run(&self, running: &Config) -> Result<Map, WireError> {
        let until = Instant::now() + LONGEST;
        if self.is_cancelled() {
            return Err(WireError::new(Code::WITHDRAWN, "the peer that asked is gone"));
        }
        let config = running.variant(&self.text).map_err(|errors| faulty(&errors))?;
        let mut replay = config.replay(&self.log).map_err(unreadable)?;
        if self.rules {
            replay.compare_rules();
        }
        let (mut told, mut bytes, mut cut) = (Vec::new(), 0, false);
        while let Some(differences) = replay.step().map_err(unreadable)? {
            for difference in &differences {
                if told.len() < MOST && bytes < MOST_BYTES {
                    let map = to_map(difference, &config);
                    bytes += size(&map);
                    told.push(Value::from(map));
                }
            }
            if replay.summary().inputs % STRIDE == 0 {
                cut = Instant::now() >= until;
                if cut || self.is_cancelled() {
                    break;
                }
            }
        }
        Ok(reply(&replay, &config, told, cut))
    }

    fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Acquire)
    }
}

fn reply(replay: &Replay, config: &Config, told: Vec<Value>, cut: bool) -> Map {
    let summary = replay.summary();
    let mut reply = Map::new()
        .with("inputs", int(summary.inputs))
        .with("differ", int(summary.differ));
    if summary.differ > told.len() as u64 {
        reply.set("more", true);
    }
    reply.set("differences", told);
    if let Some(file) = config.file().name {
        reply.set("file", file);
    }
    if summary.configured > 0 {
        reply.set("configured", int(summary.configured));
    }
    if !summary.unknown_users.is_empty() {
        let users = summary
            .unknown_users
            .iter()
            .map(|user| Value::from(user.as_str()));
        reply.set("unknown-users", users.collect::<Vec<_>>());
    }
    if let Some(end) = summary.end.as_deref().filter(|end| *end != Replay::WHOLE) {
        reply.set("end", end);
    }
    if cut {
        reply.set("cut", true);
    }
    reply
}

fn to_map(difference: &Difference, config: &Config) -> Map {
    let mut map = Map::new()
        .with("at", difference.at)
        .with("recorded-line", int(difference.line));
    let texts = [
        ("peer", difference.peer.as_deref()),
        ("user", difference.user.as_deref()),
        ("request", Some(difference.what.as_str())),
        ("message", difference.message.as_deref()),
        ("context", difference.context.as_deref()),
    ];
    for (key, text) in texts {
        if let Some(text) = text {
            map.set(key, text);
        }
    }
    map.set("old", difference.then());
    map.set("new", difference.now());
    if let Some((rule, context)) = difference.rule() {
        map.set("rule", rule);
        let context = Path::parse(context).ok();
        if let Some(place) = context.and_then(|context| config.locate_rule_from(rule, &context)) {
            map.set("file", place.file_name());
            map.set("line", int(place.line as u64));
        }
    }
    map
}

/// What is wrong with a configuration: the first fault in words, all with their places.
fn faulty(errors: &ConfigErrors) -> WireError {
    let faults = errors.iter().take(FAULTS).map(|error| {
        let mut fault = Map::new().with("text", error.text.as_str());
        for (key, number) in [("line", error.line), ("column", error.column)] {
            if let Some(number) = number {
                fault.set(key, int(number as u64));
            }
        }
        if let Some(key) = &error.key {
            fault.set("key", key.as_str());
        }
        Value::from(fault)
    });
    let faults: Vec<Value> = faults.collect();
    let text = errors.iter().next().map(|error| {
        let line = error.line.map(|line| format!("line {line}: "));
        let key = error.key.as_ref().map(|key| format!("{key}: "));
        [
            line.unwrap_or_default(),
            key.unwrap_or_default(),
            error.text.clone(),
        ]
        .concat()
    });
    bad("config", text.unwrap_or_default()).detail("faults", faults)
}

/// Why a recording cannot be decided again; not where it lies.
fn unreadable(error: RecordError) -> WireError {
    match error {
        RecordError::Read { error, .. } => {
            let text = format!("the recording cannot be read: {}", error.kind());
            WireError::new(Code::STORAGE_FAILED, text)
        }
        RecordError::Line { line, text, .. } => {
            let text = format!("line {line} of the recording: {text}");
            WireError::new(Code::STORAGE_FAILED, text)
        }
        RecordError::Config(text) => bad("config", text),
    }
}
