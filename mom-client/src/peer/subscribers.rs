//! Subscriptions: bounded queues of events that report their losses.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use mom_proto::event as names;
use mom_proto::{Content, Path, Value};
use parking_lot::Mutex;
use tokio::sync::Notify;

use crate::Event;

/// What may wait for one subscriber, in bytes of content; one event always may.
const MOST_BYTES: usize = 64 * 1024 * 1024;
/// Events kept from a join on for a subscriber that has not asked yet.
const EARLY: usize = 1024;

/// One bounded queue.
#[derive(Debug)]
pub(crate) struct EventQueue {
    waiting: Mutex<QueuedEvents>,
    wake: Notify,
}

#[derive(Debug)]
struct QueuedEvents {
    events: VecDeque<(usize, Event)>,
    bytes: usize,
    most: usize,
    lost: u64,
    closed: bool,
}

/// Why there is nothing to take.
enum Empty {
    Yet,
    ForEver,
}

impl EventQueue {
    pub(crate) fn new(most: usize) -> EventQueue {
        EventQueue {
            waiting: Mutex::new(QueuedEvents {
                events: VecDeque::new(),
                bytes: 0,
                most: most.max(1),
                lost: 0,
                closed: false,
            }),
            wake: Notify::new(),
        }
    }

    pub(crate) fn push(&self, event: Event) {
        let mut waiting = self.waiting.lock();
        if waiting.closed {
            return;
        }
        let weight = weight(&event);
        while (waiting.events.len() >= waiting.most
            || (waiting.bytes + weight > MOST_BYTES && !waiting.events.is_empty()))
            && waiting.drop_oldest()
        {}
        waiting.bytes += weight;
        if is_safety(&event) {
            waiting.replace_safety(&event);
        }
        waiting.events.push_back((weight, event));
        drop(waiting);
        self.wake.notify_one();
    }

    /// What waits can still be taken.
    pub(crate) fn close(&self) {
        self.waiting.lock().closed = true;
        self.wake.notify_one();
    }

    /// The next event; for one taker only, as a stored permit must not go to another.
    pub(crate) async fn next(&self) -> Option<Event> {
        loop {
            match self.take() {
                Ok(event) => return Some(event),
                Err(Empty::ForEver) => return None,
                Err(Empty::Yet) => self.wake.notified().await,
            }
        }
    }

    /// The next event, if one waits.
    pub(crate) fn try_next(&self) -> Option<Event> {
        self.take().ok()
    }

    fn take(&self) -> Result<Event, Empty> {
        let mut waiting = self.waiting.lock();
        if waiting.lost > 0 {
            return Ok(Event::Lagged(std::mem::take(&mut waiting.lost)));
        }
        match waiting.events.pop_front() {
            Some((weight, event)) => {
                waiting.bytes -= weight;
                Ok(event)
            }
            None if waiting.closed => Err(Empty::ForEver),
            None => Err(Empty::Yet),
        }
    }

    fn is_full(&self) -> bool {
        let waiting = self.waiting.lock();
        waiting.events.len() >= waiting.most
    }

    fn widen(&self, most: usize) {
        let mut waiting = self.waiting.lock();
        waiting.most = most.max(1);
        while waiting.events.len() > waiting.most && waiting.drop_oldest() {}
    }
}

impl QueuedEvents {
    /// Drops the oldest event that does not concern safety; false if there is none.
    fn drop_oldest(&mut self) -> bool {
        let oldest = self.events.iter().position(|(_, event)| !is_safety(event));
        // Of those that do, one of each kind and sender waits: a bound of its own, however small the queue is.
        let oldest = oldest.or((self.events.len() >= SAFETY).then_some(0));
        let Some((weight, event)) = oldest.and_then(|at| self.events.remove(at)) else {
            return false;
        };
        self.bytes -= weight;
        self.lost += match event {
            Event::Lagged(lost) => lost,
            _ => 1,
        };
        true
    }

    /// Drops what a newer event that concerns safety says as well: the same of the same sender. It keeps no place: what
    /// was said between the two is between them no more, and the newer one counts.
    fn replace_safety(&mut self, event: &Event) {
        let same = self.events.iter().position(|(_, older)| says_same(older, event));
        if let Some((weight, _)) = same.and_then(|at| self.events.remove(at)) {
            self.bytes -= weight;
        }
    }
}

/// Events that concern safety and wait at once, at most.
const SAFETY: usize = 4096;

/// Whether an event stops a device, or lets it go.
fn is_safety(event: &Event) -> bool {
    match event {
        Event::Message(parcel) => SAFETY_WORDS.contains(&parcel.name()),
        Event::Stops(_) | Event::LinkDown => true,
        _ => false,
    }
}

const SAFETY_WORDS: [&str; 3] = [names::STOP, names::UNSTOP, names::HALT];

/// Whether a newer event makes an older one needless: a stop makes an older stop of the same sender so, nothing else does, because
/// what frees a device depends on the order.
fn says_same(older: &Event, newer: &Event) -> bool {
    match (older, newer) {
        (Event::Message(older), Event::Message(newer)) => {
            newer.name() == names::STOP && older.name() == names::STOP && older.sender == newer.sender
        }
        (Event::LinkDown, Event::LinkDown) => true,
        _ => false,
    }
}

