//! What a line means: which member may stand where (M14). The JSON itself is read by serde_json.

use std::borrow::Cow;
use std::fmt;

use serde::de::{DeserializeSeed, Deserializer as _, Error, MapAccess, SeqAccess, Visitor};
use serde_json::error::Category;

use crate::slots::too_long;
use crate::text_form::{brief, decode, scalar, within};
use crate::{
    Code, HARD_DEPTH, Limits, Map, Parcel, ReadSlots, SlotValue, Value, ValueKind, WireError, check_text,
    content,
};

use super::is_blank;

/// Why a line is not a parcel, and its id if that was read before.
#[derive(Debug)]
pub(super) struct Failed {
    pub(super) reference: Option<u64>,
    pub(super) error: WireError,
}

/// Reads one line.
pub(super) fn read(line: &[u8], limits: &Limits) -> Result<Parcel, Failed> {
    let (text, broken) = match decode(line, 0) {
        Ok(text) => (text, None),
        Err((good, error)) => (good, Some(error)),
    };
    let mut slots = ReadSlots::new();
    let read = line_slots(text, limits, &mut slots);
    let reference = slots.id();
    let failed = |error| Failed { reference, error };
    if let Some(error) = broken {
        return Err(failed(error));
    }
    read.map_err(failed)?;
    slots.finish().map_err(|error| failed(error.position(0)))
}

fn line_slots(text: &str, limits: &Limits, slots: &mut ReadSlots) -> Result<(), WireError> {
    let start = text
        .bytes()
        .position(|byte| !is_blank(byte))
        .unwrap_or(text.len());
    // What serde_json says about another value could hold all of it.
    if text.as_bytes().get(start) != Some(&b'{') {
        let text = "a line is one parcel: an object, from { to }";
        return Err(WireError::new(Code::BAD_JSON, text).position(start));
    }
    let mut fault = Fault::default();
    let mut json = serde_json::Deserializer::from_str(text);
    // Depth is bounded below, with a code of its own.
    json.disable_recursion_limit();
    let parcel = ParcelVisitor {
        slots,
        limits,
        fault: &mut fault,
    };
    let read = json.deserialize_map(parcel).and_then(|()| json.end());
    read.map_err(|error| fault.told(&error))
}

/// What is wrong, if it is not the JSON itself, and where: serde's errors carry text only.
#[derive(Default)]
struct Fault {
    error: Option<WireError>,
    /// Keys and indexes, the innermost first.
    place: Vec<String>,
}

impl Fault {
    fn fail<E: Error>(&mut self, error: WireError) -> E {
        self.error = Some(error);
        E::custom("")
    }

    /// The error for a value of another form than it should have.
    fn bad<E: Error>(&mut self, text: impl Into<String>) -> E {
        self.fail(WireError::new(Code::BAD_SLOT, text))
    }

    /// Notes on the way out in which member the fault was.
    fn within<E>(&mut self, key: &str, error: E) -> E {
        self.place.push(brief(key).to_owned());
        error
    }

    fn told(self, error: &serde_json::Error) -> WireError {
        // Columns count from 1, the end of the line has none of its own.
        let position = match error.classify() {
            Category::Eof => error.column(),
            _ => error.column().saturating_sub(1),
        };
        let told = self.error.unwrap_or_else(|| {
            let text = error.to_string();
            let what = text.split(" at line ").next().unwrap_or_default();
            WireError::new(Code::BAD_JSON, format!("this is not JSON: {what}"))
        });
        let placed = |error, key: &String| within(error, key);
        self.place.iter().fold(told, placed).position(position)
    }
}

struct ParcelVisitor<'r> {
    slots: &'r mut ReadSlots,
    limits: &'r Limits,
    fault: &'r mut Fault,
}

impl<'de> Visitor<'de> for ParcelVisitor<'_> {
    type Value = ();

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a parcel")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut members: A) -> Result<(), A::Error> {
        let mut slot_bytes = 0;
        while let Some(key) = members.next_key_seed(KeySeed { fault: self.fault })? {
            let place = match ReadSlots::kind_of(&key) {
                Some(ValueKind::Time) => ValuePlace::TimeSlot,
                _ => ValuePlace::Value,
            };
            let seed = ValueSeed {
                place,
                depth: self.limits.depth.min(HARD_DEPTH),
                fault: self.fault,
            };
            let value = members
                .next_value_seed(seed)
                .map_err(|error| self.fault.within(&key, error))?;
            if key != "content" {
                slot_bytes += key.len() + size(&value);
                if slot_bytes > self.limits.slots {
                    let error = too_long(self.limits.slots).slot(brief(&key));
                    return Err(self.fault.fail(error));
                }
            }
            self.slots
                .insert(key, value)
                .map_err(|error| self.fault.fail(error))?;
        }
        Ok(())
    }
}

