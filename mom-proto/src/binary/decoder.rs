//! Frames of the binary form from a stream of bytes.

use std::collections::HashMap;

use bytes::{Buf, Bytes, BytesMut};

use super::chunks::Assembly;
use super::header::HeaderBounds;
use super::plain::Plain;
use super::words::NameCache;
use super::{FIRST_SKIPPABLE_KIND, KIND_CHUNK, KIND_PARCEL, PREFACE_MAGIC, header};
use crate::frame::Frame;
use crate::{Code, ContextNumber, Limit, Limits, PROTOCOL_VERSION, Parcel, Path, WireError};

/// Reads the preface and then frames; learns the numbers of contexts from parcels that bind them.
#[derive(Debug)]
pub struct BinaryDecoder {
    parcel: Limit,
    /// Small, for each idle connection has a decoder; the bound of a configuration is smaller still.
    depth: u32,
    slots: usize,
    greeted: bool,
    names: NameCache,
    contexts: HashMap<u64, Path>,
    bind: bool,
    /// Whether parcels may come in chunks.
    chunks: bool,
    /// Whether content may be compressed.
    packed: bool,
    assembly: Assembly,
}

impl BinaryDecoder {
    /// A decoder for the hub's end of a connection: numbers of contexts stay numbers, and parcels come whole until
    /// [`BinaryDecoder::set_limits`] says that the peer has logged in.
    pub fn new(limits: &Limits) -> BinaryDecoder {
        BinaryDecoder {
            parcel: limits.parcel,
            depth: depth_of(limits),
            slots: limits.slots,
            greeted: false,
            names: NameCache::default(),
            contexts: HashMap::new(),
            bind: false,
            chunks: false,
            packed: false,
            assembly: Assembly::default(),
        }
    }

    /// A decoder for a peer's end: numbers are learnt from the hub and turned into paths.
    pub fn for_peer(limits: &Limits) -> BinaryDecoder {
        BinaryDecoder {
            bind: true,
            chunks: true,
            ..BinaryDecoder::new(limits)
        }
    }

    /// Gives numbers that were bound to paths on an earlier connection of the same link.
    pub(crate) fn know(&mut self, contexts: Vec<(ContextNumber, Path)>) {
        let contexts = contexts.into_iter().map(|(number, path)| (number.0, path));
        self.contexts.extend(contexts);
    }

    /// From now on, content may be compressed: both ends have agreed on it.
    pub(crate) fn take_packed(&mut self) {
        self.packed = true;
    }

    fn bounds(&self) -> HeaderBounds {
        HeaderBounds {
            depth: self.depth as usize,
            slots: self.slots,
            unpacked: self.packed.then_some(self.parcel),
        }
    }

    /// The bytes that are here of parcels in chunks whose end has not come.
    pub fn held(&self) -> usize {
        self.assembly.held()
    }

    /// Changes the limits, as after login; from then on parcels may come in chunks.
    pub fn set_limits(&mut self, limits: &Limits) {
        self.chunks = true;
        self.parcel = limits.parcel;
        self.depth = depth_of(limits);
        self.slots = limits.slots;
    }

    /// Takes the next frame from the front of `input`, or `None` if it is not complete.
    ///
    /// # Errors
    /// `bad-frame`, `bad-version` or `too-large`: the stream is broken.
    pub fn decode(&mut self, input: &mut BytesMut) -> Result<Option<Frame>, WireError> {
        if !self.greeted && !self.greet(input)? {
            return Ok(None);
        }
        loop {
            let Some(frame) = self.next_frame(input)? else {
                return Ok(None);
            };
            match frame.first() {
                Some(&KIND_PARCEL) => return self.parcel(&frame).map(Some),
                Some(&KIND_CHUNK) if !self.chunks => {
                    return Err(broken("parcels come whole until the login is over"));
                }
                Some(&KIND_CHUNK) => {
                    if let Some(whole) = self.assembly.add(&frame, self.parcel)? {
                        return self.parcel(&whole).map(Some);
                    }
                }
                Some(&kind) if kind >= FIRST_SKIPPABLE_KIND => {}
                Some(kind) => {
                    return Err(broken(&format!("a frame of unknown kind {kind}")));
                }
                None => return Err(broken("a frame without a kind")),
            }
        }
    }

