//! The table of known slots, for codecs that write slots by key (XML, JSON).

use std::borrow::Cow;
use std::sync::Arc;

use crate::nearest::nearest;
use crate::{
    Code, Content, Delivery, Family, MAX_ID, Map, Parcel, Path, Time, Value, ValueKind, WireError,
    check_message_name,
};

/// The error for a parcel whose slots have more bytes than they may have.
pub(crate) fn too_long(most: usize) -> WireError {
    let text =
        format!("the slots of a parcel have at most {most} bytes; what is larger goes into its content");
    WireError::new(Code::TOO_LONG, text)
}

/// The value of a slot. Text may lie where it was read from: most slots are text, and need no copy on their way.
#[derive(Clone, Debug, PartialEq)]
pub enum SlotValue<'a> {
    /// A string.
    Text(Cow<'a, str>),
    /// Any value.
    Value(Cow<'a, Value>),
}

impl SlotValue<'_> {
    /// Its type.
    pub fn kind(&self) -> ValueKind {
        match self {
            SlotValue::Text(_) => ValueKind::String,
            SlotValue::Value(value) => value.kind(),
        }
    }

    /// The value, on its own.
    pub fn into_value(self) -> Value {
        match self {
            SlotValue::Text(text) => Value::String(text.into_owned()),
            SlotValue::Value(value) => value.into_owned(),
        }
    }

    fn as_str(&self) -> Option<&str> {
        match self {
            SlotValue::Text(text) => Some(text),
            SlotValue::Value(value) => value.as_str(),
        }
    }

    /// The value if it is not [`SlotValue::Text`].
    fn other(&self) -> Option<&Value> {
        match self {
            SlotValue::Text(_) => None,
            SlotValue::Value(value) => Some(value),
        }
    }
}

impl<'a> From<&'a str> for SlotValue<'a> {
    fn from(text: &'a str) -> SlotValue<'a> {
        SlotValue::Text(Cow::Borrowed(text))
    }
}

impl<'a> From<Cow<'a, str>> for SlotValue<'a> {
    fn from(text: Cow<'a, str>) -> SlotValue<'a> {
        SlotValue::Text(text)
    }
}

impl From<Value> for SlotValue<'_> {
    fn from(value: Value) -> Self {
        SlotValue::Value(Cow::Owned(value))
    }
}