fn size(value: &SlotValue<'_>) -> usize {
    match value {
        SlotValue::Text(text) => text.len(),
        SlotValue::Value(value) => content::size(value),
    }
}

/// A key, borrowed from the line where nothing in it is escaped.
struct KeySeed<'r> {
    fault: &'r mut Fault,
}

impl<'de> DeserializeSeed<'de> for KeySeed<'_> {
    type Value = Cow<'de, str>;

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<Cow<'de, str>, D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl<'de> Visitor<'de> for KeySeed<'_> {
    type Value = Cow<'de, str>;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a key")
    }

    fn visit_borrowed_str<E: Error>(self, key: &'de str) -> Result<Cow<'de, str>, E> {
        Ok(Cow::Borrowed(key))
    }

    fn visit_str<E: Error>(self, key: &str) -> Result<Cow<'de, str>, E> {
        unescaped(key, self.fault).map(Cow::Owned)
    }
}

/// Where a value stands.
#[derive(Clone, Copy, PartialEq)]
enum ValuePlace {
    Value,
    /// In a slot of type time.
    TimeSlot,
    /// In a tag: a string or a number.
    Tag,
    /// In `$map`: a map, whatever its keys are.
    Map,
}

/// A value; `depth` more lists and maps may open.
struct ValueSeed<'r> {
    place: ValuePlace,
    depth: usize,
    fault: &'r mut Fault,
}

impl ValueSeed<'_> {
    fn deeper<E: Error>(&mut self) -> Result<usize, E> {
        self.depth.checked_sub(1).ok_or_else(|| {
            let why = "lists and maps are nested deeper than the limit";
            self.fault.fail(WireError::new(Code::TOO_DEEP, why))
        })
    }

    /// What stands alone: everything but lists and maps.
    fn leaf<'de, E: Error>(self, value: SlotValue<'de>) -> Result<SlotValue<'de>, E> {
        match (self.place, &value) {
            (ValuePlace::Map, _) => Err(self.fault.bad("$map holds a map")),
            (ValuePlace::TimeSlot, SlotValue::Text(text)) => scalar::parse(ValueKind::Time, text, 0)
                .map(SlotValue::from)
                .map_err(|error| self.fault.fail(error)),
            _ => Ok(value),
        }
    }

    /// The value of a tag whose name was read.
    fn tagged<'de, A: MapAccess<'de>>(self, tag: &str, mut members: A) -> Result<Value, A::Error> {
        let place = match tag {
            "$map" => ValuePlace::Map,
            "$int" | "$double" | "$time" | "$binary" => ValuePlace::Tag,
            _ => {
                return Err(self
                    .fault
                    .bad(format!("there is no tag {:?}; {TAGS}", brief(tag))));
            }
        };
        let seed = ValueSeed {
            place,
            depth: self.depth,
            fault: self.fault,
        };
        let value = members.next_value_seed(seed)?;
        let parsed = |kind, fault: &mut Fault| match &value {
            SlotValue::Text(text) => {
                scalar::parse(kind, text, 0).map_err(|error| fault.fail::<A::Error>(error))
            }
            SlotValue::Value(_) => Err(fault.bad(format!("{tag} holds a string"))),
        };
        let read = match tag {
            "$int" => parsed(ValueKind::Int, self.fault)?,
            "$time" => parsed(ValueKind::Time, self.fault)?,
            "$binary" => parsed(ValueKind::Binary, self.fault)?,
            "$double" => match value.into_value() {
                // A number of JSON without a point is still the double of that number.
                Value::Int(number) => Value::Double(number as f64),
                number @ Value::Double(_) => number,
                _ => return Err(self.fault.bad("$double holds a number")),
            },
            _ => value.into_value(),
        };
        match members.next_key_seed(KeySeed { fault: self.fault })? {
            None => Ok(read),
            Some(_) => Err(self
                .fault
                .bad(format!("a tag such as {tag} stands alone; {TAGS}"))),
        }
    }
}

