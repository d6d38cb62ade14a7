//! Blobs in parts: those that are sent, and those that are put together (S13, S27).

use alloc::collections::VecDeque;
use alloc::vec;
use alloc::vec::Vec;

use crate::{FRAGMENT, Fragment, is_newer};

/// Blobs that can wait to be sent.
const WAITING: usize = 16;

/// A blob that is being sent.
struct Leaving {
    element: u8,
    blob: u16,
    bytes: Vec<u8>,
    offset: usize,
}

/// The blobs that wait to be sent, those of one element in order.
#[derive(Default)]
pub(super) struct Outgoing {
    waiting: VecDeque<Leaving>,
}

impl Outgoing {
    pub(super) fn is_full(&self) -> bool {
        self.waiting.len() >= WAITING
    }

    pub(super) fn push(&mut self, element: u8, blob: u16, bytes: Vec<u8>) {
        self.waiting.push_back(Leaving {
            element,
            blob,
            bytes,
            offset: 0,
        });
    }

    /// What waits for an element that is deactivated is not sent.
    pub(super) fn forget(&mut self, is_active: impl Fn(u8) -> bool) {
        self.waiting.retain(|leaving| is_active(leaving.element));
    }

    pub(super) fn clear(&mut self) {
        self.waiting.clear();
    }

    /// Hands the next part to `send`: of the blob that has the least to be sent, so that sound need not wait for a picture.
    pub(super) fn next<R>(&mut self, send: impl FnOnce(Fragment<'_>) -> R) -> Option<R> {
        let first = |place: usize, leaving: &Leaving| {
            let before = self.waiting.iter().take(place);
            before.into_iter().all(|other| other.element != leaving.element)
        };
        let all = self.waiting.iter().enumerate();
        let (place, _) = all
            .filter(|(place, leaving)| first(*place, leaving))
            .min_by_key(|(_, leaving)| leaving.bytes.len() - leaving.offset)?;
        let leaving = self.waiting.get_mut(place)?;
        let rest = leaving.bytes.get(leaving.offset..)?;
        let bytes = rest.get(..FRAGMENT).unwrap_or(rest);
        let fragment = Fragment {
            element: leaving.element,
            blob: leaving.blob,
            offset: leaving.offset as u32,
            total: leaving.bytes.len() as u32,
            bytes,
        };
        let result = send(fragment);
        leaving.offset += bytes.len();
        if leaving.offset >= leaving.bytes.len() {
            self.waiting.remove(place);
        }
        Some(result)
    }
}

/// The newest blob of an element.
pub(super) struct Incoming {
    blob: u16,
    total: u32,
    heard: Vec<u64>,
    /// Parts that lack; 0 for a blob that is complete, or given up.
    left: usize,
    bytes: Vec<u8>,
}

/// What a part has led to.
pub(super) enum Part {
    /// The blob lacks others.
    Kept,
    /// It was here already, or belongs to a blob that is over.
    Late,
    /// The blob is larger than is allowed.
    Large,
    /// It was the last.
    Complete(Vec<u8>),
}

impl Incoming {
    /// Bytes that it holds.
    pub(super) fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Adds a part; `lost` counts blobs that never became complete.
    pub(super) fn push(
        of: &mut Option<Incoming>,
        fragment: &Fragment<'_>,
        most: usize,
        lost: &mut u32,
    ) -> Part {
        let is_known = of.as_ref().is_some_and(|incoming| incoming.blob == fragment.blob);
        if !is_known {
            if let Some(older) = of {
                if !is_newer(fragment.blob, older.blob) {
                    return Part::Late;
                }
                *lost = lost.saturating_add(u32::from(older.left > 0));
            }
            let total = fragment.total as usize;
            let fits = total <= most;
            let parts = if fits { total.div_ceil(FRAGMENT) } else { 0 };
            *of = Some(Incoming {
                blob: fragment.blob,
                total: fragment.total,
                heard: vec![0; parts.div_ceil(64)],
                left: parts,
                bytes: vec![0; if fits { total } else { 0 }],
            });
            if !fits {
                *lost = lost.saturating_add(1);
                return Part::Large;
            }
        }
        of.as_mut().map_or(Part::Late, |incoming| incoming.add(fragment))
    }

    fn add(&mut self, fragment: &Fragment<'_>) -> Part {
        let place = fragment.place();
        let start = fragment.offset as usize;
        let bit = 1 << (place % 64);
        let Some(word) = self.heard.get_mut(place / 64).filter(|word| **word & bit == 0) else {
            return Part::Late;
        };
        if self.left == 0 || self.total != fragment.total {
            return Part::Late;
        }
        let Some(to) = self.bytes.get_mut(start..start + fragment.bytes.len()) else {
            return Part::Late;
        };
        to.copy_from_slice(fragment.bytes);
        *word |= bit;
        self.left -= 1;
        match self.left {
            0 => Part::Complete(core::mem::take(&mut self.bytes)),
            _ => Part::Kept,
        }
    }
}