/// One known slot: its key, type, and the way in and out of a parcel.
struct Slot {
    key: &'static str,
    kind: ValueKind,
    get: fn(&Parcel) -> Option<SlotValue<'_>>,
    set: fn(&mut ReadSlots, &SlotValue<'_>) -> Result<(), String>,
}

// In the order in which they are written: what a reader looks for first comes first, content last.
#[rustfmt::skip]
const SLOTS: [Slot; 18] = [
    Slot { key: "family", kind: ValueKind::String, get: |p| Some(p.family.word().into()), set: set_family },
    Slot { key: "name", kind: ValueKind::String, get: |p| Some(p.name().into()), set: |r, v| { r.name = Some(text(v)?); Ok(()) } },
    Slot { key: "id", kind: ValueKind::Int, get: |p| id_value(p.id), set: |r, v| { r.parcel.id = Some(number(v, MAX_ID)?); Ok(()) } },
    Slot { key: "reference", kind: ValueKind::Int, get: |p| id_value(p.reference), set: |r, v| { r.parcel.reference = Some(number(v, MAX_ID)?); Ok(()) } },
    Slot { key: "sender", kind: ValueKind::String, get: |p| p.sender.as_deref().map(SlotValue::from), set: |r, v| { r.parcel.sender = Some(text(v)?); Ok(()) } },
    Slot { key: "address", kind: ValueKind::List, get: get_address, set: set_address },
    Slot { key: "timestamp", kind: ValueKind::Time, get: |p| value(p.timestamp), set: |r, v| { r.parcel.timestamp = Some(time(v)?); Ok(()) } },
    Slot { key: "priority", kind: ValueKind::Int, get: |p| value(p.priority), set: set_priority },
    Slot { key: "context", kind: ValueKind::String, get: |p| p.context.as_ref().map(|c| c.as_str().into()), set: set_context },
    Slot { key: "expires", kind: ValueKind::Int, get: |p| id_value(p.expires), set: |r, v| { r.parcel.expires = Some(number(v, MAX_ID)?); Ok(()) } },
    Slot { key: "delivery", kind: ValueKind::String, get: |p| p.delivery.map(|d| d.word().into()), set: set_delivery },
    Slot { key: "fence", kind: ValueKind::Int, get: |p| id_value(p.fence), set: |r, v| { r.parcel.fence = Some(number(v, MAX_ID)?); Ok(()) } },
    Slot { key: "received", kind: ValueKind::Time, get: |p| value(p.received), set: |r, v| { r.parcel.received = Some(time(v)?); Ok(()) } },
    Slot { key: "age", kind: ValueKind::Int, get: |p| value(p.age), set: |r, v| { r.parcel.age = int(v); Ok(()) } },
    Slot { key: "age-error", kind: ValueKind::Int, get: |p| id_value(p.age_error), set: |r, v| { r.parcel.age_error = Some(number(v, MAX_ID)?); Ok(()) } },
    Slot { key: "echo", kind: ValueKind::Bool, get: |p| value(p.echo), set: |r, v| { r.parcel.echo = flag(v); Ok(()) } },
    Slot { key: "receipt", kind: ValueKind::Bool, get: |p| value(p.receipt), set: |r, v| { r.parcel.receipt = flag(v); Ok(()) } },
    Slot { key: "content", kind: ValueKind::Null, get: |_| None, set: |_, _| Ok(()) },
];

/// The slots of one parcel as they are read, in any order.
///
/// ```
/// use mom_proto::{ReadSlots, Value, ValueKind};
/// let mut slots = ReadSlots::new();
/// slots.insert("family", "message").unwrap();
/// slots.insert("name", Value::from("chat")).unwrap();
/// assert_eq!(slots.finish().unwrap().name(), "chat");
/// assert_eq!(ReadSlots::kind_of("id"), Some(ValueKind::Int));
/// ```
#[derive(Debug)]
pub struct ReadSlots {
    parcel: Parcel,
    family: bool,
    name: Option<Arc<str>>,
    seen: u32,
}

impl ReadSlots {
    /// No slots yet.
    pub fn new() -> ReadSlots {
        ReadSlots {
            parcel: Parcel::new(Family::Message, ""),
            family: false,
            name: None,
            seen: 0,
        }
    }

    /// The type of a known slot, `None` for others and for `content`, which may be anything.
    pub fn kind_of(key: &str) -> Option<ValueKind> {
        SLOTS
            .iter()
            .find(|slot| slot.key == key && slot.key != "content")
            .map(|slot| slot.kind)
    }

    /// The id read so far, for an error about the rest.
    pub fn id(&self) -> Option<u64> {
        self.parcel.id
    }

    /// Takes one slot.
    ///
    /// # Errors
    /// `bad-slot` naming the slot: twice, of another type than a known slot has, or outside its range;
    /// `bad-path` for an invalid context.
    pub fn insert<'a>(
        &mut self,
        key: impl Into<Cow<'a, str>>,
        value: impl Into<SlotValue<'a>>,
    ) -> Result<(), WireError> {
        let (key, value) = (key.into(), value.into());
        let Some(position) = SLOTS.iter().position(|slot| slot.key == key) else {
            return self
                .parcel
                .extra
                .insert_new(key.into_owned(), value.into_value())
                .map_err(|key| twice(&key));
        };
        let slot = &SLOTS[position];
        let bit = 1 << position;
        if self.seen & bit != 0 {
            return Err(twice(&key));
        }
        self.seen |= bit;
        if slot.key != "content" && slot.kind != value.kind() {
            let (wanted, given) = (slot.kind.word(), value.kind().word());
            return Err(bad(
                &key,
                format!("the slot {key} is of type {wanted}, not {given}"),
            ));
        }
        match slot.key {
            "context" => return set_path(&mut self.parcel, &value),
            // By value: content may be large.
            "content" => {
                self.parcel.content = Some(Content::Value(value.into_value()));
                return Ok(());
            }
            _ => {}
        }
        (slot.set)(self, &value).map_err(|why| bad(&key, format!("the slot {key} {why}")))
    }