    /// The plain message at the front of `input`, left where it is; none if there is no whole frame, or one that
    /// has to be decoded.
    pub fn plain<'a>(&self, input: &'a [u8]) -> Option<Plain<'a>> {
        let plain = Plain::look(input).filter(|_| self.greeted)?;
        self.parcel.allows(plain.length() - 4).then_some(plain)
    }

    /// A plain message as a parcel without its content.
    pub fn head(&mut self, plain: &Plain<'_>) -> Option<Box<Parcel>> {
        let bounds = self.bounds();
        let parcel = header::read(&plain.header(), bounds, &mut self.names).ok()?;
        Some(Box::new(Parcel {
            content: None,
            ..parcel
        }))
    }

    fn greet(&mut self, input: &mut BytesMut) -> Result<bool, WireError> {
        let known = input.len().min(PREFACE_MAGIC.len());
        if input[..known] != PREFACE_MAGIC[..known] {
            return Err(broken("a binary connection begins with \\x8fMOM"));
        }
        if input.len() < PREFACE_MAGIC.len() + 2 {
            return Ok(false);
        }
        let (major, minor) = (input[4], input[5]);
        if major != PROTOCOL_VERSION.0 {
            let (ours, _) = PROTOCOL_VERSION;
            let text = format!("version {major}.{minor} is not supported, {ours}.x is");
            return Err(WireError::new(Code::BAD_VERSION, text));
        }
        input.advance(PREFACE_MAGIC.len() + 2);
        self.greeted = true;
        Ok(true)
    }

    /// The announced size of the frame that `input` begins with, so that the reader can reserve memory for all of it.
    /// 0 if it is not known yet, or above the limit.
    pub fn announced(&self, input: &[u8]) -> usize {
        let known = input.first_chunk::<4>().filter(|_| self.greeted);
        let length = known.map_or(0, |announced| u32::from_be_bytes(*announced) as usize);
        match length > 0 && self.parcel.allows(length) {
            true => 4 + length,
            false => 0,
        }
    }

    fn next_frame(&mut self, input: &mut BytesMut) -> Result<Option<Bytes>, WireError> {
        let Some(announced) = input.first_chunk::<4>() else {
            return Ok(None);
        };
        let length = u32::from_be_bytes(*announced) as usize;
        if !self.parcel.allows(length) {
            let text = format!("a frame of {length} bytes, the limit is {}", self.parcel);
            return Err(WireError::new(Code::TOO_LARGE, text));
        }
        if input.len() < 4 + length {
            return Ok(None);
        }
        input.advance(4);
        Ok(Some(input.split_to(length).freeze()))
    }

    fn parcel(&mut self, frame: &Bytes) -> Result<Frame, WireError> {
        let bounds = self.bounds();
        let mut parcel = match header::read(frame, bounds, &mut self.names) {
            // At once: later the compiler may copy it once more on the way.
            Ok(parcel) => Box::new(parcel),
            Err((reference, error)) => return Ok(Frame::Malformed { reference, error }),
        };
        if let Some(number) = parcel.number.filter(|_| self.bind) {
            match &parcel.context {
                Some(path) => drop(self.contexts.insert(number.0, path.clone())),
                None => match self.contexts.get(&number.0) {
                    Some(path) => parcel.context = Some(path.clone()),
                    None => return Err(broken(&format!("context {} was never given a path", number.0))),
                },
            }
        }
        Ok(Frame::Parcel(parcel))
    }
}

pub(super) fn broken(what: &str) -> WireError {
    WireError::new(Code::BAD_FRAME, what)
}

fn depth_of(limits: &Limits) -> u32 {
    u32::try_from(limits.depth).unwrap_or(u32::MAX)
}
