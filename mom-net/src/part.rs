//! What is given to a link at once: whole frames, or a part of one between whose chunks others may go.

use std::io::IoSlice;
use std::ops::Range;

use mom_proto::binary::ChunkHead;
use mom_proto::codec::Encoded;

/// The length in front of a frame of the binary form, which chunks do not carry.
const LENGTH: usize = 4;

/// A part of an encoded frame on its way, and how much of it the link has taken.
///
/// ```
/// use mom_net::Part;
/// // A frame of 100 bytes in two chunks.
/// let first = Part::chunk(1, 100, 0, 60);
/// let second = Part::chunk(1, 100, first.size(), 60);
/// assert_eq!((first.size(), first.reaches(100)), (60, false));
/// assert_eq!((second.size(), second.reaches(100)), (36, true), "the length in front is in no chunk");
/// ```
#[derive(Debug)]
pub struct Part {
    /// Goes before the bytes of a chunk.
    lead: Option<ChunkHead>,
    /// The bytes of the frame.
    bytes: Range<usize>,
    /// How much of lead and bytes is written.
    done: usize,
}

impl Part {
    /// Bytes of a frame as they are.
    #[inline]
    pub fn plain(bytes: Range<usize>) -> Part {
        Part {
            lead: None,
            bytes,
            done: 0,
        }
    }

    /// The next chunk, of `most` bytes at most and one at least, of a frame of `frame` bytes in the binary form, of which
    /// chunks with `sent` bytes went before it.
    pub fn chunk(stream: u64, frame: usize, sent: usize, most: usize) -> Part {
        let whole = frame - LENGTH;
        let size = most.max(1).min(whole - sent);
        let last = sent + size == whole;
        let announce = (sent == 0).then_some(whole);
        let from = LENGTH + sent;
        Part {
            lead: Some(ChunkHead::new(stream, announce, last, size)),
            bytes: from..from + size,
            done: 0,
        }
    }

    /// Gives up a frame of which chunks have left.
    pub fn abort(stream: u64) -> Part {
        Part {
            lead: Some(ChunkHead::abort(stream)),
            bytes: 0..0,
            done: 0,
        }
    }

    /// Whether it gives up a frame.
    pub fn is_abort(&self) -> bool {
        self.lead.is_some() && self.bytes.is_empty()
    }

    /// The bytes of the frame in it.
    pub fn size(&self) -> usize {
        self.bytes.len()
    }

    /// Whether nothing of a frame of so many bytes comes after it.
    pub fn reaches(&self, frame: usize) -> bool {
        self.bytes.end >= frame
    }

    /// Whether the link has taken something of it.
    #[inline]
    pub fn is_begun(&self) -> bool {
        self.done > 0
    }

    /// The bytes that are not written yet.
    #[inline]
    pub fn left(&self) -> usize {
        self.lead.map_or(0, |lead| lead.bytes().len()) + self.bytes.len() - self.done
    }

    /// Adds what is to be written of it, three slices at most; what gives a frame up does not need the frame.
    #[inline]
    pub fn append_to<'a>(&'a self, frame: Option<&'a Encoded>, slices: &mut Vec<IoSlice<'a>>) {
        let lead = self.lead.as_ref().map_or(&[][..], ChunkHead::bytes);
        let mut skip = self.done;
        let mut add = |bytes: &'a [u8]| {
            let skipped = skip.min(bytes.len());
            skip -= skipped;
            if skipped < bytes.len() {
                slices.push(IoSlice::new(&bytes[skipped..]));
            }
        };
        add(lead);
        let Some(frame) = frame else { return };
        let split = frame.head.len();
        let (from, to) = (self.bytes.start, self.bytes.end);
        add(&frame.head[from.min(split)..to.min(split)]);
        add(&frame.body[from.max(split) - split..to.max(split) - split]);
    }

    /// Where its bytes lie in the frame.
    pub(crate) fn bytes(&self) -> Range<usize> {
        self.bytes.clone()
    }

    /// How many bytes the link has taken, of plain ones.
    pub(crate) fn written(&self) -> usize {
        self.done
    }

    /// Begins anew.
    pub(crate) fn restart(&mut self) {
        self.done = 0;
    }

    /// Counts written bytes; gives back how many were not its own.
    #[inline]
    pub fn advance(&mut self, written: usize) -> usize {
        let own = written.min(self.left());
        self.done += own;
        written - own
    }
}
