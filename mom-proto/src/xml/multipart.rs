//! The parts of a `multipart/related` body (RFC 2046, RFC 2387), and who uses them (M15).

use std::ops::Range;

use bytes::Bytes;
use indexmap::IndexMap;
use indexmap::map::Entry;
use memchr::memmem::Finder;

use crate::text_form::brief;
use crate::{Code, Limits, WireError};

use super::head::{self, Media};

/// The binary parts by their Content-ID; each is taken exactly once.
#[derive(Debug, Default)]
pub(super) struct Parts(IndexMap<String, MimePart>);

#[derive(Debug)]
struct MimePart {
    // Nothing once it is taken.
    data: Option<Bytes>,
    position: usize,
}

impl Parts {
    /// Takes the data of a part.
    pub(super) fn take(&mut self, cid: &str, position: usize) -> Result<Bytes, WireError> {
        let refused = |why: &str| bad_cid(cid, why).position(position);
        match self.0.get_mut(cid) {
            None => Err(refused("names no part")),
            Some(part) => part.data.take().ok_or_else(|| refused("is used twice")),
        }
    }

    /// Refuses parts that nothing refers to.
    pub(super) fn check_used(&self) -> Result<(), WireError> {
        match self.0.iter().find(|(_, part)| part.data.is_some()) {
            None => Ok(()),
            Some((cid, part)) => {
                Err(bad_cid(cid, "is a part that nothing refers to").position(part.position))
            }
        }
    }
}

/// Splits a body: where the XML is (empty if that cannot be told), and the other parts.
pub(super) fn split(
    body: &Bytes,
    boundary: &str,
    limits: &Limits,
) -> (Range<usize>, Result<Parts, WireError>) {
    let mut walk = Walk {
        body,
        delimiter: Finder::new(&format!("\r\n--{boundary}")).into_owned(),
        limits,
        position: 0,
    };
    match walk.first() {
        Ok((xml, more)) => (xml, walk.others(more)),
        Err(error) => (0..0, Err(error)),
    }
}

struct Walk<'a> {
    body: &'a Bytes,
    delimiter: Finder<'static>,
    limits: &'a Limits,
    position: usize,
}

#[derive(Default)]
struct PartHead {
    media: Option<String>,
    id: Option<String>,
}

impl Walk<'_> {
    /// The XML part, and whether more parts follow.
    fn first(&mut self) -> Result<(Range<usize>, bool), WireError> {
        let dashes = &self.delimiter.needle()[2..];
        if !self.body.starts_with(dashes) {
            return Err(bad(0, "a multipart body begins with its boundary"));
        }
        self.position = dashes.len();
        if !self.after_delimiter()? {
            return Err(bad(0, "a multipart body has at least the XML part"));
        }
        let start = self.position;
        let head = self.part_head()?;
        match head.media.as_deref().map(head::media) {
            Some(Ok(Media::Xml)) => {}
            Some(Err(error)) if error.code == Code::BAD_ENCODING => return Err(error.position(start)),
            _ => return Err(bad(start, "the first part is of the type application/xml")),
        }
        self.data()
    }

    fn others(&mut self, mut more: bool) -> Result<Parts, WireError> {
        let mut parts = Parts::default();
        while more {
            let start = self.position;
            // The XML is a part too.
            if parts.0.len() + 1 >= self.limits.parts {
                let text = format!("an entity has at most {} parts", self.limits.parts);
                return Err(bad(start, text));
            }
            let head = self.part_head()?;
            let media = head.media.unwrap_or_default();
            if media
                .trim_start()
                .as_bytes()
                .get(..10)
                .is_some_and(|start| start.eq_ignore_ascii_case(b"multipart/"))
            {
                return Err(bad(start, "a part is not multipart itself"));
            }
            let id = head
                .id
                .ok_or_else(|| bad(start, "a binary part needs a Content-ID"))?;
            let (range, again) = self.data()?;
            more = again;
            match parts.0.entry(id) {
                Entry::Vacant(entry) => entry.insert(MimePart {
                    data: Some(self.body.slice(range)),
                    position: start,
                }),
                Entry::Occupied(entry) => {
                    return Err(bad_cid(entry.key(), "is on two parts").position(start));
                }
            };
        }
        Ok(parts)
    }

    fn part_head(&mut self) -> Result<PartHead, WireError> {
        let start = self.position;
        let mut head = PartHead::default();
        loop {
            let rest = &self.body[self.position..];
            let window = &rest[..rest.len().min(self.limits.header + 1 - (self.position - start))];
            let Some(end) = memchr::memchr(b'\n', window) else {
                return Err(bad(
                    start,
                    "the header lines of a part do not end within the limit",
                ));
            };
            let line = head::without_line_end(&rest[..=end]);
            let at = self.position;
            self.position += end + 1;
            if line.is_empty() {
                return Ok(head);
            }
            head.line(line)
                .map_err(|error| WireError::new(Code::BAD_MIME, error.text).position(at))?;
            if self.position - start > self.limits.header {
                return Err(bad(start, "the header lines of a part are longer than the limit"));
            }
        }
    }

    /// The data up to the next delimiter, and whether another part follows it.
    fn data(&mut self) -> Result<(Range<usize>, bool), WireError> {
        let start = self.position;
        let Some(length) = self.delimiter.find(&self.body[start..]) else {
            return Err(bad(self.body.len(), "the boundary that ends the body is missing"));
        };
        self.position = start + length + self.delimiter.needle().len();
        let more = self.after_delimiter()?;
        Ok((start..start + length, more))
    }

    /// What follows a boundary: a line end and a part, or two dashes and the end.
    fn after_delimiter(&mut self) -> Result<bool, WireError> {
        match &self.body[self.position..] {
            [b'\r', b'\n', ..] => {
                self.position += 2;
                Ok(true)
            }
            b"--" | b"--\r\n" => Ok(false),
            [b'-', b'-', ..] => Err(bad(
                self.position + 2,
                "bytes after the boundary that ends the body",
            )),
            // RFC 2046: a line that begins with the boundary is one, whatever follows.
            _ => Err(bad(
                self.position,
                "the boundary occurs inside a part, or its line continues",
            )),
        }
    }
}

impl PartHead {
    fn line(&mut self, line: &[u8]) -> Result<(), WireError> {
        let (name, value) = head::header(line)?;
        let place = if name.eq_ignore_ascii_case("Content-Type") {
            &mut self.media
        } else if name.eq_ignore_ascii_case("Content-ID") {
            let id = value.strip_prefix('<').and_then(|value| value.strip_suffix('>'));
            if !id.is_some_and(|id| !id.is_empty() && !id.contains(['<', '>', ' ', '\t'])) {
                let text = format!("a Content-ID is written <part-1>, not {:?}", brief(value));
                return Err(WireError::new(Code::BAD_MIME, text));
            }
            &mut self.id
        } else {
            return head::check_encoding(name, value);
        };
        let value = value.trim_matches(['<', '>']).to_owned();
        match place.replace(value) {
            None => Ok(()),
            Some(_) => Err(WireError::new(Code::BAD_MIME, format!("{name} occurs twice"))),
        }
    }
}

fn bad(position: usize, text: impl Into<String>) -> WireError {
    WireError::new(Code::BAD_MIME, text).position(position)
}

fn bad_cid(cid: &str, why: &str) -> WireError {
    let cid = brief(cid);
    WireError::new(Code::BAD_CID, format!("the cid {cid:?} {why}")).detail("cid", cid)
}
