//! The way out to one peer: a bounded queue and the writer that empties it.
//!
//! Whoever puts parcels in also tries to write them, in the same turn: on an idle link that saves waking a
//! task, which costs more than the write. What the link does not take at once is the writer's.

mod packet;
mod queue;
mod room;

use std::cell::Cell;
use std::collections::VecDeque;
use std::sync::Arc;

use mom_hub::PeerId;
use mom_managers::Micros;
use mom_net::{Flow, GATHER, NetError, Pause, Writer};
use mom_proto::codec::Form;
use mom_proto::{ContextNumber, Limit, WireError};

use packet::Piece;
pub(crate) use packet::{DropReason, Dropped, Gate, Lane, Origin, Packet};
pub(crate) use queue::{Queue, Taken};
pub(crate) use room::Place;

use mom_system::Clock;
use mom_system::sync::atomic::{AtomicBool, Ordering, fence};
use mom_system::sync::{Mutex, MutexGuard, Notify};

/// Taken from the queue at once: more than a system call gathers is no faster, and what is taken cannot be
/// overtaken any more.
const BATCH_PIECES: usize = 256;
const BATCH_BYTES: usize = 256 * 1024;

/// The outbox of one connection.
#[derive(Debug)]
pub(crate) struct Outbox {
    pub(crate) peer: PeerId,
    name: Mutex<Arc<str>>,
    clock: Clock,
    queue: Mutex<Queue>,
    writer: Writer,
    /// Held by whoever writes.
    sending: Mutex<Sending>,
    /// Something waits that nobody has tried to write yet.
    touched: AtomicBool,
    /// Senders wait for room.
    awaited: AtomicBool,
    wake: Notify,
    closing: Mutex<Option<Closing>>,
    closed: AtomicBool,
    pub(crate) end: Notify,
    /// Something was written since the heartbeat last looked.
    pub(crate) active: AtomicBool,
    /// Something was read since the heartbeat last looked.
    pub(crate) heard: AtomicBool,
}

/// The writer's part.
#[derive(Debug, Default)]
struct Sending {
    /// What the link has taken a part of. Boxed, for most of the time there is none.
    begun: Option<Box<Piece>>,
    flow: Flow,
}

thread_local! {
    /// What a writer takes from a queue: used within a turn only, so that idle connections need no memory for it.
    static BATCH: Cell<VecDeque<Piece>> = const { Cell::new(VecDeque::new()) };
}

