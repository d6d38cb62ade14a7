//! What waits for one peer: lanes, bounded in bytes, each way of being full with its name (design §7).

use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap, VecDeque};

use mom_managers::Micros;
use mom_proto::{ContextNumber, Delivery, event};

use super::entry::{DropReason, Entry, Lane, Origin};

/// What became of a parcel at the door.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Taken {
    /// It waits.
    Yes,
    /// It was dropped, as its class allows.
    Dropped,
    /// It may not be dropped and there is no room: the receiver is too slow.
    Overflow,
}

/// Holes that a lane may keep before they are closed.
const HOLES: usize = 64;

/// The queue of one peer.
#[derive(Debug)]
pub(crate) struct Queue {
    limit: usize,
    stop: VecDeque<Entry>,
    control: VecDeque<Entry>,
    control_bytes: usize,
    data: BTreeMap<Reverse<i32>, DataLane>,
    data_bytes: usize,
    latest: HashMap<Origin, (Reverse<i32>, u64)>,
    /// What was dropped since the last look: whose, why, how many.
    drops: BTreeMap<(ContextNumber, mom_hub::PeerId, DropReason), u64>,
}

/// One priority: holes are left where an entry was replaced or dropped, so that numbers stay.
#[derive(Debug, Default)]
struct DataLane {
    first: u64,
    holes: usize,
    entries: VecDeque<Option<Entry>>,
}

impl Queue {
    pub(crate) fn new(limit: usize) -> Queue {
        Queue {
            limit,
            stop: VecDeque::new(),
            control: VecDeque::new(),
            control_bytes: 0,
            data: BTreeMap::new(),
            data_bytes: 0,
            latest: HashMap::new(),
            drops: BTreeMap::new(),
        }
    }

    pub(crate) fn push(&mut self, entry: Entry) -> Taken {
        match entry.lane {
            Lane::Stop => self.push_stop(entry),
            Lane::Control => self.push_control(entry),
            Lane::Data(priority) => self.push_data(entry, Reverse(priority)),
        }
    }

    /// The next parcel for the link; what became stale on the way is dropped.
    pub(crate) fn pop(&mut self, now: Micros) -> Option<Entry> {
        loop {
            let entry = self.pop_any()?;
            match entry.stale(now) {
                None => return Some(entry),
                Some(reason) => self.note(&entry.origin, reason),
            }
        }
    }

    #[cfg(test)]
    pub(crate) fn is_empty(&self) -> bool {
        self.stop.is_empty() && self.control.is_empty() && self.data_bytes == 0
    }

    /// Forgets all messages, for a connection that is to hear only why it ends.
    pub(crate) fn drop_data(&mut self) {
        self.data.clear();
        self.latest.clear();
        self.data_bytes = 0;
    }

    /// What was dropped since the last call.
    pub(crate) fn take_drops(&mut self) -> BTreeMap<(ContextNumber, mom_hub::PeerId, DropReason), u64> {
        std::mem::take(&mut self.drops)
    }

    pub(crate) fn has_drops(&self) -> bool {
        !self.drops.is_empty()
    }

    /// The bytes of messages that wait.
    #[cfg(test)]
    pub(crate) fn data_bytes(&self) -> usize {
        self.data_bytes
    }

    // One pending per context: a second stop says nothing that the first does not. But it overrules an unstop
    // that still waits: stops leave first, so that would undo the later word by the earlier one.
    fn push_stop(&mut self, entry: Entry) -> Taken {
        let overruled = |waiting: &Entry| {
            waiting.origin.context == entry.origin.context && &*waiting.origin.name == event::UNSTOP
        };
        while let Some(at) = self.control.iter().position(overruled) {
            if let Some(unstop) = self.control.remove(at) {
                self.control_bytes -= unstop.size();
                self.note(&unstop.origin, DropReason::Replaced);
            }
        }
        let same = |waiting: &Entry| {
            waiting.origin.context == entry.origin.context && waiting.origin.name == entry.origin.name
        };
        if !self.stop.iter().any(same) {
            self.stop.push_back(entry);
        }
        Taken::Yes
    }

    // Control is never dropped, and has a bound of its own so that data cannot crowd it out.
    fn push_control(&mut self, entry: Entry) -> Taken {
        if self.control_bytes + entry.size() > self.limit && !self.control.is_empty() {
            return Taken::Overflow;
        }
        self.control_bytes += entry.size();
        self.control.push_back(entry);
        Taken::Yes
    }

