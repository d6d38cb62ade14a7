//! Blobs put together, for robots that want them whole.

use crate::{FRAGMENT, Fragment};

/// Puts the blobs of one element together, one at a time, each at most `BYTES` and 256 fragments (120 KiB) long. A newer blob takes the
/// place of one that is not complete.
#[derive(Clone, Debug)]
pub struct Assembly<const BYTES: usize> {
    blob: Option<(u16, u32)>,
    heard: [u64; 4],
    left: usize,
    /// Blobs that were given up because a newer one came, or were too large.
    dropped: u32,
    bytes: [u8; BYTES],
}

impl<const BYTES: usize> Default for Assembly<BYTES> {
    fn default() -> Self {
        Assembly {
            blob: None,
            heard: [0; 4],
            left: 0,
            dropped: 0,
            bytes: [0; BYTES],
        }
    }
}

impl<const BYTES: usize> Assembly<BYTES> {
    /// Adds a part; the blob when it was the last that lacked.
    pub fn push(&mut self, fragment: &Fragment<'_>) -> Option<&[u8]> {
        let key = (fragment.blob, fragment.total);
        let total = fragment.total as usize;
        if self.blob != Some(key) {
            let is_older = self
                .blob
                .is_some_and(|(blob, _)| !crate::is_newer(fragment.blob, blob));
            if is_older {
                return None;
            }
            self.dropped = self.dropped.saturating_add(u32::from(self.left > 0));
            (self.blob, self.heard) = (Some(key), [0; 4]);
            self.left = total.div_ceil(FRAGMENT);
            if total > BYTES || self.left > 256 {
                self.dropped = self.dropped.saturating_add(1);
                self.left = 0;
            }
        }
        if self.left == 0 {
            return None;
        }
        let place = fragment.place();
        let word = self.heard.get_mut(place / 64)?;
        let bit = 1 << (place % 64);
        if *word & bit != 0 {
            return None;
        }
        let start = fragment.offset as usize;
        let to = self
            .bytes
            .get_mut(start..start.checked_add(fragment.bytes.len())?)?;
        to.copy_from_slice(fragment.bytes);
        *word |= bit;
        self.left -= 1;
        if self.left > 0 {
            return None;
        }
        self.bytes.get(..total)
    }

    /// Forgets the blob that was begun and its number: another session begins with another one.
    pub fn clear(&mut self) {
        self.dropped = self.dropped.saturating_add(u32::from(self.left > 0));
        (self.blob, self.heard, self.left) = (None, [0; 4], 0);
    }

    /// Blobs that never became complete, or were too large.
    #[must_use]
    pub fn dropped(&self) -> u32 {
        self.dropped
    }
}
