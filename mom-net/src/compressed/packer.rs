//! The direction that is written.

use std::fmt;
use std::io::{self, IoSlice};

use bytes::{Buf as _, BytesMut};
use flate2::{Compress, FlushCompress, Status};
use mom_proto::{Compression, STREAM_MARK, STREAM_WINDOW_LOG};
use parking_lot::Mutex;
use zstd::stream::raw::{CParameter, Encoder, Operation as _};

use crate::socket::WriteHalf;

/// Taken from a writer in one turn, which takes about 0.1 ms: what has been taken cannot be overtaken, and a task that
/// compresses more gives way to others first.
const TURN: usize = 16 * 1024;

/// Made at once of what was taken.
const STEP: usize = 16 * 1024;

/// Levels at which a message of some hundred bytes takes microseconds.
const ZSTD_LEVEL: i32 = 1;
const DEFLATE_LEVEL: u32 = 3;

/// Compresses what is written to a link.
#[derive(Debug)]
pub(crate) struct Packer {
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    engine: Engine,
    /// What the network has not taken yet.
    out: BytesMut,
    /// The last byte that was taken is not told yet, since the network has not taken all that was made of it: a task that
    /// writes comes back for that byte, and so the rest is sent.
    owed: bool,
    /// Nothing was taken yet.
    is_first: bool,
    /// How many more bytes may be taken in this turn.
    allowed: usize,
    /// Bytes given to the network, and bytes taken from writers.
    sent: u64,
    taken: u64,
    /// How many more were taken than given when all was sent the last time; less than none where nothing could be saved.
    saved: i64,
}

enum Engine {
    Zstd(Encoder<'static>),
    Deflate(Box<Compress>),
}

impl fmt::Debug for Engine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Engine::Zstd(_) => "zstd",
            Engine::Deflate(_) => "deflate",
        })
    }
}

impl Packer {
    /// Begins a stream; `marked`: behind the mark of the binary form.
    ///
    /// # Errors
    /// No memory for it, or a way that is none of a stream.
    pub(crate) fn new(way: Compression, marked: bool) -> io::Result<Packer> {
        let engine = match way {
            Compression::StreamZstd => {
                let mut encoder = Encoder::new(ZSTD_LEVEL)?;
                encoder.set_parameter(CParameter::WindowLog(STREAM_WINDOW_LOG))?;
                Engine::Zstd(encoder)
            }
            Compression::StreamDeflate => Engine::Deflate(Box::new(Compress::new(
                flate2::Compression::new(DEFLATE_LEVEL),
                true,
            ))),
            Compression::Zstd => return Err(io::ErrorKind::Unsupported.into()),
        };
        let mark: &[u8] = if marked { &STREAM_MARK } else { &[] };
        Ok(Packer {
            state: Mutex::new(State {
                engine,
                out: BytesMut::from(mark),
                owed: false,
                is_first: true,
                allowed: TURN,
                sent: 0,
                taken: 0,
                saved: 0,
            }),
        })
    }

    /// Writes the front of these pieces; gives how much of it, none if the network takes nothing now, or a turn is over and
    /// [`Packer::next_turn`] has to be asked for another one.
    pub(crate) fn try_write(&self, link: &WriteHalf, pieces: &[IoSlice<'_>]) -> io::Result<Option<usize>> {
        if pieces.iter().all(|piece| piece.is_empty()) {
            return Ok(Some(0));
        }
        let mut state = self.state.lock();
        if !state.send(link)? {
            return Ok(None);
        }
        let begun = std::mem::take(&mut state.owed);
        let taken = state.take(pieces, begun)?;
        state.owed = !state.send(link)? && taken > 0;
        match usize::from(begun) + taken - usize::from(state.owed) {
            0 => Ok(None),
            told => Ok(Some(told)),
        }
    }

    /// Begins another turn; whether one was over, so that others are to have theirs first.
    pub(crate) fn next_turn(&self) -> bool {
        let allowed = &mut self.state.lock().allowed;
        let over = *allowed == 0;
        *allowed = TURN;
        over
    }

    /// How many bytes more were taken than given when all was sent the last time; less than none where nothing could be saved.
    pub(crate) fn saved(&self) -> i64 {
        self.state.lock().saved
    }
}

impl State {
    /// Compresses the front of these pieces and flushes; gives how much of it. `begun`: the first byte was taken before.
    fn take(&mut self, pieces: &[IoSlice<'_>], begun: bool) -> io::Result<usize> {
        let (mut skip, mut taken) = (usize::from(begun), 0);
        for piece in pieces {
            let piece = &piece[skip.min(piece.len())..];
            skip = 0;
            let room = self.allowed - taken;
            if room == 1 && piece.len() > 1 {
                // The last byte that was taken may not be told yet: a frame of which only its first one was would look untouched, and
                // could be overtaken by another.
                self.allowed = taken;
                break;
            }
            let some = &piece[..piece.len().min(room)];
            self.engine.add(some, &mut self.out)?;
            taken += some.len();
        }
        if taken > 0 {
            // The first of it, which may be an answer with a secret, shares no dictionary with what others have said: its length must tell
            // nobody who sends messages whether they resemble it.
            self.engine
                .flush(std::mem::take(&mut self.is_first), &mut self.out)?;
        }
        self.taken += taken as u64;
        self.allowed -= taken;
        Ok(taken)
    }

    /// Gives the network what waits; false if it does not take all.
    fn send(&mut self, link: &WriteHalf) -> io::Result<bool> {
        while !self.out.is_empty() {
            match link.try_write(&[IoSlice::new(&self.out)])? {
                Some(written) => {
                    self.sent += written as u64;
                    self.out.advance(written);
                }
                None => return Ok(false),
            }
        }
        // An idle connection keeps no buffer.
        self.out = BytesMut::new();
        self.saved = self.taken.cast_signed() - self.sent.cast_signed();
        Ok(true)
    }
}

impl Engine {
    /// Compresses bytes, of which some may stay inside until the flush.
    fn add(&mut self, mut bytes: &[u8], out: &mut BytesMut) -> io::Result<()> {
        while !bytes.is_empty() {
            let read = match self {
                Engine::Zstd(encoder) => into_room(out, |room| {
                    let status = encoder.run_on_buffers(bytes, room)?;
                    Ok((status.bytes_read, status.bytes_written))
                })?,
                Engine::Deflate(compress) => deflate(compress, bytes, FlushCompress::None, out)?.0,
            };
            bytes = &bytes[read..];
        }
        Ok(())
    }

