//! What went out and what came in, with times (W12, W13): the latest in memory, and all of it as lines of a file.

use std::collections::VecDeque;
use std::fmt;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Write as _};
use std::path::Path;
use std::sync::mpsc::{self, RecvTimeoutError, SyncSender, TrySendError};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::{Value as Json, json};

use crate::circuit::Note;
use crate::fleet::Unit;

/// What happened with one robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// When, in µs since 1970, UTC.
    pub time: i64,
    /// The robot.
    pub unit: Unit,
    /// What.
    pub note: Note,
}

impl Entry {
    /// It as JSON: `time_us`, `unit` and `kind`, which is
    ///
    /// - `out` or `in`: a frame, with `wire` and `frame`, both notations of it, and `clamped` and `round_trip_us` if there is
    ///   something to tell;
    /// - `state`: with `state`, the paper's word;
    /// - `end`: with `reason`.
    ///
    /// ```
    /// use mom_base_station::circuit::Note;
    /// use mom_base_station::log::Entry;
    /// use mom_brs::{Command, Frame};
    ///
    /// let frame = Frame::new(&Command::MOTOR, &[50, -50])?;
    /// let entry = Entry { time: 5, unit: 1, note: Note::Sent(frame) };
    /// let json = r#"{"time_us":5,"unit":1,"kind":"out","wire":"06 00050 -0050","frame":"motor left=50 right=-50"}"#;
    /// assert_eq!(entry.to_json().to_string(), json);
    /// # Ok::<(), mom_brs::FrameFault>(())
    /// ```
    #[must_use]
    pub fn to_json(&self) -> Json {
        let mut json = json!({ "time_us": self.time, "unit": self.unit });
        let mut put = |key: &str, value: Json| {
            if let Some(object) = json.as_object_mut() {
                object.insert(key.to_owned(), value);
            }
        };
        match &self.note {
            Note::Sent(frame) | Note::Received(frame, _) => {
                let out = matches!(self.note, Note::Sent(_));
                put("kind", if out { "out" } else { "in" }.into());
                put("wire", frame.to_string().into());
                put("frame", format!("{frame:#}").into());
                if frame.is_clamped() {
                    put("clamped", true.into());
                }
                if let Note::Received(_, Some(micros)) = self.note {
                    put("round_trip_us", micros.into());
                }
            }
            Note::State(state) => {
                put("kind", "state".into());
                put("state", state.word().into());
            }
            Note::Ended(end) => {
                put("kind", "end".into());
                put("reason", end.to_string().into());
            }
        }
        json
    }
}

/// For people: `12:34:56.789 unit 1 -> 06 00050 -0050  motor left=50 right=-50`; `<-` is what came.
impl fmt::Display for Entry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = self.unit;
        write!(f, "{} unit {unit} ", time_of_day(self.time))?;
        match &self.note {
            Note::Sent(frame) => write!(f, "-> {frame}  {frame:#}"),
            Note::Received(frame, round_trip) => {
                write!(f, "<- {frame}  {frame:#}")?;
                match round_trip {
                    Some(micros) => write!(f, "  {}", millis(*micros)),
                    None => Ok(()),
                }
            }
            Note::State(state) => write!(f, "is {state}"),
            Note::Ended(end) => write!(f, "{end}"),
        }
    }
}

/// A time in µs as people read it: `1.25 ms`.
#[must_use]
pub fn millis(micros: i64) -> String {
    match micros {
        // Two digits behind the point would be noise.
        100_000.. => format!("{} ms", micros / 1000),
        _ => format!("{}.{:02} ms", micros / 1000, micros % 1000 / 10),
    }
}

/// The time of day, UTC, of a time in µs since 1970: `12:34:56.789`.
#[must_use]
pub fn time_of_day(micros: i64) -> String {
    let millis = micros.div_euclid(1000).rem_euclid(24 * 60 * 60 * 1000);
    let (seconds, millis) = (millis / 1000, millis % 1000);
    let (hours, minutes, seconds) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    format!("{hours:02}:{minutes:02}:{seconds:02}.{millis:03}")
}

/// The latest entries, and where all of them go.
#[derive(Debug)]
pub struct Log {
    ring: VecDeque<Entry>,
    most: usize,
    file: Option<LogFile>,
}

