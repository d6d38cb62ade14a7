//! All that connections share: the hub, the channels, the outboxes, and how effects are carried out.

use std::sync::Arc;

use dashmap::DashMap;
use mom_hub::{Hub, PeerId, Record, StopRecord, Ticket};
use mom_journal::Tap;
use mom_net::Taken;
use mom_proto::{Code, ContextNumber, Family, Map, Micros, Parcel, Path, Value, WireError, event};
use mom_store::{StopFile, Store};
use mom_system::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use mom_system::sync::{Mutex, Notify};
use mom_system::{Clock, Workers};

use crate::traffic::batch::{self, BatchWriter};
use crate::traffic::capacity::{names, spared};
use crate::traffic::channel::{Channel, LARGEST_STOP, Sent, by_hub, control, hub_origin, news_of, stamped};
use crate::traffic::encodings::{Bounds, Encoder, Encodings};
use crate::traffic::inquiries::Inquiries;
use crate::traffic::memory::Memory;
use crate::traffic::outbox::{Outbox, Packet, Paths};
use crate::traffic::statistics::Counts;

mod drops;
mod effects;
mod relief;
mod sending;
mod statistics;
#[cfg(test)]
mod tests;
mod totals;

use effects::Decisions;
pub(crate) use effects::Work;
pub(crate) use sending::Handled;
pub(crate) use totals::Totals;

/// The switchboard of one broker.
///
/// Locks are taken in the order turn (of [`Decisions`]), channel, outbox, and none is held over an await. The hub's is
/// held only while it decides, and takes no other; effects are carried out after it is given back.
#[derive(Debug)]
pub(crate) struct Switchboard {
    pub(crate) clock: Clock,
    hub: Mutex<Hub>,
    /// What the hub has decided and nobody has carried out yet.
    decisions: Decisions,
    pub(crate) tap: Tap,
    channels: DashMap<ContextNumber, Arc<Channel>>,
    by_path: DashMap<Path, ContextNumber>,
    bounds: Bounds,
    /// For what grows with the size of what one peer sends.
    pub(crate) workers: Arc<Workers>,
    pub(crate) memory: Memory,
    pub(crate) keeping: Keeping,
    pub(crate) outboxes: DashMap<PeerId, Arc<Outbox>>,
    batch_writer: BatchWriter,
    /// What peers ask and files answer.
    pub(crate) inquiries: Inquiries,
    /// What channels have counted that are gone.
    gone: Mutex<Counts>,
    last_peer: AtomicU64,
    /// The hub's deadline may have come closer.
    pub(crate) deadline_changed: Notify,
    /// The last connection has ended.
    empty: Notify,
    stopping: AtomicBool,
}

/// What outlives the broker; the hub knows where nothing does, and keeps nothing.
#[derive(Debug, Default)]
pub(crate) struct Keeping {
    pub(crate) store: Option<Store>,
    pub(crate) stops: Option<StopFile>,
}

/// Outboxes that were given something in the present turn and have to be flushed at its end.
pub(crate) type Touched = Vec<Arc<Outbox>>;

impl Switchboard {
    pub(crate) fn new(hub: Hub, clock: Clock, bounds: Bounds, keeping: Keeping, tap: Tap) -> Switchboard {
        let routes = hub.routes();
        let board = Switchboard {
            clock,
            hub: Mutex::new(hub),
            decisions: Decisions::default(),
            tap,
            channels: DashMap::new(),
            by_path: DashMap::new(),
            bounds,
            workers: Arc::default(),
            memory: Memory::default(),
            keeping,
            outboxes: DashMap::new(),
            batch_writer: BatchWriter::default(),
            inquiries: Inquiries::default(),
            gone: Mutex::new(Counts::default()),
            last_peer: AtomicU64::new(0),
            deadline_changed: Notify::new(),
            empty: Notify::new(),
            stopping: AtomicBool::new(false),
        };
        for route in routes {
            // Nobody is there yet.
            let _ = board.swap_route(route);
        }
        board
    }