    /// Gives all that stayed inside. `apart`: what follows refers to nothing before it.
    fn flush(&mut self, apart: bool, out: &mut BytesMut) -> io::Result<()> {
        match self {
            Engine::Zstd(encoder) => {
                loop {
                    let left = into_room(out, |room| {
                        let mut room = zstd::stream::raw::OutBuffer::around(room);
                        let left = match apart {
                            true => encoder.finish(&mut room, true)?,
                            false => encoder.flush(&mut room)?,
                        };
                        Ok((left, room.pos()))
                    })?;
                    if left == 0 {
                        break;
                    }
                }
                match apart {
                    true => encoder.reinit(),
                    false => Ok(()),
                }
            }
            Engine::Deflate(compress) => {
                let flush = match apart {
                    true => FlushCompress::Full,
                    false => FlushCompress::Sync,
                };
                // All is out once some room is left.
                while deflate(compress, &[], flush, out)?.1 == STEP {}
                Ok(())
            }
        }
    }
}

/// Gives how many bytes were read, and how many written.
fn deflate(
    compress: &mut Compress,
    bytes: &[u8],
    flush: FlushCompress,
    out: &mut BytesMut,
) -> io::Result<(usize, usize)> {
    let before = compress.total_in();
    let room_before = out.len();
    into_room(out, |room| {
        let (read, written) = (compress.total_in(), compress.total_out());
        match compress.compress(bytes, room, flush)? {
            // Nothing was to be done, or there was no room for it.
            Status::Ok | Status::BufError | Status::StreamEnd => {}
        }
        Ok((
            (compress.total_in() - read) as usize,
            (compress.total_out() - written) as usize,
        ))
    })?;
    Ok(((compress.total_in() - before) as usize, out.len() - room_before))
}

/// Has something written into some more room; gives what that gives beside the length.
fn into_room<T>(
    out: &mut BytesMut,
    write: impl FnOnce(&mut [u8]) -> io::Result<(T, usize)>,
) -> io::Result<T> {
    let before = out.len();
    out.resize(before + STEP, 0);
    let written = write(&mut out[before..]);
    out.truncate(before + written.as_ref().map_or(0, |(_, length)| *length));
    written.map(|(told, _)| told)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_turn_ends_one_byte_into_a_frame() {
        for way in [Compression::StreamZstd, Compression::StreamDeflate] {
            let packer = Packer::new(way, false).expect("memory");
            let mut state = packer.state.lock();
            let (first, second, last) = (vec![b'a'; TURN - 1], [b'b'; 100], [b'c'; 1]);
            let pieces = [&first[..], &second, &last].map(IoSlice::new);
            let taken = state.take(&pieces, false).expect("memory");
            // Neither a byte of the second, nor the last one before it.
            assert_eq!((taken, state.allowed), (TURN - 1, 0), "{way}");
            state.allowed = TURN;
            assert_eq!(state.take(&pieces[1..], false).expect("memory"), 101, "{way}");
            state.allowed = 2;
            assert_eq!(state.take(&pieces[1..], false).expect("memory"), 2, "{way}");
        }
    }
}
