//! What all proxies and the tasks of the link share.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use mom_net::{DropReason, Lane, Ledger, Outgoing};
use mom_proto::codec::Form;
use mom_proto::{Code, Compression, Family, Map, Parcel, Path, Thinning, WireError, event, outlives_loss};
use parking_lot::{Mutex, MutexGuard};
use tokio::sync::{AcquireError, Notify, Semaphore, SemaphorePermit, oneshot, watch};
use tokio::time::timeout;

use crate::device::installation::Installation;
use crate::link::login::Welcome;
use crate::link::survive::Counted;
use crate::peer::guards::Guards;
use crate::peer::handover::Handovers;
use crate::peer::pending::{AnswerTo, OpenRequests};
use crate::peer::subscribers::{EventQueue, Subscribers};
use crate::peer::waits::Waits;
use crate::peer::wanted::{Terms, Want, WantedContexts};
use crate::said::info::map_of;
use crate::wire::clock::HubClock;
use crate::wire::ids;
use crate::wire::outbox::{Capacity, Dropped, Entry, Follows, Message, Outbox};
use crate::wire::proof::Credentials;
use crate::{ClientError, LinkState, Reconnect};

/// Capacity for messages that wait to be written: 4 MiB in units of 1 KiB; and a quarter of that more for urgent ones, which
/// would else wait behind whoever waits for capacity.
const CAPACITY: u32 = 4096;
const URGENT_CAPACITY: u32 = 1024;
const CAPACITY_UNIT: usize = 1024;

/// What the builder was told.
#[derive(Clone, Debug)]
pub(crate) struct Settings {
    pub(crate) request_timeout: Duration,
    pub(crate) connect_timeout: Duration,
    pub(crate) reconnect: Option<Reconnect>,
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

#[derive(Debug)]
pub(crate) struct State {
    pub(crate) status: Status,
    pub(crate) me: Arc<Welcome>,
    pub(crate) outbox: Outbox,
    /// Messages that newer ones have replaced, by context: told when the link takes something again, all at once.
    pub(crate) replaced: BTreeMap<Path, u64>,
    pub(crate) pending: OpenRequests,
    pub(crate) places: WantedContexts,
    pub(crate) subscribers: Subscribers,
    pub(crate) guards: Guards,
    /// Parts in shared holds.
    pub(crate) inhibits: Guards,
    pub(crate) waits: Waits,
    pub(crate) handovers: Handovers,
    /// Joins after a lost link that are not answered yet.
    pub(crate) rejoining: usize,
    /// What the hub said before it closed the link.
    pub(crate) closing: Option<WireError>,
    /// What both ends have counted, where a lost connection may be resumed.
    pub(crate) counted: Option<Box<Counted>>,
}

#[derive(Clone, Debug)]
pub(crate) enum Status {
    Up,
    /// The connection is lost, and another one is to go on with all that waits.
    Resuming,
    Down,
    Closed(Option<WireError>),
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
        let state = State {
            status: Status::Up,
            me: Arc::new(me),
            outbox: Outbox::new(form),
            replaced: BTreeMap::new(),
            pending: OpenRequests::default(),
            places: WantedContexts::default(),
            subscribers: Subscribers::default(),
            guards: Guards::default(),
            inhibits: Guards::default(),
            waits: Waits::default(),
            handovers: Handovers::default(),
            rejoining: 0,
            closing: None,
            counted: None,
        };
        Shared {
            settings,
            credentials: Mutex::new(credentials),
            clock,
            form,
            state: Mutex::new(state),
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
    pub(crate) async fn request(&self, mut parcel: Parcel) -> Result<Parcel, ClientError> {
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

    /// Tells of what will not be sent, or not again: whoever waits for an answer by that, all others where the context is heard.
    pub(crate) fn tell_dropped(&self, dropped: &Dropped) {
        if dropped.is_empty() {
            return;
        }
        let mut failed = Vec::new();
        let mut state = self.lock();
        let capacity = state.lose(dropped);
        for (entry, reason) in dropped {
            let Some(error) = unsent(*reason) else { continue };
            entry.id.into_iter().for_each(|id| state.guards.ended(id));
            let waiter = entry.id.and_then(|id| state.pending.take(id));
            failed.extend(waiter.map(|waiter| (waiter, error)));
        }
        drop(state);
        self.give_capacity(capacity);
        for (waiter, error) in failed {
            self.fail(waiter, &error);
        }
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
            let text = format!("a parcel of {size} bytes, the hub takes {most}");
            return Err(ClientError::Local(WireError::new(Code::TOO_LARGE, text)));
        }
        Ok(Outgoing::Encoded(encoded))
    }

    /// Wants contexts, the uppermost first, and asks to join those that this client is not in; the last of them
    /// on these terms, if they are said.
    #[expect(
        clippy::type_complexity,
        reason = "two lists, each of pairs, used in one place"
    )]
    pub(crate) fn want(
        &self,
        way: &[Path],
        terms: Option<Terms>,
    ) -> Result<(Vec<(Path, u64)>, Vec<Want>), ClientError> {
        let mut state = self.lock();
        state.check_up()?;
        let (mut places, mut wants) = (Vec::new(), Vec::new());
        let mut asked = Ok(());
        for path in way {
            let (serial, want) = state.places.want(path);
            places.push((path.clone(), serial));
            if matches!(want, Want::Join(_)) {
                let mut waiter = Some(AnswerTo::Join(path.clone(), serial));
                let last = places.len() == way.len();
                let terms = terms.filter(|_| last).unwrap_or_default();
                if let Some(place) = state.places.get(path, serial) {
                    place.terms = terms;
                }
                let content = terms.content(&state.places.latch(path), &self.settings.installation);
                asked = self.ask_in(&mut state, join(path, content), &mut waiter);
            }
            wants.push(want);
            if asked.is_err() {
                break;
            }
        }
        drop(state);
        self.outgoing.notify_one();
        match asked {
            Ok(()) => Ok((places, wants)),
            Err(error) => {
                self.unwant(&places);
                Err(error)
            }
        }
    }

