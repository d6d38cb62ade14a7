//! Parts of blobs, for what is too large for a packet, and for audio beside motion (S13, S27).

use crate::Dropped;

/// The bytes in each fragment of a blob but the last.
pub const FRAGMENT: usize = 480;

/// The bytes before those of the blob.
pub(crate) const HEAD: usize = 11;

/// A part of a blob.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fragment<'p> {
    /// The element that the blob is for, or of.
    pub element: u8,
    /// Numbers the blobs of an element in one direction.
    pub blob: u16,
    /// Where these bytes are in the blob: a multiple of [`FRAGMENT`].
    pub offset: u32,
    /// Bytes of the whole blob, at least 1.
    pub total: u32,
    /// [`FRAGMENT`] bytes, fewer only at the end of the blob.
    pub bytes: &'p [u8],
}

impl<'p> Fragment<'p> {
    /// Where the part lies in the blob, in fragments.
    #[must_use]
    pub fn place(&self) -> usize {
        self.offset as usize / FRAGMENT
    }

    pub(crate) fn parse(payload: &'p [u8]) -> Result<Fragment<'p>, Dropped> {
        let (&[element, b0, b1, o0, o1, o2, o3, t0, t1, t2, t3], bytes) =
            payload.split_first_chunk::<HEAD>().ok_or(Dropped::Payload)?;
        let fragment = Fragment {
            element,
            blob: u16::from_be_bytes([b0, b1]),
            offset: u32::from_be_bytes([o0, o1, o2, o3]),
            total: u32::from_be_bytes([t0, t1, t2, t3]),
            bytes,
        };
        let rest = fragment
            .total
            .checked_sub(fragment.offset)
            .ok_or(Dropped::Payload)? as usize;
        let fits = (fragment.offset as usize).is_multiple_of(FRAGMENT)
            && !bytes.is_empty()
            && bytes.len() == rest.min(FRAGMENT);
        fits.then_some(fragment).ok_or(Dropped::Payload)
    }

    /// The bytes before those of the blob.
    pub(crate) fn head(&self) -> [u8; HEAD] {
        let [b0, b1] = self.blob.to_be_bytes();
        let [o0, o1, o2, o3] = self.offset.to_be_bytes();
        let [t0, t1, t2, t3] = self.total.to_be_bytes();
        [self.element, b0, b1, o0, o1, o2, o3, t0, t1, t2, t3]
    }
}
