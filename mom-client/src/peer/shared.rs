//! What all proxies and the tasks of the link share.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use mom_net::{Lane, Ledger, Outgoing};
use mom_proto::codec::Form;
use mom_proto::{Code, Compression, Family, Parcel, Path, WireError, event, outlives_loss};
use parking_lot::{Mutex, MutexGuard};
use tokio::sync::{AcquireError, Notify, Semaphore, SemaphorePermit, oneshot, watch};
use tokio::time::timeout;

use crate::device::installation::Installation;
use crate::peer::pending::AnswerTo;
use crate::peer::state::{State, too_late};
use crate::wire::clock::HubClock;
use crate::wire::ids;
use crate::wire::outbox::{Capacity, Entry, Follows, Message};
use crate::wire::proof::Credentials;
use crate::wire::welcome::Welcome;
use crate::{ClientError, LinkState};

/// A future that is compiled where it is boxed, in a function that is not `async`. The body of an `async fn` is compiled in each crate that
/// polls it, together with all that it awaits: each device and agent would compile the connection, the doors and the HTTP client once more,
/// and have them once more in its program.
pub type Boxed<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

/// Capacity for messages that wait to be written: 4 MiB in units of 1 KiB; and a quarter of that more for urgent ones, which
/// would otherwise wait behind the senders that wait for capacity.
const CAPACITY: u32 = 4096;
const URGENT_CAPACITY: u32 = 1024;
const CAPACITY_UNIT: usize = 1024;

/// What the builder was told.
#[derive(Clone, Debug)]
pub(crate) struct Settings {
    pub(crate) request_timeout: Duration,
    pub(crate) connect_timeout: Duration,
    pub(crate) event_buffer: usize,
    /// Which device this program is, where it is one.
    pub(crate) installation: Installation,
}

/// The client's state behind one lock that is never held over an await.
#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) settings: Settings,
    /// As whom it logs in, also after a lost link.
    pub(crate) credentials: Mutex<Credentials>,
    pub(crate) clock: HubClock,
    /// What the link speaks, none within a process; the same for every link of one client.
    form: Option<Form>,
    state: Mutex<State>,
    pub(crate) ids: AtomicU64,
    /// Of messages that a receiver answers, beyond all others and begun anywhere: no status of another connection of this name, and none
    /// that a channel has kept of one, is the answer to it.
    answered_ids: AtomicU64,
    capacity: Semaphore,
    urgent_capacity: Semaphore,
    /// What the hub has not read yet of what was sent, if a lost connection may be resumed. Taken after the state.
    pub(crate) ledger: Mutex<Option<Box<Ledger<Entry>>>>,
    /// Whether parcels are counted.
    pub(crate) counts: AtomicBool,
    /// Wakes the writer.
    pub(crate) outgoing: Notify,
    /// Wakes the keeper of leases and heartbeats.
    pub(crate) keeping: Notify,
    pub(crate) link: watch::Sender<LinkState>,
    /// Whether the last handle is gone or the client was closed.
    pub(crate) ending: watch::Sender<bool>,
}

impl Shared {
    pub(crate) fn new(
        settings: Settings,
        credentials: Credentials,
        clock: HubClock,
        form: Option<Form>,
        ids: AtomicU64,
        me: Welcome,
    ) -> Shared {
        Shared {
            settings,
            credentials: Mutex::new(credentials),
            clock,
            form,
            state: Mutex::new(State::new(form, me)),
            ids,
            answered_ids: AtomicU64::new(ids::any()),
            capacity: Semaphore::new(CAPACITY as usize),
            urgent_capacity: Semaphore::new(URGENT_CAPACITY as usize),
            ledger: Mutex::new(None),
            counts: AtomicBool::new(false),
            outgoing: Notify::new(),
            keeping: Notify::new(),
            link: watch::Sender::new(LinkState::Connected),
            ending: watch::Sender::new(false),
        }
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock()
    }

    pub(crate) fn next_id(&self) -> u64 {
        self.ids.fetch_add(1, Ordering::Relaxed)
    }

