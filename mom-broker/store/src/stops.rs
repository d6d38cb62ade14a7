//! Which devices are stopped, over restarts: one small file beside the epoch or the store, written whole each time.
//!
//! Stops are few, and what was stopped matters more than how fast it is written: the newest state of all of them is one
//! file, in place of the older one or not at all. What waits meanwhile goes with the next write.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path as FilePath, PathBuf};
use std::sync::Arc;

use mom_hub::{StopRecord, StopRow, Ticket};
use mom_proto::Path;
use mom_system::sync::{Condvar, Mutex, thread};
use tokio::sync::mpsc;

use super::StoreError;
use super::queue::StoreAnswer;
use super::start::{make_directory, sync};

/// The first word of the file, before the sum of what follows.
const FORM: &str = "mom-stops-1";

/// Brokers of one configuration that run at once, each with a file of its own.
const BESIDE: usize = 16;

/// Keeps what is stopped. Its thread ends with it.
#[derive(Debug)]
pub struct StopFile {
    shared: Arc<Shared>,
}

/// What was kept, and what goes on keeping it.
#[derive(Debug)]
pub struct KeptStops {
    /// What keeps.
    pub file: StopFile,
    /// What was stopped.
    pub records: Vec<StopRecord>,
    /// Why what was kept could not be read; then anything may have been stopped.
    pub unread: Option<String>,
    /// The records that are kept, or never will be: one for each ticket.
    pub answers: mpsc::UnboundedReceiver<StoreAnswer>,
}

#[derive(Debug)]
struct Shared {
    inner: Mutex<Inner>,
    changed: Condvar,
    answers: mpsc::UnboundedSender<StoreAnswer>,
}

#[derive(Debug, Default)]
struct Inner {
    rows: BTreeMap<Path, StopRow>,
    tickets: Vec<Ticket>,
    changed: bool,
    closing: bool,
    ended: bool,
}

impl StopFile {
    /// Opens the file of a configuration in a directory; `name` tells the configurations apart that share it. Blocks.
    ///
    /// # Errors
    /// A directory that cannot be used. A file that cannot be read is no error: then all is stopped.
    pub fn open(directory: &FilePath, name: &str) -> Result<KeptStops, StoreError> {
        let failed = |error| StoreError::State {
            path: directory.to_owned(),
            error,
        };
        make_directory(directory).map_err(failed)?;
        let (path, lock) = own(directory, name).map_err(failed)?;
        let read = read(&path, Some(&lock)).and_then(|rows| with_others(rows, directory, name, &path));
        let (rows, unread) = match read {
            Ok(rows) => (rows, None),
            Err(reason) => {
                // Kept for whoever looks for the cause; the next write makes a new one.
                let damaged = path.with_extension("damaged");
                let copy = fs::copy(&path, &damaged).ok().map(|_| damaged.display());
                tracing::error!(
                    file = %path.display(), reason, copy = copy.map(tracing::field::display),
                    "what was stopped cannot be read: all devices are stopped until somebody unstops them"
                );
                (BTreeMap::new(), Some(reason))
            }
        };
        let records = rows.values().cloned().map(StopRow::record);
        let (records, unread) = match records.collect::<Result<Vec<_>, _>>() {
            Ok(records) => (records, unread),
            Err(reason) => (Vec::new(), Some(reason)),
        };
        if unread.is_none() {
            let all: Vec<StopRow> = rows.values().cloned().collect();
            begin(&path, &lock, &all).map_err(failed)?;
            forget_others(directory, name, &path).map_err(failed)?;
        }
        let (answers, received) = mpsc::unbounded_channel();
        let shared = Arc::new(Shared {
            inner: Mutex::new(Inner {
                rows,
                ..Inner::default()
            }),
            changed: Condvar::new(),
            answers,
        });
        let file = StopFile {
            shared: Arc::clone(&shared),
        };
        let writer = thread::Builder::new().name("stops".to_owned());
        writer.spawn(move || run(&shared, &path, &lock)).map_err(failed)?;
        Ok(KeptStops {
            file,
            records,
            unread,
            answers: received,
        })
    }

