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
    /// A directory that cannot be used. A file that cannot be read is not an error: then all is stopped.
    pub fn open(directory: &FilePath, name: &str) -> Result<KeptStops, StoreError> {
        let failed = |error| StoreError::State {
            path: directory.to_owned(),
            error,
        };
        make_directory(directory).map_err(failed)?;
        let (path, lock) = own(directory, name).map_err(failed)?;
        let others = Others::of(directory, name, &path);
        let mut unread = None;
        let mut records = read(&path, Some(&lock)).unwrap_or_else(|reason| {
            // Kept for finding the cause; the next write makes a new one.
            let damaged = path.with_extension("damaged");
            let copy = fs::copy(&path, &damaged).ok().map(|_| damaged.display());
            tracing::error!(
                file = %path.display(), reason, copy = copy.map(tracing::field::display),
                "what was stopped cannot be read: all devices are stopped until they are unstopped"
            );
            unread = Some(reason);
            BTreeMap::new()
        });
        for (other, reason) in others.join(&mut records) {
            tracing::error!(
                file = %other.display(), reason,
                "what was stopped in another broker cannot be read: all devices are stopped until they are unstopped"
            );
            unread = unread.or(Some(format!("{}: {reason}", other.display())));
        }
        if unread.is_some() {
            // What is free here may have been stopped there.
            records.retain(|_, record| record.latch.is_stopped());
        }
        let rows: BTreeMap<Path, StopRow> = records
            .values()
            .map(|record| (record.path.clone(), StopRow::from(record)))
            .collect();
        let mut aside = Some(others);
        if unread.is_none() {
            let all: Vec<StopRow> = rows.values().cloned().collect();
            begin(&path, &lock, &all).map_err(failed)?;
            aside.take().into_iter().for_each(Others::forget);
        }
        let records = records.into_values().collect();
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
        writer
            .spawn(move || run(&shared, &path, &lock, aside))
            .map_err(failed)?;
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
fn run(shared: &Shared, path: &FilePath, lock: &File, mut aside: Option<Others>) {
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
        let written = rows.map_or(Ok(()), |rows| begin(path, lock, &rows));
        if written.is_ok() {
            aside.take().into_iter().for_each(Others::forget);
        }
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

/// The files that other brokers of a configuration have kept, with the locks of those that have ended. A broker that begins while the
/// one before it still ends knows what was stopped there, and so does the next one of both.
struct Others {
    files: Vec<(PathBuf, Option<File>)>,
}

impl Others {
    fn of(directory: &FilePath, name: &str, own: &FilePath) -> Others {
        let others = all(directory, name).filter(|other| other != own && other.exists());
        // Locked before they are read: what is still written is not removed.
        let lock = |path: &FilePath| {
            let lock = options().open(path.with_extension("lock")).ok()?;
            lock.try_lock().is_ok().then_some(lock)
        };
        let files = others.map(|path| {
            let lock = lock(&path);
            (path, lock)
        });
        Others {
            files: files.collect(),
        }
    }

    /// Whatever holds in one of them holds. Gives those that cannot be read, and why.
    fn join(&self, records: &mut BTreeMap<Path, StopRecord>) -> Vec<(PathBuf, String)> {
        let mut unread = Vec::new();
        for (file, _) in &self.files {
            match read(file, None) {
                Ok(theirs) => theirs.into_values().for_each(|theirs| {
                    let empty = StopRecord {
                        path: theirs.path.clone(),
                        latch: mom_hub::Latch::default(),
                    };
                    let own = records.entry(theirs.path.clone()).or_insert(empty);
                    own.latch.join(&theirs.latch);
                }),
                Err(reason) => unread.push((file.clone(), reason)),
            }
        }
        unread
    }

    /// Removes those of brokers that have ended, once all that they keep is kept here; a damaged one is kept, so that the cause
    /// can be found.
    fn forget(self) {
        for (file, lock) in &self.files {
            let Some(lock) = lock else { continue };
            let gone = lock.set_len(0).and_then(|()| match read(file, None) {
                Ok(_) => fs::remove_file(file),
                Err(_) => fs::rename(file, file.with_extension("damaged")),
            });
            if let Err(error) = gone {
                tracing::warn!(file = %file.display(), %error, "it is kept here, and cannot be removed there");
            }
        }
    }
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
fn read(path: &FilePath, lock: Option<&File>) -> Result<BTreeMap<Path, StopRecord>, String> {
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
        return Err("its checksum is wrong: it was modified or truncated".to_owned());
    }
    let rows: Vec<StopRow> = serde_json::from_str(body).map_err(|error| error.to_string())?;
    let records = rows.into_iter().map(StopRow::record);
    let records = records.map(|record| record.map(|record| (record.path.clone(), record)));
    records.collect()
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
