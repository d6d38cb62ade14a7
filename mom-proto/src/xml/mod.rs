//! XML with MIME headers over TCP (M14, M15, design §5).
//!
//! Each parcel is one entity, as in HTTP: header lines that begin with `Content-`, a blank line, and a body
//! of exactly `Content-Length` bytes. The body is one `<parcel>` element, or `multipart/related` with that
//! element first and each binary value in a part of its own.
//!
//! The grammar is closed: everything else is refused, with a code and the byte in the body. An error inside a
//! complete entity is [`Frame::Malformed`] and the connection stays open; broken framing and `restricted-xml`
//! (document types, declarations, processing instructions) end it. Decided here, where the design is silent:
//! - Line ends and blanks are normalised as XML 1.0 says: CR LF and lone CR in text are LF, tabs and line
//!   ends in attributes are blanks; a character reference is kept as it is.
//! - Base64 text is the standard alphabet with padding; ASCII white space in it is ignored.
//! - Doubles are written in the shortest form that reads back equal; `INF` and `NaN` do not exist.
//! - A multipart body has no preamble and no epilogue but one CR LF; delimiters end in CR LF.

mod attributes;
mod head;
mod lexeme;
mod multipart;
mod name;
mod read;
mod text;
mod write;

#[cfg(test)]
mod tests;

use bytes::{Buf, Bytes, BytesMut};

use crate::frame::Frame;
use crate::{Code, Limits, WireError};

use head::{Body, EntityHead, Media};
use multipart::Parts;

pub use write::{encode, encode_within};

const FIRST: &[u8] = b"content-";

/// Reads XML entities from the bytes of one connection, however they are split.
///
/// ```
/// use bytes::BytesMut;
/// use mom_proto::Limits;
/// use mom_proto::codec::Frame;
/// use mom_proto::xml::XmlDecoder;
///
/// let mut decoder = XmlDecoder::new(&Limits::default());
/// let mut input = BytesMut::from("Content-Type: application/xml\nContent-Length: 60\n\n");
/// assert_eq!(decoder.decode(&mut input), Ok(None), "the body is not there yet");
/// input.extend_from_slice(b"<parcel><family>message</family><name>chat</name></parcel>\n\n");
/// let Ok(Some(Frame::Parcel(parcel))) = decoder.decode(&mut input) else { panic!() };
/// assert_eq!(parcel.name(), "chat");
/// ```
#[derive(Debug)]
pub struct XmlDecoder {
    limits: Limits,
    head: EntityHead,
    // Bytes of this entity's header lines that are read and gone.
    head_bytes: usize,
    // Bytes at the front of the input that are known to hold no line end.
    scanned: usize,
    body: Option<Body>,
    // Bodies of more bytes are left unread.
    defer_above: usize,
    deferred: Option<Box<DeferredEntity>>,
}

/// An entity whose body is here and not read yet.
#[derive(Clone, Debug, PartialEq)]
pub struct DeferredEntity {
    bytes: Bytes,
    media: Media,
    limits: Limits,
}

impl DeferredEntity {
    /// The bytes of its body.
    pub fn size(&self) -> usize {
        self.bytes.len()
    }

    /// Reads it.
    ///
    /// # Errors
    /// `restricted-xml`, after which the connection ends, as from [`XmlDecoder::decode`].
    pub fn open(&self) -> Result<Frame, WireError> {
        open(&self.bytes, &self.media, &self.limits)
    }
}

impl XmlDecoder {
    /// A decoder at the start of an entity.
    pub fn new(limits: &Limits) -> XmlDecoder {
        XmlDecoder {
            limits: limits.clone(),
            head: EntityHead::default(),
            head_bytes: 0,
            scanned: 0,
            body: None,
            defer_above: usize::MAX,
            deferred: None,
        }
    }

    /// Changes the limits for all that is not yet announced, as after login.
    pub fn set_limits(&mut self, limits: &Limits) {
        self.limits = limits.clone();
    }

    /// From now on, stops in front of bodies of more bytes, for [`XmlDecoder::take_deferred`].
    pub fn defer_above(&mut self, bytes: usize) {
        self.defer_above = bytes;
    }

    /// The entity before which [`XmlDecoder::decode`] has stopped; it goes on behind it.
    pub fn take_deferred(&mut self) -> Option<Box<DeferredEntity>> {
        self.deferred.take()
    }

