//! Writes parcels: compact XML after its header lines, large binary values in parts (M14, M15).

use std::io::Write as _;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use bytes::Bytes;

use crate::codec::Encoded;
use crate::slots::check_extra;
use crate::{Code, Content, HARD_DEPTH, Parcel, Value, ValueKind, WireError, write_slots};

use super::name::{is_element_key, within};

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
    check_extra(&parcel.extra)?;
    let mut out = Vec::with_capacity(HEAD_BYTES + 512);
    out.resize(HEAD_BYTES, 0);
    let mut writer = XmlWriter {
        out,
        parts: Vec::new(),
    };
    writer.parcel(parcel)?;
    Ok(Encoded {
        head: writer.finish(),
        body: Bytes::new(),
    })
}

struct XmlWriter {
    // HEAD_BYTES of nothing yet, then the XML.
    out: Vec<u8>,
    parts: Vec<Bytes>,
}

impl XmlWriter {
    fn parcel(&mut self, parcel: &Parcel) -> Result<(), WireError> {
        self.out.extend_from_slice(b"<parcel>");
        let mut written = Ok(());
        write_slots(parcel, |key, _, value| {
            if written.is_ok() {
                written = self.member(key, value, HARD_DEPTH);
            }
        });
        written?;
        match &parcel.content {
            None => {}
            Some(Content::Value(value)) => self.member("content", value, HARD_DEPTH)?,
            Some(encoded) => self.member("content", &encoded.to_value()?, HARD_DEPTH)?,
        }
        self.out.extend_from_slice(b"</parcel>");
        Ok(())
    }

    fn member(&mut self, key: &str, value: &Value, depth: usize) -> Result<(), WireError> {
        let written = if is_element_key(key) {
            self.element(key, None, value, depth)
        } else {
            self.element("slot", Some(key), value, depth)
        };
        written.map_err(|error| within(error, key))
    }

    fn element(
        &mut self,
        name: &str,
        key: Option<&str>,
        value: &Value,
        depth: usize,
    ) -> Result<(), WireError> {
        self.out.push(b'<');
        self.out.extend_from_slice(name.as_bytes());
        if let Some(key) = key {
            self.out.extend_from_slice(b" key=\"");
            escape(key, true, &mut self.out)?;
            self.out.push(b'"');
        }
        if value.kind() != ValueKind::String {
            self.out.extend_from_slice(b" type=\"");
            self.out.extend_from_slice(value.kind().word().as_bytes());
            self.out.push(b'"');
        }
        if is_hollow(value) {
            if matches!(value, Value::List(_) | Value::Map(_)) {
                deeper(depth)?;
            }
            self.out.extend_from_slice(b"/>");
            return Ok(());
        }
        if !matches!(value, Value::Binary(_)) {
            self.out.push(b'>');
        }
        self.inside(value, depth)?;
        self.out.extend_from_slice(b"</");
        self.out.extend_from_slice(name.as_bytes());
        self.out.push(b'>');
        Ok(())
    }

    fn inside(&mut self, value: &Value, depth: usize) -> Result<(), WireError> {
        match value {
            Value::Null => Ok(()),
            Value::Bool(flag) => self.put(if *flag { b"true" } else { b"false" }),
            Value::Int(number) => self.put(itoa::Buffer::new().format(*number).as_bytes()),
            // The Debug form is the shortest that reads back equal, with an exponent where it is long.
            Value::Double(number) if number.is_finite() => {
                write!(self.out, "{number:?}").map_err(|error| not_encodable(error.to_string()))
            }
            Value::Double(number) => Err(not_encodable(format!("a double has to be finite, not {number}"))),
            Value::String(text) => escape(text, false, &mut self.out),
            Value::Time(time) => {
                time.write(&mut self.out);
                Ok(())
            }
            Value::Binary(bytes) => self.binary(bytes),
            Value::List(list) => {
                let depth = deeper(depth)?;
                list.iter().enumerate().try_for_each(|(index, item)| {
                    self.element("item", None, item, depth)
                        .map_err(|error| within(error, &index.to_string()))
                })
            }
            Value::Map(map) => {
                let depth = deeper(depth)?;
                map.iter()
                    .try_for_each(|(key, item)| self.member(key, item, depth))
            }
        }
    }