/// The subscribers by context.
#[derive(Debug, Default)]
pub(crate) struct Subscribers {
    by_path: HashMap<Path, Vec<Arc<EventQueue>>>,
    early: HashMap<Path, Arc<EventQueue>>,
    unaddressed: Vec<Arc<EventQueue>>,
    consults: Vec<Arc<EventQueue>>,
}

impl Subscribers {
    /// Keeps what comes from now on for the first subscriber, unless there is one.
    pub(crate) fn keep_early(&mut self, path: &Path) {
        if !self.by_path.contains_key(path) {
            self.early
                .entry(path.clone())
                .or_insert_with(|| Arc::new(EventQueue::new(EARLY)));
        }
    }

    pub(crate) fn subscribe(&mut self, path: &Path, most: usize) -> Arc<EventQueue> {
        let queue = match self.early.remove(path) {
            Some(early) => {
                early.widen(most);
                early
            }
            None => Arc::new(EventQueue::new(most)),
        };
        self.by_path
            .entry(path.clone())
            .or_default()
            .push(Arc::clone(&queue));
        queue
    }

    pub(crate) fn subscribe_unaddressed(&mut self, most: usize) -> Arc<EventQueue> {
        let queue = Arc::new(EventQueue::new(most));
        self.unaddressed.push(Arc::clone(&queue));
        queue
    }

    pub(crate) fn subscribe_consults(&mut self, most: usize) -> Arc<EventQueue> {
        let queue = Arc::new(EventQueue::new(most));
        self.consults.push(Arc::clone(&queue));
        queue
    }

    pub(crate) fn unsubscribe(&mut self, queue: &Arc<EventQueue>) {
        self.unaddressed.retain(|known| !Arc::ptr_eq(known, queue));
        self.consults.retain(|known| !Arc::ptr_eq(known, queue));
        self.by_path.retain(|_, queues| {
            queues.retain(|known| !Arc::ptr_eq(known, queue));
            !queues.is_empty()
        });
    }

    /// Gives an event to the subscribers of these contexts, or else to the unaddressed.
    pub(crate) fn deliver(&mut self, paths: &[Path], event: Event) {
        let mut queues: Vec<Arc<EventQueue>> = Vec::new();
        for path in paths {
            queues.extend(self.by_path.get(path).into_iter().flatten().cloned());
            queues.extend(self.early_of(path));
        }
        if queues.is_empty() {
            self.deliver_unaddressed(event);
        } else {
            push_all(&queues, event);
        }
    }

    /// Gives an event to the subscribers of this context, or else to nobody.
    pub(crate) fn deliver_only(&mut self, path: &Path, event: &Event) {
        let early = self.early_of(path);
        let known = self.by_path.get(path).into_iter().flatten();
        known.chain(&early).for_each(|queue| queue.push(event.clone()));
    }

    pub(crate) fn deliver_unaddressed(&self, event: Event) {
        if self.unaddressed.is_empty() {
            tracing::debug!(?event, "nobody subscribed");
        }
        push_all(&self.unaddressed, event);
    }

    /// Gives a question of the hub to those that answer questions; returns it if there are none.
    pub(crate) fn deliver_consult(&self, question: Event) -> Option<Event> {
        if self.consults.is_empty() {
            return Some(question);
        }
        push_all(&self.consults, question);
        None
    }

    /// Gives an event to every subscriber of all.
    pub(crate) fn deliver_all(&self, event: &Event) {
        let all = self
            .by_path
            .values()
            .flatten()
            .chain(self.early.values())
            .chain(&self.unaddressed);
        all.for_each(|queue| queue.push(event.clone()));
    }

    /// Ends the subscriptions of this context and all below it.
    pub(crate) fn close_within(&mut self, top: &Path) {
        self.early.retain(|path, _| !path.is_within(top));
        self.by_path.retain(|path, queues| {
            let ends = path.is_within(top);
            if ends {
                queues.iter().for_each(|queue| queue.close());
            }
            !ends
        });
    }

    pub(crate) fn close_all(&mut self) {
        self.close_within(&Path::root());
        let others = self.unaddressed.drain(..).chain(self.consults.drain(..));
        others.for_each(|queue| queue.close());
    }

    /// The queue that waits for a first subscriber; given up if that one does not come.
    fn early_of(&mut self, path: &Path) -> Option<Arc<EventQueue>> {
        let queue = self.early.get(path)?;
        if queue.is_full() {
            self.early.remove(path);
            return None;
        }
        Some(Arc::clone(queue))
    }
}

fn push_all(queues: &[Arc<EventQueue>], event: Event) {
    let Some((last, others)) = queues.split_last() else {
        return;
    };
    others.iter().for_each(|queue| queue.push(event.clone()));
    last.push(event);
}

