//! One interface to all codecs: detecting the form, reading frames, writing parcels.

use bytes::BytesMut;

use crate::binary::BinaryDecoder;
pub use crate::frame::{Encoded, Frame, Scratch};
use crate::json::{DeferredLine, JsonDecoder};
use crate::xml::{DeferredEntity, XmlDecoder};
use crate::{ContextNumber, Limit, Limits, Parcel, Path, WireError, binary, json, xml};

/// A wire form.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Form {
    /// XML with MIME headers (M14, M15).
    Xml,
    /// The compact binary form (M17).
    Binary,
    /// JSON, one parcel on each line.
    Json,
    /// The binary form to a peer that reads compressed content, on which it agrees at login (M16): no connection begins so.
    Packed,
}

impl Form {
    /// All that a connection may begin with.
    pub const ALL: [Form; 3] = [Form::Xml, Form::Binary, Form::Json];

    /// The word in logs and tables.
    pub fn word(self) -> &'static str {
        match self {
            Form::Xml => "xml",
            Form::Binary => "binary",
            Form::Json => "json",
            Form::Packed => "packed",
        }
    }

    /// Whether its frames are those of the binary form.
    pub fn is_binary(self) -> bool {
        matches!(self, Form::Binary | Form::Packed)
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
        if json::sniff(first) {
            return Ok(Some(Form::Json));
        }
        xml::sniff(first).map(|sure| sure.then_some(Form::Xml))
    }

    /// Encodes a parcel as one frame.
    ///
    /// # Errors
    /// `bad-content`, `bad-encoding`, `too-deep` for encoded content that had to be opened and is not a value;
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
            Form::Json => json::encode(parcel),
            Form::Packed => binary::encode_packed(parcel, scratch),
        }
    }

    /// Reads whole frames, such as [`Form::encode`] writes.
    ///
    /// # Errors
    /// Frames that are broken or hold something else than parcels.
    pub fn read(self, frames: &[u8]) -> Result<Vec<Parcel>, WireError> {
        let limits = Limits {
            parcel: Limit::Unlimited,
            ..Limits::default()
        };
        let mut input = BytesMut::with_capacity(frames.len() + binary::PREFACE.len());
        let mut decoder = Decoder::new(self, &limits);
        if self.is_binary() {
            decoder.take_packed();
            input.extend_from_slice(&binary::PREFACE);
        }
        input.extend_from_slice(frames);
        let mut parcels = Vec::new();
        while let Some(frame) = decoder.decode(&mut input)? {
            match frame {
                Frame::Parcel(parcel) => parcels.push(*parcel),
                Frame::Malformed { error, .. } => return Err(error),
            }
        }
        Ok(parcels)
    }

    /// As [`Form::encode`]; where content has to be opened, of so many levels at most, and into a frame of so many bytes.
    /// The bounds hold while it is written. Binary content stays closed and is not bounded here.
    ///
    /// # Errors
    /// As [`Form::encode`]; `too-deep` beyond `depth`, `not-encodable` beyond `most`.
    pub fn encode_within(self, parcel: &Parcel, depth: usize, most: Limit) -> Result<Encoded, WireError> {
        match self {
            Form::Xml => xml::encode_within(parcel, depth, most),
            Form::Binary => binary::encode_with(parcel, &mut Scratch::default()),
            Form::Json => json::encode_within(parcel, depth, most),
            Form::Packed => binary::encode_packed(parcel, &mut Scratch::default()),
        }
    }
}

/// Reads frames of one connection, from any split of its bytes.
#[derive(Debug)]
pub enum Decoder {
    /// Of the XML form.
    Xml(Box<XmlDecoder>),
    /// Of the binary form.
    Binary(Box<BinaryDecoder>),
    /// Of the JSON form.
    Json(Box<JsonDecoder>),
}

/// A frame of a text form that is here and not read yet.
#[derive(Clone, Debug, PartialEq)]
pub enum Deferred {
    /// Of the XML form.
    Xml(Box<DeferredEntity>),
    /// Of the JSON form.
    Json(Box<DeferredLine>),
}

impl Deferred {
    /// Its bytes.
    pub fn size(&self) -> usize {
        match self {
            Deferred::Xml(entity) => entity.size(),
            Deferred::Json(line) => line.size(),
        }
    }

    /// Reads it.
    ///
    /// # Errors
    /// As [`Decoder::decode`]: the connection ends.
    pub fn open(&self) -> Result<Frame, WireError> {
        match self {
            Deferred::Xml(entity) => entity.open(),
            Deferred::Json(line) => Ok(line.open()),
        }
    }
}

impl Decoder {
    /// A decoder for this form.
    pub fn new(form: Form, limits: &Limits) -> Decoder {
        match form {
            Form::Xml => Decoder::Xml(Box::new(XmlDecoder::new(limits))),
            Form::Binary | Form::Packed => Decoder::Binary(Box::new(BinaryDecoder::new(limits))),
            Form::Json => Decoder::Json(Box::new(JsonDecoder::new(limits))),
        }
    }

    /// Changes the limits, as after login.
    pub fn set_limits(&mut self, limits: &Limits) {
        match self {
            Decoder::Xml(decoder) => decoder.set_limits(limits),
            Decoder::Binary(decoder) => decoder.set_limits(limits),
            Decoder::Json(decoder) => decoder.set_limits(limits),
        }
    }

    /// Gives the numbers of contexts that the other side may use without their paths: the binary form has numbers alone.
    pub fn know(&mut self, contexts: Vec<(ContextNumber, Path)>) {
        if let Decoder::Binary(decoder) = self {
            decoder.know(contexts);
        }
    }

    /// From now on, takes compressed content; the text forms have none.
    pub fn take_packed(&mut self) {
        if let Decoder::Binary(decoder) = self {
            decoder.take_packed();
        }
    }

    /// From now on, leaves frames of more bytes unread, for [`Decoder::take_deferred`]: reading them takes time in
    /// proportion to their size. Frames of the binary form do not need it, because their content stays closed.
    pub fn defer_above(&mut self, bytes: usize) {
        match self {
            Decoder::Xml(decoder) => decoder.defer_above(bytes),
            Decoder::Json(decoder) => decoder.defer_above(bytes),
            Decoder::Binary(_) => {}
        }
    }

    /// The whole frame, left unread, in front of which [`Decoder::decode`] has stopped.
    pub fn take_deferred(&mut self) -> Option<Deferred> {
        match self {
            Decoder::Xml(decoder) => decoder.take_deferred().map(Deferred::Xml),
            Decoder::Json(decoder) => decoder.take_deferred().map(Deferred::Json),
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
            Decoder::Json(decoder) => decoder.decode(input),
        }
    }
}
