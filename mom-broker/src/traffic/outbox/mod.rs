//! The way out to one peer: a bounded queue and the writer that empties it.
//!
//! A sender that puts parcels in also tries to write them, in the same turn: on an idle link that saves waking a
//! task, which costs more than the write. What the link does not take at once is the writer's.

mod figures;
mod foreign;
mod link;
mod packet;
mod queue;
mod waiter;

use std::cell::Cell;
use std::collections::VecDeque;
use std::ops::{Deref, DerefMut};
use std::sync::Arc;

use mom_hub::PeerId;
use mom_net::{Flow, Ledger, NetError, Pause, Piece, Rest, Taken, Writer, write_batch};
use mom_proto::codec::Form;
use mom_proto::{ContextNumber, Limits, Micros, WireError};

pub(crate) use figures::{Heard, LoginFacts, PeerStatistics};
pub(crate) use link::Paths;
pub(crate) use packet::{Charged, Dropped, Gate, Origin, Packet};
pub(crate) use queue::PeerQueue;
pub(crate) use waiter::WaiterHandle;

use link::LinkLedger;

use crate::traffic::encodings::Unready;
use crate::traffic::memory::Account;
use mom_system::Clock;
use mom_system::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering, fence};
use mom_system::sync::{Mutex, MutexGuard, Notify};

/// The outbox of one connection.
#[derive(Debug)]
pub(crate) struct Outbox {
    pub(crate) peer: PeerId,
    who: Mutex<Who>,
    clock: Clock,
    queue: Mutex<PeerQueue>,
    /// The wire form, as its place in [`FORMS`].
    form: AtomicU8,
    /// Held by the writing thread.
    way: Mutex<Way>,
    /// Something waits that nobody has tried to write yet.
    touched: AtomicBool,
    /// Senders wait for capacity.
    awaited: AtomicBool,
    wake: Notify,
    closed: AtomicBool,
    pub(crate) end: Notify,
    /// Something was written since the heartbeat last looked.
    pub(crate) active: AtomicBool,
    pub(crate) heard: Heard,
    /// When a thread has come to its connection, µs.
    pub(crate) slice_began: AtomicU64,
}

/// The connection that an outbox writes to.
#[derive(Debug)]
struct Way {
    /// None while it is lost.
    writer: Option<Arc<Writer>>,
    flow: Flow,
    /// Where the connection can be resumed.
    link: Option<Box<LinkLedger>>,
}

/// The forms that a peer may speak, none inside this process.
const FORMS: [Option<Form>; 5] = [
    None,
    Some(Form::Xml),
    Some(Form::Binary),
    Some(Form::Json),
    Some(Form::Packed),
];

fn place_of(form: Option<Form>) -> u8 {
    match form {
        None => 0,
        Some(Form::Xml) => 1,
        Some(Form::Binary) => 2,
        Some(Form::Json) => 3,
        Some(Form::Packed) => 4,
    }
}

thread_local! {
    /// What a writer takes from a queue: used within a turn only, so that idle connections need no memory for it.
    static BATCH: Cell<VecDeque<Piece<Packet>>> = const { Cell::new(VecDeque::new()) };
}

/// Whose connection it is.
#[derive(Debug)]
struct Who {
    /// Empty before login.
    name: Arc<str>,
    account: Option<Arc<Account>>,
    login: Option<Box<LoginFacts>>,
    /// Why it ends, once it does.
    closing: Option<Box<Closing>>,
}

impl Default for Who {
    fn default() -> Who {
        Who {
            name: "".into(),
            account: None,
            login: None,
            closing: None,
        }
    }
}

/// How far a flush came.
#[derive(Debug)]
enum Flushed {
    /// All is written.
    Done,
    /// What goes next is not ready.
    Unready(Arc<Packet>),
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

/// The way to the link while a task that does not write has it. Others that come to write meanwhile leave it to
/// that task: what they would have written is seen to when it is let go.
struct HeldWay<'a> {
    // Let go before the other is dropped.
    way: MutexGuard<'a, Way>,
    _after: AfterWay<'a>,
}

