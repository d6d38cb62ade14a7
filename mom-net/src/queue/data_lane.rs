//! What waits at one priority.

use std::collections::VecDeque;
use std::sync::Arc;

use mom_proto::Delivery;

use super::Item;
use super::piece::Entry;

/// Holes that a lane may keep before they are closed.
const HOLES: usize = 64;

/// One priority: holes are left where an entry was replaced or dropped, so that numbers stay.
#[derive(Debug)]
pub(super) struct DataLane<I> {
    /// The number of the entry in front; it goes down again where entries are put back.
    first: u64,
    pub(super) holes: usize,
    /// For each class, the number before which no entry of it waits: who looks for the first one looks at none twice.
    searched: [u64; Delivery::ALL.len()],
    entries: VecDeque<Option<Entry<I>>>,
}

impl<I> Default for DataLane<I> {
    fn default() -> DataLane<I> {
        DataLane {
            first: u64::MAX / 2,
            holes: 0,
            searched: [0; Delivery::ALL.len()],
            entries: VecDeque::new(),
        }
    }
}

impl<I: Item> DataLane<I> {
    /// Adds an entry at the end; gives its number.
    pub(super) fn push(&mut self, entry: Option<Entry<I>>) -> u64 {
        let number = self.first + self.entries.len() as u64;
        self.entries.push_back(entry);
        number
    }

    /// Adds an entry in front; gives its number.
    pub(super) fn push_front(&mut self, entry: Entry<I>) -> u64 {
        self.first -= 1;
        self.searched[entry.item.delivery() as usize] = self.first;
        self.entries.push_front(Some(entry));
        self.first
    }

    pub(super) fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// The number of places, holes included.
    #[cfg(test)]
    pub(super) fn places(&self) -> usize {
        self.entries.len()
    }

    /// The entry in front, without the holes before it.
    #[inline]
    pub(super) fn front(&mut self) -> Option<&Entry<I>> {
        while let Some(None) = self.entries.front() {
            self.entries.pop_front();
            self.first += 1;
            self.holes -= 1;
        }
        self.entries.front().and_then(Option::as_ref)
    }

    /// The same, to be changed.
    pub(super) fn front_mut(&mut self) -> Option<&mut Entry<I>> {
        self.front()?;
        self.entries.front_mut().and_then(Option::as_mut)
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Entry<I>> {
        self.entries.iter().flatten()
    }

    #[inline]
    pub(super) fn pop(&mut self) -> Option<Entry<I>> {
        self.front()?;
        self.first += 1;
        self.entries.pop_front().flatten()
    }

    /// Takes out the entry in front if it is this item.
    pub(super) fn pop_if(&mut self, item: &Arc<I>) -> Option<Entry<I>> {
        let is_front = self.front().is_some_and(|front| Arc::ptr_eq(&front.item, item));
        if is_front { self.pop() } else { None }
    }

    pub(super) fn place(&mut self, number: u64) -> Option<&mut Option<Entry<I>>> {
        let index = usize::try_from(number.checked_sub(self.first)?).ok()?;
        self.entries.get_mut(index)
    }

    /// Takes out the first entry of a class.
    pub(super) fn take_first(&mut self, class: Delivery) -> Option<Entry<I>> {
        let from = self.searched[class as usize].max(self.first);
        let from = usize::try_from(from - self.first).unwrap_or(usize::MAX);
        let of_class =
            |entry: &Option<Entry<I>>| entry.as_ref().is_some_and(|entry| entry.item.delivery() == class);
        let found = self.entries.iter().skip(from).position(of_class);
        let at = found.map_or(self.entries.len(), |found| from + found);
        self.searched[class as usize] = self.first + at as u64;
        let taken = self.entries.get_mut(at).and_then(Option::take);
        self.holes += usize::from(taken.is_some());
        taken
    }

    /// Takes out all entries of which `goes` says so.
    pub(super) fn take_all(&mut self, goes: impl Fn(&I) -> bool) -> Vec<Entry<I>> {
        let place = |place: &mut Option<Entry<I>>| match place {
            Some(entry) if goes(&entry.item) => place.take(),
            _ => None,
        };
        let taken: Vec<_> = self.entries.iter_mut().filter_map(place).collect();
        self.holes += taken.len();
        taken
    }

    /// Closes the holes once they are most of the lane; gives the entries of class `latest` that have a new number.
    pub(super) fn close_holes(&mut self) -> impl Iterator<Item = (u64, &Entry<I>)> {
        let due = self.holes >= HOLES && self.holes * 2 >= self.entries.len();
        if due {
            self.entries.retain(Option::is_some);
            self.holes = 0;
            self.searched = [self.first; Delivery::ALL.len()];
        }
        // Nothing is looked at while nothing is due: this is asked after each entry that is dropped.
        let moved = if due { self.entries.len() } else { 0 };
        (self.first..)
            .zip(self.entries.iter().take(moved).flatten())
            .filter(|(_, entry)| entry.item.delivery() == Delivery::Latest)
    }

    pub(super) fn into_entries(self) -> impl Iterator<Item = Entry<I>> {
        self.entries.into_iter().flatten()
    }
}
