//! Writes parcels: compact XML after its header lines, large binary values in parts (M14, M15).

use std::collections::HashSet;
use std::io::Write as _;
use std::sync::LazyLock;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use bytes::Bytes;
use memchr::memmem::Finder;

use crate::frame::Encoded;
use crate::msgpack::{self, Item, ItemReader, key_twice};
use crate::names::position_of;
use crate::slots::check_extra;
use crate::text_form::{deeper, not_encodable, too_large, within};
use crate::{Content, HARD_DEPTH, Limit, Parcel, SlotValue, Value, ValueKind, WireError, write_slots};

use super::name::is_element_key;

// Longer binary gets a part of its own: base64 costs a third more, a part some 80 bytes.
const INLINE_BYTES: usize = 64;
// With the XML as many as the default limits allow; what remains goes inline.
const PARTS: usize = 255;
// Room before the XML for header lines, whose length is known only after it.
const HEAD_BYTES: usize = 256;
const XML: &str = "Content-Type: application/xml; charset=utf-8\r\n";

/// Encodes a parcel as one entity.
///
/// The slots come in a fixed order, content last, without white space between them; every value but a string
/// has its type. Binary values above 64 bytes become the parts `part-1`, `part-2` …
///
/// ```
/// use mom_proto::{Family, Parcel, xml};
/// let encoded = xml::encode(&Parcel::new(Family::Message, "chat").content("a < b")).unwrap();
/// assert!(encoded.to_vec().ends_with(b"<content>a &lt; b</content></parcel>"));
/// ```
///
/// # Errors
/// `not-encodable` with its slot for a double that is not finite and for text that XML cannot hold,
/// `too-deep` beyond [`HARD_DEPTH`], `bad-slot` for a known slot among the other ones, and what
/// [`Content::to_value`] says about encoded content.
pub fn encode(parcel: &Parcel) -> Result<Encoded, WireError> {
    encode_within(parcel, HARD_DEPTH, Limit::Unlimited)
}

/// As [`encode`], for content of so many levels at most and an entity of so many bytes. The bounds hold while it is
/// written: what is refused needs no more memory than what is not.
///
/// # Errors
/// As [`encode`]; `too-deep` for encoded content beyond `depth`, `not-encodable` beyond `most`.
pub fn encode_within(parcel: &Parcel, depth: usize, most: Limit) -> Result<Encoded, WireError> {
    check_extra(&parcel.extra)?;
    let mut out = Vec::with_capacity(HEAD_BYTES + 512);
    out.resize(HEAD_BYTES, 0);
    let mut writer = XmlWriter {
        out,
        parts: Vec::new(),
        part_bytes: 0,
        most: most.get(),
    };
    writer.parcel(parcel, depth)?;
    let head = writer.finish();
    match most.allows(head.len()) {
        true => Ok(Encoded {
            head,
            body: Bytes::new(),
        }),
        false => Err(too_large("XML", most.get())),
    }
}

struct XmlWriter {
    // HEAD_BYTES of nothing yet, then the XML.
    out: Vec<u8>,
    parts: Vec<Bytes>,
    part_bytes: usize,
    most: usize,
}

impl XmlWriter {
    fn parcel(&mut self, parcel: &Parcel, depth: usize) -> Result<(), WireError> {
        self.out.extend_from_slice(b"<parcel>");
        let mut written = Ok(());
        write_slots(parcel, |key, value| {
            if written.is_ok() {
                written = self.slot(key, &value);
            }
        });
        written?;
        match &parcel.content {
            None => {}
            Some(Content::Value(value)) => self.member("content", value, HARD_DEPTH)?,
            Some(encoded) => {
                let bytes = encoded.to_msgpack()?;
                let mut items = ItemReader::new(&bytes);
                self.encoded("content", None, &mut items, depth)?;
                items.end()?;
            }
        }
        self.out.extend_from_slice(b"</parcel>");
        Ok(())
    }