    /// Takes in what holds in a channel; it never waits. With a ticket there is one answer, when this or something newer is
    /// kept, or will never be.
    pub fn keep(&self, record: &StopRecord, ticket: Option<Ticket>) {
        let row = StopRow::from(record);
        let mut inner = self.shared.inner.lock();
        if inner.closing {
            drop(inner);
            return self.shared.answer(ticket.into_iter().collect(), false);
        }
        // What was never stopped says as much as no row.
        if record.latch == mom_hub::Latch::default() {
            inner.changed |= inner.rows.remove(&record.path).is_some();
        } else if inner.rows.get(&record.path) != Some(&row) {
            inner.rows.insert(record.path.clone(), row);
            inner.changed = true;
        }
        inner.tickets.extend(ticket);
        drop(inner);
        self.shared.changed.notify_all();
    }

    /// Takes no more and writes what waits. Blocks.
    pub fn close(&self) {
        let mut inner = self.shared.inner.lock();
        inner.closing = true;
        self.shared.changed.notify_all();
        while !inner.ended {
            self.shared.changed.wait(&mut inner);
        }
    }
}

impl Drop for StopFile {
    fn drop(&mut self) {
        self.shared.inner.lock().closing = true;
        self.shared.changed.notify_all();
    }
}

impl Shared {
    fn answer(&self, tickets: Vec<Ticket>, ok: bool) {
        for ticket in tickets {
            // Nobody listens any more when the broker has ended.
            let _ = self.answers.send((ticket, ok));
        }
    }
}

/// Writes whenever something has changed, until the end.
fn run(shared: &Shared, path: &FilePath, lock: &File) {
    loop {
        let mut inner = shared.inner.lock();
        while !inner.changed && inner.tickets.is_empty() && !inner.closing {
            shared.changed.wait(&mut inner);
        }
        if !inner.changed && inner.tickets.is_empty() {
            inner.ended = true;
            drop(inner);
            // Closing would do, but for a process that is just being made and has all files of this one.
            let _ = lock.unlock();
            shared.changed.notify_all();
            return;
        }
        let tickets = std::mem::take(&mut inner.tickets);
        let rows =
            std::mem::take(&mut inner.changed).then(|| inner.rows.values().cloned().collect::<Vec<_>>());
        drop(inner);
        let written = rows.map_or(Ok(()), |rows| write(path, &rows));
        if let Err(error) = &written {
            tracing::error!(
                file = %path.display(), %error,
                "what is stopped cannot be kept: a restart may forget it, and no device is unstopped until it can"
            );
            // The next one tries again with all of it.
            shared.inner.lock().changed = true;
        }
        shared.answer(tickets, written.is_ok());
        if written.is_err() && shared.waits() {
            return;
        }
    }
}

impl Shared {
    /// After a failure: waits until there is something else to write; true at the end.
    fn waits(&self) -> bool {
        let mut inner = self.inner.lock();
        while inner.tickets.is_empty() && !inner.closing {
            self.changed.wait(&mut inner);
        }
        let ends = inner.closing;
        inner.ended |= ends;
        drop(inner);
        self.changed.notify_all();
        ends
    }
}

/// The files of a name, one for each broker that may run at once.
fn all(directory: &FilePath, name: &str) -> impl Iterator<Item = PathBuf> {
    (1..=BESIDE).map(move |number| match number {
        1 => directory.join(format!("{name}.json")),
        _ => directory.join(format!("{name}-{number}.json")),
    })
}

/// What was kept, with what others of the name have kept: a broker that begins while the one before it still ends knows what was
/// stopped there, and so does the next one of both. Of two that differ the newer counts, of two of one number what is stopped.
fn with_others(
    mut rows: BTreeMap<Path, StopRow>,
    directory: &FilePath,
    name: &str,
    own: &FilePath,
) -> Result<BTreeMap<Path, StopRow>, String> {
    for other in all(directory, name).filter(|other| other != own) {
        let theirs = read(&other, None).map_err(|reason| {
            set_aside(&other);
            format!("{}: {reason}", other.display())
        })?;
        for (path, row) in theirs {
            let counts = |known: &StopRow| (known.newest(), known.is_stopped());
            match rows.get(&path) {
                Some(known) if counts(known) >= counts(&row) => {}
                _ => drop(rows.insert(path, row)),
            }
        }
    }
    Ok(rows)
}