    /// The parcel of all slots taken.
    ///
    /// # Errors
    /// `bad-slot` if family or name are missing, `bad-name` for an invalid name.
    pub fn finish(self) -> Result<Parcel, WireError> {
        if !self.family {
            return Err(bad("family", "a parcel needs the slot family".to_owned()));
        }
        let Some(name) = self.name else {
            return Err(bad("name", "a parcel needs the slot name".to_owned()));
        };
        check_message_name(&name)?;
        Ok(Parcel { name, ..self.parcel })
    }
}

impl Default for ReadSlots {
    fn default() -> ReadSlots {
        ReadSlots::new()
    }
}

/// Gives every slot that the parcel has but `content`, known ones first, in a fixed order.
pub fn write_slots(parcel: &Parcel, mut slot: impl FnMut(&str, SlotValue<'_>)) {
    for known in &SLOTS {
        if let Some(value) = (known.get)(parcel) {
            slot(known.key, value);
        }
    }
    for (key, value) in parcel.extra.iter() {
        slot(key, SlotValue::Value(Cow::Borrowed(value)));
    }
}

/// Checks that the other slots hide none of the known ones; for codecs that carry them apart.
pub(crate) fn check_extra(extra: &Map) -> Result<(), WireError> {
    match extra.keys().find(|key| SLOTS.iter().any(|slot| slot.key == *key)) {
        Some(key) => Err(bad(
            key,
            format!("the slot {key} may not be among the other slots"),
        )),
        None => Ok(()),
    }
}

fn bad(slot: &str, text: String) -> WireError {
    WireError::new(Code::BAD_SLOT, text).slot(slot)
}

fn twice(key: &str) -> WireError {
    bad(key, format!("the slot {key} occurs twice"))
}

fn value<T: Into<Value>>(of: Option<T>) -> Option<SlotValue<'static>> {
    of.map(|value| SlotValue::from(value.into()))
}

fn id_value(number: Option<u64>) -> Option<SlotValue<'static>> {
    value(number.and_then(|number| i64::try_from(number).ok()))
}

fn get_address(parcel: &Parcel) -> Option<SlotValue<'_>> {
    let address = parcel.address.as_ref()?;
    let names: Vec<Value> = address.iter().map(|name| Value::from(&**name)).collect();
    value(Some(names))
}

fn int(value: &SlotValue<'_>) -> Option<i64> {
    value.other().and_then(Value::as_int)
}

fn flag(value: &SlotValue<'_>) -> Option<bool> {
    value.other().and_then(Value::as_bool)
}

fn number(value: &SlotValue<'_>, most: u64) -> Result<u64, String> {
    int(value)
        .and_then(|number| u64::try_from(number).ok())
        .filter(|number| *number <= most)
        .ok_or_else(|| format!("is a number from 0 to {most}"))
}

fn text(value: &SlotValue<'_>) -> Result<Arc<str>, String> {
    value
        .as_str()
        .map(Arc::from)
        .ok_or_else(|| "is a string".to_owned())
}

fn time(value: &SlotValue<'_>) -> Result<Time, String> {
    match value.other() {
        Some(Value::Time(time)) => Ok(*time),
        _ => Err("is a time".to_owned()),
    }
}

fn set_family(slots: &mut ReadSlots, value: &SlotValue<'_>) -> Result<(), String> {
    let word = value.as_str().unwrap_or_default();
    slots.parcel.family = Family::from_word(word).ok_or_else(|| {
        let near = nearest(word, Family::ALL.map(Family::word));
        let hint = near
            .map(|near| format!(", did you mean {near}?"))
            .unwrap_or_default();
        format!("does not know the family {word:?}{hint}")
    })?;
    slots.family = true;
    Ok(())
}

fn set_address(slots: &mut ReadSlots, value: &SlotValue<'_>) -> Result<(), String> {
    let list = value.other().and_then(Value::as_list).unwrap_or_default();
    if list.is_empty() {
        return Err("is empty: leave it out to reach all members".to_owned());
    }
    let names: Option<Vec<Arc<str>>> = list.iter().map(|item| item.as_str().map(Arc::from)).collect();
    slots.parcel.address = Some(names.ok_or("is a list of strings")?);
    Ok(())
}