    fn slot(&mut self, key: &str, value: &SlotValue<'_>) -> Result<(), WireError> {
        match value {
            SlotValue::Value(value) => self.member(key, value, HARD_DEPTH),
            SlotValue::Text(text) => {
                let (name, attribute) = element_of(key);
                self.leaf(name, attribute, Item::Text(text))
                    .map_err(|error| within(error, key))
            }
        }
    }

    fn member(&mut self, key: &str, value: &Value, depth: usize) -> Result<(), WireError> {
        let (name, attribute) = element_of(key);
        self.element(name, attribute, value, depth)
            .map_err(|error| within(error, key))
    }

    fn element(
        &mut self,
        name: &str,
        key: Option<&str>,
        value: &Value,
        depth: usize,
    ) -> Result<(), WireError> {
        match value {
            Value::List(list) => {
                let depth = deeper(depth)?;
                if !self.open(name, key, ValueKind::List, list.len())? {
                    return Ok(());
                }
                list.iter().enumerate().try_for_each(|(index, item)| {
                    self.element("item", None, item, depth)
                        .map_err(|error| within(error, &index.to_string()))
                })?;
            }
            Value::Map(map) => {
                let depth = deeper(depth)?;
                if !self.open(name, key, ValueKind::Map, map.len())? {
                    return Ok(());
                }
                map.iter()
                    .try_for_each(|(key, item)| self.member(key, item, depth))?;
            }
            Value::Null => return self.leaf(name, key, Item::Null),
            Value::Bool(flag) => return self.leaf(name, key, Item::Bool(*flag)),
            Value::Int(number) => return self.leaf(name, key, Item::Int(*number)),
            Value::Double(number) => return self.leaf(name, key, Item::Double(*number)),
            Value::String(text) => return self.leaf(name, key, Item::Text(text)),
            Value::Time(time) => return self.leaf(name, key, Item::Time(*time)),
            Value::Binary(bytes) => return self.leaf(name, key, Item::Binary(bytes.clone())),
        }
        self.close(name)
    }

    /// An element of the next value of encoded content, in which so many levels more may open.
    fn encoded(
        &mut self,
        name: &str,
        key: Option<&str>,
        items: &mut ItemReader<'_>,
        depth: usize,
    ) -> Result<(), WireError> {
        let start = items.position();
        match items.item()? {
            Item::List(length) => {
                let depth = msgpack::deeper(depth, start)?;
                if !self.open(name, key, ValueKind::List, length)? {
                    return Ok(());
                }
                (0..length).try_for_each(|_| self.encoded("item", None, items, depth))?;
            }
            Item::Map(length) => {
                let depth = msgpack::deeper(depth, start)?;
                if !self.open(name, key, ValueKind::Map, length)? {
                    return Ok(());
                }
                let mut keys = HashSet::new();
                for _ in 0..length {
                    let at = items.position();
                    let key = items.key()?;
                    if !keys.insert(key) {
                        return Err(key_twice(key, at));
                    }
                    let (name, attribute) = element_of(key);
                    self.encoded(name, attribute, items, depth)?;
                }
            }
            leaf => return self.leaf(name, key, leaf),
        }
        self.close(name)
    }

