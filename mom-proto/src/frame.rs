//! Frames as all codecs give them, and the memory that they are written into.

use bytes::{Bytes, BytesMut};

use crate::{Parcel, WireError};

/// Memory for encoding: small frames are cut from one block instead of each having its own.
#[derive(Debug, Default)]
pub struct Scratch {
    pub(crate) header: Vec<u8>,
    pool: BytesMut,
    block: usize,
}

impl Scratch {
    /// A block's size. A frame that waits keeps its whole block, so blocks are not large.
    const BLOCK: usize = 16 * 1024;

    /// Memory that takes a block at a time; the default takes what each frame needs.
    pub fn pooled() -> Scratch {
        Scratch {
            block: Scratch::BLOCK,
            ..Scratch::default()
        }
    }

    /// Room for one frame of `size` bytes.
    pub(crate) fn room(&mut self, size: usize) -> &mut BytesMut {
        if self.pool.capacity() < size {
            self.pool = BytesMut::with_capacity(size.max(self.block));
        }
        &mut self.pool
    }
}

/// One encoded frame in two pieces, so that large content is shared and not copied.
#[derive(Clone, Debug, Default)]
pub struct Encoded {
    /// The header, or the whole frame.
    pub head: Bytes,
    /// The content, if it is apart.
    pub body: Bytes,
}

impl Encoded {
    /// The frame's size in bytes.
    pub fn len(&self) -> usize {
        self.head.len() + self.body.len()
    }

    /// Whether there is nothing to send.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The frame in one piece.
    pub fn to_vec(&self) -> Vec<u8> {
        [&self.head[..], &self.body[..]].concat()
    }
}

/// What a decoder found: one frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Frame {
    /// A parcel.
    Parcel(Box<Parcel>),
    /// A healthy frame around a malformed parcel: answer the error, go on.
    Malformed {
        /// The parcel's id, as far as it could be read.
        reference: Option<u64>,
        /// What is wrong, with slot and position.
        error: WireError,
    },
}