    /// Wants contexts no more, and leaves those that nobody else wants.
    pub(crate) fn unwant(&self, places: &[(Path, u64)]) {
        let mut state = self.lock();
        for (path, serial) in places.iter().rev() {
            if state.places.unwant(path, *serial) {
                state.subscribers.close_within(path);
                // Without a link there is nothing to leave.
                let _ = self.ask_in(
                    &mut state,
                    verb(Family::Context, "leave", path),
                    &mut Some(AnswerTo::Nobody),
                );
            }
        }
        drop(state);
        self.outgoing.notify_one();
    }

    /// Joins a channel again, to be spared of something else than before.
    pub(crate) async fn thin(&self, path: &Path, thinning: Thinning) -> Result<(), ClientError> {
        let known = self.lock().places.terms(path);
        self.set_terms(path, Terms { thinning, ..known }).await
    }

    /// Joins a channel again, on other terms.
    pub(crate) async fn set_terms(&self, path: &Path, terms: Terms) -> Result<(), ClientError> {
        // An empty map too: without content the hub leaves everything as it was.
        let content = terms.map(&self.lock().places.latch(path), &self.settings.installation);
        let parcel = verb(Family::Context, "join", path).content(content);
        let reply = self.request(parcel).await?;
        let mut state = self.lock();
        state.places.set_terms(path, terms);
        if let Some(word) = state.places.first_word(path, &map_of(&reply)) {
            state.subscribers.deliver_only(path, &word);
        }
        Ok(())
    }

    /// Leaves a context and all below it.
    pub(crate) async fn leave(&self, path: &Path) -> Result<(), ClientError> {
        let asked = self.request(verb(Family::Context, "leave", path)).await;
        if asked.is_ok() {
            let mut state = self.lock();
            state.places.remove_within(path);
            state.subscribers.close_within(path);
        }
        asked.map(drop)
    }

