//! The direction that is read.

use std::cell::RefCell;
use std::fmt;
use std::io;
use std::task::{Context, Poll};

use bytes::{Buf as _, BytesMut};
use flate2::{Decompress, FlushDecompress, Status};
use mom_proto::codec::Form;
use mom_proto::{Code, Compression, STREAM_MARK, STREAM_WINDOW_LOG, WireError};
use zstd::stream::raw::{DParameter, Decoder, Operation as _};

use crate::socket::ReadHalf;

/// Opened at once: what so many bytes make is handled before more is.
const STEP: usize = 64 * 1024;

/// What the end of a stream and the beginning of another cost, as bytes that are opened: tables and a window are made anew.
const BEGINNING: usize = 4 * 1024;

/// Read at once from the network.
const AT_ONCE: usize = 16 * 1024;

/// Line ends before a stream that are looked past: those behind the parcel before it. More are read as what they are, line by line.
const BLANKS: usize = 4;

/// What a frame of zstd begins with (RFC 8878, 3.1.1).
const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// The first byte of zlib with a window of 32 KiB (RFC 1950, 2.2).
const ZLIB: u8 = 0x78;

thread_local! {
    /// What was opened: used within a turn only, so that idle connections need no memory for it.
    static OPENED: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

/// Opens what arrives on a connection from where a stream begins.
#[derive(Debug)]
pub(crate) struct Unpacker {
    way: Compression,
    form: Form,
    /// None before the stream has begun.
    engine: Option<Engine>,
    /// What has arrived and is not opened.
    arrived: BytesMut,
    /// What was read may give more than was taken.
    has_more: bool,
    /// How many bytes were opened in all.
    opened: u64,
    /// What is wrong behind what was opened.
    fault: Option<WireError>,
    /// It has worked, and opened next to nothing: others are to have their turn.
    is_tired: bool,
}

enum Engine {
    Zstd(Box<Decoder<'static>>),
    Deflate(Box<Decompress>),
}

impl fmt::Debug for Engine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Engine::Zstd(_) => "zstd",
            Engine::Deflate(_) => "deflate",
        })
    }
}

/// Whether a stream begins where a parcel could.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Begins {
    No,
    /// More has to arrive before that is known.
    Perhaps,
    /// Behind so many bytes.
    At(usize),
}

impl Unpacker {
    /// For a connection on which the stream has not begun.
    pub(crate) fn new(way: Compression, form: Form) -> Unpacker {
        Unpacker {
            way,
            form,
            engine: None,
            arrived: BytesMut::new(),
            has_more: false,
            opened: 0,
            fault: None,
            is_tired: false,
        }
    }

    /// How many bytes were opened in all.
    pub(crate) fn opened(&self) -> u64 {
        self.opened
    }

    pub(crate) fn is_open(&self) -> bool {
        self.engine.is_some()
    }

    /// Whether something is here that can be opened at once.
    pub(crate) fn has_more(&self) -> bool {
        self.has_more || !self.arrived.is_empty()
    }

    /// Whether others are to have their turn before more is opened; asked once.
    pub(crate) fn is_tired(&mut self) -> bool {
        std::mem::take(&mut self.is_tired)
    }

    /// Looks whether the stream begins at the front of what has arrived, and opens the first of it; false if more has to arrive before
    /// anything can be said of it.
    pub(crate) fn begin(&mut self, bytes: &mut BytesMut) -> Result<bool, WireError> {
        let at = match self.begins(bytes) {
            Begins::No => return Ok(true),
            Begins::Perhaps => return Ok(false),
            Begins::At(at) => at,
        };
        // Blanks stay, as their reader may have seen them already.
        let mut arrived = bytes.split_off(at);
        if self.form.is_binary() {
            arrived.advance(STREAM_MARK.len());
            bytes.clear();
        }
        self.arrived = arrived;
        self.engine = Some(self.open().map_err(|error| broken(self.way, &error))?);
        self.fill(bytes)?;
        Ok(true)
    }

    fn begins(&self, bytes: &[u8]) -> Begins {
        if self.form.is_binary() {
            let known = bytes.len().min(STREAM_MARK.len());
            return match bytes[..known] == STREAM_MARK[..known] {
                false => Begins::No,
                true if known < STREAM_MARK.len() => Begins::Perhaps,
                true => Begins::At(0),
            };
        }
        let blanks = bytes
            .iter()
            .take(BLANKS)
            .take_while(|byte| matches!(byte, b'\n' | b'\r'));
        let at = blanks.count();
        match (self.way, &bytes[at..]) {
            (_, []) => Begins::No,
            (Compression::StreamDeflate, [ZLIB]) => Begins::Perhaps,
            // No preset dictionary, and the two bytes are a multiple of 31.
            (Compression::StreamDeflate, [ZLIB, flags, ..])
                if flags & 0x20 == 0 && u16::from_be_bytes([ZLIB, *flags]).is_multiple_of(31) =>
            {
                Begins::At(at)
            }
            (Compression::StreamZstd, rest) => {
                let known = rest.len().min(ZSTD.len());
                match rest[..known] == ZSTD[..known] {
                    false => Begins::No,
                    true if known < ZSTD.len() => Begins::Perhaps,
                    true => Begins::At(at),
                }
            }
            _ => Begins::No,
        }
    }

