//! What is sent again after a loss: all of it in the order in which it was sent.

use std::collections::VecDeque;
use std::sync::Arc;

use super::piece::Entry;
use super::{Item, Lane};

/// The number of what is sent again.
pub(super) const AGAIN: u64 = u64::MAX - 1;

/// What the other side has not read of what was sent before. Most connections never have any.
#[derive(Debug)]
#[expect(
    clippy::box_collection,
    reason = "a queue is one of ten thousand, and has a pointer for this"
)]
pub(super) struct Again<I>(Option<Box<VecDeque<Entry<I>>>>);

impl<I> Default for Again<I> {
    fn default() -> Again<I> {
        Again(None)
    }
}

impl<I: Item> Again<I> {
    #[inline]
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_none()
    }

    pub(super) fn front(&self) -> Option<&Entry<I>> {
        self.0.as_ref()?.front()
    }

    /// Whether its last entry says to the other side that this is all.
    pub(super) fn has_end(&self) -> bool {
        let last = self.0.as_ref().and_then(|entries| entries.back());
        last.is_some_and(|last| !last.item.counts())
    }

    pub(super) fn pop(&mut self) -> Option<Entry<I>> {
        let entry = self.0.as_mut()?.pop_front();
        self.shrink();
        entry
    }

    pub(super) fn push_front(&mut self, entry: Entry<I>) {
        self.0.get_or_insert_default().push_front(entry);
    }

    pub(super) fn push(&mut self, entry: Entry<I>) {
        self.0.get_or_insert_default().push_back(entry);
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Entry<I>> {
        self.0.iter().flat_map(|entries| entries.iter())
    }

    pub(super) fn iter_mut(&mut self) -> impl Iterator<Item = &mut Entry<I>> {
        self.0.iter_mut().flat_map(|entries| entries.iter_mut())
    }

    /// The first of a lane.
    pub(super) fn first_of(&self, lane: Lane) -> Option<&Entry<I>> {
        self.iter().find(|entry| entry.item.lane() == lane)
    }

    /// Takes out the first of a lane.
    pub(super) fn take_first_of(&mut self, lane: Lane) -> Option<Entry<I>> {
        let entries = self.0.as_mut()?;
        let at = entries.iter().position(|entry| entry.item.lane() == lane)?;
        let entry = entries.remove(at);
        self.shrink();
        entry
    }

    /// Where this item is.
    pub(super) fn position(&self, item: &Arc<I>) -> Option<usize> {
        self.iter().position(|entry| Arc::ptr_eq(&entry.item, item))
    }

    /// Takes out this item.
    pub(super) fn remove(&mut self, item: &Arc<I>) -> Option<Entry<I>> {
        self.replace(self.position(item)?, std::iter::empty())
    }

    /// Puts others into the place of an entry; gives it.
    pub(super) fn replace(
        &mut self,
        at: usize,
        others: impl DoubleEndedIterator<Item = Entry<I>>,
    ) -> Option<Entry<I>> {
        let entries = self.0.as_mut()?;
        let entry = entries.remove(at);
        others.rev().for_each(|other| entries.insert(at, other));
        self.shrink();
        entry
    }

    /// Takes out all entries of which `goes` says so.
    pub(super) fn take_all(&mut self, goes: impl Fn(&I) -> bool) -> VecDeque<Entry<I>> {
        let Some(entries) = self.0.take() else {
            return VecDeque::new();
        };
        let (gone, kept) = entries.into_iter().partition(|entry| goes(&entry.item));
        self.0 = Some(Box::new(kept));
        self.shrink();
        gone
    }

    fn shrink(&mut self) {
        self.0.take_if(|entries| entries.is_empty());
    }
}
