//! An item on its way to a link.

use std::io::IoSlice;
use std::sync::Arc;

use mom_proto::binary;
use mom_proto::codec::{Encoded, Form};

use super::Item;
use crate::Part;

/// An item as it waits in one queue.
#[derive(Debug)]
pub(super) struct Entry<I> {
    pub(super) item: Arc<I>,
    /// Data: its place in the order in which data was put in. Control that waits behind data: the last data put in before it.
    pub(super) number: u64,
    pub(super) progress: Progress,
}

/// How much of an item was given to the link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Progress {
    /// Bytes of its frames, or, once it goes in chunks, of what the chunks carry.
    pub(super) sent: usize,
    /// The stream of its chunks; 0 for none.
    pub(super) stream: u64,
}

impl<I: Item> Entry<I> {
    pub(super) fn new(item: Arc<I>, number: u64) -> Entry<I> {
        Entry {
            item,
            number,
            progress: Progress::default(),
        }
    }

    pub(super) fn is_begun(&self) -> bool {
        self.progress != Progress::default()
    }

    /// The bytes of its frames; 0 inside a process.
    pub(super) fn length(&self, form: Option<Form>) -> usize {
        self.item.frames(form).map_or(0, Encoded::len)
    }

    /// How many parcels have not left yet.
    pub(super) fn remaining(&self, form: Option<Form>) -> u64 {
        match self.item.frames(form) {
            Some(frames) if self.item.count() > 1 => {
                let rest = frames.head.get(self.progress.sent..).unwrap_or_default();
                u64::from(binary::cut(rest, rest.len()).1)
            }
            _ => u64::from(self.item.count()),
        }
    }
}

/// What is given to the link at once: an item, or a part of one that others may follow.
#[derive(Debug)]
pub struct Piece<I> {
    /// None where a stream of chunks is given up.
    pub(super) item: Option<Arc<I>>,
    /// Its part of the item's frames.
    pub(super) part: Part,
    pub(super) number: u64,
    /// How far the item was before.
    pub(super) before: Progress,
    /// The stream that it belongs to; 0 for none.
    pub(super) stream: u64,
    /// Nothing of the item comes after it.
    pub(super) last: bool,
}

impl<I: Item> Piece<I> {
    /// All of an item.
    pub(super) fn whole(entry: Entry<I>, form: Option<Form>) -> Piece<I> {
        Piece {
            part: Part::plain(0..entry.length(form)),
            item: Some(entry.item),
            number: entry.number,
            before: entry.progress,
            stream: 0,
            last: true,
        }
    }

    /// Gives up a stream of chunks.
    pub(super) fn abort(stream: u64) -> Piece<I> {
        Piece {
            item: None,
            part: Part::abort(stream),
            number: 0,
            before: Progress::default(),
            stream,
            last: true,
        }
    }

    /// The item; none where a stream of chunks is given up.
    pub fn item(&self) -> Option<&Arc<I>> {
        self.item.as_ref()
    }

    /// The item, if nothing of it comes after this piece.
    pub fn into_last(self) -> Option<Arc<I>> {
        self.item.filter(|_| self.last)
    }

    /// Whether nothing of its item comes after it.
    pub fn is_last(&self) -> bool {
        self.last
    }

    /// Whether the link has taken a part of it.
    pub fn is_begun(&self) -> bool {
        self.part.is_begun()
    }

    /// The bytes that are not written yet.
    pub fn left(&self) -> usize {
        self.part.left()
    }

    /// Counts written bytes; gives back how many were not its own.
    pub fn advance(&mut self, written: usize) -> usize {
        self.part.advance(written)
    }

    /// Adds what is to be written of it.
    pub fn append_to<'a>(&'a self, form: Option<Form>, slices: &mut Vec<IoSlice<'a>>) {
        let frames = self.item.as_ref().and_then(|item| item.frames(form));
        self.part.append_to(frames, slices);
    }
}