    /// The id of a parcel that is to be sent.
    fn id_of(&self, parcel: &Parcel) -> u64 {
        match ids::is_answered(parcel) {
            true => self.answered_ids.fetch_add(1, Ordering::Relaxed),
            false => self.next_id(),
        }
    }

    /// Capacity for messages again.
    pub(crate) fn give_capacity(&self, capacity: Capacity) {
        self.capacity.add_permits(capacity.usual);
        self.urgent_capacity.add_permits(capacity.urgent);
    }

    /// What is left of the usual capacity.
    #[cfg(test)]
    pub(crate) fn capacity_left(&self) -> usize {
        self.capacity.available_permits()
    }

    /// Nobody need wait for capacity any more.
    pub(crate) fn close_capacity(&self) {
        self.capacity.close();
        self.urgent_capacity.close();
    }

    /// Asks and waits for the reply.
    pub(crate) fn request(&self, parcel: Parcel) -> Boxed<'_, Result<Parcel, ClientError>> {
        Box::pin(self.ask_and_wait(parcel))
    }

    async fn ask_and_wait(&self, mut parcel: Parcel) -> Result<Parcel, ClientError> {
        let (sender, receiver) = oneshot::channel();
        let what = describe(&parcel);
        let id = self.id_of(&parcel);
        parcel.id = Some(id);
        let ticket = Ticket { shared: self, id };
        let asked = async {
            if parcel.family == Family::Message {
                self.post(parcel, Some(AnswerTo::Caller(sender))).await?;
            } else {
                self.ask(parcel, AnswerTo::Caller(sender))?;
            }
            receiver
                .await
                .map_err(|_| ClientError::Connection("the link was lost".to_owned()))?
        };
        let after = self.settings.request_timeout;
        let answer = timeout(after, asked).await;
        drop(ticket);
        answer.unwrap_or(Err(ClientError::TimedOut { what, after }))
    }

    /// Queues a request.
    pub(crate) fn ask(&self, parcel: Parcel, waiter: AnswerTo) -> Result<(), ClientError> {
        // The waiter may hold the last handle: on an error it is dropped after the lock is given back.
        let mut waiter = Some(waiter);
        let mut state = self.lock();
        let asked = self.ask_in(&mut state, parcel, &mut waiter);
        drop(state);
        self.outgoing.notify_one();
        asked
    }

    /// Queues a request, taking the waiter only if that succeeds; without one, no answer is expected.
    pub(crate) fn ask_in(
        &self,
        state: &mut State,
        parcel: Parcel,
        waiter: &mut Option<AnswerTo>,
    ) -> Result<(), ClientError> {
        let follows = Follows::of(&parcel);
        self.ask_behind(state, parcel, waiter, follows)
    }

    /// The same, behind these of the messages that wait.
    pub(crate) fn ask_behind(
        &self,
        state: &mut State,
        mut parcel: Parcel,
        waiter: &mut Option<AnswerTo>,
        follows: Follows,
    ) -> Result<(), ClientError> {
        state.check_up()?;
        if state.is_resuming() && !outlives_loss(&parcel, false) {
            return Err(too_late());
        }
        let id = *parcel.id.get_or_insert_with(|| self.next_id());
        let outgoing = self.prepare(&mut parcel, &state.me)?;
        if let Some(waiter) = waiter.take() {
            state.pending.insert(id, waiter);
        }
        state.outbox.push_control(&parcel, outgoing, follows);
        Ok(())
    }

    /// Queues a message, waiting for capacity.
    pub(crate) async fn post(&self, mut parcel: Parcel, waiter: Option<AnswerTo>) -> Result<(), ClientError> {
        let (me, link) = {
            let state = self.lock();
            let link = state.outbox.mark().link;
            state.check_message(&parcel, link)?;
            (Arc::clone(&state.me), link)
        };
        let id = parcel.id.unwrap_or_else(|| self.id_of(&parcel));
        parcel.id = Some(id);
        // Outside the lock: content may be large.
        let outgoing = self.prepare(&mut parcel, &me)?;
        let Ok((permit, capacity)) = self.acquire(&parcel, outgoing.len()).await else {
            return Err(self.lock().check_up().err().unwrap_or(ClientError::Closed(None)));
        };
        let mut state = self.lock();
        let guard = state.check_message(&parcel, link)?;
        permit.into_iter().for_each(SemaphorePermit::forget);
        let awaited = waiter.is_some();
        if let Some(waiter) = waiter {
            state.pending.insert(id, waiter);
        } else if let Some(path) = &parcel.context {
            state.pending.note(id, path.clone());
        }
        let message = Message {
            capacity,
            awaited,
            guard,
            outgoing,
        };
        if let Some(token) = message.guard.as_ref().filter(|_| parcel.name() == event::COMMAND) {
            state.guards.said(token, id);
        }
        let dropped = state.outbox.push_message(&parcel, message);
        drop(state);
        self.outgoing.notify_one();
        self.tell_dropped(&dropped);
        Ok(())
    }

    /// Waits for capacity for a message; a stop and an `unstop` need none.
    async fn acquire(
        &self,
        parcel: &Parcel,
        size: usize,
    ) -> Result<(Option<SemaphorePermit<'_>>, Capacity), AcquireError> {
        let units = |most: u32| u32::try_from(1 + size / CAPACITY_UNIT).map_or(most, |units| units.min(most));
        if parcel.family == Family::Message && matches!(parcel.name(), event::STOP | event::UNSTOP) {
            return Ok((None, Capacity::default()));
        }
        let urgent = Lane::Data(parcel.priority.unwrap_or_default()).is_urgent();
        let (capacity, units) = match urgent {
            true => (&self.urgent_capacity, units(URGENT_CAPACITY)),
            false => (&self.capacity, units(CAPACITY)),
        };
        let permit = capacity.acquire_many(units).await?;
        let mut taken = Capacity::default();
        *(if urgent {
            &mut taken.urgent
        } else {
            &mut taken.usual
        }) = units as usize;
        Ok((Some(permit), taken))
    }

    /// Stamps and encodes a parcel.
    pub(crate) fn prepare(&self, parcel: &mut Parcel, me: &Welcome) -> Result<Outgoing, ClientError> {
        parcel.timestamp = parcel.timestamp.or_else(|| self.clock.wall());
        let Some(form) = self.form else {
            return Ok(Outgoing::Parcel(Arc::new(parcel.clone())));
        };
        let (form, unpacked) = match form {
            Form::Binary if me.compression == Some(Compression::Zstd) => (Form::Packed, parcel.size()),
            form => (form, 0),
        };
        let encoded = form.encode(parcel)?;
        let (size, most) = (encoded.len().max(unpacked), me.limits.parcel);
        if !most.allows(size) {
            let text = format!("the parcel has {size} bytes; the hub accepts at most {most}");
            return Err(ClientError::Local(WireError::new(Code::TOO_LARGE, text)));
        }
        Ok(Outgoing::Encoded(encoded))
    }

    /// Says good-bye after all that waits, and ends the link.
    pub(crate) fn end(&self) {
        let mut state = self.lock();
        if !*self.ending.borrow() {
            // Without a link there is nobody to say it to.
            let mut waiter = Some(AnswerTo::Nobody);
            let _ = self.ask_in(
                &mut state,
                verb(Family::Login, "logout", &Path::root()),
                &mut waiter,
            );
        }
        state.outbox.finish();
        drop(state);
        self.ending.send_replace(true);
        self.outgoing.notify_one();
    }
}

/// A request that leaves no trace when its caller goes.
struct Ticket<'a> {
    shared: &'a Shared,
    id: u64,
}

impl Drop for Ticket<'_> {
    fn drop(&mut self) {
        let waiter = self.shared.lock().pending.take(self.id);
        drop(waiter);
    }
}

/// A request about a context.
pub(crate) fn verb(family: Family, name: &str, path: &Path) -> Parcel {
    Parcel::new(family, name).context(path.clone())
}

fn describe(parcel: &Parcel) -> String {
    let path = parcel
        .context
        .as_ref()
        .map(|path| format!(" {path}"))
        .unwrap_or_default();
    format!("{} {}{path}", parcel.family, parcel.name())
}
