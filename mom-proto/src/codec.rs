//! One interface to both codecs: detecting the form, reading frames, writing parcels.

use bytes::{Bytes, BytesMut};

use crate::binary::BinaryDecoder;
use crate::xml::{DeferredEntity, XmlDecoder};
use crate::{Limits, Parcel, WireError, binary, xml};

/// A wire form.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Form {
    /// XML with MIME headers (M14, M15).
    Xml,
    /// The compact binary form (M17).
    Binary,
}

impl Form {
    /// All of them.
    pub const ALL: [Form; 2] = [Form::Xml, Form::Binary];

    /// The word in logs and tables.
    pub fn word(self) -> &'static str {
        match self {
            Form::Xml => "xml",
            Form::Binary => "binary",
        }
    }

    /// The form that a connection's first bytes begin, once there are enough of them to tell (at most eight).
    ///
    /// # Errors
    /// `bad-frame` for bytes that begin no form.
    pub fn sniff(first: &[u8]) -> Result<Option<Form>, WireError> {
        if first.is_empty() {
            return Ok(None);
        }
        if binary::PREFACE_MAGIC.starts_with(&first[..first.len().min(4)]) {
            return Ok((first.len() >= 4).then_some(Form::Binary));
        }
        xml::sniff(first).map(|sure| sure.then_some(Form::Xml))
    }

    /// Encodes a parcel as one frame.
    ///
    /// # Errors
    /// `bad-content`, `bad-encoding`, `too-deep` for encoded content that had to be opened and is no value;
    /// `not-encodable` for values without a form on the wire.
    pub fn encode(self, parcel: &Parcel) -> Result<Encoded, WireError> {
        self.encode_with(parcel, &mut Scratch::default())
    }

    /// Encodes a parcel as one frame, in memory that is shared between frames.
    ///
    /// # Errors
    /// As [`Form::encode`].
    pub fn encode_with(self, parcel: &Parcel, scratch: &mut Scratch) -> Result<Encoded, WireError> {
        match self {
            Form::Xml => xml::encode(parcel),
            Form::Binary => binary::encode_with(parcel, scratch),
        }
    }
}

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

/// Reads frames of one connection, from any split of its bytes.
#[derive(Debug)]
pub enum Decoder {
    /// Of the XML form.
    Xml(Box<XmlDecoder>),
    /// Of the binary form.
    Binary(Box<BinaryDecoder>),
}

impl Decoder {
    /// A decoder for this form.
    pub fn new(form: Form, limits: &Limits) -> Decoder {
        match form {
            Form::Xml => Decoder::Xml(Box::new(XmlDecoder::new(limits))),
            Form::Binary => Decoder::Binary(Box::new(BinaryDecoder::new(limits))),
        }
    }

    /// Changes the limits, as after login.
    pub fn set_limits(&mut self, limits: &Limits) {
        match self {
            Decoder::Xml(decoder) => decoder.set_limits(limits),
            Decoder::Binary(decoder) => decoder.set_limits(limits),
        }
    }

    /// From now on, leaves entities of more bytes unread, for [`Decoder::take_deferred`]: reading them takes time in
    /// proportion to their size. Frames of the binary form do not need it, because their content stays closed.
    pub fn defer_above(&mut self, bytes: usize) {
        if let Decoder::Xml(decoder) = self {
            decoder.defer_above(bytes);
        }
    }

    /// The whole entity, left unread, in front of which [`Decoder::decode`] has stopped.
    pub fn take_deferred(&mut self) -> Option<Box<DeferredEntity>> {
        match self {
            Decoder::Xml(decoder) => decoder.take_deferred(),
            Decoder::Binary(_) => None,
        }
    }

    /// Takes the next frame from the front of `input`, or `None` if it is not complete.
    ///
    /// # Errors
    /// A broken frame: say so and close. The decoder is of no use after it.
    pub fn decode(&mut self, input: &mut BytesMut) -> Result<Option<Frame>, WireError> {
        match self {
            Decoder::Xml(decoder) => decoder.decode(input),
            Decoder::Binary(decoder) => decoder.decode(input),
        }
    }
}
