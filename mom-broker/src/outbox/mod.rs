//! The way out to one peer: a bounded queue and the writer that empties it.
//!
//! Whoever puts parcels in also tries to write them, in the same turn: on an idle link that saves waking a
//! task, which costs more than the write. What the link does not take at once is the writer task's.

mod entry;
mod queue;

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering, fence};

use mom_hub::PeerId;
use mom_net::{NetError, Progress, Writer};
use mom_proto::WireError;
use mom_proto::codec::Form;
use parking_lot::{Mutex, MutexGuard};
use tokio::sync::Notify;

pub(crate) use entry::{DropReason, Entry, Gate, Lane, Origin};
pub(crate) use queue::{Queue, Taken};

use crate::clock::Clock;

/// Taken from the queue at once: more than a system call gathers is no faster, and what is taken cannot be
/// overtaken any more.
const BATCH_PARCELS: usize = 256;
const BATCH_BYTES: usize = 64 * 1024;

/// The outbox of one connection.
#[derive(Debug)]
pub(crate) struct Outbox {
    pub(crate) peer: PeerId,
    name: Mutex<Arc<str>>,
    clock: Clock,
    queue: Mutex<Queue>,
    writer: Writer,
    /// Held by whoever writes; what was taken from the queue and is not written yet.
    batch: Mutex<VecDeque<Entry>>,
    /// Something waits that nobody has tried to write yet.
    touched: AtomicBool,
    wake: Notify,
    closing: Mutex<Option<Closing>>,
    closed: AtomicBool,
    pub(crate) end: Notify,
    /// Something was written since the heartbeat last looked.
    pub(crate) active: AtomicBool,
    /// Something was read since the heartbeat last looked.
    pub(crate) heard: AtomicBool,
}

/// Why a connection ends.
#[derive(Clone, Debug)]
pub(crate) struct Closing {
    pub(crate) error: Option<WireError>,
}

impl Outbox {
    pub(crate) fn new(peer: PeerId, clock: Clock, writer: Writer, limit: usize) -> Outbox {
        Outbox {
            peer,
            name: Mutex::new("".into()),
            clock,
            queue: Mutex::new(Queue::new(limit)),
            writer,
            batch: Mutex::new(VecDeque::new()),
            touched: AtomicBool::new(false),
            wake: Notify::new(),
            closing: Mutex::new(None),
            closed: AtomicBool::new(false),
            end: Notify::new(),
            active: AtomicBool::new(false),
            heard: AtomicBool::new(false),
        }
    }

    /// The wire form, none for a peer in this process.
    pub(crate) fn form(&self) -> Option<Form> {
        self.writer.form()
    }

    /// Puts a parcel in. True the first time since the last [`Outbox::flush`]: then somebody has to call it.
    pub(crate) fn push(&self, entry: Entry) -> (Taken, bool) {
        if self.closed.load(Ordering::Acquire) {
            return (Taken::Dropped, false);
        }
        let taken = self.queue.lock().push(entry);
        let first = !self.touched.swap(true, Ordering::SeqCst);
        // Pairs with the fence in `flush_batch`: either that flush sees this parcel, or this one gets the lock.
        fence(Ordering::SeqCst);
        (taken, first)
    }

    /// Writes what waits as far as the link takes it, and leaves the rest to the writer task.
    pub(crate) fn flush(&self) {
        match self.try_flush() {
            Ok(Progress::Done) => {}
            Ok(Progress::Blocked) => self.wake.notify_one(),
            Err(error) => self.broken(&error),
        }
    }

    /// Ends the connection: nothing more is taken in; what waits still goes out if `drain` says so, the error in
    /// any case, last.
    pub(crate) fn close(&self, error: Option<WireError>, farewell: Option<Entry>, drain: bool) {
        if self.closed.swap(true, Ordering::AcqRel) {
            return;
        }
        let mut queue = self.queue.lock();
        if !drain {
            queue.drop_data();
        }
        if let Some(entry) = farewell {
            queue.push_farewell(entry);
        }
        drop(queue);
        *self.closing.lock() = Some(Closing { error });
        self.touched.store(true, Ordering::Release);
        self.wake.notify_one();
        self.end.notify_one();
    }

    /// Changes the bound and notes the peer's name, as after login.
    pub(crate) fn admit(&self, limit: usize, name: Arc<str>) {
        self.queue.lock().set_limit(limit);
        *self.name.lock() = name;
    }

