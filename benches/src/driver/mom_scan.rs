//! Finding parcels in what a MOM broker sends, without decoding more than one in a thousand.

use std::collections::BTreeMap;

use bytes::BytesMut;
use mom_net::DropReason;
use mom_proto::binary::PREFACE;
use mom_proto::codec::{Decoder, Form, Frame};
use mom_proto::{Family, Limits, Parcel, Value, WireError};

use super::{NUMBER, Scan, Scanner, Template};
use crate::Error;

/// One frame of so many is decoded whole, to be sure that the others are what they look like.
const SAMPLE: u32 = 1024;

/// Decodes some frames whole.
struct Samples {
    form: Form,
    decoder: Decoder,
    seen: u32,
}

fn decoder(form: Form) -> Decoder {
    let mut decoder = Decoder::new(form, &Limits::default());
    if form == Form::Binary {
        // Its own greeting is read already; a preface and nothing after it is not a frame.
        let greeted = decoder.decode(&mut BytesMut::from(&PREFACE[..]));
        debug_assert!(matches!(greeted, Ok(None)));
    }
    decoder
}

/// Decodes a frame that stands alone.
#[cfg(test)]
pub(super) fn decode_one(form: Form, frame: &[u8]) -> Result<Parcel, Error> {
    Samples::new(form).decode(frame)
}

impl Samples {
    fn new(form: Form) -> Samples {
        Samples {
            form,
            decoder: decoder(form),
            seen: 0,
        }
    }

    /// Whether the next message is one to decode.
    fn next(&mut self) -> bool {
        self.seen = self.seen.wrapping_add(1);
        self.seen % SAMPLE == 1
    }

    /// Checks a message.
    fn message(&mut self, frame: &[u8]) -> Result<(), Error> {
        let parcel = self.decode(frame)?;
        let length = match parcel.value() {
            Value::Binary(bytes) => bytes.len(),
            Value::String(text) => text.len(),
            _ => 0,
        };
        let good = parcel.family == Family::Message
            && length >= NUMBER
            && parcel.sender.is_some()
            && parcel.received.is_some()
            && parcel.timestamp.is_some();
        match good {
            true => Ok(()),
            false => Err(Error::Unexpected(format!(
                "a message that was not sent: {parcel:?}"
            ))),
        }
    }

    /// Looks at a frame that is not a message: whatever tells of trouble ends the measurement.
    fn other(&mut self, frame: &[u8]) -> Result<Scan, Error> {
        let parcel = self.decode(frame)?;
        match parcel.family {
            Family::Error => Err(Error::Hub {
                what: "while measuring".to_owned(),
                error: WireError::from_parcel(&parcel),
            }),
            Family::Event if parcel.name() == mom_proto::event::DROPPED => {
                let Value::Map(told) = parcel.value() else {
                    return Ok(Scan::Dropped(frame.len(), 1));
                };
                // A receiver of the run before, of whose end the hub has only heard now. Those of this run count for
                // themselves what comes.
                if told.get("reason").and_then(Value::as_str) == Some(DropReason::Closed.word()) {
                    return Ok(Scan::Other(frame.len()));
                }
                let count = told.get("count").and_then(Value::as_int);
                let count = count.and_then(|count| u64::try_from(count).ok()).unwrap_or(1);
                Ok(Scan::Dropped(frame.len(), count))
            }
            _ => Ok(Scan::Other(frame.len())),
        }
    }

    fn decode(&mut self, frame: &[u8]) -> Result<Parcel, Error> {
        let decoded = self.decoder.decode(&mut BytesMut::from(frame));
        match decoded.map_err(Error::hub("a frame"))? {
            Some(Frame::Parcel(parcel)) => Ok(*parcel),
            other => Err(Error::Unexpected(format!(
                "{other:?} for a frame of {}",
                self.form.word()
            ))),
        }
    }
}

/// Finds parcels in the binary form.
pub(super) struct BinaryScanner {
    samples: Samples,
    /// Parcels that are on their way in pieces, by their streams.
    open: BTreeMap<u64, Pieces>,
}