    fn binary(&mut self, bytes: &Bytes) -> Result<(), WireError> {
        if bytes.len() > INLINE_BYTES && self.parts.len() < PARTS {
            self.parts.push(bytes.clone());
            self.out.extend_from_slice(b"><cid>part-");
            self.put(itoa::Buffer::new().format(self.parts.len()).as_bytes())?;
            return self.put(b"</cid>");
        }
        self.out.extend_from_slice(b" encoding=\"base64\">");
        let start = self.out.len();
        self.out.resize(start + bytes.len().div_ceil(3) * 4, 0);
        let written = STANDARD.encode_slice(bytes, &mut self.out[start..]);
        written
            .map(|_| ())
            .map_err(|error| not_encodable(error.to_string()))
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), WireError> {
        self.out.extend_from_slice(bytes);
        Ok(())
    }

    fn finish(mut self) -> Bytes {
        let head = if self.parts.is_empty() {
            let length = self.out.len() - HEAD_BYTES;
            format!("{XML}Content-Length: {length}\r\n\r\n")
        } else {
            let boundary = boundary(&self.out[HEAD_BYTES..], &self.parts);
            for (index, part) in self.parts.iter().enumerate() {
                let id = index + 1;
                let head = format!(
                    "\r\n--{boundary}\r\nContent-Type: application/octet-stream\r\nContent-ID: <part-{id}>\r\n\r\n"
                );
                self.out.reserve(head.len() + part.len() + boundary.len() + 6);
                self.out.extend_from_slice(head.as_bytes());
                self.out.extend_from_slice(part);
            }
            self.out
                .extend_from_slice(format!("\r\n--{boundary}--").as_bytes());
            let first = format!("--{boundary}\r\n{XML}\r\n");
            let length = first.len() + self.out.len() - HEAD_BYTES;
            format!(
                "Content-Type: multipart/related; type=\"application/xml\"; boundary={boundary}\r\n\
                 Content-Length: {length}\r\n\r\n{first}"
            )
        };
        // The longest head, with twenty digits for each number, is below HEAD_BYTES.
        let start = HEAD_BYTES - head.len();
        self.out[start..HEAD_BYTES].copy_from_slice(head.as_bytes());
        Bytes::from(self.out).slice(start..)
    }
}

/// Whether an element of this value has nothing inside.
fn is_hollow(value: &Value) -> bool {
    match value {
        Value::Null => true,
        Value::String(text) => text.is_empty(),
        Value::List(list) => list.is_empty(),
        Value::Map(map) => map.is_empty(),
        _ => false,
    }
}

/// `mom-` and the smallest number with which it stands in none of these pieces.
///
/// Found in one pass: searching again for each candidate would let crafted data take arbitrarily long.
fn boundary(xml: &[u8], parts: &[Bytes]) -> String {
    // More digits than any count of places in memory has.
    const DIGITS: usize = 18;
    let mut taken: Vec<u64> = Vec::new();
    for piece in std::iter::once(xml).chain(parts.iter().map(|part| &part[..])) {
        for at in memchr::memmem::find_iter(piece, b"mom-") {
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
static SPECIAL: [bool; 256] = {
    let mut special = [false; 256];
    let mut byte = 0;
    while byte < 256 {
        special[byte] = byte < 0x20 || byte == 0xEF;
        byte += 1;
    }
    special[b'&' as usize] = true;
    special[b'<' as usize] = true;
    special[b'>' as usize] = true;
    special[b'"' as usize] = true;
    special
};

fn escape(text: &str, attribute: bool, out: &mut Vec<u8>) -> Result<(), WireError> {
    let bytes = text.as_bytes();
    let mut copied = 0;
    for (at, &byte) in bytes.iter().enumerate() {
        if !SPECIAL[usize::from(byte)] {
            continue;
        }
        let escaped: &[u8] = match byte {
            b'&' => b"&amp;",
            b'<' => b"&lt;",
            b'>' => b"&gt;",
            b'"' => b"&quot;",
            b'\r' => b"&#13;",
            b'\n' if attribute => b"&#10;",
            b'\t' if attribute => b"&#9;",
            b'\n' | b'\t' => continue,
            0xEF if !matches!(bytes[at + 1..], [0xBF, 0xBE | 0xBF, ..]) => continue,
            _ => {
                let c = text[at..].chars().next().unwrap_or_default();
                return Err(not_encodable(format!("XML has no character {c:?}")));
            }
        };
        out.extend_from_slice(&bytes[copied..at]);
        out.extend_from_slice(escaped);
        copied = at + 1;
    }
    out.extend_from_slice(&bytes[copied..]);
    Ok(())
}

fn deeper(depth: usize) -> Result<usize, WireError> {
    depth.checked_sub(1).ok_or_else(|| {
        WireError::new(
            Code::TOO_DEEP,
            format!("lists and maps are nested deeper than {HARD_DEPTH}"),
        )
    })
}

fn not_encodable(text: String) -> WireError {
    WireError::new(Code::NOT_ENCODABLE, text)
}