impl Log {
    /// A log that remembers the latest `most` entries, at least one.
    #[must_use]
    pub fn new(most: usize) -> Log {
        Log {
            ring: VecDeque::new(),
            most: most.max(1),
            file: None,
        }
    }

    /// The same with a file for all entries, whether they are remembered or not.
    #[must_use]
    pub fn with_file(self, file: LogFile) -> Log {
        Log {
            file: Some(file),
            ..self
        }
    }

    /// Takes an entry.
    pub fn push(&mut self, entry: Entry) {
        if let Some(file) = &mut self.file {
            file.write(entry.clone());
        }
        while self.ring.len() >= self.most {
            self.ring.pop_front();
        }
        self.ring.push_back(entry);
    }

    /// The entries that it remembers, the oldest first.
    pub fn entries(&self) -> impl DoubleEndedIterator<Item = &Entry> {
        self.ring.iter()
    }
}

/// A file of JSON lines, which a thread of its own writes, so that a slow disk delays no robot.
#[derive(Debug)]
pub struct LogFile {
    entries: Option<SyncSender<Written>>,
    /// Closed when all is written.
    ended: mpsc::Receiver<()>,
    lost: u64,
}

#[derive(Debug)]
enum Written {
    Entry(Entry),
    /// So many entries are missing here.
    Lost(u64),
}

/// What waits for the disk at most.
const MOST_UNWRITTEN: usize = 16_384;

/// So long the end of the program waits for the disk at most.
const WRITTEN_WITHIN: Duration = Duration::from_secs(2);

/// Between two looks for a place in what waits for the disk.
const LOOKS_AGAIN: Duration = Duration::from_millis(5);

/// What was written is in the file after this time at the latest.
const FLUSHED_AFTER: Duration = Duration::from_millis(200);

impl LogFile {
    /// Opens a file to append to, and makes it if there is none.
    ///
    /// # Errors
    ///
    /// It cannot be opened.
    pub fn open(path: &Path) -> io::Result<LogFile> {
        let file = OpenOptions::new().create(true).append(true).open(path)?;
        let (sender, receiver) = mpsc::sync_channel(MOST_UNWRITTEN);
        let (end, ended) = mpsc::channel();
        thread::Builder::new().name("log".to_owned()).spawn(move || {
            let _end: mpsc::Sender<()> = end;
            write_all(&receiver, BufWriter::new(file));
        })?;
        Ok(LogFile {
            entries: Some(sender),
            ended,
            lost: 0,
        })
    }

    /// Hands an entry to the thread. If the disk is too slow the entry is missing, and a line `{"lost":N}` says so.
    fn write(&mut self, entry: Entry) {
        let Some(entries) = &self.entries else { return };
        if self.lost > 0 && entries.try_send(Written::Lost(self.lost)).is_ok() {
            self.lost = 0;
        }
        // Nothing comes before the count of what is missing there.
        if self.lost > 0 || entries.try_send(Written::Entry(entry)).is_err() {
            self.lost += 1;
        }
    }
}

/// Writes what waits, and only then is dropped; a file that takes nothing, as a pipe that nobody reads, is not waited for.
impl Drop for LogFile {
    fn drop(&mut self) {
        let until = Instant::now() + WRITTEN_WITHIN;
        if let Some(entries) = self.entries.take() {
            let mut left = (self.lost > 0).then_some(Written::Lost(self.lost));
            while let Some(lost) = left.take().filter(|_| Instant::now() < until) {
                if let Err(TrySendError::Full(lost)) = entries.try_send(lost) {
                    thread::sleep(LOOKS_AGAIN);
                    left = Some(lost);
                }
            }
        }
        // Its end of this is dropped with the writer.
        let _ = self
            .ended
            .recv_timeout(until.saturating_duration_since(Instant::now()));
    }
}

