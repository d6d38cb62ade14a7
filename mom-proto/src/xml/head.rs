//! The header lines before an entity and before each of its parts.

use mime::Mime;

use crate::text_form::brief;
use crate::{Code, Limits, WireError};

use super::FIRST;

// Lines as this crate itself writes them need no parser of headers and media types.
const OWN_TYPE: &[u8] = b"Content-Type: application/xml; charset=utf-8";
const OWN_LENGTH: &[u8] = b"Content-Length: ";
const BOUNDARY_BYTES: usize = 70;

/// What an entity's body is.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Media {
    /// One XML document.
    Xml,
    /// An XML document and its binary parts.
    Related { boundary: String },
}

/// The body that header lines announce.
#[derive(Debug)]
pub(super) struct Body {
    pub(super) length: usize,
    /// Its type, or why it is skipped and refused.
    pub(super) media: Result<Media, WireError>,
}

/// The header lines of one entity so far.
#[derive(Debug, Default)]
pub(super) struct EntityHead {
    length: Option<usize>,
    media: Option<Result<Media, WireError>>,
    encoding: Option<WireError>,
}

impl EntityHead {
    /// Takes one line, without its line end.
    pub(super) fn line(&mut self, line: &[u8], limits: &Limits) -> Result<(), WireError> {
        if line == OWN_TYPE {
            return put_once(&mut self.media, Ok(Media::Xml), "Content-Type");
        }
        if let Some(digits) = line.strip_prefix(OWN_LENGTH)
            && let Some(value) = decimal(digits)
        {
            return put_once(&mut self.length, length(value, limits)?, "Content-Length");
        }
        let (name, value) = header(line)?;
        if name.eq_ignore_ascii_case("Content-Length") {
            let length = length(value, limits)?;
            return put_once(&mut self.length, length, "Content-Length");
        }
        if name.eq_ignore_ascii_case("Content-Type") {
            return put_once(&mut self.media, media(value), "Content-Type");
        }
        if let Err(error) = check_encoding(name, value) {
            self.encoding.get_or_insert(error);
        }
        Ok(())
    }

    /// The body that all lines announce.
    pub(super) fn finish(self) -> Result<Body, WireError> {
        let length = self.length.ok_or_else(|| missing("Content-Length"))?;
        let media = self.media.ok_or_else(|| missing("Content-Type"))?;
        Ok(Body {
            length,
            media: self.encoding.map_or(media, Err),
        })
    }
}

/// A line without its LF or CR LF.
pub(super) fn without_line_end(line: &[u8]) -> &[u8] {
    let line = line.strip_suffix(b"\n").unwrap_or(line);
    line.strip_suffix(b"\r").unwrap_or(line)
}

/// Whether a header line may begin with these bytes.
pub(super) fn may_begin(line: &[u8]) -> bool {
    let known = line.len().min(FIRST.len());
    line[..known].eq_ignore_ascii_case(&FIRST[..known])
}

/// The error for a line that is not a header.
pub(super) fn no_header(line: &[u8]) -> WireError {
    let shown = String::from_utf8_lossy(&line[..line.len().min(40)]);
    let text = format!("a header line is Content-Something: value, in ASCII, not {shown:?}");
    WireError::new(Code::BAD_FRAME, text)
}

/// The name and value of a header line.
pub(super) fn header(line: &[u8]) -> Result<(&str, &str), WireError> {
    let plain = |byte: &u8| matches!(byte, b'\t' | b' '..=b'~');
    let text = std::str::from_utf8(line)
        .ok()
        .filter(|text| may_begin(line) && text.as_bytes().iter().all(plain));
    let (name, value) = text
        .and_then(|text| text.split_once(':'))
        .ok_or_else(|| no_header(line))?;
    // A blank before the colon would allow request smuggling past lenient readers.
    let token = |byte: u8| byte.is_ascii_alphanumeric() || b"-_".contains(&byte);
    match name.len() > FIRST.len() && name.bytes().all(token) {
        true => Ok((name, value.trim_matches([' ', '\t']))),
        false => Err(no_header(line)),
    }
}