    /// The peer's name, empty before login; it is known here also when the hub has forgotten the peer.
    pub(crate) fn name(&self) -> Arc<str> {
        Arc::clone(&self.name.lock())
    }

    /// Gives up what still waits, for an end at which nobody takes it any more.
    pub(crate) fn abandon(&self) {
        self.queue.lock().drop_data();
    }

    /// Whether the connection is to end.
    pub(crate) fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }

    /// Why the connection ends, once it does.
    pub(crate) fn closing(&self) -> Option<Closing> {
        self.closing.lock().clone()
    }

    /// The bytes that wait.
    pub(crate) fn queued(&self) -> usize {
        self.queue.lock().bytes()
    }

    /// What was dropped since the last call; cheap where nothing was.
    pub(crate) fn take_drops(&self) -> Vec<((mom_proto::ContextNumber, PeerId, DropReason), u64)> {
        let mut queue = self.queue.lock();
        match queue.has_drops() {
            true => queue.take_drops().into_iter().collect(),
            false => Vec::new(),
        }
    }

    /// The writer task: writes whenever the link takes more, until the end.
    pub(crate) async fn run(&self) {
        loop {
            self.wake.notified().await;
            // Asked before the last flush: what was to go out is in the queue by then.
            let ends = self.closing().is_some();
            loop {
                match self.flush_after_others() {
                    Ok(Progress::Done) => break,
                    Ok(Progress::Blocked) => {
                        if let Err(error) = self.writer.ready().await {
                            return self.broken(&error);
                        }
                    }
                    Err(error) => return self.broken(&error),
                }
            }
            if ends {
                self.writer.finish();
                return;
            }
        }
    }

    fn try_flush(&self) -> Result<Progress, NetError> {
        loop {
            // Whoever holds the batch looks at `touched` again after letting go, so nothing is forgotten.
            let Some(batch) = self.batch.try_lock() else {
                return Ok(Progress::Done);
            };
            if let Some(progress) = self.flush_batch(batch)? {
                return Ok(progress);
            }
        }
    }

    /// Waits for whoever is writing now, who never waits for the link: when this says done, all is written.
    fn flush_after_others(&self) -> Result<Progress, NetError> {
        loop {
            if let Some(progress) = self.flush_batch(self.batch.lock())? {
                return Ok(progress);
            }
        }
    }

    /// Writes what waits; none if there is more by now.
    fn flush_batch(&self, mut batch: MutexGuard<'_, VecDeque<Entry>>) -> Result<Option<Progress>, NetError> {
        self.touched.store(false, Ordering::Release);
        let progress = self.write_all(&mut batch)?;
        drop(batch);
        fence(Ordering::SeqCst);
        let settled = progress == Progress::Blocked || !self.touched.load(Ordering::Acquire);
        Ok(settled.then_some(progress))
    }

    fn write_all(&self, batch: &mut VecDeque<Entry>) -> Result<Progress, NetError> {
        loop {
            if batch.is_empty() {
                self.take_batch(batch);
            }
            if batch.is_empty() {
                return Ok(Progress::Done);
            }
            self.active.store(true, Ordering::Relaxed);
            if self.writer.try_write(batch)? == Progress::Blocked {
                self.put_back(batch);
                return Ok(Progress::Blocked);
            }
        }
    }

    fn take_batch(&self, batch: &mut VecDeque<Entry>) {
        let now = self.clock.now();
        let mut queue = self.queue.lock();
        let mut bytes = 0;
        while batch.len() < BATCH_PARCELS && bytes < BATCH_BYTES {
            let Some(entry) = queue.pop(now) else { break };
            bytes += entry.frame.len();
            batch.push_back(entry);
        }
    }

    /// Only what the link has begun to take stays out of the queue: the rest may be overtaken, replaced, or
    /// lose its owner before the link takes more.
    fn put_back(&self, batch: &mut VecDeque<Entry>) {
        let begun = usize::from(batch.front().is_some_and(Entry::begun));
        let mut queue = self.queue.lock();
        while batch.len() > begun {
            if let Some(entry) = batch.pop_back() {
                queue.put_back(entry);
            }
        }
    }

    fn broken(&self, error: &NetError) {
        tracing::debug!(peer = self.peer.0, %error, "link failed");
        self.close(None, None, false);
    }
}
