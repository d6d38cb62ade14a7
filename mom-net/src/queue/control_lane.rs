//! What is urgent, in its order; some of it waits behind data that was put in before.

use std::cmp::Reverse;
use std::collections::VecDeque;
use std::sync::Arc;

use super::Item;
use super::piece::Entry;

/// A place in the order in which data leaves: the later, the greater.
pub(super) type DataPlace = (Reverse<i32>, u64);

/// Requests, replies, events and the like.
#[derive(Debug)]
pub(super) struct ControlLane<I> {
    entries: VecDeque<ControlEntry<I>>,
}

#[derive(Debug)]
struct ControlEntry<I> {
    entry: Entry<I>,
    /// The last of the data before it that it waits behind; what leaves before that goes before it, too.
    behind: Option<DataPlace>,
}

impl<I> Default for ControlLane<I> {
    fn default() -> ControlLane<I> {
        ControlLane {
            entries: VecDeque::new(),
        }
    }
}

impl<I: Item> ControlLane<I> {
    /// Adds an entry at the end, behind this data.
    pub(super) fn push(&mut self, entry: Entry<I>, behind: Option<DataPlace>) {
        self.entries.push_back(ControlEntry { entry, behind });
    }

    /// Adds an entry that waits behind nothing before the first that waits behind data, if it overtakes that and all after it, else
    /// at the end.
    pub(super) fn push_ahead(&mut self, entry: Entry<I>) {
        // It is looked at where there is something to overtake only.
        let last = self.entries.back();
        if !last.is_some_and(|last| entry.item.overtakes(&last.entry.item)) {
            return self.push(entry, None);
        }
        let waiting = self.entries.iter().position(|earlier| earlier.behind.is_some());
        let overtakes = |at: &usize| {
            let mut later = self.entries.range(*at..);
            later.all(|earlier| entry.item.overtakes(&earlier.entry.item))
        };
        let at = waiting.filter(overtakes).unwrap_or(self.entries.len());
        self.entries.insert(at, ControlEntry { entry, behind: None });
    }

    /// Adds an entry in front, behind nothing.
    pub(super) fn push_front(&mut self, entry: Entry<I>) {
        self.entries.push_front(ControlEntry { entry, behind: None });
    }

    #[inline]
    pub(super) fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// The entry in front.
    #[inline]
    pub(super) fn front(&self) -> Option<&Entry<I>> {
        self.entries.front().map(|control| &control.entry)
    }

    /// The number of the entry in front, and what it waits behind.
    #[inline]
    pub(super) fn front_place(&self) -> Option<(u64, Option<DataPlace>)> {
        let front = self.entries.front()?;
        Some((front.entry.number, front.behind))
    }

    pub(super) fn pop(&mut self) -> Option<Entry<I>> {
        let control = self.entries.pop_front();
        // Most peers hear what they are told at login and no more for a long time.
        if self.entries.is_empty() {
            self.entries = VecDeque::new();
        }
        control.map(|control| control.entry)
    }

    /// Takes out the entry in front if it is this item.
    pub(super) fn pop_if(&mut self, item: &Arc<I>) -> Option<Entry<I>> {
        let is_front = self.front().is_some_and(|front| Arc::ptr_eq(&front.item, item));
        if is_front { self.pop() } else { None }
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Entry<I>> {
        self.entries.iter().map(|control| &control.entry)
    }

    /// Takes out all entries of which `goes` says so.
    pub(super) fn take_all(&mut self, goes: impl Fn(&I) -> bool) -> Vec<Entry<I>> {
        let mut taken = Vec::new();
        if self.iter().any(|entry| goes(&entry.item)) {
            let (gone, kept): (VecDeque<_>, VecDeque<_>) = self
                .entries
                .drain(..)
                .partition(|control| goes(&control.entry.item));
            self.entries = kept;
            taken.extend(gone.into_iter().map(|control| control.entry));
        }
        taken
    }

    /// Has those wait behind an entry of data that follow it, as it comes back.
    pub(super) fn note_back(&mut self, data: &Entry<I>, priority: Reverse<i32>) {
        for control in &mut self.entries {
            let item = &control.entry.item;
            if control.entry.number >= data.number && item.waits_behind_data() && item.follows(&data.item) {
                control.behind = control.behind.max(Some((priority, data.number)));
            }
        }
    }

    /// Whether one waits that data with a higher number than this must not go before.
    pub(super) fn holds_back_after(&self, number: u64) -> bool {
        let waits = |control: &ControlEntry<I>| control.behind.is_some() && control.entry.number >= number;
        self.entries.iter().any(waits)
    }
}