/// What is known of a parcel in pieces.
enum Pieces {
    /// A message; the last bytes of it that have come, enough for a number.
    Message(Vec<u8>),
    /// Anything else, or a message to be decoded: all of it.
    Kept(Vec<u8>),
}

/// The kinds of frames.
const WHOLE: u8 = 0;
const CHUNK: u8 = 1;
const FIRST: u8 = 1;
const LAST: u8 = 2;
const ABORT: u8 = 4;
/// The presence bit of content, which all messages of peers here have, and the hub's own `halt` has not.
const CONTENT_BIT: u8 = 1 << 5;
/// The presence bit of the slot family, which messages leave out; the bitmap is a varint of seven bits a byte.
const FAMILY_BYTE: usize = 1;
const FAMILY_BIT: u8 = 1 << 3;

/// Whether a frame from its kind on is a message of a peer.
fn is_message(frame: &[u8]) -> bool {
    match frame {
        [WHOLE, low, ..] if low & CONTENT_BIT == 0 => false,
        [WHOLE, low, ..] if *low < 0x80 => true,
        [WHOLE, bitmap @ ..] => bitmap.get(FAMILY_BYTE).is_some_and(|bits| bits & FAMILY_BIT == 0),
        _ => false,
    }
}

impl BinaryScanner {
    pub(super) fn new() -> BinaryScanner {
        BinaryScanner {
            samples: Samples::new(Form::Binary),
            open: BTreeMap::new(),
        }
    }

    /// A piece of a parcel; `size` bytes on the wire.
    fn chunk(&mut self, frame: &[u8], size: usize) -> Result<Scan, Error> {
        let broken = || Error::Unexpected("a chunk that is none".to_owned());
        let mut rest = &frame[1..];
        let stream = varint(&mut rest).ok_or_else(broken)?;
        let (flags, mut piece) = rest.split_first().ok_or_else(broken)?;
        if flags & ABORT != 0 {
            self.open.remove(&stream);
            return Ok(Scan::Other(size));
        }
        let mut parcel = match flags & FIRST {
            0 => self.open.remove(&stream).ok_or_else(broken)?,
            _ => {
                varint(&mut piece).ok_or_else(broken)?;
                match is_message(piece) && !self.samples.next() {
                    true => Pieces::Message(Vec::new()),
                    false => Pieces::Kept(Vec::new()),
                }
            }
        };
        match &mut parcel {
            Pieces::Message(tail) => {
                tail.extend_from_slice(&piece[piece.len().saturating_sub(NUMBER)..]);
                let old = tail.len().saturating_sub(NUMBER);
                tail.drain(..old);
            }
            Pieces::Kept(bytes) => bytes.extend_from_slice(piece),
        }
        if flags & LAST == 0 {
            self.open.insert(stream, parcel);
            return Ok(Scan::Other(size));
        }
        match parcel {
            Pieces::Message(tail) => Ok(Scan::Parcel(size, Template::last_number(&tail)?)),
            Pieces::Kept(bytes) => {
                let length = u32::try_from(bytes.len()).map_err(|_| broken())?;
                let whole = [&length.to_be_bytes()[..], &bytes].concat();
                match is_message(&bytes) {
                    true => {
                        self.samples.message(&whole)?;
                        Ok(Scan::Parcel(size, Template::last_number(&bytes)?))
                    }
                    false => self.samples.other(&whole).map(|scan| match scan {
                        Scan::Dropped(_, count) => Scan::Dropped(size, count),
                        _ => Scan::Other(size),
                    }),
                }
            }
        }
    }
}

