//! The header of a binary parcel: a presence bitmap and the slots it announces.

use std::sync::Arc;

use bytes::Bytes;

use super::wire::{FieldReader, bad, put_name, put_varint, put_zigzag};
use super::words::NameCache;
use crate::parcel::ContextNumber;
use crate::slots::{check_extra, too_long};
use crate::{
    Code, Content, Delivery, Family, Limit, MAX_ID, Map, Packed, Parcel, Path, Time, Value, WireError,
    check_message_name, event, msgpack,
};

pub(super) const CONTEXT_NUMBER: u32 = 0;
pub(super) const NAME: u32 = 1;
pub(super) const SENDER: u32 = 2;
pub(super) const TIMESTAMP: u32 = 3;
pub(super) const ID: u32 = 4;
pub(super) const CONTENT: u32 = 5;
const FENCE: u32 = 6;
const RECEIVED: u32 = 7;
const AGE: u32 = 8;
const AGE_ERROR: u32 = 9;
const FAMILY: u32 = 10;
const REFERENCE: u32 = 11;
pub(super) const PRIORITY: u32 = 12;
const ADDRESS: u32 = 13;
const EXPIRES: u32 = 14;
pub(super) const DELIVERY: u32 = 15;
pub(super) const ECHO: u32 = 16;
const RECEIPT: u32 = 17;
const CONTEXT_PATH: u32 = 18;
const EXTRA: u32 = 19;
const PACKED: u32 = 20;
const FIRST_UNKNOWN: u32 = 21;

/// The only way of compressing so far.
const ZSTD: u8 = 1;

/// Appends the header of a parcel, whose content is compressed if `packed` says so.
pub(super) fn write(parcel: &Parcel, packed: Option<&Packed>, out: &mut Vec<u8>) -> Result<(), WireError> {
    let bits = presence(parcel) | packed.map_or(0, |_| 1 << PACKED);
    let has = |bit: u32| bits & (1 << bit) != 0;
    put_varint(out, bits);
    if let Some(ContextNumber(number)) = parcel.number {
        put_varint(out, number);
    }
    put_name(out, &parcel.name);
    parcel.sender.iter().for_each(|sender| put_name(out, sender));
    parcel
        .timestamp
        .iter()
        .for_each(|time| out.extend_from_slice(&time.micros().to_be_bytes()));
    parcel.id.iter().for_each(|id| put_varint(out, *id));
    parcel.fence.iter().for_each(|fence| put_varint(out, *fence));
    parcel
        .received
        .iter()
        .for_each(|time| out.extend_from_slice(&time.micros().to_be_bytes()));
    parcel.age.iter().for_each(|age| put_zigzag(out, *age));
    parcel.age_error.iter().for_each(|error| put_varint(out, *error));
    if has(FAMILY) {
        out.push(parcel.family.number());
    }
    parcel
        .reference
        .iter()
        .for_each(|reference| put_varint(out, *reference));
    parcel
        .priority
        .iter()
        .for_each(|priority| put_zigzag(out, i64::from(*priority)));
    if let Some(address) = &parcel.address {
        put_varint(out, address.len() as u64);
        address.iter().for_each(|name| put_name(out, name));
    }
    parcel
        .expires
        .iter()
        .for_each(|expires| put_varint(out, *expires));
    parcel
        .delivery
        .iter()
        .for_each(|delivery| out.push(*delivery as u8));
    parcel.echo.iter().for_each(|echo| out.push(u8::from(*echo)));
    parcel
        .receipt
        .iter()
        .for_each(|receipt| out.push(u8::from(*receipt)));
    if let Some(path) = parcel.context.as_ref().filter(|_| has(CONTEXT_PATH)) {
        put_varint(out, path.as_str().len() as u64);
        out.extend_from_slice(path.as_str().as_bytes());
    }
    if has(EXTRA) {
        let mut block = Vec::new();
        msgpack::encode(&Value::Map(parcel.extra.clone()), &mut block)?;
        put_varint(out, block.len() as u64);
        out.extend_from_slice(&block);
    }
    if let Some(packed) = packed {
        let mut block = vec![ZSTD];
        put_varint(&mut block, packed.length() as u64);
        put_varint(out, block.len() as u64);
        out.extend_from_slice(&block);
    }
    Ok(())
}