/// Looks for something left to write, when it is dropped.
struct AfterWay<'a>(&'a Outbox);

impl Deref for HeldWay<'_> {
    type Target = Way;

    fn deref(&self) -> &Way {
        &self.way
    }
}

impl DerefMut for HeldWay<'_> {
    fn deref_mut(&mut self) -> &mut Way {
        &mut self.way
    }
}

impl Drop for AfterWay<'_> {
    fn drop(&mut self) {
        fence(Ordering::SeqCst);
        if self.0.touched.load(Ordering::Acquire) {
            self.0.wake.notify_one();
        }
    }
}

impl Outbox {
    pub(crate) fn new(peer: PeerId, clock: Clock, writer: Writer, limit: usize) -> Outbox {
        Outbox {
            peer,
            who: Mutex::new(Who::default()),
            clock,
            queue: Mutex::new(PeerQueue::new(writer.form(), limit)),
            form: AtomicU8::new(place_of(writer.form())),
            way: Mutex::new(Way {
                writer: Some(Arc::new(writer)),
                flow: Flow::default(),
                link: None,
            }),
            touched: AtomicBool::new(false),
            awaited: AtomicBool::new(false),
            wake: Notify::new(),
            closed: AtomicBool::new(false),
            end: Notify::new(),
            active: AtomicBool::new(false),
            heard: Heard::default(),
            slice_began: AtomicU64::new(0),
        }
    }

    /// The wire form, none for a peer in this process.
    pub(crate) fn form(&self) -> Option<Form> {
        FORMS[usize::from(self.form.load(Ordering::Relaxed))]
    }

    /// Puts a packet in. True the first time since the last [`Outbox::flush`], and for what is urgent: then a task has
    /// to call it.
    pub(crate) fn push(&self, packet: Arc<Packet>) -> (Taken, bool) {
        let mut queue = self.queue.lock();
        // Under the lock that `close` holds: nothing follows the last word.
        if self.closed.load(Ordering::Acquire) {
            return (Taken::Dropped, false);
        }
        let urgent = packet.lane.is_urgent();
        let taken = queue.push(packet, &self.clock);
        drop(queue);
        // Earlier writers may take their time, which nothing urgent has.
        let first = !self.touched.swap(true, Ordering::SeqCst) || urgent;
        // Pairs with the fence in `flush_batch`: either that flush sees this parcel, or this one gets the lock.
        fence(Ordering::SeqCst);
        (taken, first)
    }

    /// As [`Outbox::push`], for what the hub tells a device of others: before commands as long as it is little, and
    /// else `behind` all messages.
    pub(crate) fn push_news(&self, packet: Arc<Packet>, behind: &Arc<Packet>) -> (Taken, bool) {
        let mut queue = self.queue.lock();
        if self.closed.load(Ordering::Acquire) {
            return (Taken::Dropped, false);
        }
        let taken = queue.push_news(packet, behind, &self.clock);
        drop(queue);
        let first = !self.touched.swap(true, Ordering::SeqCst);
        // As in `push`.
        fence(Ordering::SeqCst);
        (taken, first)
    }

