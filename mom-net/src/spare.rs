//! Buffers for reading that nobody uses at the moment.
//!
//! Frames are cut from the buffer that they were read into, so a buffer can be used again when the last of its frames is
//! written. For large frames that is worth waiting for: a fresh quarter of a megabyte costs the system more than reading
//! into it does.

use std::cell::RefCell;

use bytes::BytesMut;

/// Read at once from a socket; also the most that small parcels wait for each other in one turn.
const SIZE: usize = 64 * 1024;

/// Room below which a buffer is replaced; above it what is left is used up first, so that a peer of small
/// parcels does not cost a buffer for each.
const LEAST: usize = 4 * 1024;

/// Kept by each thread; a connection needs one only between the arrival of bytes and the end of their turn.
const KEPT: usize = 2;

/// Large buffers kept by each thread, with frames of theirs still on their way or not; and how large one may be.
const LARGE_KEPT: usize = 6;
const LARGEST: usize = 1024 * 1024;

thread_local! {
    static SPARE: RefCell<Vec<BytesMut>> = const { RefCell::new(Vec::new()) };
    static LARGE: RefCell<Vec<BytesMut>> = const { RefCell::new(Vec::new()) };
}

/// What a connection reads into.
#[derive(Debug, Default)]
pub(crate) struct ReadBuffer {
    pub(crate) bytes: BytesMut,
    /// Whether it was made for one large frame.
    large: bool,
    /// The size of the last frame if that was a large one: the next is probably as large. No frame has more bytes than this holds.
    last: u32,
}

impl ReadBuffer {
    pub(crate) fn new(bytes: BytesMut) -> ReadBuffer {
        ReadBuffer {
            bytes,
            ..ReadBuffer::default()
        }
    }

    /// Makes room before something is read. `announced` = the size of the frame in front, 0 if that is not known.
    pub(crate) fn make_room(&mut self, announced: usize) {
        let bytes = &mut self.bytes;
        if announced > SIZE {
            self.last = u32::try_from(announced).unwrap_or(u32::MAX);
            if bytes.capacity() < announced {
                let mut larger = take_large(announced);
                larger.extend_from_slice(bytes);
                self.replace(larger, true);
            }
        } else if bytes.is_empty() && bytes.capacity() < LEAST {
            match self.last {
                0 => self.replace(take(), false),
                size => self.replace(take_large(size as usize), true),
            }
        } else if bytes.capacity() - bytes.len() < LEAST {
            bytes.reserve(SIZE);
        }
    }

    /// A frame of this size was taken out.
    pub(crate) fn took(&mut self, length: usize) {
        // A small one must not hold the memory of a large one.
        if length <= SIZE {
            self.last = 0;
        }
    }

    /// Gives the memory up while nothing is there.
    pub(crate) fn rest(&mut self) {
        if self.bytes.is_empty() {
            self.replace(BytesMut::new(), false);
        }
    }

    fn replace(&mut self, bytes: BytesMut, large: bool) {
        let before = std::mem::replace(&mut self.bytes, bytes);
        match std::mem::replace(&mut self.large, large) {
            true => give_large(before),
            false => give(before),
        }
    }
}

/// An empty buffer for one frame of this size.
fn take_large(size: usize) -> BytesMut {
    let reclaimed = LARGE.with_borrow_mut(|spare| {
        let free = spare.iter_mut().position(|buffer| buffer.try_reclaim(size))?;
        Some(spare.swap_remove(free))
    });
    reclaimed.unwrap_or_else(|| BytesMut::with_capacity(size))
}

/// Takes a large buffer back; frames that were cut from it may still live.
fn give_large(mut buffer: BytesMut) {
    buffer.clear();
    if buffer.capacity() > LARGEST {
        return;
    }
    LARGE.with_borrow_mut(|spare| {
        if spare.len() >= LARGE_KEPT {
            spare.remove(0);
        }
        spare.push(buffer);
    });
}

/// An empty buffer, used before or new.
fn take() -> BytesMut {
    SPARE
        .with_borrow_mut(Vec::pop)
        .unwrap_or_else(|| BytesMut::with_capacity(SIZE))
}

/// Takes back an empty buffer, unless a frame that was cut from it still lives or it was made for a large one.
fn give(mut buffer: BytesMut) {
    buffer.clear();
    if !buffer.try_reclaim(SIZE) || buffer.capacity() > 2 * SIZE {
        return;
    }
    SPARE.with_borrow_mut(|spare| {
        if spare.len() < KEPT {
            spare.push(buffer);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_buffer_comes_back_unless_a_frame_of_it_lives() {
        let mut first = take();
        first.extend_from_slice(b"frame");
        let frame = first.split_to(5).freeze();
        let at = frame.as_ptr();
        give(first);
        let second = take();
        assert_ne!(second.as_ptr(), at, "the frame is still read");
        drop(frame);
        let at = second.as_ptr();
        give(second);
        assert_eq!(take().as_ptr(), at);
    }

    /// Reads a frame of this size, all of it at once.
    fn read(buffer: &mut ReadBuffer, size: usize) -> bytes::Bytes {
        buffer.make_room(0);
        buffer.bytes.extend_from_slice(&[0; 4]);
        buffer.make_room(size);
        let capacity = buffer.bytes.capacity();
        assert!(capacity >= size, "room for all of it: {capacity}");
        buffer.bytes.resize(size, 1);
        let frame = buffer.bytes.split_to(size).freeze();
        buffer.took(size);
        frame
    }

    #[test]
    fn a_large_buffer_is_used_again_when_its_frame_is_gone() {
        let size = 4 * SIZE;
        let mut buffer = ReadBuffer::default();
        let first = read(&mut buffer, size);
        let second = read(&mut buffer, size);
        let at = first.as_ptr();
        drop(first);
        let third = read(&mut buffer, size);
        assert_eq!(third.as_ptr(), at, "the memory of the first");
        assert!(
            second[4..].iter().all(|byte| *byte == 1),
            "nobody wrote over the second"
        );
        buffer.rest();
        assert_eq!(buffer.bytes.capacity(), 0, "who is idle keeps nothing");
    }

    #[test]
    fn a_small_frame_does_not_hold_the_memory_of_a_large_one() {
        let mut buffer = ReadBuffer::default();
        drop(read(&mut buffer, 4 * SIZE));
        let small = read(&mut buffer, 100);
        buffer.rest();
        drop(small);
        buffer.make_room(0);
        assert!(buffer.bytes.capacity() <= 2 * SIZE);
    }
}