pub(super) fn presence(parcel: &Parcel) -> u64 {
    // Messages name their context by number alone; all others bind the number, being rare. So does a stop, which may
    // overtake the reply that would bind it.
    let binds = parcel.family != Family::Message || &*parcel.name == event::STOP;
    let path = parcel.context.is_some() && (parcel.number.is_none() || binds);
    let bit = |bit: u32, present: bool| u64::from(present) << bit;
    bit(CONTEXT_NUMBER, parcel.number.is_some())
        | bit(NAME, true)
        | bit(SENDER, parcel.sender.is_some())
        | bit(TIMESTAMP, parcel.timestamp.is_some())
        | bit(ID, parcel.id.is_some())
        | bit(CONTENT, parcel.content.is_some())
        | bit(FENCE, parcel.fence.is_some())
        | bit(RECEIVED, parcel.received.is_some())
        | bit(AGE, parcel.age.is_some())
        | bit(AGE_ERROR, parcel.age_error.is_some())
        | bit(FAMILY, parcel.family != Family::Message)
        | bit(REFERENCE, parcel.reference.is_some())
        | bit(PRIORITY, parcel.priority.is_some())
        | bit(ADDRESS, parcel.address.is_some())
        | bit(EXPIRES, parcel.expires.is_some())
        | bit(DELIVERY, parcel.delivery.is_some())
        | bit(ECHO, parcel.echo.is_some())
        | bit(RECEIPT, parcel.receipt.is_some())
        | bit(CONTEXT_PATH, path)
        | bit(EXTRA, !parcel.extra.is_empty())
}

/// What a header may hold.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeaderBounds {
    /// Lists and maps inside each other.
    pub(super) depth: usize,
    /// Bytes of all slots.
    pub(super) slots: usize,
    /// Bytes that content may unpack to; none where compression was not agreed on.
    pub(super) unpacked: Option<Limit>,
}

/// Reads the parcel in `frame`, whose first byte is the kind.
///
/// # Errors
/// The error of the parcel, and its id if that was read before.
pub(super) fn read(
    frame: &Bytes,
    bounds: HeaderBounds,
    names: &mut NameCache,
) -> Result<Parcel, (Option<u64>, WireError)> {
    let mut parcel = Parcel::new(Family::Message, "");
    let mut reader = FieldReader::at(frame, 1);
    fill(&mut parcel, &mut reader, bounds, names).map_err(|error| (parcel.id, error))?;
    Ok(parcel)
}

fn fill(
    parcel: &mut Parcel,
    reader: &mut FieldReader<'_>,
    bounds: HeaderBounds,
    names: &mut NameCache,
) -> Result<(), WireError> {
    let bits = reader.varint()?;
    let (mut named, mut packed) = (false, None);
    // Slots stand in the order of their bits, so one walk over the set bits reads them all.
    let mut rest = bits;
    while rest != 0 {
        let bit = rest.trailing_zeros();
        rest &= rest - 1;
        match bit {
            CONTEXT_NUMBER => parcel.number = Some(ContextNumber(reader.varint()?)),
            NAME => {
                let start = reader.position();
                parcel.name = reader.name(names)?;
                check_message_name(&parcel.name).map_err(|error| error.position(start))?;
                named = true;
            }
            SENDER => parcel.sender = Some(reader.name(names)?),
            TIMESTAMP => parcel.timestamp = Some(time(reader)?),
            ID => parcel.id = Some(number(reader, "id")?),
            CONTENT => {}
            FENCE => parcel.fence = Some(number(reader, "fence")?),
            RECEIVED => parcel.received = Some(time(reader)?),
            AGE => parcel.age = Some(reader.zigzag()?),
            AGE_ERROR => parcel.age_error = Some(number(reader, "age-error")?),
            PACKED => packed = Some(unpacked_length(reader, bounds)?),
            _ => fill_rare(parcel, reader, bit, bounds, names)?,
        }
        bounds.check(reader.position())?;
    }
    if bits & (1 << CONTENT) != 0 {
        parcel.content = Some(match packed {
            None => Content::Encoded(reader.rest()),
            Some(_) if parcel.family != Family::Message => {
                return Err(bad(1, "only the content of a message may be compressed").slot("content"));
            }
            Some(length) => Content::Packed(Packed::received(reader.rest(), length)),
        });
    }
    match named {
        true => Ok(()),
        false => Err(bad(1, "a parcel needs the slot name").slot("name")),
    }
}