fn set_priority(slots: &mut ReadSlots, value: &SlotValue<'_>) -> Result<(), String> {
    let priority = int(value).and_then(|number| i32::try_from(number).ok());
    slots.parcel.priority = Some(priority.ok_or("is a number of 32 bits")?);
    Ok(())
}

fn set_delivery(slots: &mut ReadSlots, value: &SlotValue<'_>) -> Result<(), String> {
    let delivery = value.as_str().and_then(Delivery::from_word);
    slots.parcel.delivery = Some(delivery.ok_or("is one of reliable, latest, fleeting")?);
    Ok(())
}

fn set_context(slots: &mut ReadSlots, value: &SlotValue<'_>) -> Result<(), String> {
    set_path(&mut slots.parcel, value).map_err(|error| error.text)
}

// Apart from the others because its error keeps a code of its own.
fn set_path(parcel: &mut Parcel, value: &SlotValue<'_>) -> Result<(), WireError> {
    let path = Path::parse(value.as_str().unwrap_or_default());
    parcel.context = Some(path.map_err(|error| WireError::new(error.code, error.text).slot("context"))?);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(slots: &[(&str, Value)]) -> Result<Parcel, WireError> {
        let mut read = ReadSlots::new();
        for (key, value) in slots {
            read.insert(*key, value.clone())?;
        }
        read.finish()
    }

    fn base(key: &'static str, value: Value) -> Vec<(&'static str, Value)> {
        vec![("family", "message".into()), ("name", "x".into()), (key, value)]
    }

    #[test]
    fn what_is_written_is_read() {
        let mut parcel = Parcel::new(Family::Message, "command")
            .context(Path::parse("/robot/arm").unwrap())
            .id(MAX_ID)
            .content("grip open");
        parcel.address = Some(vec!["arm".into(), "bob~2".into()]);
        parcel.sender = Some("alice".into());
        parcel.timestamp = Time::from_micros(5);
        parcel.priority = Some(i32::MIN);
        parcel.reference = Some(0);
        parcel.expires = Some(250);
        parcel.delivery = Some(Delivery::Latest);
        parcel.fence = Some(7);
        parcel.received = Time::from_micros(9);
        parcel.age = Some(-3);
        parcel.age_error = Some(4);
        parcel.echo = Some(false);
        parcel.receipt = Some(true);
        parcel.extra.set("colour", "red");
        let mut back = ReadSlots::new();
        write_slots(&parcel, |key, value| {
            back.insert(key.to_owned(), value.into_value()).unwrap();
        });
        back.insert("content", "grip open").unwrap();
        assert_eq!(back.finish(), Ok(parcel));
    }

    #[test]
    fn a_bad_slot_is_named() {
        for (key, value) in [
            ("id", Value::Int(-1)),
            ("id", Value::Int(1 << 53)),
            ("id", "1".into()),
            ("reference", Value::Double(1.0)),
            ("address", Value::List(vec![])),
            ("address", Value::List(vec![Value::Int(1)])),
            ("priority", Value::Int(1 << 31)),
            ("timestamp", Value::Int(0)),
            ("delivery", "sometimes".into()),
            ("echo", "false".into()),
            ("fence", Value::Int(-1)),
            ("expires", Value::Null),
        ] {
            let error = read(&base(key, value)).expect_err(key);
            assert_eq!(
                (error.code.clone(), error.get("slot")),
                (Code::BAD_SLOT, Some(&key.into())),
                "{error}"
            );
        }
        let error = read(&base("context", "/a/../b".into())).expect_err("path");
        assert_eq!(
            (error.code.clone(), error.get("slot")),
            (Code::BAD_PATH, Some(&"context".into()))
        );
        assert_eq!(
            read(&[("family", "message".into())])
                .expect_err("no name")
                .get("slot"),
            Some(&"name".into())
        );
        let error = read(&[("family", "massage".into())]).expect_err("no family");
        assert!(error.text.contains("did you mean message?"), "{error}");
        let twice = read(&base("name", "y".into())).expect_err("twice");
        assert_eq!(twice.get("slot"), Some(&"name".into()));
    }
}
