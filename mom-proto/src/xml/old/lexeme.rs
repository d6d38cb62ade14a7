//! Lexemes of XML, of the few kinds that the grammar has.

use std::borrow::Cow;

use crate::nearest::nearest;
use crate::text_form::{brief, within};
use crate::{Code, Limits, ValueKind, WireError};

use super::name::is_name;
use super::text::{TextKind, bad, first_ink, is_blank, unescape};

/// One lexeme; positions count from the start of the text.
#[derive(Debug)]
pub(super) enum Lexeme<'a> {
    /// `<name …>` or `<name …/>`.
    Open(Tag<'a>),
    /// `</name>`.
    Close(&'a str),
    /// Characters and references, as they stand there.
    Text(&'a str),
    /// Nothing more.
    End,
}

/// A start tag with the attributes of the grammar.
#[derive(Debug)]
pub(super) struct Tag<'a> {
    pub(super) name: &'a str,
    pub(super) key: Option<Cow<'a, str>>,
    pub(super) kind: Option<ValueKind>,
    pub(super) base64: bool,
    /// Whether it is its own end.
    pub(super) empty: bool,
    /// The position of its `<` in the body.
    pub(super) position: usize,
}

impl Tag<'_> {
    /// Whether there is nothing but the name.
    pub(super) fn is_bare(&self) -> bool {
        self.key.is_none() && self.kind.is_none() && !self.base64
    }
}

/// The lexemes of one document.
pub(super) struct Lexemes<'a> {
    text: &'a str,
    at: usize,
    base: usize,
    limits: &'a Limits,
}

impl<'a> Lexemes<'a> {
    /// The tokens of `text`, which lies at `base` in the body; an XML declaration is read already.
    pub(super) fn new(text: &'a str, base: usize, limits: &'a Limits) -> Result<Lexemes<'a>, WireError> {
        let at = declaration(text, base, limits)?;
        Ok(Lexemes {
            text,
            at,
            base,
            limits,
        })
    }

    /// Where the next token begins, in the body.
    pub(super) fn position(&self) -> usize {
        self.base + self.at
    }

    /// The raw text from one position of the body to another.
    pub(super) fn between(&self, start: usize, end: usize) -> &'a str {
        &self.text[start - self.base..end - self.base]
    }

    /// The next token.
    pub(super) fn next(&mut self) -> Result<Lexeme<'a>, WireError> {
        let rest = &self.text[self.at..];
        let length = match rest.as_bytes() {
            [] => return Ok(Lexeme::End),
            // Before its end is looked for: a document type may be as long as the body.
            [b'<', b'!' | b'?', ..] => return Err(self.refused_markup(rest.as_bytes())),
            [b'<', b'/', ..] => return self.close(rest).map(Lexeme::Close),
            [b'<', ..] => return self.open(rest).map(Lexeme::Open),
            bytes => memchr::memchr(b'<', bytes).unwrap_or(bytes.len()),
        };
        self.at += length;
        Ok(Lexeme::Text(&rest[..length]))
    }

    /// The text up to `</name>` and that tag, if there is nothing else between.
    pub(super) fn text_of(&mut self, name: &str) -> Option<&'a str> {
        let rest = &self.text[self.at..];
        let text = &rest[..memchr::memchr(b'<', rest.as_bytes())?];
        let after = rest[text.len()..].strip_prefix("</")?.strip_prefix(name)?;
        let after = after.strip_prefix('>')?;
        self.at = self.text.len() - after.len();
        Some(text)
    }

    fn close(&mut self, rest: &'a str) -> Result<&'a str, WireError> {
        let end = memchr::memchr(b'>', rest.as_bytes()).ok_or_else(|| self.endless())?;
        self.at += end + 1;
        Ok(rest[2..end].trim_end_matches([' ', '\t', '\r', '\n']))
    }

    fn endless(&self) -> WireError {
        bad(self.position(), "this tag does not end")
    }

    fn refused_markup(&self, rest: &[u8]) -> WireError {
        let begins = |prefix: &[u8]| {
            rest.get(..prefix.len())
                .is_some_and(|start| start.eq_ignore_ascii_case(prefix))
        };
        let declares: [&[u8]; 5] = [
            b"<!DOCTYPE",
            b"<!ENTITY",
            b"<!ELEMENT",
            b"<!ATTLIST",
            b"<!NOTATION",
        ];
        let what = if begins(b"<?") {
            "a processing instruction"
        } else if declares.into_iter().any(begins) {
            "a document type or declaration"
        } else if begins(b"<!--") {
            return bad(self.position(), "a parcel has no comments");
        } else if begins(b"<![CDATA[") {
            return bad(
                self.position(),
                "a parcel has no CDATA sections: write &lt; and &amp;",
            );
        } else {
            return bad(self.position(), "this markup is no part of a parcel");
        };
        WireError::new(Code::RESTRICTED_XML, format!("{what} is never allowed")).position(self.position())
    }

    fn open(&mut self, rest: &'a str) -> Result<Tag<'a>, WireError> {
        let position = self.position();
        let name_ends = |byte: u8| is_blank(byte) || byte == b'>' || byte == b'/';
        let end = rest.bytes().position(name_ends).ok_or_else(|| self.endless())?;
        let mut tag = Tag {
            name: &rest[1..end],
            key: None,
            kind: None,
            base64: false,
            empty: false,
            position,
        };
        if tag.name.len() > self.limits.attribute_size {
            return Err(bad(position, "the name of an element is longer than the limit"));
        }
        if rest.as_bytes()[end] == b'>' {
            self.at += end + 1;
            return check_name(tag.name, position + 1).map(|()| tag);
        }
        let length = end + tag_length(&rest.as_bytes()[end..]).ok_or_else(|| self.endless())?;
        self.at += length;
        check_name(tag.name, position + 1)?;
        let inner = &rest[1..length - 1];
        let inner = match inner.strip_suffix('/') {
            Some(inner) => {
                tag.empty = true;
                inner
            }
            None => inner,
        };
        let mut attributes = Attributes {
            raw: inner,
            at: tag.name.len(),
            base: position + 1,
            count: 0,
            limits: self.limits,
        };
        let read = attributes.set_all(&mut tag);
        // A slot that has its key as its name can be told from the others already.
        match read {
            Err(error) if !matches!(tag.name, "parcel" | "slot" | "item") => Err(within(error, tag.name)),
            read => read.map(|()| tag),
        }
    }
}

/// The bytes up to the `>` of a start tag; another one may stand between quotes.
fn tag_length(bytes: &[u8]) -> Option<usize> {
    let mut at = 0;
    loop {
        at += memchr::memchr3(b'>', b'"', b'\'', &bytes[at..])? + 1;
        match bytes[at - 1] {
            b'>' => return Some(at),
            quote => at += memchr::memchr(quote, &bytes[at..])? + 1,
        }
    }
}

/// One attribute, its value resolved.
struct Attribute<'a> {
    name: &'a str,
    value: Cow<'a, str>,
    position: usize,
}

