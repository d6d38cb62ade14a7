//! What waits to be sent over one connection.
//!
//! The hub and its clients send through the same queue. It has lanes (stop, signs of life, control, data by priority), cuts
//! large frames into chunks between which more urgent ones go, takes back what the link did not take, and is bounded in
//! bytes. Its user says by a [`DropPolicy`] what may no longer leave, and is told what was dropped and why.
//!
//! A writer asks [`Flow`](crate::Flow) how much the network has room for, [takes](SendQueue::take) a batch of that size,
//! [writes](write_batch) it, and [puts back](SendQueue::put_back) the rest.

mod again;
mod control_lane;
mod data_lane;
mod item;
mod ledger;
mod piece;
mod restart;
mod take;
#[cfg(test)]
mod tests;
mod write;

use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::Arc;

use mom_proto::codec::Form;
use mom_proto::{Delivery, Limit};

pub use item::{DropPolicy, DropReason, Item, Lane};
pub use ledger::{BadCount, Ledger, Rewound};
pub use piece::Piece;
pub use write::write_batch;

use again::Again;
use control_lane::{ControlLane, DataPlace};
use data_lane::DataLane;
use piece::Entry;

/// What became of an item that was put in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// It waits.
    Yes,
    /// It was dropped, as its class allows.
    Dropped,
    /// It may not be dropped and there is no capacity.
    Overflow,
}

/// What is left in a queue of which nothing may be written now.
#[derive(Debug)]
pub enum Rest<I> {
    /// Nothing, or something may be written.
    None,
    /// The network has no room for more.
    NoRoom,
    /// What goes next is not ready: this.
    Unready(Arc<I>),
}

/// The queue of one connection.
#[derive(Debug)]
pub struct SendQueue<I: Item, P> {
    form: Option<Form>,
    limit: usize,
    /// The largest parcel that the receiver takes, and the bytes that all its open streams together may announce.
    parcel: Limit,
    /// Stops, then signs of life.
    unpaced: VecDeque<Entry<I>>,
    control: ControlLane<I>,
    control_bytes: usize,
    data: BTreeMap<Reverse<i32>, DataLane<I>>,
    data_bytes: usize,
    /// Part of `data_bytes` that may not be dropped.
    reliable_bytes: usize,
    /// Where the waiting item of class `latest` of each key is.
    latest: HashMap<I::Key, (Reverse<i32>, u64)>,
    /// Items of which a part was given to the link; at most one of each urgency.
    open: Vec<Entry<I>>,
    /// Streams of chunks that the receiver has to be told to forget.
    aborts: VecDeque<u64>,
    /// What the link has taken a part of.
    begun: Option<Box<Piece<I>>>,
    /// The last word.
    last: Option<Arc<I>>,
    last_stream: u64,
    /// What is sent again after a loss, in its order, before all that waits.
    again: Again<I>,
    /// Data items that were ever put in.
    put: u64,
    policy: P,
}

impl<I: Item, P: DropPolicy<I>> SendQueue<I, P> {
    /// An empty queue for a link of this form (none inside a process) that is bounded to so many bytes.
    pub fn new(form: Option<Form>, limit: usize, policy: P) -> SendQueue<I, P> {
        SendQueue {
            form,
            limit,
            parcel: Limit::Unlimited,
            unpaced: VecDeque::new(),
            control: ControlLane::default(),
            control_bytes: 0,
            data: BTreeMap::new(),
            data_bytes: 0,
            reliable_bytes: 0,
            latest: HashMap::new(),
            open: Vec::new(),
            aborts: VecDeque::new(),
            begun: None,
            last: None,
            last_stream: 0,
            again: Again::default(),
            put: 0,
            policy,
        }
    }

    /// Puts an item in, at the end of its lane.
    pub fn push(&mut self, item: Arc<I>) -> Taken {
        self.push_up_to(item, self.limit)
    }

    /// As [`SendQueue::push`], where data that may not be dropped may take so many bytes, more than the bound for all else.
    pub fn push_up_to(&mut self, item: Arc<I>, most: usize) -> Taken {
        self.push_entry(Entry::new(item, 0), most)
    }

    /// Takes in the last word to a connection, however much waits: it leaves after all else.
    pub fn push_last(&mut self, item: Arc<I>) {
        self.last = Some(item);
    }

    /// Changes the bounds, as after login: of what waits, and of one parcel.
    pub fn set_limits(&mut self, limit: usize, parcel: Limit) {
        self.limit = limit;
        self.parcel = parcel;
    }