const TAGS: &str = "tags are $int, $double, $time and $binary, and a map whose first key begins with $ is written \
                    {\"$map\":{…}}";

impl<'de> DeserializeSeed<'de> for ValueSeed<'_> {
    type Value = SlotValue<'de>;

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<SlotValue<'de>, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for ValueSeed<'_> {
    type Value = SlotValue<'de>;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a value")
    }

    fn visit_unit<E: Error>(self) -> Result<SlotValue<'de>, E> {
        self.leaf(Value::Null.into())
    }

    fn visit_bool<E: Error>(self, flag: bool) -> Result<SlotValue<'de>, E> {
        self.leaf(Value::Bool(flag).into())
    }

    fn visit_i64<E: Error>(self, number: i64) -> Result<SlotValue<'de>, E> {
        self.leaf(Value::Int(number).into())
    }

    fn visit_u64<E: Error>(self, number: u64) -> Result<SlotValue<'de>, E> {
        // serde_json gives larger whole numbers as doubles; those between 2⁶³ and 2⁶⁴ are no different.
        let int = i64::try_from(number).map(Value::Int);
        self.leaf(int.unwrap_or(Value::Double(number as f64)).into())
    }

    fn visit_f64<E: Error>(self, number: f64) -> Result<SlotValue<'de>, E> {
        self.leaf(Value::Double(number).into())
    }

    fn visit_borrowed_str<E: Error>(self, text: &'de str) -> Result<SlotValue<'de>, E> {
        self.leaf(text.into())
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<SlotValue<'de>, E> {
        let text = unescaped(text, self.fault)?;
        self.leaf(SlotValue::Text(Cow::Owned(text)))
    }

    fn visit_seq<A: SeqAccess<'de>>(mut self, mut items: A) -> Result<SlotValue<'de>, A::Error> {
        if matches!(self.place, ValuePlace::Tag | ValuePlace::Map) {
            return self.leaf_wanted();
        }
        let depth = self.deeper()?;
        let mut list = Vec::new();
        loop {
            let seed = ValueSeed {
                place: ValuePlace::Value,
                depth,
                fault: self.fault,
            };
            match items.next_element_seed(seed) {
                Ok(Some(item)) => list.push(item.into_value()),
                Ok(None) => return Ok(Value::List(list).into()),
                Err(error) => return Err(self.fault.within(&list.len().to_string(), error)),
            }
        }
    }

    fn visit_map<A: MapAccess<'de>>(mut self, mut members: A) -> Result<SlotValue<'de>, A::Error> {
        if self.place == ValuePlace::Tag {
            return self.leaf_wanted();
        }
        let mut next = members.next_key_seed(KeySeed { fault: self.fault })?;
        if let Some(tag) = next.as_deref()
            && tag.starts_with('$')
            && self.place != ValuePlace::Map
        {
            return self.tagged(tag, members).map(SlotValue::from);
        }
        let depth = self.deeper()?;
        let mut map = Map::new();
        while let Some(key) = next {
            let seed = ValueSeed {
                place: ValuePlace::Value,
                depth,
                fault: self.fault,
            };
            let value = members
                .next_value_seed(seed)
                .map_err(|error| self.fault.within(&key, error))?;
            map.insert_new(key.into_owned(), value.into_value())
                .map_err(|key| {
                    let error = self
                        .fault
                        .bad(format!("the member {:?} occurs twice", brief(&key)));
                    self.fault.within(&key, error)
                })?;
            next = members.next_key_seed(KeySeed { fault: self.fault })?;
        }
        Ok(Value::Map(map).into())
    }
}

impl ValueSeed<'_> {
    /// The error for a list or map in a tag that holds none.
    fn leaf_wanted<T, E: Error>(self) -> Result<T, E> {
        Err(self.fault.bad(match self.place {
            ValuePlace::Map => "$map holds a map",
            _ => "a tag such as $int holds a string, $double a number",
        }))
    }
}

/// Text that was escaped: only now can it be seen whether it has characters that no string has.
fn unescaped<E: Error>(text: &str, fault: &mut Fault) -> Result<String, E> {
    match check_text(text) {
        Ok(()) => Ok(text.to_owned()),
        Err(error) => Err(fault.fail(error)),
    }
}
