//! Writes a recording, from a thread of its own.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

use mom_hub::{Effect, Hub, Input, Settings};
use mom_proto::{Family, Micros, Verb};
use mom_system::open_own;
use tokio::sync::oneshot;

use super::RecordConfig;
use super::line::{RecordedLine, RecordedStep, RecordingHead, Told};
use super::outcome::outcomes;
use crate::ConfigFile;
use crate::kept_files::KeptFiles;

/// The reason in the last line of a complete recording.
pub(super) const STOPPED: &str = "the broker stopped";

/// The most inputs that wait for the writer, and about how many bytes.
const QUEUE: usize = 16 * 1024;
const WAITING: usize = 64 * 1024 * 1024;

/// About the size of an input without its content.
const INPUT: usize = 512;

/// How soon inputs are in the file.
const TICK: Duration = Duration::from_secs(1);

/// How long a stopping broker waits for the end of the file.
const PATIENCE: Duration = Duration::from_secs(5);

/// Records the hub's inputs and decisions.
///
/// A recording with a gap could not be replayed: if the disk does not keep up, it stops for good, and reports that in
/// its last line and in the log.
#[derive(Debug)]
pub(crate) struct Recorder {
    queue: SyncSender<RecordNote>,
    shared: Arc<RecordShared>,
    path: PathBuf,
}

#[derive(Debug, Default)]
struct RecordShared {
    stopped: AtomicBool,
    overflow: AtomicBool,
    waiting: AtomicUsize,
}

#[derive(Debug)]
enum RecordNote {
    Step(Box<RecordedStep>, usize),
    /// Answered when everything before it is in the file.
    Written(oneshot::Sender<()>),
    End(oneshot::Sender<()>),
}

/// An input that the hub is just about to take.
#[derive(Debug)]
pub(crate) struct Noted {
    told: Told,
    asked: Option<(u64, Option<Verb>)>,
    cost: usize,
}

impl Recorder {
    /// Begins a recording of a hub with these settings, if one is configured.
    ///
    /// # Errors
    /// What the system says about the file, or that another broker writes it.
    pub(crate) fn start(
        record: &RecordConfig,
        settings: &Settings,
        config: &ConfigFile,
    ) -> io::Result<Option<Recorder>> {
        let Some(path) = &record.path else {
            return Ok(None);
        };
        let files = KeptFiles::new(path, record.keep, record.reserve);
        let mut writer = RecordWriter {
            file: BufWriter::new(begin(&files)?),
            files,
            length: 0,
            size: record.size,
            shared: Arc::default(),
        };
        writer.write(&RecordedLine::Head(Box::new(RecordingHead::new(
            settings, config,
        ))))?;
        writer.file.flush()?;
        let shared = Arc::clone(&writer.shared);
        let (queue, notes) = sync_channel(QUEUE);
        std::thread::Builder::new()
            .name("record".to_owned())
            .spawn(move || writer.run(&notes))?;
        Ok(Some(Recorder {
            queue,
            shared,
            path: path.clone(),
        }))
    }

    /// Notes an input; `hub` is as it was before. None once the recording has stopped.
    pub(crate) fn note(&self, input: &Input, hub: &Hub) -> Option<Noted> {
        if self.shared.stopped.load(Ordering::Relaxed) {
            return None;
        }
        let (asked, content) = match input {
            Input::Request { peer, parcel, .. } => {
                let verb = Verb::of(parcel.family, &parcel.name).ok();
                // A message has an answer only if it is refused.
                let size = parcel.content.as_ref().map_or(0, |content| content.size());
                let kept = if parcel.family == Family::Message { 0 } else { size };
                (Some((peer.0, verb)), kept)
            }
            _ => (None, 0),
        };
        Some(Noted {
            told: Told::of(input, hub),
            asked,
            cost: content + INPUT,
        })
    }

    /// Writes the decision on it.
    pub(crate) fn decided(&self, now: Micros, noted: Noted, effects: &[Effect], deadline: Option<Micros>) {
        let step = RecordedStep {
            now,
            input: noted.told,
            decided: outcomes(effects, noted.asked),
            deadline,
        };
        let waiting = self.shared.waiting.fetch_add(noted.cost, Ordering::Relaxed);
        let full = waiting > WAITING;
        if full
            || self
                .queue
                .try_send(RecordNote::Step(Box::new(step), noted.cost))
                .is_err()
        {
            self.shared.overflow.store(true, Ordering::Relaxed);
            self.shared.stopped.store(true, Ordering::Relaxed);
        }
    }

