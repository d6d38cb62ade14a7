//! Keeps what must outlive the broker: of each token who owns it and the highest fence (design §4, §6).
//!
//! A commit is an fsync or two, and an embedded database has one writer. So that a grant never waits for the
//! fsync of another token, there are several files, the lanes, and a record goes to any that is idle; only when
//! all are busy some wait, and then go together. Every record has a number of one rising sequence: whichever
//! lane it lies in, the highest one of a token holds.
//!
//! `queue` decides which record goes where, without IO; `disk` writes one lane; `start` reads all of them and
//! makes the new epoch; here are the threads, one per lane.

mod disk;
mod epoch;
mod error;
mod queue;
mod quiet;
mod row;
mod rows;
mod settings;
mod start;
mod stops;
#[cfg(test)]
mod tests;

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path as FilePath;
use std::sync::Arc;

use mom_hub::{Record, Ticket};
use mom_proto::Time;
use mom_system::sync::{Condvar, Mutex, thread};
use tokio::sync::mpsc;

pub use error::StoreError;
// The broker knows it by its shorter name.
pub use queue::StoreAnswer;
pub use settings::StoreConfig;
pub use stops::{KeptStops, StopFile};

use disk::{Disk, lane_file};
use queue::StoreQueue;
use start::{Begun, Lock};

/// The files of a store. Beyond a few, a disk only does one after the other what it is asked at once.
const LANES: usize = 4;

/// A store that is open.
#[derive(Debug)]
pub struct Store {
    shared: Arc<StoreShared>,
    /// Closed when the last lane has ended.
    ended: Mutex<mpsc::Receiver<()>>,
}

/// A store that was opened, and what was in it.
pub struct Opened {
    /// The store itself.
    pub store: Store,
    /// The epoch of this start; it is durable.
    pub epoch: u64,
    /// The latest record of each token.
    pub records: Vec<Record>,
    /// The awaited records that are durable, or will never be. One per ticket.
    pub answers: mpsc::UnboundedReceiver<StoreAnswer>,
}

#[derive(Debug)]
struct StoreShared {
    inner: Mutex<StoreInner>,
    changed: Condvar,
    answers: mpsc::UnboundedSender<StoreAnswer>,
}

#[derive(Debug)]
struct StoreInner {
    queue: StoreQueue,
    closing: bool,
}

/// The thread of one lane.
struct LaneWriter {
    lane: usize,
    name: String,
    disk: Box<dyn Disk>,
    shared: Arc<StoreShared>,
    /// The directory is free for another broker when the last one has ended.
    lock: Option<Arc<Lock>>,
    ended: mpsc::Sender<()>,
}

/// Opens the store of a configuration, if it has one.
///
/// # Errors
/// As [`Store::open`].
pub async fn open(path: Option<&FilePath>, wall: Time) -> Result<Option<Opened>, StoreError> {
    let Some(path) = path.map(FilePath::to_owned) else {
        return Ok(None);
    };
    let shown = path.clone();
    let opened = tokio::task::spawn_blocking(move || Store::open(&path, wall)).await;
    let opened = opened.unwrap_or_else(|error| Err(disk::unwritable(&shown, &error)))?;
    let (epoch, records) = (opened.epoch, opened.records.len());
    tracing::info!(path = %shown.display(), epoch, records, "store opened");
    Ok(Some(opened))
}

/// Takes the next epoch from the state directory of a configuration, if it has one.
///
/// # Errors
/// Why the broker must not start without it.
pub async fn take_epoch(state: Option<&FilePath>, wall: Time) -> Result<Option<u64>, StoreError> {
    let Some(state) = state.map(FilePath::to_owned) else {
        return Ok(None);
    };
    let shown = state.clone();
    let taken = tokio::task::spawn_blocking(move || epoch::take(&state, wall)).await;
    let epoch = taken.unwrap_or_else(|error| Err(disk::unwritable(&shown, &error)))?;
    tracing::info!(state = %shown.display(), epoch, "fences rise over restarts");
    Ok(Some(epoch))
}

/// Opens what keeps stops over restarts, in the store's directory or the one for state; none where a configuration has
/// neither. `name` tells brokers apart that share a directory.
///
/// # Errors
/// A directory that cannot be used.
pub async fn open_stops(config: &StoreConfig, name: String) -> Result<Option<KeptStops>, StoreError> {
    let Some(directory) = config.path.clone().or_else(|| config.state.clone()) else {
        return Ok(None);
    };
    let shown = directory.clone();
    let opened = tokio::task::spawn_blocking(move || StopFile::open(&directory, &name)).await;
    opened
        .unwrap_or_else(|error| Err(disk::unwritable(&shown, &error)))
        .map(Some)
}