/// Refuses encodings that change the bytes.
pub(super) fn check_encoding(name: &str, value: &str) -> Result<(), WireError> {
    let encodes = name.eq_ignore_ascii_case("Content-Encoding")
        || name.eq_ignore_ascii_case("Content-Transfer-Encoding");
    let same = ["identity", "binary", "8bit"]
        .iter()
        .any(|word| value.eq_ignore_ascii_case(word));
    if !encodes || same {
        return Ok(());
    }
    let text = format!("{name} is identity, binary or 8bit, not {:?}", brief(value));
    Err(WireError::new(Code::BAD_MIME, text))
}

/// Reads the type of an entity.
pub(super) fn media(value: &str) -> Result<Media, WireError> {
    let refused = |why: &str| {
        let text = format!("{why}; the type {:?} is not supported", brief(value));
        WireError::new(Code::BAD_MIME, text)
    };
    let mime: Mime = value.parse().map_err(|_| refused("no media type"))?;
    let known: &[&str] = match mime.essence_str() {
        "application/xml" => &["charset"],
        "multipart/related" => &["type", "boundary"],
        _ => return Err(refused("application/xml or multipart/related is expected")),
    };
    // If one side ignored a parameter that another obeys, they would read different things.
    let mut seen: Vec<mime::Name<'_>> = Vec::new();
    for (name, _) in mime.params() {
        if seen.contains(&name) || !known.contains(&name.as_str()) {
            return Err(refused("a parameter is unknown or occurs twice"));
        }
        seen.push(name);
    }
    if known == ["charset"] {
        return xml_type(&mime);
    }
    let root = mime.get_param("type").map(|root| root.as_str());
    if !root.is_some_and(|root| root.eq_ignore_ascii_case("application/xml")) {
        return Err(refused("multipart/related needs type=\"application/xml\""));
    }
    let boundary = mime.get_param(mime::BOUNDARY).map(|boundary| boundary.as_str());
    let boundary = boundary.filter(|boundary| is_boundary(boundary)).ok_or_else(|| {
        refused("multipart/related needs a boundary of 1 to 70 letters, digits and '()+_,-./:=? or blanks")
    })?;
    Ok(Media::Related {
        boundary: boundary.to_owned(),
    })
}

fn xml_type(mime: &Mime) -> Result<Media, WireError> {
    match mime.get_param(mime::CHARSET) {
        Some(charset) if charset != mime::UTF_8 => Err(WireError::new(
            Code::BAD_ENCODING,
            format!("XML is in UTF-8 here, not {:?}", brief(charset.as_str())),
        )),
        _ => Ok(Media::Xml),
    }
}

// RFC 2046 §5.1.1.
fn is_boundary(text: &str) -> bool {
    let allowed = |byte: u8| byte.is_ascii_alphanumeric() || b"'()+_,-./:=? ".contains(&byte);
    (1..=BOUNDARY_BYTES).contains(&text.len()) && !text.ends_with(' ') && text.bytes().all(allowed)
}

/// Digits, at least one.
fn decimal(bytes: &[u8]) -> Option<&str> {
    let digits = !bytes.is_empty() && bytes.iter().all(u8::is_ascii_digit);
    std::str::from_utf8(bytes).ok().filter(|_| digits)
}

fn length(value: &str, limits: &Limits) -> Result<usize, WireError> {
    if decimal(value.as_bytes()).is_none() {
        let text = format!(
            "Content-Length is a decimal number of bytes, not {:?}",
            brief(value)
        );
        return Err(WireError::new(Code::BAD_FRAME, text));
    }
    // Only digits: what does not fit is larger than any limit.
    match value.parse() {
        Ok(length) if limits.parcel.allows(length) => Ok(length),
        _ => Err(WireError::new(
            Code::TOO_LARGE,
            format!(
                "a parcel has at most {} bytes, not {}",
                limits.parcel,
                brief(value)
            ),
        )),
    }
}

fn put_once<T>(place: &mut Option<T>, value: T, name: &str) -> Result<(), WireError> {
    match place.replace(value) {
        None => Ok(()),
        Some(_) => Err(WireError::new(Code::BAD_FRAME, format!("{name} occurs twice"))),
    }
}

fn missing(name: &str) -> WireError {
    WireError::new(Code::BAD_FRAME, format!("an entity needs {name}"))
}