    pub(crate) fn subscribe(&self, path: &Path) -> Arc<EventQueue> {
        let mut state = self.lock();
        let queue = state.subscribers.subscribe(path, self.settings.event_buffer);
        if matches!(state.status, Status::Closed(_)) {
            queue.close();
        }
        queue
    }

    pub(crate) fn subscribe_unaddressed(&self) -> Arc<EventQueue> {
        let mut state = self.lock();
        let queue = state
            .subscribers
            .subscribe_unaddressed(self.settings.event_buffer);
        if matches!(state.status, Status::Closed(_)) {
            queue.close();
        }
        queue
    }

    pub(crate) fn subscribe_consults(&self) -> Arc<EventQueue> {
        let mut state = self.lock();
        let queue = state.subscribers.subscribe_consults(self.settings.event_buffer);
        if matches!(state.status, Status::Closed(_)) {
            queue.close();
        }
        queue
    }

    pub(crate) fn unsubscribe(&self, queue: &Arc<EventQueue>) {
        self.lock().subscribers.unsubscribe(queue);
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

impl State {
    /// The token that a message needs, as far as this peer knows.
    fn guard_of(&self, parcel: &Parcel) -> Option<Path> {
        self.places
            .gate(parcel.context.as_ref()?)
            .token_for(parcel.name())
    }

    /// Whether a message that was said while the outbox wrote to this link can be sent now; the token that it needs.
    fn check_message(&self, parcel: &Parcel, link: u64) -> Result<Option<Path>, ClientError> {
        self.check_up()?;
        let guard = self.guard_of(parcel);
        let lost = self.is_resuming() || self.outbox.mark().link != link;
        match lost && !outlives_loss(parcel, guard.is_some()) {
            true => Err(too_late()),
            false => Ok(guard),
        }
    }

    /// Whether the connection is lost, and another one is to go on.
    pub(crate) fn is_resuming(&self) -> bool {
        matches!(self.status, Status::Resuming)
    }

    /// Whether anything can be sent now.
    pub(crate) fn check_up(&self) -> Result<(), ClientError> {
        match &self.status {
            Status::Up | Status::Resuming => Ok(()),
            Status::Down => Err(ClientError::Connection("the link is down".to_owned())),
            Status::Closed(error) => Err(ClientError::Closed(error.clone())),
        }
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

/// The request to join a context on these terms.
pub(crate) fn join(path: &Path, terms: Option<Map>) -> Parcel {
    let parcel = verb(Family::Context, "join", path);
    match terms {
        Some(content) => parcel.content(content),
        None => parcel,
    }
}

fn describe(parcel: &Parcel) -> String {
    let path = parcel
        .context
        .as_ref()
        .map(|path| format!(" {path}"))
        .unwrap_or_default();
    format!("{} {}{path}", parcel.family, parcel.name())
}

/// What moves a device, lets it move or changes who drives it is of its moment.
fn too_late() -> ClientError {
    let text = "it is lost, and what is said now would come too late: it is not sent";
    ClientError::Connection(text.to_owned())
}

/// What who waits for an answer hears of a parcel that will not be sent, or not again; none where a lost link tells it.
fn unsent(reason: DropReason) -> Option<ClientError> {
    let local = |code, text: &str| Some(ClientError::Local(WireError::new(code, text)));
    match reason {
        DropReason::Withdrawn => local(
            Code::WITHDRAWN,
            "a stop came after this unstop, before it was sent",
        ),
        DropReason::Replaced => local(Code::WITHDRAWN, "a newer one came after it, before it was sent"),
        DropReason::Expired => local(Code::EXPIRED, "its time was over before it was sent"),
        DropReason::Lost => {
            let text = "it was lost before this was sent, and it would come too late: it is not sent";
            Some(ClientError::Connection(text.to_owned()))
        }
        DropReason::Unknown => {
            let text = "the connection was lost after it had left, whether the hub has read it cannot be known, and it is not sent again";
            Some(ClientError::Unknown(WireError::new(Code::DISCONNECTED, text)))
        }
        _ => None,
    }
}