/// How far a flush came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Flushed {
    /// All is written.
    Done,
    /// The link takes no more now.
    Blocked,
    /// The network holds as much as it may.
    Paced,
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
            queue: Mutex::new(Queue::new(writer.form(), limit)),
            writer,
            sending: Mutex::new(Sending::default()),
            touched: AtomicBool::new(false),
            awaited: AtomicBool::new(false),
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

    /// Puts a packet in. True the first time since the last [`Outbox::flush`], and for what is urgent: then somebody has
    /// to call it.
    pub(crate) fn push(&self, packet: Arc<Packet>) -> (Taken, bool) {
        let mut queue = self.queue.lock();
        // Under the lock that `close` holds: nothing follows the last word.
        if self.closed.load(Ordering::Acquire) {
            return (Taken::Dropped, false);
        }
        let urgent = packet.lane > Lane::Data(0);
        let taken = queue.push(packet);
        drop(queue);
        // Whoever touched it before may take its time, which nothing urgent has.
        let first = !self.touched.swap(true, Ordering::SeqCst) || urgent;
        // Pairs with the fence in `flush_batch`: either that flush sees this parcel, or this one gets the lock.
        fence(Ordering::SeqCst);
        (taken, first)
    }

    /// As [`Outbox::push`], for a receiver that wants the newest of each sender and name only, and one in `interval` µs
    /// at most. What has to wait for its turn leaves by itself when that comes.
    pub(crate) fn push_thinned(&self, packet: Arc<Packet>, interval: Micros) -> (Taken, bool) {
        let now = self.clock.now();
        let mut queue = self.queue.lock();
        if self.closed.load(Ordering::Acquire) {
            return (Taken::Dropped, false);
        }
        let before = queue.due();
        let taken = queue.push_thinned(packet, interval, now);
        let sooner = queue
            .due()
            .is_some_and(|due| before.is_none_or(|before| due < before));
        drop(queue);
        if sooner {
            self.wake.notify_one();
        }
        if taken == Taken::Later {
            return (taken, false);
        }
        let first = !self.touched.swap(true, Ordering::SeqCst);
        // As in `push`.
        fence(Ordering::SeqCst);
        (taken, first)
    }

    /// Ends the turns of a channel; what waited for them goes now if the peer still hears it, and else not at all.
    pub(crate) fn end_turns(&self, channel: ContextNumber, hears: bool) {
        let mut queue = self.queue.lock();
        match hears {
            true => queue.hand_out_turns(channel),
            false => queue.drop_turns(Some(channel)),
        }
        drop(queue);
        self.wake.notify_one();
    }

    /// Writes what waits as far as the link takes it, and leaves the rest to the writer.
    pub(crate) fn flush(&self) {
        match self.try_flush() {
            Ok(Flushed::Done) => {}
            Ok(Flushed::Blocked | Flushed::Paced) => self.wake.notify_one(),
            Err(error) => self.broken(&error),
        }
    }

    /// Ends the connection: nothing more is taken in; what waits still goes out if `drain` says so, the error in
    /// any case, last.
    pub(crate) fn close(&self, error: Option<WireError>, farewell: Option<Arc<Packet>>, drain: bool) {
        let mut queue = self.queue.lock();
        if self.closed.swap(true, Ordering::AcqRel) {
            return;
        }
        if !drain {
            queue.drop_data();
        }
        if let Some(packet) = farewell {
            queue.push_farewell(packet);
        }
        drop(queue);
        *self.closing.lock() = Some(Closing { error });
        self.touched.store(true, Ordering::Release);
        self.wake.notify_one();
        self.end.notify_one();
        self.call_all();
    }

    /// Changes the bounds, of what waits and of one parcel, and notes the peer's name, as after login.
    pub(crate) fn admit(&self, limit: usize, parcel: Limit, name: Arc<str>) {
        self.queue.lock().set_limits(limit, parcel);
        *self.name.lock() = name;
    }

    /// The peer's name, empty before login; it is known here also when the hub has forgotten the peer.
    pub(crate) fn name(&self) -> Arc<str> {
        Arc::clone(&self.name.lock())
    }

    /// Gives up what still waits, for an end at which nobody takes it any more.
    pub(crate) fn abandon(&self) {
        self.queue.lock().drop_data();
        self.call_all();
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
    pub(crate) fn take_drops(&self) -> Vec<(Dropped, u64)> {
        let mut queue = self.queue.lock();
        match queue.has_drops() {
            true => queue.take_drops().into_iter().collect(),
            false => Vec::new(),
        }
    }

    /// The writer: writes whenever the link takes more, until the end.
    pub(crate) async fn run(&self) {
        loop {
            self.woken().await;
            // Asked before the last flush: what was to go out is in the queue by then.
            let ends = self.closing().is_some();
            let flushed = match self.flush_after_others() {
                Ok(Flushed::Done) => Ok(()),
                // Most links are never full: the others need no room for what waits for them.
                Ok(flushed) => Box::pin(self.write_on(flushed)).await,
                Err(error) => Err(error),
            };
            if let Err(error) = flushed {
                return self.broken(&error);
            }
            if ends {
                self.writer.finish();
                return;
            }
        }
    }

    /// Writes on where a flush came no further, until all is written.
    async fn write_on(&self, mut flushed: Flushed) -> Result<(), NetError> {
        let mut pause = Pause::default();
        loop {
            match flushed {
                Flushed::Done => return Ok(()),
                Flushed::Blocked => self.writer.ready().await?,
                Flushed::Paced => {
                    tokio::time::sleep(pause.time()).await;
                    pause.look(&self.sending.lock().flow);
                }
            }
            flushed = self.flush_after_others()?;
        }
    }

    /// Waits until there is something to write: somebody says so, or a turn comes.
    async fn woken(&self) {
        let Some(due) = self.queue.lock().due() else {
            return self.wake.notified().await;
        };
        // Few peers want a rate: the others need no room for a timer.
        let woken = async {
            tokio::select! {
                () = self.wake.notified() => {}
                () = self.clock.reach(due) => {}
            }
        };
        Box::pin(woken).await;
    }

    fn try_flush(&self) -> Result<Flushed, NetError> {
        loop {
            // Whoever is writing looks at `touched` again after letting go, so nothing is forgotten.
            let Some(sending) = self.sending.try_lock() else {
                return Ok(Flushed::Done);
            };
            if let Some(flushed) = self.flush_once(sending)? {
                return Ok(flushed);
            }
        }
    }

    /// Waits for whoever is writing now, who never waits for the link: when this says done, all is written.
    fn flush_after_others(&self) -> Result<Flushed, NetError> {
        loop {
            if let Some(flushed) = self.flush_once(self.sending.lock())? {
                return Ok(flushed);
            }
        }
    }

    /// Writes what waits; none if there is more by now.
    fn flush_once(&self, mut sending: MutexGuard<'_, Sending>) -> Result<Option<Flushed>, NetError> {
        self.touched.store(false, Ordering::Release);
        let flushed = self.write_all(&mut sending)?;
        drop(sending);
        self.call_next();
        fence(Ordering::SeqCst);
        let settled = flushed != Flushed::Done || !self.touched.load(Ordering::Acquire);
        Ok(settled.then_some(flushed))
    }

    fn write_all(&self, sending: &mut Sending) -> Result<Flushed, NetError> {
        let mut batch = BATCH.take();
        batch.extend(sending.begun.take().map(|piece| *piece));
        let result = self.write_batches(&mut batch, &mut sending.flow);
        self.put_back(&mut batch, sending);
        BATCH.set(batch);
        result
    }

    fn write_batches(&self, batch: &mut VecDeque<Piece>, flow: &mut Flow) -> Result<Flushed, NetError> {
        loop {
            if batch.is_empty() {
                // All that was taken has left, so its room is real.
                self.call_next();
            }
            if batch.is_empty() && !self.take_batch(batch, flow) {
                return Ok(Flushed::Paced);
            }
            if batch.is_empty() {
                flow.rest();
                return Ok(Flushed::Done);
            }
            self.active.store(true, Ordering::Relaxed);
            if !self.write(batch, flow)? {
                return Ok(Flushed::Blocked);
            }
        }
    }

    /// Takes what the network has room for; false if something waits and there is no room.
    fn take_batch(&self, batch: &mut VecDeque<Piece>, flow: &mut Flow) -> bool {
        let room = flow.room(|| self.writer.link()).min(BATCH_BYTES);
        let piece = flow.piece();
        let now = self.clock.now();
        let mut queue = self.queue.lock();
        queue.take_turns(now);
        let mut bytes = 0;
        while batch.len() < BATCH_PIECES {
            let next = match room.checked_sub(bytes) {
                // Pieces rather a little too large than very small ones.
                Some(left) if left > 0 => queue.pop(now, piece.min(left.max(piece / 2))),
                _ => queue.pop_urgent(),
            };
            let Some(next) = next else { break };
            bytes += next.length();
            batch.push_back(next);
        }
        !batch.is_empty() || queue.is_empty()
    }

    /// Writes from the front of the batch; false if the link takes nothing now.
    fn write(&self, batch: &mut VecDeque<Piece>, flow: &mut Flow) -> Result<bool, NetError> {
        let Some(form) = self.writer.form() else {
            return self.pass(batch);
        };
        let mut slices = Vec::with_capacity(GATHER.min(batch.len() * 2 + 1));
        for piece in batch.iter() {
            if slices.len() + 3 > GATHER {
                break;
            }
            piece.append_to(Some(form), &mut slices);
        }
        let Some(mut written) = self.writer.try_write_pieces(&slices)? else {
            return Ok(false);
        };
        flow.wrote(written);
        while let Some(front) = batch.front_mut() {
            written = front.part.advance(written);
            if front.length() > 0 {
                break;
            }
            batch.pop_front();
        }
        Ok(true)
    }

    /// Passes parcels to a peer in this process.
    fn pass(&self, batch: &mut VecDeque<Piece>) -> Result<bool, NetError> {
        while let Some(front) = batch.front() {
            if let Some(parcel) = front.parcel()
                && !self.writer.try_pass(parcel)?
            {
                return Ok(false);
            }
            batch.pop_front();
        }
        Ok(true)
    }

    /// Only what the link has begun to take stays out of the queue: the rest may be overtaken, replaced, or
    /// lose its owner before the link takes more.
    fn put_back(&self, batch: &mut VecDeque<Piece>, sending: &mut Sending) {
        let Some(first) = batch.front() else {
            return;
        };
        if first.part.is_begun() {
            sending.begun = batch.pop_front().map(Box::new);
        }
        let mut queue = self.queue.lock();
        while let Some(piece) = batch.pop_back() {
            queue.put_back(piece);
        }
    }

    fn broken(&self, error: &NetError) {
        tracing::debug!(peer = self.peer.0, %error, "link failed");
        self.close(None, None, false);
    }
}