    /// A number for a new connection.
    pub(crate) fn next_peer(&self) -> PeerId {
        PeerId(self.last_peer.fetch_add(1, Ordering::Relaxed) + 1)
    }

    /// When the hub wants to be called.
    pub(crate) fn deadline(&self) -> Option<Micros> {
        self.hub.lock().deadline()
    }

    /// Asserts the hub's invariants.
    pub(crate) fn check(&self) {
        self.hub.lock().check();
    }

    /// Asks the hub something that changes nothing, at the present time. It is held up for as long: a moment.
    pub(crate) fn ask_hub<T>(&self, ask: impl FnOnce(&mut Hub, Micros) -> T) -> T {
        let now = self.clock.now();
        ask(&mut self.hub.lock(), now)
    }

    /// The name of a peer, for logs.
    pub(crate) fn peer_name(&self, peer: PeerId) -> Option<Arc<str>> {
        self.hub.lock().peer_name(peer)
    }

    /// Says something of the broker's own to a peer.
    pub(crate) fn tell(&self, peer: PeerId, parcel: Parcel, touched: &mut Touched) {
        if let Some(outbox) = self.outbox(peer) {
            self.push_control(&outbox, stamped(parcel, self.clock.wall()), touched);
        }
    }

    /// Closes a connection with an error that says why.
    pub(crate) fn close(&self, outbox: &Outbox, error: Option<WireError>) {
        let farewell = error.as_ref().and_then(|error| {
            let parcel = stamped(error.to_parcel(None), self.clock.wall());
            let origin = hub_origin(&parcel);
            let encodings = Encodings::new(parcel, std::iter::once(outbox.form())).ok()?;
            Some(control(Family::Error, encodings, origin, None))
        });
        // A peer that leaves, or is closed because the broker stops, gets all that waits; an expelled one does not.
        let drain = error.as_ref().is_none_or(|error| error.code == Code::SHUTDOWN);
        outbox.close(error, farewell, drain);
    }

    /// Takes in a new connection; one that comes while the broker stops is told so at once.
    pub(crate) fn add_outbox(&self, outbox: &Arc<Outbox>) {
        self.outboxes.insert(outbox.peer, Arc::clone(outbox));
        if self.stopping.load(Ordering::SeqCst) {
            self.close(outbox, Some(shutdown()));
        }
    }

    /// Tells all connections that the broker stops, now and from now on.
    pub(crate) fn shut_down(&self) {
        // The flag first: a connection that the walk misses sees it after its own arrival.
        self.stopping.store(true, Ordering::SeqCst);
        let outboxes: Vec<Arc<Outbox>> = self.outboxes.iter().map(|outbox| Arc::clone(&outbox)).collect();
        outboxes
            .iter()
            .for_each(|outbox| self.close(outbox, Some(shutdown())));
    }

