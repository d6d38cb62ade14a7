//! What is seen in one trial, all by one clock.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use rustix::time::{ClockId, clock_gettime};

/// µs of `CLOCK_MONOTONIC`, which the bodies' traces use, too.
pub(super) type Micros = i64;

pub(super) fn now() -> Micros {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec * 1_000_000 + now.tv_nsec / 1000
}

/// Where a body was.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sample {
    pub(super) at: Micros,
    pub(super) place: Vec<f64>,
}

/// What of a world is hindered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Hindered {
    /// The way between device and hub: nothing passes.
    Link,
    /// That between the device's program and its robot.
    Wire,
    /// This program of the world is stopped (SIGSTOP) or dead; the first is the hub.
    Program(usize),
}

/// What the test did or heard. The time beside it is when that was over or heard: what it names had happened by then.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Seen {
    /// The hub has taken this stop.
    Stop { number: u64 },
    /// Stops up to this one are lifted from this time on at the earliest.
    Unstop { number: u64 },
    /// The token is known to be with this owner.
    Grant { owner: String, fence: u64 },
    /// A command leaves, under a fence or while nothing guards the channel. The body moves this way by it, where it moves.
    Command { owner: String, ways: f64, fenced: bool },
    /// The hub has told a new guard of the channel.
    Guarded,
    /// A command has ended, by a word of the device or the hub.
    Ended { owner: String },
    /// The statement that was begun is the last that moves, and takes so long.
    Last { owner: String, lasts: Micros },
    /// The device's word. `rests`: it says that it stands, and how it knows.
    State {
        stopped: bool,
        stop: u64,
        moving: bool,
        rests: bool,
        at: Option<f64>,
    },
    /// Something begins to be hindered, or is so no more.
    Hinder { what: Hindered, begins: bool },
}

/// All of one trial.
#[derive(Debug, Clone, Default)]
pub(super) struct Log {
    /// Where each body was: a program that is started again has another.
    pub(super) bodies: Vec<Vec<Sample>>,
    /// In the order of their times.
    pub(super) seen: Vec<(Micros, Seen)>,
    /// The longest time for which this process had no turn, µs.
    pub(super) pause: Micros,
}

/// The notes of a trial, from several tasks.
#[derive(Debug, Clone, Default)]
pub(super) struct Notes(Arc<Mutex<Vec<(Micros, Seen)>>>);

impl Notes {
    /// Notes what happens now.
    pub(super) fn note(&self, seen: Seen) {
        self.note_at(now(), seen);
    }

    pub(super) fn note_at(&self, at: Micros, seen: Seen) {
        let mut notes = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        notes.push((at, seen));
    }

    /// All until now, in order, and begins anew.
    pub(super) fn take(&self) -> Vec<(Micros, Seen)> {
        let mut notes = std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner));
        notes.sort_by_key(|(at, _)| *at);
        notes
    }
}

/// The trace of a body, read as it grows.
#[derive(Debug)]
pub(super) struct Reading {
    path: PathBuf,
    read: u64,
    rest: String,
    /// The newest place.
    last: Option<Sample>,
}

impl Reading {
    pub(super) fn of(path: PathBuf) -> Self {
        Self {
            path,
            read: 0,
            rest: String::new(),
            last: None,
        }
    }

    /// Where the body was last.
    pub(super) fn last(&self) -> Option<&Sample> {
        self.last.as_ref()
    }

    /// What has come since the last call, body by body.
    pub(super) fn more(&mut self) -> io::Result<Vec<Vec<Sample>>> {
        let mut file = File::open(&self.path)?;
        file.seek(SeekFrom::Start(self.read))?;
        self.read += file.read_to_string(&mut self.rest)? as u64;
        let whole = self.rest.rfind('\n').map_or(0, |end| end + 1);
        let text: String = self.rest.drain(..whole).collect();
        let mut bodies = vec![Vec::new()];
        for line in text.lines() {
            if line == "begin" {
                bodies.push(Vec::new());
                continue;
            }
            let mut words = line.split(' ');
            let at = words.next().and_then(|word| word.parse().ok());
            let place: Option<Vec<f64>> = words.map(|word| word.parse().ok()).collect();
            let (Some(at), Some(place), Some(body)) = (at, place, bodies.last_mut()) else {
                return Err(io::Error::other(format!("not a line of a trace: {line:?}")));
            };
            let sample = Sample { at, place };
            self.last = Some(sample.clone());
            body.push(sample);
        }
        bodies.retain(|body| !body.is_empty());
        Ok(bodies)
    }
}