    /// The configuration that the next input brings.
    pub(crate) fn name_configuration(noted: &mut Option<Noted>, config: &ConfigFile) {
        if let Some(Noted {
            told: told @ Told::Configure(..),
            ..
        }) = noted
        {
            *told = Told::Configure(config.name.clone(), config.sha256.clone());
        }
    }

    /// The file, once what was noted is in it, or after a short time.
    pub(crate) async fn written(&self) -> &Path {
        let (done, written) = oneshot::channel();
        // Nobody waits for a disk that does not keep up; a recording that has ended is whole.
        if self.queue.try_send(RecordNote::Written(done)).is_ok() {
            let _ = tokio::time::timeout(TICK, written).await;
        }
        &self.path
    }

    /// Ends the recording; returns when it is in the file, or after a bounded time.
    pub(crate) async fn end(&self) {
        if self.shared.stopped.swap(true, Ordering::Relaxed) && !self.shared.overflow.load(Ordering::Relaxed)
        {
            return;
        }
        let (done, written) = oneshot::channel();
        let queue = self.queue.clone();
        // The queue may be full, and a disk that hangs must not hold up the program's end.
        let sent = std::thread::Builder::new()
            .name("record-end".to_owned())
            .spawn(move || queue.send(RecordNote::End(done)).is_ok());
        if sent.is_err() || tokio::time::timeout(PATIENCE, written).await.is_err() {
            tracing::error!("the recording could not be written to its end");
        }
    }
}

/// An empty file; an existing one becomes the youngest of the old ones.
fn begin(files: &KeptFiles) -> io::Result<File> {
    let file = open_own(files.path())?;
    let known = file.metadata()?;
    if !known.is_file() || known.len() == 0 {
        return Ok(file);
    }
    files.trim()?;
    files.shift()?;
    open_own(files.path())
}

struct RecordWriter {
    file: BufWriter<File>,
    files: KeptFiles,
    length: u64,
    size: u64,
    shared: Arc<RecordShared>,
}

impl Drop for RecordWriter {
    fn drop(&mut self) {
        // As for the audit log: unlocked, so that the next broker finds the file free.
        let _ = self.file.get_ref().unlock();
    }
}

impl RecordWriter {
    fn run(mut self, notes: &Receiver<RecordNote>) {
        if let Err(error) = self.take_all(notes) {
            tracing::error!(%error, "the recording stops: it cannot be written");
        }
        self.shared.stopped.store(true, Ordering::Relaxed);
    }

    fn take_all(&mut self, notes: &Receiver<RecordNote>) -> io::Result<()> {
        loop {
            let mut next = notes.recv_timeout(TICK);
            loop {
                match next {
                    Ok(RecordNote::Step(step, cost)) => {
                        self.shared.waiting.fetch_sub(cost, Ordering::Relaxed);
                        if self.write(&RecordedLine::Step(step))? {
                            return self.end("it has reached its size", true);
                        }
                    }
                    Ok(RecordNote::Written(done)) => {
                        self.file.flush()?;
                        // The receiver may have stopped waiting.
                        let _ = done.send(());
                    }
                    Ok(RecordNote::End(done)) => {
                        let ended = self.end(STOPPED, false);
                        // The receiver may have stopped waiting.
                        let _ = done.send(());
                        return ended;
                    }
                    Err(RecvTimeoutError::Timeout) => break,
                    Err(RecvTimeoutError::Disconnected) => return self.end(STOPPED, false),
                }
                next = notes.try_recv().map_err(|_| RecvTimeoutError::Timeout);
            }
            if self.shared.overflow.load(Ordering::Relaxed) {
                return self.end("the disk did not keep up", true);
            }
            self.file.flush()?;
            if let Err(error) = self.files.leave_space() {
                return self.end(&error.to_string(), true);
            }
        }
    }

    /// True if it does not fit.
    fn write(&mut self, line: &RecordedLine) -> io::Result<bool> {
        let mut bytes = serde_json::to_vec(line)?;
        bytes.push(b'\n');
        let length = self.length + bytes.len() as u64;
        if length > self.size && matches!(line, RecordedLine::Step(_)) {
            return Ok(true);
        }
        self.length = length;
        self.file.write_all(&bytes).map(|()| false)
    }

    fn end(&mut self, why: &str, early: bool) -> io::Result<()> {
        if early {
            tracing::warn!(why, "the recording stops");
        }
        self.write(&RecordedLine::End(why.to_owned()))?;
        self.file.flush()
    }
}