impl Store {
    /// Opens the store of a directory, or makes it. Blocks.
    ///
    /// # Errors
    /// Why the broker must not start with it.
    pub fn open(directory: &FilePath, wall: Time) -> Result<Opened, StoreError> {
        let Begun { lock, lanes, found } = start::begin(directory, LANES, wall)?;
        let names = (0..).map(|lane| lane_file(directory, lane).display().to_string());
        let disks = names.zip(lanes.into_iter().map(|lane| Box::new(lane) as Box<dyn Disk>));
        let queue = StoreQueue::new(found.epoch, found.seen, found.kept);
        let (store, answers) = Store::run(disks.collect(), queue, Some(lock))
            .map_err(|error| disk::unwritable(directory, &error))?;
        Ok(Opened {
            store,
            epoch: found.epoch,
            records: found.records,
            answers,
        })
    }

    /// Begins a thread for each disk.
    fn run(
        disks: Vec<(String, Box<dyn Disk>)>,
        queue: StoreQueue,
        lock: Option<Lock>,
    ) -> std::io::Result<(Store, mpsc::UnboundedReceiver<StoreAnswer>)> {
        // Not bounded here: the hub awaits one ticket per token at most.
        let (answers, received) = mpsc::unbounded_channel();
        let (ending, ended) = mpsc::channel(1);
        let lock = lock.map(Arc::new);
        let inner = StoreInner {
            queue,
            closing: false,
        };
        let shared = Arc::new(StoreShared {
            inner: Mutex::new(inner),
            changed: Condvar::new(),
            answers,
        });
        // First of all, so that threads that have begun end if a later one cannot.
        let store = Store {
            shared: Arc::clone(&shared),
            ended: Mutex::new(ended),
        };
        for (lane, (name, disk)) in disks.into_iter().enumerate() {
            let worker = LaneWriter {
                lane,
                name,
                disk,
                shared: Arc::clone(&shared),
                lock: lock.clone(),
                ended: ending.clone(),
            };
            let thread = thread::Builder::new().name(format!("store-{lane}"));
            thread.spawn(move || worker.run())?;
        }
        Ok((store, received))
    }

    /// Takes a record in; it never waits. With a ticket there is one answer, when the record or a newer one of its
    /// token is durable, or will never be.
    pub fn put(&self, record: Record, ticket: Option<Ticket>) {
        let mut inner = self.shared.inner.lock();
        let taken = !inner.closing && inner.queue.put(record, ticket);
        drop(inner);
        match ticket {
            _ if taken => drop(self.shared.changed.notify_all()),
            Some(ticket) => self.shared.answer(vec![(ticket, false)]),
            None => {}
        }
    }

    /// Takes no more, writes what waits, and closes the files; returns when that is done.
    pub async fn close(&self) {
        self.begin_close();
        std::future::poll_fn(|context| self.ended.lock().poll_recv(context)).await;
    }

    fn begin_close(&self) {
        self.shared.inner.lock().closing = true;
        self.shared.changed.notify_all();
    }
}

/// The lanes write what waits and end by themselves.
impl Drop for Store {
    fn drop(&mut self) {
        self.begin_close();
    }
}

impl StoreShared {
    /// What a lane does next; none = it ends. Waits.
    fn next(&self, lane: usize) -> Option<queue::StoreBatch> {
        let mut inner = self.inner.lock();
        loop {
            if let Some(batch) = inner.queue.take(lane) {
                return Some(batch);
            }
            if inner.closing && inner.queue.is_quiet() {
                inner.queue.leave(lane);
                return None;
            }
            self.changed.wait(&mut inner);
        }
    }

    fn answer(&self, answers: Vec<StoreAnswer>) {
        for answer in answers {
            // Nobody listens any more when the broker has ended.
            let _ = self.answers.send(answer);
        }
    }
}

/// Why something did not work, if it did not.
fn attempt(act: impl FnOnce() -> io::Result<()>) -> Option<String> {
    match catch_unwind(AssertUnwindSafe(act)) {
        Ok(Ok(())) => None,
        Ok(Err(error)) => Some(error.to_string()),
        Err(_) => Some("the database failed on its own".to_owned()),
    }
}

impl LaneWriter {
    fn run(mut self) {
        let mut broken = None;
        while let Some(batch) = self.shared.next(self.lane) {
            let write = || self.disk.write(&batch.meta, &batch.records, &batch.gone);
            // A ticket is answered whatever happens.
            let error = broken.take().or_else(|| attempt(write));
            let mut inner = self.shared.inner.lock();
            let answers = inner.queue.finish(self.lane, batch, error.is_none());
            let dead = inner.queue.is_dead();
            drop(inner);
            self.shared.changed.notify_all();
            self.shared.answer(answers);
            if let Some(error) = error {
                self.report(&error, dead);
                break;
            }
            // Nobody waits for this: the other lanes write meanwhile.
            broken = attempt(|| self.disk.shrink());
        }
        // The file is closed before the directory is said to be free.
        drop(self.disk);
        drop(self.lock);
        drop(self.ended);
    }

    fn report(&self, error: &str, dead: bool) {
        tracing::error!(
            file = self.name,
            error,
            "store: cannot write; this lane is not used again"
        );
        if dead {
            tracing::error!(
                "store: no lane is left; all changes of ownership that have to be durable are refused as \
                 storage-failed until the broker is started again on a disk that is well"
            );
        }
    }
}
