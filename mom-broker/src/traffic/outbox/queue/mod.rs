//! What waits for one peer: lanes, bounded in bytes, each way of being full with its name (design §7).

mod lane;
mod line;
mod take;
mod thin;
mod turns;

use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::Arc;

use mom_proto::codec::Form;
use mom_proto::{Delivery, Limit, event};

use super::packet::{DropReason, Dropped, Entry, Lane, Origin, Packet};

use lane::DataLane;
use line::Line;
use turns::Turns;

/// What became of a parcel at the door.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Taken {
    /// It waits.
    Yes,
    /// It waits for its turn, and there is nothing to write before that.
    Later,
    /// It was dropped, as its class allows.
    Dropped,
    /// It may not be dropped and there is no room: the receiver is too slow.
    Overflow,
}

/// The queue of one peer.
#[derive(Debug)]
pub(crate) struct Queue {
    form: Option<Form>,
    limit: usize,
    /// The largest parcel that the receiver takes; all that go to it in chunks at a time together too.
    parcel: Limit,
    stop: VecDeque<Entry>,
    control: VecDeque<Entry>,
    control_bytes: usize,
    data: BTreeMap<Reverse<i32>, DataLane>,
    data_bytes: usize,
    /// Of which may not be dropped.
    reliable_bytes: usize,
    /// Who waits for room; most of the time there is none.
    line: Option<Box<Line>>,
    latest: HashMap<Origin, (Reverse<i32>, u64)>,
    /// What waits for its turn, where the receiver wants so many in a time.
    turns: Option<Box<Turns>>,
    /// Of which a part was given to the link; at most one of each urgency.
    open: Vec<Entry>,
    /// Streams of chunks that the receiver has to be told to forget.
    aborts: VecDeque<(Arc<Packet>, u64)>,
    last_stream: u64,
    /// The last word, and whether it still waits.
    farewell: Option<(Arc<Packet>, bool)>,
    /// What was dropped since the last look, and how many.
    drops: BTreeMap<Dropped, u64>,
}

impl Queue {
    pub(crate) fn new(form: Option<Form>, limit: usize) -> Queue {
        Queue {
            form,
            limit,
            parcel: Limit::Unlimited,
            stop: VecDeque::new(),
            control: VecDeque::new(),
            control_bytes: 0,
            data: BTreeMap::new(),
            data_bytes: 0,
            reliable_bytes: 0,
            line: None,
            latest: HashMap::new(),
            turns: None,
            open: Vec::new(),
            aborts: VecDeque::new(),
            last_stream: 0,
            farewell: None,
            drops: BTreeMap::new(),
        }
    }

    pub(crate) fn push(&mut self, packet: Arc<Packet>) -> Taken {
        let entry = Entry::new(packet);
        match entry.packet.lane {
            Lane::Stop => self.push_stop(entry),
            Lane::Control => self.push_control(entry),
            Lane::Data(priority) => self.push_data(entry, Reverse(priority)),
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.stop.is_empty()
            && self.aborts.is_empty()
            && self.control_bytes == 0
            && self.data_bytes == 0
            && self.control.is_empty()
            && !self.farewell.as_ref().is_some_and(|(_, waits)| *waits)
    }

    /// Takes in the last word to a connection, however much waits: it leaves after all else.
    pub(crate) fn push_farewell(&mut self, packet: Arc<Packet>) {
        self.farewell = Some((packet, true));
    }

    /// Changes the bounds, as after login: of what waits, and of one parcel.
    pub(crate) fn set_limits(&mut self, limit: usize, parcel: Limit) {
        self.limit = limit;
        self.parcel = parcel;
    }

    /// Forgets all messages, for a connection that is to hear only why it ends.
    pub(crate) fn drop_data(&mut self) {
        let data = std::mem::take(&mut self.data);
        let open = std::mem::take(&mut self.open);
        let waiting = data.into_values().flat_map(DataLane::into_entries);
        for entry in waiting.chain(open) {
            match entry.packet.lane {
                Lane::Data(_) => self.note(&entry, DropReason::Closed),
                _ => self.control_bytes = self.control_bytes.saturating_sub(self.size(&entry.packet)),
            }
        }
        self.latest.clear();
        (self.data_bytes, self.reliable_bytes) = (0, 0);
        self.drop_turns(None);
    }

    /// What was dropped since the last call.
    pub(crate) fn take_drops(&mut self) -> BTreeMap<Dropped, u64> {
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
            waiting.packet.origin.context == entry.packet.origin.context
                && &*waiting.packet.origin.name == event::UNSTOP
        };
        while let Some(at) = self.control.iter().position(overruled) {
            if let Some(unstop) = self.control.remove(at) {
                self.control_bytes -= self.size(&unstop.packet);
                self.note(&unstop, DropReason::Replaced);
            }
        }
        let same = |waiting: &Entry| {
            waiting.packet.origin.context == entry.packet.origin.context
                && waiting.packet.origin.name == entry.packet.origin.name
        };
        if !self.stop.iter().any(same) {
            self.stop.push_back(entry);
        }
        Taken::Yes
    }

