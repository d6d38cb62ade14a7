//! Large parcels in chunks, so that urgent ones can overtake them (design §5, §7).
//!
//! A chunk frame is: kind 1, a varint stream number, one byte of flags (1 first, 2 last, 4 aborted), in the first
//! chunk a varint of the whole length, then bytes. The chunks of a stream, joined, are the frame that would have been
//! sent whole, from its kind byte on.

use std::collections::BTreeMap;

use bytes::{Bytes, BytesMut};

use super::decoder::broken;
use super::wire::{FieldReader, put_varint};
use super::{KIND_CHUNK, KIND_PARCEL};
use crate::frame::Encoded;
use crate::{Code, Limit, WireError};

const FIRST: u8 = 1;
const LAST: u8 = 2;
const ABORT: u8 = 4;

/// Streams of chunks that may be open at once on one connection.
pub const STREAMS: usize = 8;

/// The beginning of a chunk frame, to be followed by its bytes.
///
/// ```
/// use mom_proto::binary::ChunkHead;
/// let head = ChunkHead::new(1, Some(300), false, 100);
/// assert_eq!(head.bytes(), [0, 0, 0, 105, 1, 1, 1, 0xac, 2]);
/// assert_eq!(ChunkHead::abort(1).bytes(), [0, 0, 0, 3, 1, 1, 4]);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct ChunkHead {
    bytes: [u8; ChunkHead::MOST],
    length: u8,
}

impl ChunkHead {
    /// Length, kind, two varints and the flags.
    const MOST: usize = 4 + 1 + 10 + 1 + 10;

    /// The head of `piece` bytes of a stream; of its first piece if `whole`, the length of all, is given.
    pub fn new(stream: u64, whole: Option<usize>, last: bool, piece: usize) -> ChunkHead {
        let flags = whole.map_or(0, |_| FIRST) | if last { LAST } else { 0 };
        ChunkHead::with(stream, flags, whole, piece)
    }

    /// The frame that aborts a stream.
    pub fn abort(stream: u64) -> ChunkHead {
        ChunkHead::with(stream, ABORT, None, 0)
    }

    /// The bytes of the head.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length)]
    }

    fn with(stream: u64, flags: u8, whole: Option<usize>, piece: usize) -> ChunkHead {
        let mut head = Vec::with_capacity(ChunkHead::MOST);
        head.extend_from_slice(&[0, 0, 0, 0, KIND_CHUNK]);
        put_varint(&mut head, stream);
        head.push(flags);
        whole
            .iter()
            .for_each(|whole| put_varint(&mut head, *whole as u64));
        let length = u32::try_from(head.len() - 4 + piece).unwrap_or(u32::MAX);
        head[..4].copy_from_slice(&length.to_be_bytes());
        let mut bytes = [0; ChunkHead::MOST];
        bytes[..head.len()].copy_from_slice(&head);
        ChunkHead {
            bytes,
            length: head.len() as u8,
        }
    }
}

/// Cuts an encoded parcel into chunk frames of at most `size` bytes of payload each.
pub fn chunks(encoded: &Encoded, stream: u64, size: usize) -> Vec<Bytes> {
    let whole = encoded.to_vec();
    let payload = whole.get(4..).unwrap_or_default();
    let mut frames = Vec::new();
    let mut rest = payload;
    while !rest.is_empty() {
        let (piece, after) = rest.split_at(size.max(1).min(rest.len()));
        let whole = frames.is_empty().then_some(payload.len());
        let head = ChunkHead::new(stream, whole, after.is_empty(), piece.len());
        frames.push([head.bytes(), piece].concat().into());
        rest = after;
    }
    frames
}

/// The parcels arriving in chunks; together never larger than one parcel may be.
#[derive(Debug, Default)]
pub(super) struct Assembly {
    open: BTreeMap<u64, OpenStream>,
    announced: usize,
}

#[derive(Debug)]
struct OpenStream {
    length: usize,
    bytes: BytesMut,
}

impl Assembly {
    /// The bytes of all streams that are open.
    pub(super) fn held(&self) -> usize {
        self.open.values().map(|open| open.bytes.len()).sum()
    }

    /// Adds a chunk; gives the whole frame with the last one.
    pub(super) fn add(&mut self, frame: &Bytes, limit: Limit) -> Result<Option<Bytes>, WireError> {
        let mut reader = FieldReader::at(frame, 1);
        let read = |result: Result<u64, WireError>| result.map_err(|error| broken(&error.text));
        let stream = read(reader.varint())?;
        let flags = reader.byte().map_err(|error| broken(&error.text))?;
        if flags & !(FIRST | LAST | ABORT) != 0 {
            return Err(broken("a chunk with unknown flags"));
        }
        if flags & ABORT != 0 {
            return match self.close(stream) {
                Some(_) => Ok(None),
                None => Err(broken("the abort of a stream that is not open")),
            };
        }
        if flags & FIRST != 0 {
            let length = read(reader.varint())?;
            self.start(stream, length, limit)?;
        }
        let open = self
            .open
            .get_mut(&stream)
            .ok_or_else(|| broken("a chunk of a stream that is not open"))?;
        let piece = reader.rest();
        if open.bytes.len() + piece.len() > open.length {
            return Err(broken("a stream of chunks longer than announced"));
        }
        open.bytes.extend_from_slice(&piece);
        if flags & LAST == 0 {
            return Ok(None);
        }
        let done = self.close(stream).filter(|open| open.bytes.len() == open.length);
        let whole = done
            .ok_or_else(|| broken("a stream of chunks shorter than announced"))?
            .bytes
            .freeze();
        match whole.first() {
            Some(&KIND_PARCEL) => Ok(Some(whole)),
            _ => Err(broken("chunks of something that is not a parcel")),
        }
    }

    fn start(&mut self, stream: u64, length: u64, limit: Limit) -> Result<(), WireError> {
        let length = usize::try_from(length).unwrap_or(usize::MAX);
        let together = self.announced.saturating_add(length);
        if !limit.allows(together) {
            let text = format!("parcels of {together} bytes in chunks, the limit is {limit}");
            return Err(WireError::new(Code::TOO_LARGE, text));
        }
        if self.open.len() >= STREAMS {
            return Err(broken("more than 8 streams of chunks at once"));
        }
        if self
            .open
            .insert(
                stream,
                OpenStream {
                    length,
                    bytes: BytesMut::new(),
                },
            )
            .is_some()
        {
            return Err(broken("a stream of chunks that begins twice"));
        }
        self.announced = together;
        Ok(())
    }

    fn close(&mut self, stream: u64) -> Option<OpenStream> {
        let open = self.open.remove(&stream)?;
        self.announced -= open.length;
        Some(open)
    }
}