    /// Takes the next entity from the front of `input`, or `None` if it is not complete.
    ///
    /// # Errors
    /// `bad-frame` for bytes that are not an entity's header, `too-large` as soon as a length above the limit is
    /// announced, `restricted-xml` for a document type, a declaration or a processing instruction. The
    /// decoder is of no use after an error.
    pub fn decode(&mut self, input: &mut BytesMut) -> Result<Option<Frame>, WireError> {
        if self.deferred.is_some() {
            return Ok(None);
        }
        if self.body.is_none() {
            self.body = self.read_head(input)?;
        }
        match self.body.take() {
            Some(Body {
                media: Ok(media),
                length,
            }) if length > self.defer_above && input.len() >= length => {
                self.deferred = Some(Box::new(DeferredEntity {
                    bytes: input.split_to(length).freeze(),
                    media,
                    limits: self.limits.clone(),
                }));
                Ok(None)
            }
            Some(body) if input.len() >= body.length => self.read_body(body, input).map(Some),
            waiting => {
                self.body = waiting;
                Ok(None)
            }
        }
    }

    /// Reads header lines as far as they are complete; each byte is looked at once.
    fn read_head(&mut self, input: &mut BytesMut) -> Result<Option<Body>, WireError> {
        let mut start = 0;
        loop {
            let scanned = start + self.scanned;
            let Some(found) = memchr::memchr(b'\n', &input[scanned..]) else {
                input.advance(start);
                self.scanned = input.len();
                self.check_begun_line(input)?;
                return Ok(None);
            };
            let next = scanned + found + 1;
            let line = head::without_line_end(&input[start..next]);
            self.scanned = 0;
            if !line.is_empty() {
                self.head_bytes += next - start;
                self.check_head_bytes(self.head_bytes)?;
                self.head.line(line, &self.limits)?;
            } else if self.head_bytes > 0 {
                self.check_head_bytes(self.head_bytes + next - start)?;
                input.advance(next);
                self.head_bytes = 0;
                return std::mem::take(&mut self.head).finish().map(Some);
            }
            start = next;
        }
    }

    // What cannot become a header line is refused before its end arrives.
    fn check_begun_line(&self, line: &[u8]) -> Result<(), WireError> {
        self.check_head_bytes(self.head_bytes + line.len())?;
        if line.is_empty() || line == b"\r" || head::may_begin(line) {
            return Ok(());
        }
        Err(head::no_header(line))
    }

    fn check_head_bytes(&self, bytes: usize) -> Result<(), WireError> {
        if bytes <= self.limits.header {
            return Ok(());
        }
        let text = format!("the header lines have at most {} bytes", self.limits.header);
        Err(WireError::new(Code::BAD_FRAME, text))
    }

    fn read_body(&self, body: Body, input: &mut BytesMut) -> Result<Frame, WireError> {
        match body.media {
            Ok(Media::Xml) => {
                let frame = frame(&input[..body.length], 0, &self.limits, &mut Parts::default());
                input.advance(body.length);
                frame
            }
            Ok(media) => open(&input.split_to(body.length).freeze(), &media, &self.limits),
            Err(error) => {
                input.advance(body.length);
                Ok(Frame::Malformed {
                    reference: None,
                    error,
                })
            }
        }
    }
}

/// Reads a whole body.
fn open(bytes: &Bytes, media: &Media, limits: &Limits) -> Result<Frame, WireError> {
    let boundary = match media {
        Media::Xml => return frame(bytes, 0, limits, &mut Parts::default()),
        Media::Related { boundary } => boundary,
    };
    let (xml, parts) = multipart::split(bytes, boundary, limits);
    let (xml, base) = (&bytes[xml.clone()], xml.start);
    match parts {
        Ok(mut parts) => frame(xml, base, limits, &mut parts),
        Err(error) => Ok(Frame::Malformed {
            reference: read::reference(xml, base, limits),
            error,
        }),
    }
}

fn frame(xml: &[u8], base: usize, limits: &Limits, parts: &mut Parts) -> Result<Frame, WireError> {
    match read::read(xml, base, limits, parts) {
        Ok(parcel) => Ok(Frame::Parcel(Box::new(parcel))),
        Err(failed) if failed.error.code == Code::RESTRICTED_XML => Err(failed.error),
        Err(failed) => Ok(Frame::Malformed {
            reference: failed.reference,
            error: failed.error,
        }),
    }
}

/// Whether these first bytes of a connection begin this form: `true` when it is sure (after `Content-` or
/// eight bytes), `false` when they are too few to tell.
///
/// # Errors
/// `bad-frame` when they cannot begin it.
pub fn sniff(first: &[u8]) -> Result<bool, WireError> {
    let mut rest = first;
    loop {
        rest = match rest {
            [b'\n', rest @ ..] | [b'\r', b'\n', rest @ ..] => rest,
            _ => break,
        };
    }
    if rest.is_empty() || rest == b"\r" || head::may_begin(rest) {
        return Ok(first.len() >= FIRST.len() || rest.len() >= FIRST.len());
    }
    Err(WireError::new(
        Code::BAD_FRAME,
        "a connection begins with \"Content-\" (XML), { (JSON) or the preface of the binary form",
    ))
}