fn fill_rare(
    parcel: &mut Parcel,
    reader: &mut FieldReader<'_>,
    bit: u32,
    bounds: HeaderBounds,
    names: &mut NameCache,
) -> Result<(), WireError> {
    let start = reader.position();
    match bit {
        FAMILY => {
            let family = Family::from_number(reader.byte()?);
            parcel.family = family.ok_or_else(|| bad(start, "a number of no family").slot("family"))?;
        }
        REFERENCE => parcel.reference = Some(number(reader, "reference")?),
        PRIORITY => {
            let priority = i32::try_from(reader.zigzag()?);
            parcel.priority = Some(priority.map_err(|_| bad(start, "more than 32 bits").slot("priority"))?);
        }
        ADDRESS => parcel.address = Some(address(reader, bounds, names)?),
        EXPIRES => parcel.expires = Some(number(reader, "expires")?),
        DELIVERY => {
            let delivery = Delivery::ALL.get(usize::from(reader.byte()?)).copied();
            parcel.delivery = Some(delivery.ok_or_else(|| bad(start, "no delivery class").slot("delivery"))?);
        }
        ECHO => parcel.echo = Some(flag(reader, "echo")?),
        RECEIPT => parcel.receipt = Some(flag(reader, "receipt")?),
        CONTEXT_PATH => {
            let path = Path::parse(reader.text()?);
            parcel.context = Some(path.map_err(|error| error.slot("context").position(start))?);
        }
        EXTRA => parcel.extra = extra(reader, bounds)?,
        FIRST_UNKNOWN.. => drop(reader.block()?),
        _ => {}
    }
    Ok(())
}

impl HeaderBounds {
    /// Checks how far the slots reach.
    fn check(self, position: usize) -> Result<(), WireError> {
        match position <= self.slots {
            true => Ok(()),
            false => Err(too_long(self.slots)),
        }
    }
}

/// How many bytes the content unpacks to.
fn unpacked_length(reader: &mut FieldReader<'_>, bounds: HeaderBounds) -> Result<usize, WireError> {
    let start = reader.position();
    let bad = |text: &str| bad(start, text).slot("content");
    let most = bounds
        .unpacked
        .ok_or_else(|| bad("compressed content, which was not agreed on at login"))?;
    let block = reader.block()?;
    let mut fields = FieldReader::at(&block, 0);
    if fields.byte()? != ZSTD {
        return Err(bad("content compressed in an unknown way; 1 is zstd"));
    }
    let length = usize::try_from(fields.varint()?).unwrap_or(usize::MAX);
    if !most.allows(length) {
        let text = format!("content of {length} bytes when it is decompressed; a parcel has at most {most}");
        return Err(WireError::new(Code::TOO_LONG, text)
            .slot("content")
            .position(start));
    }
    Ok(length)
}

fn number(reader: &mut FieldReader<'_>, slot: &str) -> Result<u64, WireError> {
    let start = reader.position();
    let number = reader.varint()?;
    match number <= MAX_ID {
        true => Ok(number),
        false => Err(bad(start, &format!("the slot {slot} is a number below 2^53")).slot(slot)),
    }
}

fn flag(reader: &mut FieldReader<'_>, slot: &str) -> Result<bool, WireError> {
    let start = reader.position();
    match reader.byte()? {
        0 => Ok(false),
        1 => Ok(true),
        _ => Err(bad(start, "a flag is 0 or 1").slot(slot)),
    }
}

fn time(reader: &mut FieldReader<'_>) -> Result<Time, WireError> {
    let start = reader.position();
    Time::from_micros(reader.long()?).ok_or_else(|| bad(start, "a time outside the years 0 to 9999"))
}

fn address(
    reader: &mut FieldReader<'_>,
    bounds: HeaderBounds,
    names: &mut NameCache,
) -> Result<Vec<Arc<str>>, WireError> {
    let start = reader.position();
    let count = reader.varint()?;
    if count == 0 {
        let text = "the slot address is empty: leave it out to reach all members";
        return Err(WireError::new(Code::BAD_SLOT, text)
            .slot("address")
            .position(start));
    }
    // Not with_capacity: the count is a claim, each name takes at least a byte of the frame.
    let mut address = Vec::new();
    for _ in 0..count {
        address.push(reader.name(names)?);
        bounds.check(reader.position())?;
    }
    Ok(address)
}

fn extra(reader: &mut FieldReader<'_>, bounds: HeaderBounds) -> Result<Map, WireError> {
    let start = reader.position();
    let block = reader.block()?;
    // Before it is opened: what is refused costs nothing.
    bounds.check(reader.position())?;
    let within = reader.position() - block.len();
    let shifted = |error: WireError| match error.get("position").and_then(Value::as_int) {
        Some(position) => error.position(within + usize::try_from(position).unwrap_or_default()),
        None => error,
    };
    match msgpack::decode(&block, bounds.depth + 1).map_err(shifted)? {
        Value::Map(map) => check_extra(&map).map(|()| map),
        _ => Err(bad(start, "the other slots are a map")),
    }
}