    // Control is never dropped, and has a bound of its own so that data cannot crowd it out.
    fn push_control(&mut self, entry: Entry) -> Taken {
        let size = self.size(&entry.packet);
        if self.control_bytes + size > self.limit && !self.control.is_empty() {
            return Taken::Overflow;
        }
        self.control_bytes += size;
        self.control.push_back(entry);
        Taken::Yes
    }

    fn push_data(&mut self, entry: Entry, priority: Reverse<i32>) -> Taken {
        let (delivery, size) = (entry.packet.delivery, self.size(&entry.packet));
        if delivery == Delivery::Latest && self.replace(&entry, priority) {
            return Taken::Yes;
        }
        if !self.fits(size) && !self.make_room(delivery, size) {
            return match delivery {
                Delivery::Reliable => Taken::Overflow,
                Delivery::Latest | Delivery::Fleeting => {
                    self.note(&entry, DropReason::Full);
                    Taken::Dropped
                }
            };
        }
        self.data_bytes += size;
        self.reliable_bytes += reliable(&entry.packet, size);
        let origin = (delivery == Delivery::Latest).then(|| entry.packet.origin.clone());
        let number = self.data.entry(priority).or_default().push(Some(entry));
        if let Some(origin) = origin {
            self.latest.insert(origin, (priority, number));
        }
        Taken::Yes
    }

    /// Puts a newer value into the place of an older one that still waits at the same priority.
    fn replace(&mut self, entry: &Entry, priority: Reverse<i32>) -> bool {
        let origin = &entry.packet.origin;
        let (form, limit) = (self.form, self.limit);
        let Some(&(waits_at, number)) = self.latest.get(origin) else {
            return false;
        };
        let Some(place) = self.data.get_mut(&waits_at).and_then(|lane| lane.place(number)) else {
            return false;
        };
        let Some(old) = place.as_ref().map(|old| size(&old.packet, form)) else {
            return false;
        };
        if waits_at != priority {
            // Another priority is another place: the older value goes, the newer queues up there.
            let replaced = place.take();
            self.data_bytes -= old;
            self.latest.remove(origin);
            replaced
                .iter()
                .for_each(|entry| self.note(entry, DropReason::Replaced));
            if let Some(lane) = self.data.get_mut(&waits_at) {
                lane.holes += 1;
            }
            self.close_holes(waits_at);
            return false;
        }
        let new = size(&entry.packet, form);
        if self.data_bytes - old + new > limit {
            return false;
        }
        let replaced = place.replace(entry.clone());
        self.data_bytes = self.data_bytes - old + new;
        replaced
            .iter()
            .for_each(|entry| self.note(entry, DropReason::Replaced));
        true
    }

    /// Drops what may be dropped, the least urgent and oldest first, until there is room for a parcel of this class.
    fn make_room(&mut self, delivery: Delivery, need: usize) -> bool {
        for class in [Delivery::Fleeting, Delivery::Latest] {
            // What may be dropped itself pushes out its own class at most.
            if delivery == Delivery::Fleeting && class == Delivery::Latest {
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
                    self.data_bytes -= self.size(&dropped.packet);
                    if class == Delivery::Latest {
                        self.latest.remove(&dropped.packet.origin);
                    }
                    self.note(&dropped, DropReason::Full);
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
        for (number, entry) in lane.close_holes() {
            self.latest
                .insert(entry.packet.origin.clone(), (priority, number));
        }
    }

    fn size(&self, packet: &Packet) -> usize {
        size(packet, self.form)
    }

    fn note(&mut self, entry: &Entry, reason: DropReason) {
        let origin = &entry.packet.origin;
        let key = Dropped {
            context: origin.context,
            sender: origin.sender,
            reason,
            class: entry.packet.delivery,
        };
        *self.drops.entry(key).or_default() += entry.remaining(self.form);
    }
}

/// The bytes that count against the bound.
fn size(packet: &Packet, form: Option<Form>) -> usize {
    packet.charge(form)
}

/// How many of these bytes may not be dropped.
fn reliable(packet: &Packet, size: usize) -> usize {
    match packet.delivery {
        Delivery::Reliable => size,
        Delivery::Latest | Delivery::Fleeting => 0,
    }
}

#[cfg(test)]
mod lined;

#[cfg(test)]
mod tests;

#[cfg(test)]
mod thinned;