    fn open(&self) -> io::Result<Engine> {
        match self.way {
            Compression::StreamZstd => {
                let mut decoder = Decoder::new()?;
                decoder.set_parameter(DParameter::WindowLogMax(STREAM_WINDOW_LOG))?;
                Ok(Engine::Zstd(Box::new(decoder)))
            }
            Compression::StreamDeflate => Ok(Engine::Deflate(Box::new(Decompress::new(true)))),
            Compression::Zstd => Err(io::ErrorKind::Unsupported.into()),
        }
    }

    /// Reads what has arrived; 0 bytes at the end.
    pub(crate) fn poll_read(
        &mut self,
        stream: &mut ReadHalf,
        context: &mut Context<'_>,
    ) -> Poll<io::Result<usize>> {
        use bytes::BufMut as _;
        self.arrived.reserve(AT_ONCE);
        let mut room = (&mut self.arrived).limit(AT_ONCE);
        let read = stream.poll_read(&mut room, context);
        if read.is_pending() && self.arrived.is_empty() {
            self.arrived = BytesMut::new();
        }
        read
    }

    /// Takes what a test has.
    #[cfg(test)]
    pub(crate) fn arrive(&mut self, bytes: &[u8]) {
        self.arrived.extend_from_slice(bytes);
    }

    /// Opens some more of what has arrived. What comes before a fault is given first, and the fault by the next call.
    ///
    /// # Errors
    /// `bad-frame` for what is not a stream, or needs more memory than was agreed on.
    pub(crate) fn fill(&mut self, bytes: &mut BytesMut) -> Result<(), WireError> {
        let way = self.way;
        if let Some(fault) = self.fault.take() {
            return Err(fault);
        }
        let Some(engine) = &mut self.engine else {
            return Ok(());
        };
        OPENED.with_borrow_mut(|opened| {
            opened.resize(STEP, 0);
            let (mut written, mut begun) = (0, 0);
            loop {
                let fault = match engine.step(&self.arrived, &mut opened[written..]) {
                    Ok(Step {
                        read: 0, written: 0, ..
                    }) if !self.arrived.is_empty() => broken(way, &"it is malformed"),
                    Err(error) => broken(way, &error),
                    Ok(step) => {
                        self.arrived.advance(step.read);
                        written += step.written;
                        begun += usize::from(step.is_end) * BEGINNING;
                        self.has_more = written == STEP;
                        self.is_tired = begun > written && begun >= STEP;
                        match self.has_more || self.is_tired || self.arrived.is_empty() {
                            true => break,
                            false => continue,
                        }
                    }
                };
                if written == 0 {
                    return Err(fault);
                }
                (self.fault, self.has_more) = (Some(fault), true);
                break;
            }
            bytes.extend_from_slice(&opened[..written]);
            self.opened += written as u64;
            Ok(())
        })
    }
}

/// What was done at once.
struct Step {
    read: usize,
    written: usize,
    /// A stream or frame has ended.
    is_end: bool,
}

impl Engine {
    /// Opens some bytes into this room.
    fn step(&mut self, bytes: &[u8], room: &mut [u8]) -> io::Result<Step> {
        match self {
            Engine::Zstd(decoder) => {
                let status = decoder.run_on_buffers(bytes, room)?;
                Ok(Step {
                    read: status.bytes_read,
                    written: status.bytes_written,
                    is_end: status.remaining == 0,
                })
            }
            Engine::Deflate(decompress) => {
                let (read, written) = (decompress.total_in(), decompress.total_out());
                let status = decompress.decompress(bytes, room, FlushDecompress::None)?;
                let step = Step {
                    read: (decompress.total_in() - read) as usize,
                    written: (decompress.total_out() - written) as usize,
                    is_end: status == Status::StreamEnd,
                };
                if step.is_end {
                    // Another may follow it, as frames of zstd do.
                    decompress.reset(true);
                }
                Ok(step)
            }
        }
    }
}

fn broken(way: Compression, why: &dyn fmt::Display) -> WireError {
    let text = match way {
        Compression::StreamZstd => format!(
            "the {way} cannot be opened: {why}; its window is {} KiB at most",
            (1 << STREAM_WINDOW_LOG) / 1024
        ),
        _ => format!("the {way} cannot be opened: {why}"),
    };
    WireError::new(Code::BAD_FRAME, text)
}