fn weight(event: &Event) -> usize {
    let (Event::Message(parcel) | Event::Other(parcel) | Event::Dropped { parcel, .. }) = event else {
        return 0;
    };
    match &parcel.content {
        Some(Content::Encoded(bytes)) => bytes.len(),
        Some(Content::Packed(packed)) => packed.bytes().len(),
        Some(Content::Value(value)) => value_weight(value),
        None => 0,
    }
}

fn value_weight(value: &Value) -> usize {
    match value {
        Value::String(text) => text.len(),
        Value::Binary(bytes) => bytes.len(),
        Value::List(list) => list.iter().map(|item| 8 + value_weight(item)).sum(),
        Value::Map(map) => map
            .iter()
            .map(|(key, item)| 8 + key.len() + value_weight(item))
            .sum(),
        _ => 8,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(queue: &EventQueue) -> Vec<Event> {
        std::iter::from_fn(|| queue.take().ok()).collect()
    }

    fn check(most: usize, pushed: u64, expected: &[Event]) {
        let queue = EventQueue::new(most);
        (0..pushed).for_each(|number| queue.push(Event::Count(number)));
        assert_eq!(taken(&queue), expected, "{pushed} into {most}");
        assert_eq!(queue.waiting.lock().bytes, 0);
    }

    #[test]
    fn the_oldest_go_and_are_counted() {
        check(2, 2, &[Event::Count(0), Event::Count(1)]);
        check(2, 5, &[Event::Lagged(3), Event::Count(3), Event::Count(4)]);
        check(0, 2, &[Event::Lagged(1), Event::Count(1)]);
    }

    #[test]
    fn bytes_are_bounded_too() {
        let queue = EventQueue::new(10);
        let large = || {
            let content = bytes_of(MOST_BYTES / 2 + 1);
            Event::Message(mom_proto::Parcel::new(mom_proto::Family::Message, "image").content(content))
        };
        queue.push(large());
        queue.push(large());
        assert_eq!(queue.waiting.lock().events.len(), 1);
        assert!(matches!(queue.take(), Ok(Event::Lagged(1))));
    }

    fn bytes_of(length: usize) -> Value {
        Value::String("x".repeat(length))
    }

    #[test]
    fn what_came_before_the_first_subscriber_is_kept_up_to_a_bound() {
        let path = Path::parse("/chat").unwrap();
        for (early, kept, unaddressed) in [(3, 3, 0), (EARLY, EARLY, 0), (EARLY + 5, 0, 5)] {
            let mut subscribers = Subscribers::default();
            let others = subscribers.subscribe_unaddressed(1024);
            subscribers.keep_early(&path);
            for number in 0..early {
                subscribers.deliver(std::slice::from_ref(&path), Event::Count(number as u64));
            }
            let queue = subscribers.subscribe(&path, 1024);
            assert_eq!((taken(&queue).len(), taken(&others).len()), (kept, unaddressed));
            subscribers.deliver(std::slice::from_ref(&path), Event::Rejoined);
            assert_eq!(taken(&queue), [Event::Rejoined]);
            drop(queue);
            subscribers.close_within(&path);
            subscribers.deliver_only(&path, &Event::Rejoined);
            assert_eq!(taken(&others), [], "a context's own news is nobody else's");
        }
    }

    fn said(name: &str, sender: &str) -> Event {
        let mut parcel = mom_proto::Parcel::new(mom_proto::Family::Message, name);
        parcel.sender = Some(sender.into());
        Event::Message(parcel)
    }

    #[test]
    fn what_stops_a_device_is_never_dropped() {
        let queue = EventQueue::new(2);
        let safety = [
            said("stop", "bob"),
            said("halt", "hub"),
            said("unstop", "bob"),
            Event::LinkDown,
        ];
        safety.iter().for_each(|event| queue.push(event.clone()));
        (0..2000).for_each(|number| queue.push(said("note", &number.to_string())));
        let taken = taken(&queue);
        assert!(matches!(taken[0], Event::Lagged(1999)), "{:?}", taken[0]);
        assert_eq!(taken[1..5], safety, "in their order");
        assert_eq!(taken[5..], [said("note", "1999")]);
        assert_eq!(queue.waiting.lock().bytes, 0);
    }

    #[test]
    fn a_flood_of_stops_takes_no_room() {
        let queue = EventQueue::new(8);
        for _ in 0..10_000 {
            queue.push(said("stop", "bob"));
            queue.push(said("stop", "eve"));
        }
        assert_eq!(taken(&queue), [said("stop", "bob"), said("stop", "eve")]);
        // Not even where each is answered by an unstop.
        for _ in 0..10_000 {
            queue.push(said("stop", "bob"));
            queue.push(said("unstop", "bob"));
        }
        assert!(queue.waiting.lock().events.len() <= SAFETY + 1);
    }

    #[test]
    fn a_closed_queue_ends_after_what_waits() {
        let queue = EventQueue::new(4);
        queue.push(Event::LinkDown);
        queue.close();
        queue.push(Event::Rejoined);
        assert!(matches!(queue.take(), Ok(Event::LinkDown)));
        assert!(matches!(queue.take(), Err(Empty::ForEver)));
    }
}
