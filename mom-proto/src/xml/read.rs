//! The grammar of parcels: which element may stand where, and what it means (M14).

use std::borrow::Cow;

use crate::slots::too_long;
use crate::text_form::{brief, decode, scalar, within};
use crate::{Code, HARD_DEPTH, Limits, Map, Parcel, ReadSlots, SlotValue, Value, ValueKind, WireError};

use super::lexeme::{Lexeme, Lexemes, Tag};
use super::multipart::Parts;
use super::name::is_reserved;
use super::text::{TextKind, bad, first_ink, unescape};

/// Why a document is not a parcel, and its id if that was read before.
#[derive(Debug)]
pub(super) struct Failed {
    pub(super) reference: Option<u64>,
    pub(super) error: WireError,
}

/// Reads a document that lies at `base` in the body; all `parts` have to be used.
pub(super) fn read(
    document: &[u8],
    base: usize,
    limits: &Limits,
    parts: &mut Parts,
) -> Result<Parcel, Failed> {
    let (text, broken) = match decode(document, base) {
        Ok(text) => (text, None),
        Err((good, error)) => (good, Some(error)),
    };
    let mut slots = ReadSlots::new();
    let read = document_slots(text, base, limits, parts, &mut slots);
    let reference = slots.id();
    let failed = |error| Failed { reference, error };
    if let Some(error) = broken {
        // Forbidden constructs close the connection, whatever comes after them.
        let restricted = read.err().filter(|error| error.code == Code::RESTRICTED_XML);
        return Err(failed(restricted.unwrap_or(error)));
    }
    read.map_err(failed)?;
    slots.finish().map_err(|error| failed(placed(error, base)))
}

/// The id of a parcel whose parts are broken.
pub(super) fn reference(document: &[u8], base: usize, limits: &Limits) -> Option<u64> {
    match read(document, base, limits, &mut Parts::default()) {
        Ok(parcel) => parcel.id,
        Err(failed) => failed.reference,
    }
}

fn document_slots(
    text: &str,
    base: usize,
    limits: &Limits,
    parts: &mut Parts,
    slots: &mut ReadSlots,
) -> Result<(), WireError> {
    let mut reader = ParcelReader {
        tokens: Lexemes::new(text, base, limits)?,
        parts,
    };
    let root = reader.root()?;
    let mut slot_bytes = 0;
    while let Some(tag) = reader.child(&root)? {
        let position = tag.position;
        let key = member_key(&tag)?;
        let kind = ReadSlots::kind_of(&key).unwrap_or(ValueKind::String);
        let depth = limits.depth.min(HARD_DEPTH);
        let value = reader
            .slot(&tag, tag.kind.unwrap_or(kind), depth)
            .map_err(|error| within(error, &key))?;
        if key != "content" {
            slot_bytes += reader.tokens.position().saturating_sub(position);
            if slot_bytes > limits.slots {
                return Err(too_long(limits.slots).slot(brief(&key)).position(position));
            }
        }
        slots
            .insert(key, value)
            .map_err(|error| placed(error, position))?;
    }
    reader.end()?;
    reader.parts.check_used()
}

struct ParcelReader<'a, 'p> {
    tokens: Lexemes<'a>,
    parts: &'p mut Parts,
}