impl<'a> Tag<'a> {
    fn set(&mut self, attribute: Attribute<'a>) -> Result<(), WireError> {
        let Attribute {
            name,
            value,
            position,
        } = attribute;
        let before = match name {
            "type" => {
                let kind = ValueKind::from_word(&value).ok_or_else(|| unknown_type(&value, position))?;
                self.kind.replace(kind).is_some()
            }
            "key" => self.key.replace(value).is_some(),
            "encoding" if value == "base64" => std::mem::replace(&mut self.base64, true),
            "encoding" => return Err(bad(position, "the only encoding is base64")),
            "xmlns" => return Err(bad(position, "a parcel has no namespaces")),
            _ => {
                return Err(bad(
                    position,
                    format!("the attribute {:?} is unknown", brief(name)),
                ));
            }
        };
        match before {
            false => Ok(()),
            true => Err(bad(position, format!("the attribute {name} occurs twice"))),
        }
    }
}

/// Reads `name="value"` one after the other.
struct Attributes<'a, 'l> {
    raw: &'a str,
    at: usize,
    base: usize,
    count: usize,
    limits: &'l Limits,
}

impl<'a> Attributes<'a, '_> {
    fn set_all(&mut self, tag: &mut Tag<'a>) -> Result<(), WireError> {
        while let Some(attribute) = self.next()? {
            tag.set(attribute)?;
        }
        Ok(())
    }

    fn next(&mut self) -> Result<Option<Attribute<'a>>, WireError> {
        let blanks = self.skip_blanks();
        if self.at == self.raw.len() {
            return Ok(None);
        }
        let position = self.base + self.at;
        if blanks == 0 {
            return Err(bad(position, "attributes are separated by blanks"));
        }
        self.count += 1;
        if self.count > self.limits.attributes {
            let why = format!("an element has at most {} attributes", self.limits.attributes);
            return Err(bad(position, why));
        }
        let rest = &self.raw[self.at..];
        let name = &rest[..rest
            .bytes()
            .position(|byte| byte == b'=' || is_blank(byte))
            .unwrap_or(rest.len())];
        check_name(name, position)?;
        self.at += name.len();
        self.skip_blanks();
        if !self.raw[self.at..].starts_with('=') {
            return Err(bad(self.base + self.at, "an attribute is written name=\"value\""));
        }
        self.at += 1;
        self.skip_blanks();
        let raw = self.quoted()?;
        if raw.len() > self.limits.attribute_size {
            let why = format!("an attribute has at most {} bytes", self.limits.attribute_size);
            return Err(bad(position, why));
        }
        let start = self.base + self.at - raw.len() - 1;
        if let Some(at) = memchr::memchr(b'<', raw.as_bytes()) {
            return Err(bad(start + at, "an attribute may not contain <: write &lt;"));
        }
        Ok(Some(Attribute {
            name,
            value: unescape(raw, start, TextKind::Attribute)?,
            position,
        }))
    }

    fn quoted(&mut self) -> Result<&'a str, WireError> {
        let rest = &self.raw[self.at..];
        let missing = || bad(self.base + self.at, "an attribute's value stands between quotes");
        let quote = match rest.as_bytes().first() {
            Some(quote @ (b'"' | b'\'')) => *quote,
            _ => return Err(missing()),
        };
        let length = memchr::memchr(quote, &rest.as_bytes()[1..]).ok_or_else(missing)?;
        self.at += length + 2;
        Ok(&rest[1..=length])
    }

    fn skip_blanks(&mut self) -> usize {
        let rest = &self.raw[self.at..];
        let blanks = first_ink(rest).unwrap_or(rest.len());
        self.at += blanks;
        blanks
    }
}

