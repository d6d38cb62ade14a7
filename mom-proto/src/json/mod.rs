//! JSON, one parcel on each line.
//!
//! A parcel is one object, its members are slots. Null, booleans, strings and lists are JSON's own. What JSON does not
//! tell apart has a tag, an object of one member:
//!
//! | value | JSON | read as well |
//! |---|---|---|
//! | int | `7`; from 2⁵³ on `{"$int":"9007199254740992"}` | any whole number of 64 bits, any `$int` |
//! | double | `1.0`, `1e300`: always with a point or an exponent | `{"$double":1}`, for JavaScript |
//! | time | `{"$time":"2026-11-21T10:00:00.000123Z"}`; in a slot of that type the text alone | `$time` there too |
//! | binary | `{"$binary":"AAEC/w=="}` | |
//! | map | an object in order; `{"$map":{…}}` if its first key begins with `$` | any map so |
//!
//! An error inside a line is [`Frame::Malformed`] and the connection stays open; a line longer than the limit ends it.
//! Decided here, where the design is silent:
//! - An object is a tagged value if its first key begins with `$`. It is known when its first key is read, so nothing is
//!   read twice. A tag has no other member.
//! - `-0` and whole numbers beyond 64 bits are doubles, as they are in JavaScript.
//! - The byte that an error names is the one at which serde_json stopped: at the value at fault or just behind it.

mod read;
mod write;

#[cfg(test)]
mod tests;

use bytes::{Buf, Bytes, BytesMut};

use crate::frame::Frame;
use crate::{Code, Limits, WireError};

pub use write::{encode, encode_within};

/// Reads lines from the bytes of one connection, however they are split.
///
/// ```
/// use bytes::BytesMut;
/// use mom_proto::Limits;
/// use mom_proto::codec::Frame;
/// use mom_proto::json::JsonDecoder;
///
/// let mut decoder = JsonDecoder::new(&Limits::default());
/// let mut input = BytesMut::from("{\"family\":\"message\",");
/// assert_eq!(decoder.decode(&mut input), Ok(None), "the line has not ended");
/// input.extend_from_slice(b"\"name\":\"chat\"}\n");
/// let Ok(Some(Frame::Parcel(parcel))) = decoder.decode(&mut input) else { panic!() };
/// assert_eq!(parcel.name(), "chat");
/// ```
#[derive(Debug)]
pub struct JsonDecoder {
    limits: Limits,
    // Bytes at the front of the input that are known to hold no line end.
    scanned: usize,
    // Lines of more bytes are left unread.
    defer_above: usize,
    deferred: Option<Box<DeferredLine>>,
}

/// A line that is here and not read yet.
#[derive(Clone, Debug, PartialEq)]
pub struct DeferredLine {
    line: Bytes,
    limits: Limits,
}

impl DeferredLine {
    /// Its bytes.
    pub fn size(&self) -> usize {
        self.line.len()
    }

    /// Reads it.
    pub fn open(&self) -> Frame {
        frame(&self.line, &self.limits)
    }
}

impl JsonDecoder {
    /// A decoder at the start of a line.
    pub fn new(limits: &Limits) -> JsonDecoder {
        JsonDecoder {
            limits: limits.clone(),
            scanned: 0,
            defer_above: usize::MAX,
            deferred: None,
        }
    }

    /// Changes the limits for all lines that are not read yet, as after login.
    pub fn set_limits(&mut self, limits: &Limits) {
        self.limits = limits.clone();
    }

    /// From now on, stops in front of longer lines, for [`JsonDecoder::take_deferred`].
    pub fn defer_above(&mut self, bytes: usize) {
        self.defer_above = bytes;
    }

    /// The line before which [`JsonDecoder::decode`] has stopped; it goes on behind it.
    pub fn take_deferred(&mut self) -> Option<Box<DeferredLine>> {
        self.deferred.take()
    }

    /// Takes the next line from the front of `input`, or `None` if it is not complete. Empty lines are skipped.
    ///
    /// # Errors
    /// `too-large` as soon as a line is longer than the limit. The decoder is of no use after it.
    pub fn decode(&mut self, input: &mut BytesMut) -> Result<Option<Frame>, WireError> {
        while self.deferred.is_none() {
            let Some(found) = memchr::memchr(b'\n', &input[self.scanned..]) else {
                self.scanned = input.len();
                self.check_length(input.len())?;
                return Ok(None);
            };
            let length = self.scanned + found;
            self.scanned = 0;
            self.check_length(length)?;
            if input[..length].iter().all(|byte| is_blank(*byte)) {
                input.advance(length + 1);
            } else if length > self.defer_above {
                let line = input.split_to(length).freeze();
                input.advance(1);
                let limits = self.limits.clone();
                self.deferred = Some(Box::new(DeferredLine { line, limits }));
            } else {
                let frame = frame(&input[..length], &self.limits);
                input.advance(length + 1);
                return Ok(Some(frame));
            }
        }
        Ok(None)
    }

    fn check_length(&self, length: usize) -> Result<(), WireError> {
        if self.limits.parcel.allows(length) {
            return Ok(());
        }
        let text = format!("a line holds one parcel of at most {} bytes", self.limits.parcel);
        Err(WireError::new(Code::TOO_LARGE, text))
    }
}

fn frame(line: &[u8], limits: &Limits) -> Frame {
    match read::read(line, limits) {
        Ok(parcel) => Frame::Parcel(Box::new(parcel)),
        Err(failed) => Frame::Malformed {
            reference: failed.reference,
            error: failed.error,
        },
    }
}

/// White space of JSON inside a line.
fn is_blank(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t' | b'\r')
}

/// Whether the first bytes of a connection begin this form.
pub fn sniff(first: &[u8]) -> bool {
    first.first() == Some(&b'{')
}