    /// An element with nothing but text in it.
    fn leaf(&mut self, name: &str, key: Option<&str>, value: Item<'_>) -> Result<(), WireError> {
        match value {
            Item::Null => {
                self.open(name, key, ValueKind::Null, 0)?;
                return Ok(());
            }
            Item::Bool(flag) => {
                self.open(name, key, ValueKind::Bool, 1)?;
                self.put(if flag { b"true" } else { b"false" });
            }
            Item::Int(number) => {
                self.open(name, key, ValueKind::Int, 1)?;
                self.put(itoa::Buffer::new().format(number).as_bytes());
            }
            Item::Double(number) if number.is_finite() => {
                self.open(name, key, ValueKind::Double, 1)?;
                // The Debug form is the shortest that reads back equal, with an exponent where it is long.
                write!(self.out, "{number:?}").map_err(|error| not_encodable(error.to_string()))?;
            }
            Item::Double(number) => {
                return Err(not_encodable(format!("a double must be finite, not {number}")));
            }
            Item::Text(text) => {
                if !self.open(name, key, ValueKind::String, text.len())? {
                    return Ok(());
                }
                escape(text, false, &mut self.out, self.most)?;
            }
            Item::Time(time) => {
                self.open(name, key, ValueKind::Time, 1)?;
                time.write(&mut self.out);
            }
            Item::Binary(bytes) => {
                self.begin(name, key, ValueKind::Binary)?;
                self.binary(&bytes)?;
            }
            Item::List(_) | Item::Map(_) => {}
        }
        self.close(name)
    }

    /// Begins an element of something with so many members; false if it has none and ends here.
    fn open(
        &mut self,
        name: &str,
        key: Option<&str>,
        kind: ValueKind,
        members: usize,
    ) -> Result<bool, WireError> {
        self.begin(name, key, kind)?;
        self.put(if members > 0 { b">" } else { b"/>" });
        Ok(members > 0)
    }

    /// Begins a tag, which has to be ended.
    fn begin(&mut self, name: &str, key: Option<&str>, kind: ValueKind) -> Result<(), WireError> {
        if self.out.len() + self.part_bytes > self.most.saturating_add(HEAD_BYTES) {
            return Err(too_large("XML", self.most));
        }
        self.out.push(b'<');
        self.put(name.as_bytes());
        if let Some(key) = key {
            self.put(b" key=\"");
            escape(key, true, &mut self.out, self.most)?;
            self.out.push(b'"');
        }
        if kind != ValueKind::String {
            self.put(b" type=\"");
            self.put(kind.word().as_bytes());
            self.out.push(b'"');
        }
        Ok(())
    }

    fn close(&mut self, name: &str) -> Result<(), WireError> {
        self.put(b"</");
        self.put(name.as_bytes());
        self.out.push(b'>');
        Ok(())
    }

    fn binary(&mut self, bytes: &Bytes) -> Result<(), WireError> {
        if bytes.len() > INLINE_BYTES && self.parts.len() < PARTS {
            self.parts.push(bytes.clone());
            self.part_bytes += bytes.len();
            self.put(b"><cid>part-");
            self.put(itoa::Buffer::new().format(self.parts.len()).as_bytes());
            self.put(b"</cid>");
            return Ok(());
        }
        self.out.extend_from_slice(b" encoding=\"base64\">");
        let start = self.out.len();
        self.out.resize(start + bytes.len().div_ceil(3) * 4, 0);
        let written = STANDARD.encode_slice(bytes, &mut self.out[start..]);
        written
            .map(|_| ())
            .map_err(|error| not_encodable(error.to_string()))
    }

    fn put(&mut self, bytes: &[u8]) {
        self.out.extend_from_slice(bytes);
    }