fn check_name(name: &str, position: usize) -> Result<(), WireError> {
    if is_name(name) {
        return Ok(());
    }
    let why = match name.contains(':') {
        true => format!("a parcel has no namespaces: {:?}", brief(name)),
        false => format!("{:?} is no name", brief(name)),
    };
    Err(bad(position, why))
}

fn unknown_type(word: &str, position: usize) -> WireError {
    let near = nearest(word, ValueKind::ALL.map(ValueKind::word));
    WireError::new(Code::BAD_SLOT, format!("the type {:?} is unknown", brief(word)))
        .position(position)
        .nearest_opt(near)
}

/// Reads `<?xml version="1.0" encoding="UTF-8"?>` and gives the position after it; 0 without one.
fn declaration(text: &str, base: usize, limits: &Limits) -> Result<usize, WireError> {
    // Any other processing instruction, `<?xmlish` too, is refused as a token.
    let Some(rest) = text
        .strip_prefix("<?xml")
        .filter(|rest| rest.bytes().next().is_some_and(is_blank))
    else {
        return Ok(0);
    };
    let start = text.len() - rest.len();
    let length = memchr::memmem::find(rest.as_bytes(), b"?>")
        .ok_or_else(|| bad(base, "the XML declaration does not end"))?;
    let mut attributes = Attributes {
        raw: &rest[..length],
        at: 0,
        base: base + start,
        count: 0,
        limits,
    };
    let mut order = ["version", "encoding", "standalone"].into_iter();
    let mut version = false;
    while let Some(Attribute {
        name,
        value,
        position,
    }) = attributes.next()?
    {
        if !order.any(|known| known == name) {
            let why = "an XML declaration has version, encoding and standalone, in this order";
            return Err(bad(position, why));
        }
        match name {
            "version" if value == "1.0" => version = true,
            "encoding" if value.eq_ignore_ascii_case("utf-8") => {}
            "encoding" => {
                return Err(WireError::new(Code::BAD_ENCODING, "XML is in UTF-8 here").position(position));
            }
            "standalone" if value == "yes" || value == "no" => {}
            _ => return Err(bad(position, format!("the XML declaration has a bad {name}"))),
        }
    }
    match version {
        true => Ok(start + length + 2),
        false => Err(bad(base, "an XML declaration needs version=\"1.0\"")),
    }
}
