//! Lexemes of XML, of the few kinds that the grammar has: quick-xml finds them, this module says which are allowed.

use std::borrow::Cow;
use std::io::BufRead;

use quick_xml::Reader;
use quick_xml::events::Event;
use quick_xml::parser::{ElementParser, Parser};

use crate::text_form::{brief, within};
use crate::{Code, Limits, ValueKind, WireError};

use super::attributes::{Attribute, Attributes};
use super::name::is_name;
use super::text::{bad, is_blank};

/// One lexeme, as it stands in the text.
#[derive(Debug)]
pub(super) enum Lexeme<'a> {
    /// `<name …>` or `<name …/>`.
    Open(Tag<'a>),
    /// `</name>`; what is not a name is not a start tag's either.
    Close(&'a str),
    /// Characters, or a reference, between two tags; maybe in several pieces.
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
    reader: Reader<&'a [u8]>,
    base: usize,
    limits: &'a Limits,
}

impl<'a> Lexemes<'a> {
    /// The lexemes of `text`, which lies at `base` in the body; an XML declaration is read already.
    pub(super) fn new(text: &'a str, base: usize, limits: &'a Limits) -> Result<Lexemes<'a>, WireError> {
        let mut reader = Reader::from_str(text);
        let config = reader.config_mut();
        // The grammar compares names itself, with what it has opened, and refuses any reference between tags.
        config.check_end_names = false;
        config.allow_unmatched_ends = true;
        config.allow_dangling_amp = true;
        let mut lexemes = Lexemes {
            text,
            reader,
            base,
            limits,
        };
        lexemes.declaration()?;
        Ok(lexemes)
    }

    /// Where the next lexeme begins, in the body.
    pub(super) fn position(&self) -> usize {
        self.base + self.offset()
    }

    /// The next lexeme.
    pub(super) fn next(&mut self) -> Result<Lexeme<'a>, WireError> {
        // Before its end is looked for: a document type may be as long as the body.
        if let rest @ [b'<', b'!' | b'?', ..] = *self.reader.get_ref() {
            return Err(self.refused_markup(rest));
        }
        let start = self.offset();
        match self.reader.read_event() {
            Ok(Event::Start(tag)) => self.open(start, tag.len(), tag.name().0.len(), false),
            Ok(Event::Empty(tag)) => self.open(start, tag.len(), tag.name().0.len(), true),
            Ok(Event::End(name)) => Ok(Lexeme::Close(&self.text[start + 2..][..name.len()])),
            Ok(Event::Text(_) | Event::GeneralRef(_)) => Ok(Lexeme::Text(&self.text[start..self.offset()])),
            Ok(Event::Eof) => Ok(Lexeme::End),
            Ok(_) | Err(_) => self.endless(start),
        }
    }

    /// The text after a start tag, up to the next tag. The reader does not see it: it would give an event for each `&`,
    /// some hundred times the work.
    pub(super) fn text(&mut self) -> &'a str {
        let rest = &self.text[self.offset()..];
        let length = memchr::memchr(b'<', rest.as_bytes()).unwrap_or(rest.len());
        self.reader.stream().consume(length);
        &rest[..length]
    }

    /// Whether `</name>` is what follows, which is read then.
    pub(super) fn closes(&mut self, name: &str) -> bool {
        let rest = &self.text[self.offset()..];
        let inner = rest.strip_prefix("</").and_then(|rest| rest.strip_prefix(name));
        let closes = inner.is_some_and(|rest| rest.starts_with('>'));
        if closes {
            // An event less for nearly each element. The reader then keeps the name and a number of each, which is in
            // proportion to the text, and less than the values that are read.
            self.reader.stream().consume(name.len() + "</>".len());
        }
        closes
    }

    // What the reader has left is more reliable than what it counts, which is beyond a tag that does not end.
    fn offset(&self) -> usize {
        self.text.len() - self.reader.get_ref().len()
    }

    /// What the reader finds no end of; the first fault in it counts.
    #[cold]
    fn endless(&self, start: usize) -> Result<Lexeme<'a>, WireError> {
        let rest = &self.text[start..];
        // The reader looks for quotes in an end tag.
        if let (Some(name), Some(end)) = (rest.strip_prefix("</"), rest.find('>')) {
            return Ok(Lexeme::Close(&name[..end - 2]));
        }
        if !rest.starts_with("</") {
            self.name_at(start)?;
        }
        Err(self.no_end(start))
    }

    fn no_end(&self, start: usize) -> WireError {
        bad(self.base + start, "this tag does not end")
    }

    /// The name of the start tag at `start`, where the reader sees another one, or no end: for the reader only
    /// blanks end a name, and it may have quotes.
    #[cold]
    fn name_at(&self, start: usize) -> Result<&'a str, WireError> {
        let rest = &self.text[start..];
        let ends = |byte: u8| is_blank(byte) || byte == b'>' || byte == b'/';
        let end = rest.bytes().position(ends).ok_or_else(|| self.no_end(start))?;
        let name = &rest[1..end];
        self.check_length(name, self.base + start)?;
        if ElementParser::Outside.feed(&rest.as_bytes()[end..]).is_none() {
            return Err(self.no_end(start));
        }
        match is_name(name) {
            true => Ok(name),
            false => Err(misnamed(name, self.base + start + 1)),
        }
    }

    #[cold]
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
            return bad(self.position(), "this markup is not a part of a parcel");
        };
        WireError::new(Code::RESTRICTED_XML, format!("{what} is never allowed")).position(self.position())
    }

    /// The start tag at `start`, which has so many bytes inside, the first of them its name as the reader sees it.
    fn open(&self, start: usize, inner: usize, name: usize, empty: bool) -> Result<Lexeme<'a>, WireError> {
        let position = self.base + start;
        let inner = &self.text[start + 1..][..inner];
        let mut name = &inner[..name];
        if !is_name(name) {
            name = self.name_at(start)?;
        }
        self.check_length(name, position)?;
        let mut tag = Tag {
            name,
            key: None,
            kind: None,
            base64: false,
            empty,
            position,
        };
        if inner.len() > name.len() {
            self.set_attributes(&mut tag, inner)?;
        }
        Ok(Lexeme::Open(tag))
    }

    fn set_attributes(&self, tag: &mut Tag<'a>, inner: &'a str) -> Result<(), WireError> {
        let mut attributes = Attributes::new(inner, tag.name.len(), tag.position + 1, self.limits);
        let read = attributes.set_all(tag);
        // A slot that has its key as its name can be told from the others already.
        match read {
            Err(error) if !matches!(tag.name, "parcel" | "slot" | "item") => Err(within(error, tag.name)),
            read => read,
        }
    }

    fn check_length(&self, name: &str, position: usize) -> Result<(), WireError> {
        match name.len() <= self.limits.attribute_size {
            true => Ok(()),
            false => Err(bad(position, "the name of an element is longer than the limit")),
        }
    }

    /// Reads `<?xml version="1.0" encoding="UTF-8"?>` if the text begins with it.
    fn declaration(&mut self) -> Result<(), WireError> {
        // Any other processing instruction, `<?xmlish` too, is refused as a lexeme.
        let Some(rest) = self.text.strip_prefix("<?xml") else {
            return Ok(());
        };
        if !rest.bytes().next().is_some_and(is_blank) {
            return Ok(());
        }
        let Ok(Event::Decl(declaration)) = self.reader.read_event() else {
            return Err(bad(self.base, "the XML declaration does not end"));
        };
        let inner = &self.text[2..][..declaration.len()];
        let mut attributes = Attributes::new(inner, "xml".len(), self.base + 2, self.limits);
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
            true => Ok(()),
            false => Err(bad(self.base, "an XML declaration needs version=\"1.0\"")),
        }
    }
}

/// Why `name` is none.
#[cold]
pub(super) fn misnamed(name: &str, position: usize) -> WireError {
    let why = match name.contains(':') {
        true => format!("a parcel has no namespaces: {:?}", brief(name)),
        false => format!("{:?} is not a name", brief(name)),
    };
    bad(position, why)
}