    fn push_data(&mut self, entry: Entry, priority: Reverse<i32>) -> Taken {
        if entry.delivery == Delivery::Latest && self.replace(&entry, priority) {
            return Taken::Yes;
        }
        if !self.fits(entry.size()) && !self.make_room(&entry) {
            return match entry.delivery {
                Delivery::Reliable => Taken::Overflow,
                Delivery::Latest | Delivery::Fleeting => {
                    self.note(&entry.origin, DropReason::Full);
                    Taken::Dropped
                }
            };
        }
        self.data_bytes += entry.size();
        let lane = self.data.entry(priority).or_default();
        if entry.delivery == Delivery::Latest {
            let number = lane.first + lane.entries.len() as u64;
            self.latest.insert(entry.origin.clone(), (priority, number));
        }
        lane.entries.push_back(Some(entry));
        Taken::Yes
    }

    /// Puts a newer value into the place of an older one that still waits at the same priority.
    fn replace(&mut self, entry: &Entry, priority: Reverse<i32>) -> bool {
        let Some(&(waits_at, number)) = self.latest.get(&entry.origin) else {
            return false;
        };
        let Some(place) = self.data.get_mut(&waits_at).and_then(|lane| lane.place(number)) else {
            return false;
        };
        let Some(old) = place.as_ref().map(Entry::size) else {
            return false;
        };
        if waits_at != priority {
            // Another priority is another place: the older value goes, the newer queues up there.
            *place = None;
            self.data_bytes -= old;
            self.latest.remove(&entry.origin);
            self.note(&entry.origin, DropReason::Replaced);
            if let Some(lane) = self.data.get_mut(&waits_at) {
                lane.holes += 1;
            }
            self.close_holes(waits_at);
            return false;
        }
        if self.data_bytes - old + entry.size() > self.limit {
            return false;
        }
        self.data_bytes = self.data_bytes - old + entry.size();
        *place = Some(entry.clone());
        self.note(&entry.origin, DropReason::Replaced);
        true
    }

    /// Drops what may be dropped, the least urgent and oldest first, until the entry fits.
    fn make_room(&mut self, entry: &Entry) -> bool {
        let need = entry.size();
        for class in [Delivery::Fleeting, Delivery::Latest] {
            // What may be dropped itself pushes out its own class at most.
            if entry.delivery == Delivery::Fleeting && class == Delivery::Latest {
                break;
            }
            let priorities: Vec<Reverse<i32>> = self.data.keys().rev().copied().collect();
            for priority in priorities {
                while !self.fits(need) {
                    let Some(dropped) = self
                        .data
                        .get_mut(&priority)
                        .and_then(|lane| lane.take_first(class))
                    else {
                        break;
                    };
                    self.data_bytes -= dropped.size();
                    if class == Delivery::Latest {
                        self.latest.remove(&dropped.origin);
                    }
                    self.note(&dropped.origin, DropReason::Full);
                    self.close_holes(priority);
                }
            }
        }
        self.fits(need)
    }

    /// Whether so many bytes may be added. An empty queue takes anything: one parcel may be larger than the
    /// bound, and its receiver is not slow for that.
    fn fits(&self, need: usize) -> bool {
        self.data_bytes == 0 || self.data_bytes + need <= self.limit
    }

    /// Closes the holes of a lane once they are most of it, or a link that stands still would collect them.
    fn close_holes(&mut self, priority: Reverse<i32>) {
        let Some(lane) = self.data.get_mut(&priority) else {
            return;
        };
        if lane.holes < HOLES || lane.holes * 2 < lane.entries.len() {
            return;
        }
        lane.entries.retain(Option::is_some);
        lane.holes = 0;
        for (number, entry) in (lane.first..).zip(lane.entries.iter().flatten()) {
            if entry.delivery == Delivery::Latest {
                self.latest.insert(entry.origin.clone(), (priority, number));
            }
        }
    }

    fn pop_any(&mut self) -> Option<Entry> {
        if let Some(stop) = self.stop.pop_front() {
            return Some(stop);
        }
        if let Some(control) = self.control.pop_front() {
            self.control_bytes -= control.size();
            return Some(control);
        }
        self.pop_data()
    }