fn write_all(entries: &mpsc::Receiver<Written>, mut file: BufWriter<File>) {
    // As long as there is something to flush, it waits only so long for more.
    let mut flushed = true;
    loop {
        let next = match flushed {
            true => entries.recv().map_err(|_| RecvTimeoutError::Disconnected),
            false => entries.recv_timeout(FLUSHED_AFTER),
        };
        let json = match next {
            Ok(Written::Entry(entry)) => entry.to_json(),
            Ok(Written::Lost(count)) => json!({ "lost": count }),
            Err(end) => {
                // A full disk must not stop driving: what cannot be written is gone.
                let _ = file.flush();
                if end == RecvTimeoutError::Disconnected {
                    return;
                }
                flushed = true;
                continue;
            }
        };
        let _ = writeln!(file, "{json}");
        flushed = false;
    }
}

#[cfg(test)]
mod tests {
    use mom_brs::{Command, Frame};

    use super::*;
    use crate::circuit::{End, State};

    fn entry(time: i64, note: Note) -> Entry {
        Entry { time, unit: 3, note }
    }

    fn null() -> Frame {
        Frame::reply(&Command::NULL, &[]).unwrap()
    }

    #[test]
    fn a_log_remembers_the_latest() {
        let mut log = Log::new(2);
        for time in 0..5 {
            log.push(entry(time, Note::State(State::Trying)));
        }
        assert_eq!(log.entries().map(|entry| entry.time).collect::<Vec<_>>(), [3, 4]);
    }

    /// The writer waits in the pipe, whose other end is open and not read.
    #[test]
    fn a_log_that_takes_nothing_is_not_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let made = std::process::Command::new("mkfifo").arg(&path).status();
        assert!(made.unwrap().success());
        let reader = OpenOptions::new().read(true).write(true).open(&path).unwrap();
        let mut log = Log::new(1).with_file(LogFile::open(&path).unwrap());
        for time in 0..20_000 {
            log.push(entry(time, Note::State(State::Writable)));
        }
        drop(log);
        drop(reader);
    }

    #[test]
    fn a_file_holds_all_a_line_each_also_after_it_was_opened_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.jsonl");
        let clamped = Frame::new(&Command::MOTOR, &[2000, 0]).unwrap();
        for note in [
            Note::Received(null(), Some(6000)),
            Note::Sent(clamped),
            Note::Ended(End::Silent),
        ] {
            let mut log = Log::new(1).with_file(LogFile::open(&path).unwrap());
            log.push(entry(1, Note::State(State::Writable)));
            log.push(entry(2, note));
        }
        let text = std::fs::read_to_string(path).unwrap();
        let state = r#"{"time_us":1,"unit":3,"kind":"state","state":"writable"}"#;
        let lines: Vec<&str> = text.lines().collect();
        let expected = [
            state,
            r#"{"time_us":2,"unit":3,"kind":"in","wire":"00","frame":"null","round_trip_us":6000}"#,
            state,
            r#"{"time_us":2,"unit":3,"kind":"out","wire":"06 01000 00000","frame":"motor left=1000 right=0","clamped":true}"#,
            state,
            r#"{"time_us":2,"unit":3,"kind":"end","reason":"the robot is silent"}"#,
        ];
        assert_eq!(lines, expected);
    }

    #[test]
    fn what_a_slow_disk_did_not_take_is_counted() {
        let (sender, receiver) = mpsc::sync_channel(1);
        let mut file = LogFile {
            entries: Some(sender),
            ended: mpsc::channel().1,
            lost: 0,
        };
        for time in 0..4 {
            file.write(entry(time, Note::Ended(End::Closed)));
        }
        assert!(matches!(
            receiver.recv(),
            Ok(Written::Entry(Entry { time: 0, .. }))
        ));
        file.write(entry(4, Note::Ended(End::Closed)));
        assert!(matches!(receiver.recv(), Ok(Written::Lost(3))));
        assert_eq!(file.lost, 1, "the count took the only place");
        drop(receiver);
    }

    #[test]
    fn people_read_times_frames_and_round_trips() {
        let time = (12 * 3600 + 34 * 60 + 56) * 1_000_000 + 789_000;
        let line = entry(time, Note::Received(null(), Some(6_123))).to_string();
        assert_eq!(line, "12:34:56.789 unit 3 <- 00  null  6.12 ms");
        assert_eq!(millis(1_234_567), "1234 ms");
        let state = entry(-1, Note::State(State::Connected)).to_string();
        assert_eq!(state, "23:59:59.999 unit 3 is connected");
    }
}