/// Takes a number of seven bits a byte, the lowest first.
fn varint(bytes: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for index in 0..9 {
        let (byte, rest) = bytes.split_first()?;
        *bytes = rest;
        value |= u64::from(byte & 0x7f) << (7 * index);
        if byte & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

impl Scanner for BinaryScanner {
    fn scan(&mut self, bytes: &[u8]) -> Result<Scan, Error> {
        let Some((length, rest)) = bytes.split_first_chunk::<4>() else {
            return Ok(Scan::Incomplete);
        };
        let Some(frame) = rest.get(..u32::from_be_bytes(*length) as usize) else {
            return Ok(Scan::Incomplete);
        };
        let size = frame.len() + 4;
        if frame.first() == Some(&CHUNK) {
            return self.chunk(frame, size);
        }
        if !is_message(frame) {
            return self.samples.other(&bytes[..size]);
        }
        if self.samples.next() {
            self.samples.message(&bytes[..size])?;
        }
        Ok(Scan::Parcel(size, Template::last_number(frame)?))
    }
}

/// Finds parcels in the XML form.
pub(super) struct XmlScanner {
    samples: Samples,
}

const XML_MESSAGE: &[u8] = b"<parcel><family>message</family>";
pub(super) const XML_END: &[u8] = b"</content></parcel>";

impl XmlScanner {
    pub(super) fn new() -> XmlScanner {
        XmlScanner {
            samples: Samples::new(Form::Xml),
        }
    }
}

impl Scanner for XmlScanner {
    fn scan(&mut self, bytes: &[u8]) -> Result<Scan, Error> {
        let Some(size) = entity(bytes)? else {
            return Ok(Scan::Incomplete);
        };
        let body = &bytes[size.header..size.whole];
        let message = body
            .strip_prefix(XML_MESSAGE)
            .and_then(|rest| rest.strip_suffix(XML_END));
        let Some(message) = message else {
            return self.samples.other(&bytes[..size.whole]);
        };
        if self.samples.next() {
            self.samples.message(&bytes[..size.whole])?;
        }
        Ok(Scan::Parcel(size.whole, Template::last_number(message)?))
    }
}

/// Finds parcels in the JSON form.
pub(super) struct JsonScanner {
    samples: Samples,
}

const JSON_MESSAGE: &[u8] = b"{\"family\":\"message\",";
const JSON_CONTENT: &[u8] = b",\"content\":\"";
pub(super) const JSON_END: &[u8] = b"\"}\n";

impl JsonScanner {
    pub(super) fn new() -> JsonScanner {
        JsonScanner {
            samples: Samples::new(Form::Json),
        }
    }
}

impl Scanner for JsonScanner {
    fn scan(&mut self, bytes: &[u8]) -> Result<Scan, Error> {
        let Some(end) = memchr::memchr(b'\n', bytes) else {
            return Ok(Scan::Incomplete);
        };
        let line = &bytes[..=end];
        let message = line
            .strip_prefix(JSON_MESSAGE)
            .and_then(|rest| rest.strip_suffix(JSON_END))
            .filter(|rest| memchr::memmem::find(rest, JSON_CONTENT).is_some());
        let Some(message) = message else {
            return self.samples.other(line);
        };
        if self.samples.next() {
            self.samples.message(line)?;
        }
        Ok(Scan::Parcel(line.len(), Template::last_number(message)?))
    }
}

/// The lengths of an XML entity, in bytes.
struct Entity {
    header: usize,
    whole: usize,
}

/// The entity at the front, if all of it is there.
fn entity(bytes: &[u8]) -> Result<Option<Entity>, Error> {
    const END: &[u8] = b"\r\n\r\n";
    const LENGTH: &[u8] = b"Content-Length: ";
    let Some(end) = memchr::memmem::find(bytes, END) else {
        return Ok(None);
    };
    let digits = memchr::memmem::find(&bytes[..end], LENGTH)
        .map(|at| &bytes[at + LENGTH.len()..end])
        .and_then(|rest| rest.split(|byte| *byte == b'\r').next());
    let length = digits
        .and_then(super::decimal)
        .ok_or_else(|| Error::Unexpected("an entity without a length".to_owned()))?;
    let header = end + END.len();
    let whole = header + length;
    Ok((whole <= bytes.len()).then_some(Entity { header, whole }))
}