    fn finish(mut self) -> Bytes {
        let head = if self.parts.is_empty() {
            let length = self.out.len() - HEAD_BYTES;
            [
                XML,
                "Content-Length: ",
                itoa::Buffer::new().format(length),
                "\r\n\r\n",
            ]
            .concat()
        } else {
            let boundary = boundary(&self.out[HEAD_BYTES..], &self.parts);
            for (index, part) in self.parts.iter().enumerate() {
                let head = [
                    "\r\n--",
                    &boundary,
                    "\r\nContent-Type: application/octet-stream\r\nContent-ID: <part-",
                    itoa::Buffer::new().format(index + 1),
                    ">\r\n\r\n",
                ]
                .concat();
                self.out.reserve(head.len() + part.len() + boundary.len() + 6);
                self.out.extend_from_slice(head.as_bytes());
                self.out.extend_from_slice(part);
            }
            for piece in ["\r\n--", &boundary, "--"] {
                self.out.extend_from_slice(piece.as_bytes());
            }
            let first = ["--", &boundary, "\r\n", XML, "\r\n"].concat();
            [
                "Content-Type: multipart/related; type=\"application/xml\"; boundary=",
                &boundary,
                "\r\nContent-Length: ",
                itoa::Buffer::new().format(first.len() + self.out.len() - HEAD_BYTES),
                "\r\n\r\n",
                &first,
            ]
            .concat()
        };
        // The longest head, with twenty digits for each number, is below HEAD_BYTES.
        let start = HEAD_BYTES - head.len();
        self.out[start..HEAD_BYTES].copy_from_slice(head.as_bytes());
        Bytes::from(self.out).slice(start..)
    }
}

/// The name of the element for a member of this key, and the key as its attribute where that is not a name.
fn element_of(key: &str) -> (&str, Option<&str>) {
    match is_element_key(key) {
        true => (key, None),
        false => ("slot", Some(key)),
    }
}

/// `mom-` and the smallest number with which it stands in none of these pieces.
///
/// Found in one pass: searching again for each candidate would let crafted data take arbitrarily long.
fn boundary(xml: &[u8], parts: &[Bytes]) -> String {
    // More digits than any count of places in memory has.
    const DIGITS: usize = 18;
    static MARK: LazyLock<Finder<'static>> = LazyLock::new(|| Finder::new("mom-"));
    let mut taken: Vec<u64> = Vec::new();
    for piece in std::iter::once(xml).chain(parts.iter().map(|part| &part[..])) {
        for at in MARK.find_iter(piece) {
            let digits = piece[at + 4..]
                .iter()
                .take(DIGITS)
                .take_while(|byte| byte.is_ascii_digit());
            let mut number = 0;
            for digit in digits {
                number = number * 10 + u64::from(digit - b'0');
                taken.push(number);
            }
        }
    }
    taken.sort_unstable();
    taken.dedup();
    let free = (0..).zip(&taken).find(|(number, taken)| number != *taken);
    let free = free.map_or(taken.len() as u64, |(number, _)| number);
    format!("mom-{free}")
}

// What has to be looked at: markup, line ends and tabs, what XML does not have, and 0xEF, with which
// U+FFFE and U+FFFF begin.
fn is_special(byte: u8) -> bool {
    (byte < 0x20) | (byte == b'&') | (byte == b'<') | (byte == b'>') | (byte == b'"') | (byte == 0xEF)
}

fn escape(text: &str, attribute: bool, out: &mut Vec<u8>, most: usize) -> Result<(), WireError> {
    let bytes = text.as_bytes();
    let mut copied = 0;
    let mut at = 0;
    while let Some(found) = position_of(&bytes[at..], is_special) {
        at += found + 1;
        let special = at - 1;
        let escaped: &[u8] = match bytes[special] {
            b'&' => b"&amp;",
            b'<' => b"&lt;",
            b'>' => b"&gt;",
            b'"' => b"&quot;",
            b'\r' => b"&#13;",
            b'\n' if attribute => b"&#10;",
            b'\t' if attribute => b"&#9;",
            b'\n' | b'\t' => continue,
            0xEF if !matches!(bytes[at..], [0xBF, 0xBE | 0xBF, ..]) => continue,
            _ => {
                let c = text[special..].chars().next().unwrap_or_default();
                return Err(not_encodable(format!("XML has no character {c:?}")));
            }
        };
        out.extend_from_slice(&bytes[copied..special]);
        out.extend_from_slice(escaped);
        copied = at;
        if out.len() > most.saturating_add(HEAD_BYTES) {
            return Err(too_large("XML", most));
        }
    }
    out.extend_from_slice(&bytes[copied..]);
    Ok(())
}