    fn pop_data(&mut self) -> Option<Entry> {
        // The lane of the default priority stays, to be filled again; others go when they are empty.
        while let Some((priority, lane)) = self.data.iter_mut().find(|(_, lane)| !lane.entries.is_empty()) {
            let priority = *priority;
            let popped = lane.pop();
            if lane.entries.is_empty() && priority != Reverse(0) {
                self.data.remove(&priority);
            }
            if let Some(entry) = popped {
                self.data_bytes -= entry.size();
                if entry.delivery == Delivery::Latest {
                    self.latest.remove(&entry.origin);
                }
                return Some(entry);
            }
        }
        None
    }

    fn note(&mut self, origin: &Origin, reason: DropReason) {
        *self
            .drops
            .entry((origin.context, origin.sender, reason))
            .or_default() += 1;
    }
}

impl DataLane {
    fn pop(&mut self) -> Option<Entry> {
        while let Some(entry) = self.entries.pop_front() {
            self.first += 1;
            if entry.is_some() {
                return entry;
            }
            self.holes -= 1;
        }
        None
    }

    fn place(&mut self, number: u64) -> Option<&mut Option<Entry>> {
        let index = usize::try_from(number.checked_sub(self.first)?).ok()?;
        self.entries.get_mut(index)
    }

    fn take_first(&mut self, class: Delivery) -> Option<Entry> {
        let of_class =
            |entry: &&mut Option<Entry>| entry.as_ref().is_some_and(|entry| entry.delivery == class);
        let taken = self.entries.iter_mut().find(of_class).and_then(Option::take);
        self.holes += usize::from(taken.is_some());
        taken
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU64, Ordering};

    use bytes::Bytes;
    use mom_hub::PeerId;
    use mom_net::Outgoing;
    use mom_proto::codec::Encoded;

    use super::*;

    /// 936 bytes and the queue's own 64 make 1000.
    const SIZE: usize = 936;

    fn entry(name: &str, lane: Lane, delivery: Delivery) -> Entry {
        let head = Bytes::from(name.as_bytes().repeat(SIZE)[..SIZE].to_vec());
        let origin = Origin {
            context: ContextNumber(1),
            sender: PeerId(1),
            name: name.into(),
        };
        let frame = Outgoing::Encoded(Encoded {
            head,
            body: Bytes::new(),
        });
        Entry {
            frame,
            lane,
            delivery,
            origin,
            expires_at: None,
            gate: None,
        }
    }

    fn data(name: &str, delivery: Delivery) -> Entry {
        entry(name, Lane::Data(0), delivery)
    }

    fn names(queue: &mut Queue) -> Vec<String> {
        std::iter::from_fn(|| queue.pop(0))
            .map(|entry| entry.origin.name.to_string())
            .collect()
    }

    #[test]
    fn lanes_leave_in_their_order() {
        let mut queue = Queue::new(100_000);
        for (name, lane) in [
            ("low", Lane::Data(-1)),
            ("first", Lane::Data(0)),
            ("second", Lane::Data(0)),
            ("high", Lane::Data(7)),
            ("reply", Lane::Control),
            ("stop", Lane::Stop),
            ("stop", Lane::Stop),
        ] {
            assert_eq!(queue.push(entry(name, lane, Delivery::Reliable)), Taken::Yes);
        }
        assert_eq!(
            names(&mut queue),
            ["stop", "reply", "high", "first", "second", "low"]
        );
        assert!(queue.is_empty());
    }

    #[test]
    fn a_full_queue_drops_by_class() {
        let mut queue = Queue::new(3000);
        for name in ["a", "b", "c"] {
            assert_eq!(queue.push(data(name, Delivery::Fleeting)), Taken::Yes);
        }
        assert_eq!(
            queue.push(data("d", Delivery::Fleeting)),
            Taken::Yes,
            "the oldest went"
        );
        assert_eq!(
            queue.push(data("l", Delivery::Latest)),
            Taken::Yes,
            "fleeting makes room"
        );
        assert_eq!(queue.push(data("r", Delivery::Reliable)), Taken::Yes);
        assert_eq!(queue.push(data("r", Delivery::Reliable)), Taken::Yes);
        assert_eq!(
            queue.push(data("f", Delivery::Fleeting)),
            Taken::Dropped,
            "latest is not dropped for fleeting"
        );
        assert_eq!(
            queue.push(data("r", Delivery::Reliable)),
            Taken::Yes,
            "latest is dropped for reliable"
        );
        assert_eq!(queue.push(data("r", Delivery::Reliable)), Taken::Overflow);
        assert_eq!(queue.data_bytes(), 3000);
        assert_eq!(queue.take_drops().values().sum::<u64>(), 6);
        assert_eq!(names(&mut queue), ["r", "r", "r"]);
        assert_eq!(queue.data_bytes(), 0);
    }