/// Keeps a damaged file that nobody uses for whoever looks for the cause.
fn set_aside(path: &FilePath) {
    let lock = options().open(path.with_extension("lock"));
    if lock.is_ok_and(|lock| lock.try_lock().is_ok()) {
        let _ = fs::rename(path, path.with_extension("damaged"));
    }
}

/// Removes the files of brokers that have ended, once all that they keep is kept here.
fn forget_others(directory: &FilePath, name: &str, own: &FilePath) -> io::Result<()> {
    for other in all(directory, name).filter(|other| other != own) {
        if !other.try_exists()? {
            continue;
        }
        let lock = options().open(other.with_extension("lock"))?;
        if lock.try_lock().is_ok() {
            lock.set_len(0)?;
            fs::remove_file(&other)?;
        }
    }
    Ok(())
}

/// The first file of this name that no other broker uses.
fn own(directory: &FilePath, name: &str) -> io::Result<(PathBuf, File)> {
    for (number, path) in (1..).zip(all(directory, name)) {
        let lock = options().open(path.with_extension("lock"))?;
        match lock.try_lock() {
            Ok(()) => {
                if number > 1 {
                    tracing::warn!(
                        file = %path.display(),
                        "another broker of this configuration runs here: what is stopped from now on is kept apart"
                    );
                }
                return Ok((path, lock));
            }
            Err(TryLockError::WouldBlock) => {}
            Err(TryLockError::Error(error)) => return Err(error),
        }
    }
    Err(io::Error::other(format!(
        "{BESIDE} brokers of this configuration keep their stops here; give this one a state directory of its own"
    )))
}

/// Writes the file, and marks in its lock that it is there from now on.
fn begin(path: &FilePath, mut lock: &File, rows: &[StopRow]) -> io::Result<()> {
    write(path, rows)?;
    if lock.metadata()?.len() == 0 {
        lock.write_all(b"kept\n")?;
        lock.sync_all()?;
    }
    Ok(())
}

/// What the file keeps; its lock tells one that was deleted from one that never was.
fn read(path: &FilePath, lock: Option<&File>) -> Result<BTreeMap<Path, StopRow>, String> {
    let text = match fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return match lock.map(|lock| lock.metadata().map(|lock| lock.len())) {
                None | Some(Ok(0)) => Ok(BTreeMap::new()),
                Some(Ok(_)) => Err("it is gone".to_owned()),
                Some(Err(error)) => Err(error.to_string()),
            };
        }
        Err(error) => return Err(error.to_string()),
    };
    let (head, body) = text.split_once('\n').ok_or("it is cut")?;
    let sum = head.strip_prefix(FORM).map(str::trim);
    if sum != Some(&sum_of(body)) {
        return Err("its sum is wrong: something changed it, or it is cut".to_owned());
    }
    let rows: Vec<StopRow> = serde_json::from_str(body).map_err(|error| error.to_string())?;
    let rows = rows.into_iter().map(|row| Ok((row.clone().record()?.path, row)));
    rows.collect()
}

fn write(path: &FilePath, rows: &[StopRow]) -> io::Result<()> {
    let body = serde_json::to_string_pretty(rows).map_err(io::Error::other)?;
    let new = path.with_extension("new");
    let mut file = options().truncate(true).open(&new)?;
    write!(file, "{FORM} {}\n{body}", sum_of(&body))?;
    file.sync_all()?;
    fs::rename(&new, path)?;
    sync(path.parent().unwrap_or(FilePath::new(".")))
}

fn sum_of(body: &str) -> String {
    format!("{:08x}", crc32fast::hash(body.as_bytes()))
}

fn options() -> OpenOptions {
    let mut options = OpenOptions::new();
    options.write(true).create(true).truncate(false).mode(0o600);
    options
}