impl<'a> ParcelReader<'a, '_> {
    fn root(&mut self) -> Result<Tag<'a>, WireError> {
        loop {
            let position = self.tokens.position();
            match self.tokens.next()? {
                Lexeme::Text(raw) => check_blank(raw, position)?,
                Lexeme::Open(tag) if tag.name == "parcel" && tag.is_bare() => return Ok(tag),
                _ => {
                    return Err(bad(
                        position,
                        "a document is one element <parcel>, without attributes",
                    ));
                }
            }
        }
    }

    fn end(&mut self) -> Result<(), WireError> {
        loop {
            let position = self.tokens.position();
            match self.tokens.next()? {
                Lexeme::Text(raw) => check_blank(raw, position)?,
                Lexeme::End => return Ok(()),
                _ => return Err(bad(position, "nothing may follow after </parcel>")),
            }
        }
    }

    /// The next element inside `parent`, `None` at its end.
    fn child(&mut self, parent: &Tag<'_>) -> Result<Option<Tag<'a>>, WireError> {
        if parent.empty {
            return Ok(None);
        }
        loop {
            let position = self.tokens.position();
            match self.tokens.next()? {
                Lexeme::Text(raw) => check_blank(raw, position)?,
                Lexeme::Open(tag) => return Ok(Some(tag)),
                Lexeme::Close(name) if name == parent.name => return Ok(None),
                token => return Err(not_closed(parent, &token, position)),
            }
        }
    }

    /// The value of a slot; `depth` more lists and maps may open.
    fn slot(&mut self, tag: &Tag<'a>, kind: ValueKind, depth: usize) -> Result<SlotValue<'a>, WireError> {
        match kind == ValueKind::String && !tag.base64 {
            true => Ok(self.text(tag)?.0.into()),
            false => self.value(tag, kind, depth).map(SlotValue::from),
        }
    }

    /// The value of an element; `depth` more lists and maps may open.
    fn value(&mut self, tag: &Tag<'a>, kind: ValueKind, depth: usize) -> Result<Value, WireError> {
        if tag.base64 && kind != ValueKind::Binary {
            return Err(bad(tag.position, "only binary values have an encoding"));
        }
        if depth == 0 && matches!(kind, ValueKind::List | ValueKind::Map) {
            let why = "lists and maps are nested deeper than the limit";
            return Err(WireError::new(Code::TOO_DEEP, why).position(tag.position));
        }
        match kind {
            ValueKind::List => self.list(tag, depth - 1),
            ValueKind::Map => self.map(tag, depth - 1),
            ValueKind::Binary if !tag.base64 => self.part(tag),
            ValueKind::String => Ok(Value::String(self.text(tag)?.0.into_owned())),
            _ => {
                let (text, position) = self.text(tag)?;
                scalar::parse(kind, &text, position)
            }
        }
    }

    fn list(&mut self, list: &Tag<'a>, depth: usize) -> Result<Value, WireError> {
        let mut items = Vec::new();
        while let Some(tag) = self.child(list)? {
            let item = self.item(&tag, depth);
            items.push(item.map_err(|error| within(error, &items.len().to_string()))?);
        }
        Ok(Value::List(items))
    }

    fn item(&mut self, tag: &Tag<'a>, depth: usize) -> Result<Value, WireError> {
        if tag.name != "item" || tag.key.is_some() {
            return Err(bad(tag.position, "a list is made of <item type=\"…\"> elements"));
        }
        self.value(tag, tag.kind.unwrap_or(ValueKind::String), depth)
    }

    fn map(&mut self, map: &Tag<'a>, depth: usize) -> Result<Value, WireError> {
        let mut members = Map::new();
        while let Some(tag) = self.child(map)? {
            let key = member_key(&tag)?;
            let value = self
                .value(&tag, tag.kind.unwrap_or(ValueKind::String), depth)
                .map_err(|error| within(error, &key))?;
            members.insert_new(key.into_owned(), value).map_err(|key| {
                let twice = format!("the member {:?} occurs twice", brief(&key));
                within(WireError::new(Code::BAD_SLOT, twice).position(tag.position), &key)
            })?;
        }
        Ok(Value::Map(members))
    }

    /// Binary as `<cid>part-1</cid>`.
    fn part(&mut self, binary: &Tag<'a>) -> Result<Value, WireError> {
        let wanted = "binary is one <cid>, or text with encoding=\"base64\"";
        let Some(tag) = self.child(binary)? else {
            return Err(WireError::new(Code::BAD_SLOT, wanted).position(binary.position));
        };
        if tag.name != "cid" || !tag.is_bare() {
            return Err(bad(tag.position, wanted));
        }
        let (cid, position) = self.text(&tag)?;
        let bytes = self.parts.take(&cid, position)?;
        match self.child(binary)? {
            None => Ok(Value::Binary(bytes)),
            Some(tag) => Err(bad(tag.position, wanted)),
        }
    }

    /// The text of an element that holds nothing else, and its position.
    fn text(&mut self, tag: &Tag<'a>) -> Result<(Cow<'a, str>, usize), WireError> {
        let start = self.tokens.position();
        if tag.empty {
            return Ok((Cow::Borrowed(""), start));
        }
        let raw = self.tokens.text();
        if !self.tokens.closes(tag.name) {
            let position = self.tokens.position();
            match self.tokens.next()? {
                // With blanks after the name.
                Lexeme::Close(name) if name == tag.name => {}
                Lexeme::Open(_) => return Err(bad(position, "a value of this type has no elements in it")),
                token => return Err(not_closed(tag, &token, position)),
            }
        }
        Ok((unescape(raw, start, TextKind::Element)?, start))
    }
}

/// The key of a slot or a map's member.
fn member_key<'a>(tag: &Tag<'a>) -> Result<Cow<'a, str>, WireError> {
    match (tag.name, &tag.key) {
        ("slot", Some(key)) => Ok(key.clone()),
        ("slot", None) => Err(bad(tag.position, "a <slot> needs its key")),
        (_, Some(_)) => Err(bad(tag.position, "only a <slot> has a key")),
        (name, None) if is_reserved(name) => Err(bad(
            tag.position,
            "names that begin with xml are reserved: write <slot key=\"…\">",
        )),
        (name, None) => Ok(Cow::Borrowed(name)),
    }
}

fn check_blank(raw: &str, position: usize) -> Result<(), WireError> {
    match first_ink(raw) {
        None => Ok(()),
        Some(at) => Err(bad(position + at, "text stands only in values")),
    }
}

fn not_closed(tag: &Tag<'_>, found: &Lexeme<'_>, position: usize) -> WireError {
    let found = match found {
        // The reader lets an end tag have attributes, with > between their quotes.
        Lexeme::Close(name) => {
            let name = name.split('>').next().unwrap_or_default();
            format!("</{}>", brief(name.trim_end_matches([' ', '\t', '\r', '\n'])))
        }
        _ => "the end".to_owned(),
    };
    bad(
        position,
        format!("expected </{}>, found {found}", brief(tag.name)),
    )
}

fn placed(error: WireError, position: usize) -> WireError {
    match error.get("position") {
        Some(_) => error,
        None => error.position(position),
    }
}
