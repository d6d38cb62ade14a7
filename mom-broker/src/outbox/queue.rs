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
#[derive(Debug)]
struct DataLane {
    /// The number of the entry in front; it goes down again where entries are put back.
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

    /// Puts back, in front, what was taken and could not be written: so that it is looked at again, and what
    /// is more urgent can overtake it.
    pub(crate) fn put_back(&mut self, entry: Entry) {
        match entry.lane {
            Lane::Stop => {
                if !self.stop.iter().any(|waiting| waiting.origin == entry.origin) {
                    self.stop.push_front(entry);
                }
            }
            Lane::Control => {
                let context = entry.origin.context;
                if &*entry.origin.name == event::UNSTOP
                    && self.stop.iter().any(|stop| stop.origin.context == context)
                {
                    return self.note(&entry.origin, DropReason::Replaced);
                }
                self.control_bytes += entry.size();
                self.control.push_front(entry);
            }
            Lane::Data(priority) => self.put_back_data(entry, Reverse(priority)),
        }
    }

    fn put_back_data(&mut self, entry: Entry, priority: Reverse<i32>) {
        let latest = entry.delivery == Delivery::Latest;
        if latest && self.latest.contains_key(&entry.origin) {
            return self.note(&entry.origin, DropReason::Replaced);
        }
        self.data_bytes += entry.size();
        let lane = self.data.entry(priority).or_default();
        lane.first -= 1;
        if latest {
            self.latest.insert(entry.origin.clone(), (priority, lane.first));
        }
        lane.entries.push_front(Some(entry));
    }

    /// Takes in the last word to a connection, however much waits: it leaves after all else.
    pub(crate) fn push_farewell(&mut self, entry: Entry) {
        self.data_bytes += entry.size();
        self.data
            .entry(Reverse(i32::MIN))
            .or_default()
            .entries
            .push_back(Some(entry));
    }

    /// Changes the bound, as after login.
    pub(crate) fn set_limit(&mut self, limit: usize) {
        self.limit = limit;
    }

    /// Forgets all messages, for a connection that is to hear only why it ends.
    pub(crate) fn drop_data(&mut self) {
        let data = std::mem::take(&mut self.data);
        for entry in data.into_values().flat_map(|lane| lane.entries).flatten() {
            self.note(&entry.origin, DropReason::Closed);
        }
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

    /// The bytes of messages, replies and events that wait.
    pub(crate) fn bytes(&self) -> usize {
        self.data_bytes + self.control_bytes
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

impl Default for DataLane {
    fn default() -> DataLane {
        DataLane {
            first: u64::MAX / 2,
            holes: 0,
            entries: VecDeque::new(),
        }
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
mod tests;
