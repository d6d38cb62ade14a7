//! Buffers for reading that nobody uses at the moment.

use std::cell::RefCell;

use bytes::BytesMut;

/// Read at once from a socket; also the most that small parcels wait for each other in one turn.
pub(crate) const SIZE: usize = 64 * 1024;

/// Kept by each thread; a connection needs one only between the arrival of bytes and the end of their turn.
const KEPT: usize = 2;

thread_local! {
    static SPARE: RefCell<Vec<BytesMut>> = const { RefCell::new(Vec::new()) };
}

/// An empty buffer, used before or new.
pub(crate) fn take() -> BytesMut {
    SPARE
        .with_borrow_mut(Vec::pop)
        .unwrap_or_else(|| BytesMut::with_capacity(SIZE))
}

/// Takes back an empty buffer, unless a frame that was cut from it still lives or it was made for a large one.
pub(crate) fn give(mut buffer: BytesMut) {
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
}