    /// Whether the broker stops.
    pub(crate) fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::SeqCst)
    }

    /// Forgets a connection that has ended; what still waited for it is told to its senders.
    pub(crate) fn remove_outbox(&self, outbox: &Outbox) {
        outbox.abandon();
        let mut touched = Touched::new();
        self.report_drops_of([outbox], &mut touched);
        flush(&mut touched);
        self.outboxes.remove(&outbox.peer);
        self.tap.audit.left(outbox.peer);
        if self.outboxes.is_empty() {
            self.empty.notify_one();
        }
    }

    /// Returns when there is no connection any more.
    pub(crate) async fn wait_empty(&self) {
        while !self.outboxes.is_empty() {
            self.empty.notified().await;
        }
    }

    pub(crate) fn outbox(&self, peer: PeerId) -> Option<Arc<Outbox>> {
        self.outboxes.get(&peer).map(|outbox| Arc::clone(&outbox))
    }

    fn channel_of(&self, parcel: &Parcel) -> Option<Arc<Channel>> {
        self.number_of(parcel).and_then(|number| self.channel(number))
    }

    /// The number of the channel that a message is for.
    pub(crate) fn number_of(&self, parcel: &Parcel) -> Option<ContextNumber> {
        // The path first, as the hub does.
        match (&parcel.context, parcel.number) {
            (Some(path), _) => self.by_path.get(path).map(|number| *number),
            (None, number) => number,
        }
    }

    pub(crate) fn channel(&self, number: ContextNumber) -> Option<Arc<Channel>> {
        self.channels.get(&number).map(|channel| Arc::clone(&channel))
    }

    fn swap_route(&self, route: Arc<mom_hub::Route>) -> Touched {
        let number = route.number;
        match self.channel(number) {
            Some(channel) => channel.swap(route, &self.clock, |peer| self.outbox(peer)),
            None => {
                self.by_path.insert(route.path.clone(), number);
                let encoder = Encoder::new(self.bounds, Arc::clone(&self.workers));
                self.channels.insert(
                    number,
                    Arc::new(Channel::new(route, encoder, |peer| self.outbox(peer))),
                );
                Touched::new()
            }
        }
    }

    fn drop_route(&self, number: ContextNumber) {
        if let Some((_, channel)) = self.channels.remove(&number) {
            self.gone.lock().add(&channel.counts());
            // A reader that found the channel just before gets what it would get after.
            let path = channel.end();
            self.by_path.remove_if(&path, |_, known| *known == number);
        }
    }

    /// Hands a record to the store, which answers by [`Input::Stored`] later and never waits here.
    pub(crate) fn keep(&self, record: Record, ticket: Option<Ticket>) {
        match &self.keeping.store {
            Some(store) => store.put(record, ticket),
            // Its settings tell the hub that nothing is durable here, so it awaits nothing.
            None => tracing::error!(token = %record.path, ?ticket, "a record without a store"),
        }
    }

    /// The same of what is stopped in a channel.
    pub(crate) fn keep_stop(&self, record: &StopRecord, ticket: Option<Ticket>) {
        match &self.keeping.stops {
            Some(stops) => stops.keep(record, ticket),
            None => tracing::error!(channel = %record.path, ?ticket, "a stop is to be kept nowhere"),
        }
    }

    /// After a delivery: flushes are noted, slow receivers closed, a receipt given.
    fn settle(&self, sender: PeerId, sent: Sent, touched: &mut Touched) {
        let Sent {
            delivered,
            route,
            receipt,
            reference,
            ..
        } = sent;
        let path = &route.path;
        if delivered.lively && delivered.touched.len() >= batch::RECEIVERS {
            self.batch_writer.defer(delivered.touched);
        } else {
            touched.extend(delivered.touched);
        }
        for outbox in delivered.too_slow {
            let queued = outbox.queued();
            let text = format!(
                "{queued} bytes that may not be dropped waited for this peer: as many as limits.burst lets wait, or more \
                 than limits.outbox for longer than limits.stalled"
            );
            tracing::info!(peer = outbox.peer.0, context = %path, queued, "slow receiver closed");
            self.close(&outbox, Some(WireError::new(Code::SLOW_RECEIVER, text)));
        }
        if let Some(reference) = delivered.shortened {
            let most = i64::try_from(LARGEST_STOP).unwrap_or(i64::MAX);
            let mut parcel = Parcel::new(Family::Event, event::SHORTENED)
                .context(path.clone())
                .content(Map::new().with("name", event::STOP).with("most", most));
            parcel.number = Some(route.number);
            parcel.reference = reference;
            self.tell(sender, parcel, touched);
        }
        if let Some(reference) = receipt {
            let dropped: Vec<Value> = delivered
                .dropped
                .iter()
                .map(|name| Value::from(&**name))
                .collect();
            let count = i64::try_from(delivered.delivered).unwrap_or(i64::MAX);
            let mut content = Map::new().with("delivered", count).with("dropped", dropped);
            if !delivered.spared.is_empty() {
                content.set("slow", names(&delivered.spared));
            }
            let mut parcel = Parcel::new(Family::Reply, "ok")
                .context(path.clone())
                .content(content);
            parcel.number = Some(route.number);
            parcel.reference = reference;
            self.tell(sender, parcel, touched);
        } else if !delivered.spared.is_empty() {
            let refused = spared(&delivered.spared, path).to_parcel(reference);
            self.tell(sender, refused, touched);
        }
    }

    pub(crate) fn push_to_all(&self, to: &[PeerId], parcel: &Arc<Parcel>, touched: &mut Touched) {
        let outboxes: Vec<Arc<Outbox>> = to.iter().filter_map(|peer| self.outbox(*peer)).collect();
        let forms = outboxes.iter().map(|outbox| outbox.form());
        match Encodings::new((**parcel).clone(), forms) {
            Ok(encodings) => {
                // What many hear is held once, and of nobody in particular.
                let account = match outboxes.as_slice() {
                    [outbox] => outbox.account(),
                    _ => None,
                };
                let packet = by_hub(parcel, encodings, account.as_ref());
                let news = news_of(parcel).map(|class| Arc::new(packet.as_news(class)));
                for outbox in outboxes {
                    match &news {
                        Some(news) if outbox.is_device() && !puts_out(parcel, &outbox) => {
                            self.push_news(&outbox, &packet, news, touched);
                        }
                        _ => self.push(&outbox, Arc::clone(&packet), touched),
                    }
                }
            }
            // Only content that an application chose can do this: the safe state of a token.
            Err(error) => tracing::warn!(name = parcel.name(), %error, "cannot be encoded"),
        }
    }

    fn push_control(&self, outbox: &Arc<Outbox>, parcel: Parcel, touched: &mut Touched) {
        let (family, origin) = (parcel.family, hub_origin(&parcel));
        if let Ok(encodings) = Encodings::new(parcel, std::iter::once(outbox.form())) {
            let account = outbox.account();
            self.push(
                outbox,
                control(family, encodings, origin, account.as_ref()),
                touched,
            );
        }
    }

    /// True if it is not dropped.
    fn push_news(
        &self,
        outbox: &Arc<Outbox>,
        packet: &Arc<Packet>,
        news: &Arc<Packet>,
        touched: &mut Touched,
    ) -> bool {
        let (taken, first) = outbox.push_news(Arc::clone(packet), news);
        if first {
            touched.push(Arc::clone(outbox));
        }
        taken == Taken::Yes
    }

    fn push(&self, outbox: &Arc<Outbox>, packet: Arc<Packet>, touched: &mut Touched) {
        let (taken, first) = outbox.push(packet);
        if first {
            touched.push(Arc::clone(outbox));
        }
        if taken == Taken::Overflow {
            let text = "the replies and events queued for this peer reached its limit";
            self.close(outbox, Some(WireError::new(Code::SLOW_RECEIVER, text)));
        }
    }
}

impl Paths for Switchboard {
    fn path(&self, number: ContextNumber) -> Option<Path> {
        Some(self.channel(number)?.route().path.clone())
    }
}

fn shutdown() -> WireError {
    WireError::new(Code::SHUTDOWN, "the hub is shutting down; connect again later")
}

/// Whether it tells a peer that it was put out itself.
fn puts_out(parcel: &Parcel, outbox: &Outbox) -> bool {
    let peer = |content: Value| content.get("peer").and_then(Value::as_str) == Some(&*outbox.name());
    parcel.name() == event::EXPELLED && peer(parcel.value())
}

/// Flushes every outbox of a turn.
pub(crate) fn flush(touched: &mut Touched) {
    touched.drain(..).for_each(|outbox| outbox.flush());
}