    #[test]
    fn latest_replaces_in_place() {
        let mut queue = Queue::new(3000);
        queue.push(data("pose", Delivery::Latest));
        queue.push(data("chat", Delivery::Reliable));
        for _ in 0..1000 {
            assert_eq!(queue.push(data("pose", Delivery::Latest)), Taken::Yes);
        }
        assert_eq!(queue.data_bytes(), 2000);
        assert_eq!(names(&mut queue), ["pose", "chat"]);
        assert!(queue.latest.is_empty());
        let drops: Vec<_> = queue.take_drops().into_iter().collect();
        assert_eq!(
            drops,
            [((ContextNumber(1), PeerId(1), DropReason::Replaced), 1000)]
        );
    }

    #[test]
    fn stale_parcels_do_not_leave() {
        let mut queue = Queue::new(10_000);
        let gate = Arc::new(AtomicU64::new(7));
        let guarded = Entry {
            gate: Some((Arc::clone(&gate), 7)),
            ..data("command", Delivery::Reliable)
        };
        queue.push(guarded.clone());
        queue.push(Entry {
            expires_at: Some(50),
            ..data("old", Delivery::Reliable)
        });
        queue.push(data("chat", Delivery::Reliable));
        assert_eq!(
            queue.pop(49).map(|entry| entry.origin.name.to_string()),
            Some("command".into())
        );
        queue.push(guarded);
        gate.store(8, Ordering::Release);
        assert_eq!(
            queue.pop(50).map(|entry| entry.origin.name.to_string()),
            Some("chat".into())
        );
        assert!(queue.pop(50).is_none());
        let reasons: Vec<_> = queue
            .take_drops()
            .into_keys()
            .map(|(_, _, reason)| reason)
            .collect();
        assert_eq!(reasons, [DropReason::Expired, DropReason::Fence]);
    }

    /// Whatever waits in which order, a device that was stopped last stays stopped.
    #[test]
    fn a_stop_overrules_an_unstop_that_waits() {
        let mut queue = Queue::new(100_000);
        let stop = entry("stop", Lane::Stop, Delivery::Reliable);
        let unstop = entry("unstop", Lane::Control, Delivery::Reliable);
        for each in [&stop, &unstop, &stop] {
            assert_eq!(queue.push(each.clone()), Taken::Yes);
        }
        assert_eq!(names(&mut queue), ["stop"]);
        assert_eq!(queue.take_drops().values().sum::<u64>(), 1, "the unstop is told");
        queue.push(stop.clone());
        queue.push(unstop.clone());
        assert_eq!(names(&mut queue), ["stop", "unstop"]);
        queue.push(unstop);
        queue.push(Entry {
            origin: Origin {
                context: ContextNumber(2),
                ..stop.origin.clone()
            },
            ..stop
        });
        assert_eq!(names(&mut queue), ["stop", "unstop"], "of another channel");
    }

    /// A parcel may be larger than the bound; a receiver that is not behind gets it.
    #[test]
    fn an_empty_queue_takes_any_parcel() {
        for class in [Delivery::Reliable, Delivery::Latest, Delivery::Fleeting] {
            let mut queue = Queue::new(900);
            assert_eq!(queue.push(data("large", class)), Taken::Yes, "{class:?}");
            assert_eq!(
                queue.push(data("more", Delivery::Reliable)),
                match class {
                    Delivery::Reliable => Taken::Overflow,
                    _ => Taken::Yes,
                }
            );
        }
    }

    /// What was dropped leaves nothing behind, however long the link stands still.
    #[test]
    fn a_queue_that_stands_still_does_not_grow() {
        let mut queue = Queue::new(3000);
        queue.push(data("first", Delivery::Reliable));
        for turn in 0..10_000 {
            queue.push(data("fleeting", Delivery::Fleeting));
            queue.push(entry("pose", Lane::Data(turn % 2), Delivery::Latest));
        }
        let places: usize = queue.data.values().map(|lane| lane.entries.len()).sum();
        assert!(places < 500, "{places} places for 3 parcels");
        assert_eq!(
            queue.pop(0).map(|entry| entry.origin.name.to_string()).as_deref(),
            Some("pose")
        );
    }
}