    /// Says in which form frames leave from now on, none inside a process.
    pub fn set_form(&mut self, form: Option<Form>) {
        self.form = form;
    }

    /// Whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.unpaced.is_empty()
            && self.aborts.is_empty()
            && self.control_bytes == 0
            && self.data_bytes == 0
            && self.control.is_empty()
            && self.again.is_empty()
            && self.last.is_none()
            && self.begun.is_none()
    }

    /// Whether something waits that pacing does not hold back.
    pub fn has_unpaced(&self) -> bool {
        !self.unpaced.is_empty()
    }

    /// The bytes of data and control that wait.
    pub fn bytes(&self) -> usize {
        self.data_bytes + self.control_bytes
    }

    /// The bytes of data that wait.
    pub fn data_bytes(&self) -> usize {
        self.data_bytes
    }

    /// The bytes of data that wait and may not be dropped.
    pub fn reliable_bytes(&self) -> usize {
        self.reliable_bytes
    }

    /// The data that waits, what was begun among it.
    pub fn data(&self) -> impl Iterator<Item = &I> {
        let waiting = self.data.values().flat_map(DataLane::iter);
        let begun = self.open.iter().chain(self.again.iter());
        let begun = begun.filter(|entry| matches!(entry.item.lane(), Lane::Data(_)));
        waiting.chain(begun).map(|entry| &*entry.item)
    }

    /// Whether data of this lane waits that has not begun.
    pub fn has_data_at(&self, lane: Lane) -> bool {
        match lane {
            Lane::Data(priority) => {
                let lane = self.data.get(&Reverse(priority));
                lane.is_some_and(|lane| lane.iter().next().is_some())
            }
            _ => false,
        }
    }

    /// The most bytes of data that may wait.
    pub fn limit(&self) -> usize {
        self.limit
    }

    /// The form in which frames leave.
    pub fn form(&self) -> Option<Form> {
        self.form
    }

    /// The bytes that an item counts while it waits here.
    pub fn charge(&self, item: &I) -> usize {
        item.charge(self.form)
    }

    /// The policy, to collect what it was told.
    pub fn policy(&mut self) -> &mut P {
        &mut self.policy
    }

    /// Tells the policy of an item that was dropped before it was put in.
    pub fn note_dropped(&mut self, item: &Arc<I>, reason: DropReason) {
        self.policy.dropped(item, u64::from(item.count()), reason);
    }

    /// Drops all data and gives it, for a connection that is to hear only why it ends. What the link has begun to take goes
    /// on.
    #[must_use = "freeing it takes its time, which is better done where nobody waits"]
    pub fn drop_data(&mut self) -> Vec<Arc<I>> {
        let data = std::mem::take(&mut self.data);
        let open = std::mem::take(&mut self.open);
        let waiting = data.into_values().flat_map(DataLane::into_entries);
        let again = self.again.take_all(|item| matches!(item.lane(), Lane::Data(_)));
        let mut dropped = Vec::new();
        for entry in waiting.chain(open).chain(again) {
            match entry.item.lane() {
                Lane::Data(_) => self.note(&entry, DropReason::Closed),
                _ => self.control_bytes = self.control_bytes.saturating_sub(self.charge(&entry.item)),
            }
            dropped.push(entry.item);
        }
        self.latest.clear();
        (self.data_bytes, self.reliable_bytes) = (0, 0);
        dropped
    }

    /// Drops all waiting data of which `goes` says so; gives it, and its bytes. What the link has begun to take goes on.
    #[must_use = "freeing it takes its time, which is better done where nobody waits"]
    pub fn drop_data_of(&mut self, reason: DropReason, goes: impl Fn(&I) -> bool) -> (Vec<Arc<I>>, usize) {
        let (mut dropped, mut freed) = (Vec::new(), 0);
        for entry in self
            .again
            .take_all(|item| matches!(item.lane(), Lane::Data(_)) && goes(item))
        {
            freed += self.charge(&entry.item);
            self.leave(&entry.item);
            self.note(&entry, reason);
            dropped.push(entry.item);
        }
        let priorities: Vec<Reverse<i32>> = self.data.keys().copied().collect();
        for priority in priorities {
            let Some(lane) = self.data.get_mut(&priority) else {
                continue;
            };
            for entry in lane.take_all(&goes) {
                let size = self.charge(&entry.item);
                freed += size;
                self.data_bytes -= size;
                self.reliable_bytes -= reliable(&*entry.item, size);
                if entry.item.delivery() == Delivery::Latest {
                    self.latest.remove(&entry.item.key());
                }
                self.note(&entry, reason);
                dropped.push(entry.item);
            }
            self.close_holes(priority);
        }
        (dropped, freed)
    }

    /// Forgets everything and gives it, because the peer is another one from now on: on this link, whose other end is
    /// told to forget what it has a part of, or on the next one.
    pub fn clear(&mut self, link_is_gone: bool) -> Vec<Arc<I>> {
        let data = std::mem::take(&mut self.data);
        let (again, control) = (self.again.take_all(|_| true), self.control.take_all(|_| true));
        let waiting = self.unpaced.drain(..).chain(again).chain(control);
        let waiting = waiting.chain(data.into_values().flat_map(DataLane::into_entries));
        let mut items: Vec<Arc<I>> = waiting.map(|entry| entry.item).collect();
        for entry in self.open.drain(..) {
            if entry.progress.stream > 0 {
                self.aborts.push_back(entry.progress.stream);
            }
            items.push(entry.item);
        }
        self.latest.clear();
        (self.control_bytes, self.data_bytes, self.reliable_bytes) = (0, 0, 0);
        if link_is_gone {
            self.aborts.clear();
            let begun = self.begun.take().filter(|piece| piece.last);
            items.extend(begun.and_then(|piece| piece.item));
        }
        items
    }

    fn push_entry(&mut self, entry: Entry<I>, most: usize) -> Taken {
        match entry.item.lane() {
            lane @ (Lane::Stop | Lane::Sign) => self.push_unpaced(entry, lane),
            Lane::Control => self.push_control(entry),
            Lane::Data(priority) => self.push_data(entry, Reverse(priority), most),
        }
    }

    // One stop is enough, and what the newest says of it is what counts. It withdraws an unstop that still waits: stops leave first,
    // so the later word would be undone by the earlier one.
    fn push_unpaced(&mut self, entry: Entry<I>, lane: Lane) -> Taken {
        if lane == Lane::Stop {
            self.drop_control(DropReason::Withdrawn, |waiting| entry.item.withdraws(waiting));
        }
        let older = self
            .unpaced
            .iter()
            .position(|waiting| entry.item.repeats(&waiting.item));
        if let Some(at) = older {
            let older = std::mem::replace(&mut self.unpaced[at], entry);
            self.note(&older, DropReason::Replaced);
        } else {
            let behind = self.unpaced.iter().position(|waiting| waiting.item.lane() < lane);
            self.unpaced.insert(behind.unwrap_or(self.unpaced.len()), entry);
        }
        Taken::Yes
    }

    // Control is never dropped for room, and has a bound of its own so that data cannot crowd it out.
    fn push_control(&mut self, mut entry: Entry<I>) -> Taken {
        let size = self.charge(&entry.item);
        if entry.item.waits_behind_data() {
            self.drop_control(DropReason::Replaced, |waiting| entry.item.repeats(waiting));
            entry.number = self.put;
            let behind = self.last_before(&entry.item);
            self.control_bytes += size;
            self.control.push(entry, behind);
            return Taken::Yes;
        }
        if self.control_bytes.saturating_add(size) > self.limit && !self.control.is_empty() {
            return Taken::Overflow;
        }
        self.control_bytes += size;
        self.control.push_ahead(entry);
        Taken::Yes
    }

    /// The last to leave of the data that an item of control follows.
    fn last_before(&self, item: &I) -> Option<DataPlace> {
        let lanes = self.data.iter();
        let waiting = lanes.flat_map(|(priority, lane)| lane.iter().map(move |entry| (*priority, entry)));
        let open = self.open.iter().filter_map(|entry| match entry.item.lane() {
            Lane::Data(priority) => Some((Reverse(priority), entry)),
            _ => None,
        });
        waiting
            .chain(open)
            .filter(|(_, entry)| item.follows(&entry.item))
            .map(|(priority, entry)| (priority, entry.number))
            .max()
    }

    /// Drops all waiting control of which `goes` says so.
    fn drop_control(&mut self, reason: DropReason, goes: impl Fn(&I) -> bool) {
        for entry in self.control.take_all(goes) {
            self.control_bytes -= self.charge(&entry.item);
            self.note(&entry, reason);
        }
    }

    fn push_data(&mut self, mut entry: Entry<I>, priority: Reverse<i32>, most: usize) -> Taken {
        let (delivery, size) = (entry.item.delivery(), self.charge(&entry.item));
        self.put += 1;
        entry.number = self.put;
        if delivery == Delivery::Latest {
            if self.replace_in_place(&entry, priority) {
                return Taken::Yes;
            }
            // It would push out what waits, the older value among it, and be dropped itself.
            if !self.can_fit(size) {
                self.note(&entry, DropReason::Full);
                return Taken::Dropped;
            }
            self.drop_older(&entry);
        }
        if !self.fits(size) && !self.make_room(delivery, size) {
            match delivery {
                Delivery::Reliable if self.data_bytes.saturating_add(size) <= most => {}
                Delivery::Reliable => return Taken::Overflow,
                Delivery::Latest | Delivery::Fleeting => {
                    self.note(&entry, DropReason::Full);
                    return Taken::Dropped;
                }
            }
        }
        self.data_bytes += size;
        self.reliable_bytes += reliable(&*entry.item, size);
        let key = (delivery == Delivery::Latest).then(|| entry.item.key());
        let number = self.data.entry(priority).or_default().push(Some(entry));
        if let Some(key) = key {
            self.latest.insert(key, (priority, number));
        }
        Taken::Yes
    }

    /// Whether so many bytes fit once all is dropped that may be.
    fn can_fit(&self, need: usize) -> bool {
        let stays = |open: &&Entry<I>| {
            matches!(open.item.lane(), Lane::Data(_)) && open.item.delivery() != Delivery::Reliable
        };
        if self.fits(need) {
            return true;
        }
        let begun = self.open.iter().filter(stays);
        let stay = self.reliable_bytes + begun.map(|open| self.charge(&open.item)).sum::<usize>();
        stay == 0 || stay.saturating_add(need) <= self.limit
    }

    /// Puts a newer value into the place of an older one that still waits at the same priority, if it fits there.
    fn replace_in_place(&mut self, entry: &Entry<I>, priority: Reverse<i32>) -> bool {
        let Some(&(waits_at, number)) = self.latest.get(&entry.item.key()) else {
            return false;
        };
        let place = self.data.get_mut(&waits_at).and_then(|lane| lane.place(number));
        let Some((place, old)) = place.and_then(|place| {
            let old = place.as_ref().map(|old| (old.number, old.item.charge(self.form)));
            old.map(|old| (place, old))
        }) else {
            return false;
        };
        let (old_number, old_size) = old;
        let bytes = self.data_bytes - old_size + entry.item.charge(self.form);
        // Not in front of what follows the older one.
        if waits_at != priority
            || self.control.holds_back_after(old_number)
            || (bytes > self.data_bytes && bytes > self.limit)
        {
            return false;
        }
        let newer = Entry::new(Arc::clone(&entry.item), old_number);
        let replaced = place.replace(newer);
        self.data_bytes = bytes;
        replaced
            .iter()
            .for_each(|entry| self.note(entry, DropReason::Replaced));
        true
    }

    /// Drops the older value whose place a newer one does not take.
    fn drop_older(&mut self, newer: &Entry<I>) {
        let Some((waits_at, number)) = self.latest.remove(&newer.item.key()) else {
            return;
        };
        let Some(lane) = self.data.get_mut(&waits_at) else {
            return;
        };
        if let Some(replaced) = lane.place(number).and_then(Option::take) {
            lane.holes += 1;
            self.data_bytes -= self.charge(&replaced.item);
            self.note(&replaced, DropReason::Replaced);
        }
        self.close_holes(waits_at);
    }

    /// Drops what may be dropped, the least urgent and oldest first, until there is room for an item of this class.
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
                    self.data_bytes -= self.charge(&dropped.item);
                    if class == Delivery::Latest {
                        self.latest.remove(&dropped.item.key());
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
        self.data_bytes == 0 || self.data_bytes.saturating_add(need) <= self.limit
    }

    /// Closes the holes of a lane once they are most of it, or a link that stands still would collect them.
    fn close_holes(&mut self, priority: Reverse<i32>) {
        let Some(lane) = self.data.get_mut(&priority) else {
            return;
        };
        for (number, entry) in lane.close_holes() {
            self.latest.insert(entry.item.key(), (priority, number));
        }
    }

    fn note(&mut self, entry: &Entry<I>, reason: DropReason) {
        let remaining = entry.remaining(self.form);
        self.policy.dropped(&entry.item, remaining, reason);
    }
}

/// How many of these bytes may not be dropped.
fn reliable<I: Item>(item: &I, size: usize) -> usize {
    match item.delivery() {
        Delivery::Reliable => size,
        Delivery::Latest | Delivery::Fleeting => 0,
    }
}