    /// As [`Outbox::push`], for a receiver that wants the newest of each sender and name only, and one in `interval` µs
    /// at most. None: it waits for its time, and leaves by itself when that comes.
    pub(crate) fn push_thinned(&self, packet: Arc<Packet>, interval: Micros) -> (Option<Taken>, bool) {
        let now = self.clock.now();
        let mut queue = self.queue.lock();
        if self.closed.load(Ordering::Acquire) {
            return (Some(Taken::Dropped), false);
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
        if taken.is_none() {
            return (None, false);
        }
        let first = !self.touched.swap(true, Ordering::SeqCst);
        // As in `push`.
        fence(Ordering::SeqCst);
        (taken, first)
    }

    /// Ends the thinning of a channel; what it holds back goes now if the peer still hears it, and else not at all.
    pub(crate) fn end_thinning(&self, channel: ContextNumber, hears: bool) {
        let mut queue = self.queue.lock();
        let dropped = match hears {
            true => {
                queue.release_thinned(channel);
                Vec::new()
            }
            false => queue.drop_thinned(Some(channel)),
        };
        drop(queue);
        drop(dropped);
        self.wake.notify_one();
    }

    /// Its peer is a device from now on, wherever it is one, and reads so many bytes in a second, if that is known.
    pub(crate) fn note_device(&self, pace: Option<u32>) {
        self.queue.lock().note_device(pace);
    }

    /// Whether its peer is a device somewhere.
    pub(crate) fn is_device(&self) -> bool {
        self.queue.lock().is_device()
    }

    /// Writes what waits as far as the link takes it, and leaves the rest to the writer.
    pub(crate) fn flush(&self) {
        match self.try_flush() {
            Ok(Flushed::Done) => {}
            Ok(Flushed::Blocked | Flushed::Paced | Flushed::Unready(_)) => self.wake.notify_one(),
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
        let dropped = if drain { Vec::new() } else { queue.drop_data() };
        if let Some(packet) = farewell {
            queue.push_last(packet);
        }
        drop(queue);
        drop(dropped);
        self.who.lock().closing = Some(Box::new(Closing { error }));
        self.touched.store(true, Ordering::Release);
        self.wake.notify_one();
        self.end.notify_one();
        self.call_all();
    }

    /// Changes the bounds, and notes whose it is and how it has come, as after login.
    pub(crate) fn admit(&self, limits: &Limits, name: Arc<str>, account: Arc<Account>, login: LoginFacts) {
        self.queue.lock().set_limits(limits);
        let mut who = self.who.lock();
        (who.name, who.account) = (name, Some(account));
        who.login = Some(Box::new(login));
    }

    pub(crate) fn is_logged_in(&self) -> bool {
        self.who.lock().login.is_some()
    }

    /// What its peer's user has waiting here and elsewhere; none before login.
    pub(crate) fn account(&self) -> Option<Arc<Account>> {
        self.who.lock().account.clone()
    }

    /// Drops what waits and of which `goes` says so, for want of memory; gives its bytes.
    pub(crate) fn drop_for_memory(&self, goes: impl Fn(&Packet) -> bool) -> usize {
        let (dropped, freed) = self.queue.lock().drop_for_memory(goes);
        drop(dropped);
        self.call_next();
        freed
    }

    /// Notes that a thread has come to its connection.
    pub(crate) fn begin_slice(&self) {
        self.slice_began.store(self.clock.now(), Ordering::Relaxed);
    }

    /// The peer's name, empty before login; it is known here also when the hub has forgotten the peer.
    pub(crate) fn name(&self) -> Arc<str> {
        Arc::clone(&self.who.lock().name)
    }

    /// Gives up what still waits, for an end at which nobody takes it any more.
    pub(crate) fn abandon(&self) {
        let dropped = self.queue.lock().drop_data();
        drop(dropped);
        self.call_all();
    }

    /// Whether the connection is to end.
    pub(crate) fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }

    /// Why the connection ends, once it does.
    pub(crate) fn closing(&self) -> Option<Closing> {
        self.who.lock().closing.as_deref().cloned()
    }

    /// The bytes that wait.
    pub(crate) fn queued(&self) -> usize {
        self.queue.lock().bytes()
    }

    /// What was dropped since the last call; cheap where nothing was.
    pub(crate) fn take_drops(&self) -> Vec<(Dropped, u64)> {
        let drops = self.queue.lock().take_drops();
        drops.into_iter().collect()
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
                if let Some(writer) = self.writer() {
                    writer.finish();
                }
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
                Flushed::Blocked => match self.writer() {
                    Some(writer) => writer.ready().await?,
                    None => return Ok(()),
                },
                Flushed::Paced => {
                    tokio::time::sleep(pause.time()).await;
                    pause.look(&self.way().flow);
                }
                Flushed::Unready(packet) => self.make_ready(&packet).await,
            }
            // A link that is ready and takes nothing must not keep others from their turns.
            tokio::task::consume_budget().await;
            flushed = self.flush_after_others()?;
        }
    }

    /// Has a packet made ready that goes next, or looks again when something else is to be written.
    async fn make_ready(&self, packet: &Arc<Packet>) {
        match packet.encodings.unready(self.form()) {
            None => {}
            Some(Unready::Later(later)) => {
                tokio::select! {
                    () = later.write() => {}
                    () = self.wake.notified() => {}
                }
            }
            Some(Unready::Foreign) => {
                self.translate(packet);
                tokio::task::yield_now().await;
            }
            Some(Unready::Replay(replay)) => {
                let next = replay.step(self.form(), &self.clock, self.account().as_ref());
                self.queue.lock().replace_front(packet, next);
                // The same task reads what this peer says.
                tokio::task::yield_now().await;
            }
        }
    }

    /// Waits until there is something to write: it is woken, or a turn comes.
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

    /// The way to the link, for who writes nothing.
    fn way(&self) -> HeldWay<'_> {
        HeldWay {
            way: self.way.lock(),
            _after: AfterWay(self),
        }
    }

    fn try_flush(&self) -> Result<Flushed, NetError> {
        loop {
            // The holder looks at `touched` again after letting go, so nothing is forgotten.
            let Some(way) = self.way.try_lock() else {
                return Ok(Flushed::Done);
            };
            if let Some(flushed) = self.flush_once(way)? {
                return Ok(flushed);
            }
        }
    }

    /// Waits for the thread that is writing now, which never waits for the link: when this says done, all is written.
    fn flush_after_others(&self) -> Result<Flushed, NetError> {
        loop {
            if let Some(flushed) = self.flush_once(self.way.lock())? {
                return Ok(flushed);
            }
        }
    }

    /// Writes what waits; none if there is more by now.
    fn flush_once(&self, mut way: MutexGuard<'_, Way>) -> Result<Option<Flushed>, NetError> {
        self.touched.store(false, Ordering::Release);
        let flushed = self.write_all(&mut way)?;
        drop(way);
        self.call_next();
        fence(Ordering::SeqCst);
        let settled = !matches!(flushed, Flushed::Done) || !self.touched.load(Ordering::Acquire);
        Ok(settled.then_some(flushed))
    }

    fn write_all(&self, way: &mut Way) -> Result<Flushed, NetError> {
        let Way { writer, flow, link } = way;
        // All that waits does so until the peer has come back.
        let Some(writer) = writer else {
            return Ok(Flushed::Done);
        };
        let mut batch = BATCH.take();
        let ledger = link.as_mut().map(|link| &mut link.ledger);
        let result = self.write_batches(&mut batch, writer, flow, ledger);
        if !batch.is_empty() {
            // It may be overtaken, replaced, or lose its owner before the link takes more.
            self.queue.lock().put_back(&mut batch);
        }
        BATCH.set(batch);
        result
    }

    fn write_batches(
        &self,
        batch: &mut VecDeque<Piece<Packet>>,
        writer: &Writer,
        flow: &mut Flow,
        mut ledger: Option<&mut Ledger<Packet>>,
    ) -> Result<Flushed, NetError> {
        let form = self.form();
        loop {
            // All that was taken has left, so its capacity is real.
            self.call_next();
            let (allowance, now) = (flow.allowance(writer), self.clock.now());
            let rest = self.queue.lock().take(now, allowance, batch);
            match rest {
                Rest::None => {}
                Rest::NoRoom => return Ok(Flushed::Paced),
                Rest::Unready(packet) => return Ok(Flushed::Unready(packet)),
            }
            if batch.is_empty() {
                flow.rest();
                return Ok(Flushed::Done);
            }
            self.active.store(true, Ordering::Relaxed);
            let all = write_batch(writer, form, flow, batch, |piece| {
                if let Some(ledger) = &mut ledger {
                    ledger.note(piece, form);
                }
            })?;
            if !all {
                return Ok(Flushed::Blocked);
            }
        }
    }

    fn broken(&self, error: &NetError) {
        tracing::debug!(peer = self.peer.0, %error, "link failed");
        // Its reader ends, and decides what follows.
        match self.is_linked() {
            true => {
                self.take_writer();
                self.end.notify_one();
            }
            false => self.close(None, None, false),
        }
    }
}
