//! Device map and payload (S17, S18): what stands behind the header of a data packet.

use crate::{Direction, Dropped, Element, Kind, Layout, Payload, Refused};

/// What one bit of a device map that is 1 carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Item<'p> {
    /// The value of an effector (down), a sensor or a monitor (up). Of type bytes without their number.
    Value(&'p [u8]),
    /// Down: a sensor or a monitor is asked for now.
    Ask,
    /// A command or memory command (down), an event or memory event (up).
    Call {
        /// 1 to 255.
        id: u8,
        /// Its data, of type bytes without their number.
        data: &'p [u8],
    },
    /// The other end has this id. Down, of a memory event, 0: say again what you hold (S22).
    Ack(u8),
    /// Down: a module's members are activated.
    Activate,
}

/// The items of a map and its payload, in the order of the map.
#[derive(Clone, Debug)]
pub struct Items<'p> {
    elements: &'p [Element<'p>],
    direction: Direction,
    /// The bytes of the map that were not begun.
    map: &'p [u8],
    /// The bits that are left of the byte that was begun.
    bits: u8,
    /// The place of the first bit that was not begun.
    begun: usize,
    payload: &'p [u8],
}

impl<'p> Items<'p> {
    /// What stands behind a header, checked as a whole: no item comes out of a packet that is wrong anywhere.
    ///
    /// # Errors
    ///
    /// [`Dropped::Map`] where the map is cut off or has a bit that the direction or the model has not;
    /// [`Dropped::Payload`] where the payload is too short or too long, or has an id or a number that cannot be.
    pub fn parse(layout: &'p Layout<'p>, direction: Direction, body: &'p [u8]) -> Result<Items<'p>, Dropped> {
        let (map, payload) = body.split_at_checked(layout.map_len()).ok_or(Dropped::Map)?;
        let items = Items {
            elements: layout.elements,
            direction,
            map,
            bits: 0,
            begun: 0,
            payload,
        };
        let mut check = items.clone();
        while check.step()?.is_some() {}
        match check.payload.is_empty() {
            true => Ok(items),
            false => Err(Dropped::Payload),
        }
    }

    fn step(&mut self) -> Result<Option<(u8, Item<'p>)>, Dropped> {
        while self.bits == 0 {
            let Some((&bits, map)) = self.map.split_first() else {
                return Ok(None);
            };
            (self.bits, self.map) = (bits, map);
            self.begun += 8;
        }
        let skipped = self.bits.leading_zeros();
        let place = self.begun - 8 + skipped as usize;
        self.bits &= 0x7F >> skipped;
        let element = self.elements.get(place).ok_or(Dropped::Map)?;
        let item = take(element, self.direction, &mut self.payload)?;
        Ok(Some((place as u8, item)))
    }
}

impl<'p> Iterator for Items<'p> {
    type Item = (u8, Item<'p>);

    fn next(&mut self) -> Option<(u8, Item<'p>)> {
        self.step().ok().flatten()
    }
}

/// What the bit of an element carries in one direction.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Bit {
    Value,
    Ask,
    Activate,
    Ack,
    /// An id that may be 0.
    AckOrAsk,
    Call,
    /// A call whose data go behind their number, whatever their type.
    Counted,
    /// It is never 1.
    Never,
}

const fn carried(direction: Direction, kind: Kind) -> Bit {
    match (direction, kind) {
        (Direction::Down, Kind::Effector) | (Direction::Up, Kind::Sensor | Kind::Monitor) => Bit::Value,
        (Direction::Down, Kind::Sensor | Kind::Monitor) => Bit::Ask,
        (Direction::Down, Kind::Module) => Bit::Activate,
        (Direction::Down, Kind::MemoryEvent) => Bit::AckOrAsk,
        (Direction::Down, Kind::Event) | (Direction::Up, Kind::Command | Kind::MemoryCommand) => Bit::Ack,
        (Direction::Down, Kind::Command | Kind::MemoryCommand) | (Direction::Up, Kind::Event) => Bit::Call,
        (Direction::Up, Kind::MemoryEvent) => Bit::Counted,
        (Direction::Up, Kind::Effector | Kind::Module) => Bit::Never,
    }
}

/// Takes the item of an element from the front of a payload.
#[inline]
fn take<'p>(
    element: &Element<'_>,
    direction: Direction,
    payload: &mut &'p [u8],
) -> Result<Item<'p>, Dropped> {
    match carried(direction, element.kind) {
        Bit::Value => {
            let value = data(element.payload, payload)?;
            let counts = direction == Direction::Up || element.payload.is_finite(value);
            counts.then_some(Item::Value(value)).ok_or(Dropped::Payload)
        }
        Bit::Ask => Ok(Item::Ask),
        Bit::Activate => Ok(Item::Activate),
        Bit::AckOrAsk => Ok(Item::Ack(byte(payload)?)),
        Bit::Ack => Ok(Item::Ack(id(payload)?)),
        Bit::Call => Ok(Item::Call {
            id: id(payload)?,
            data: data(element.payload, payload)?,
        }),
        Bit::Counted => {
            let id = id(payload)?;
            let data = counted(payload)?;
            let fits = element.payload.takes(data);
            fits.then_some(Item::Call { id, data }).ok_or(Dropped::Payload)
        }
        Bit::Never => Err(Dropped::Map),
    }
}

#[inline]
fn split<'p>(payload: &mut &'p [u8], len: usize) -> Result<&'p [u8], Dropped> {
    let (taken, rest) = payload.split_at_checked(len).ok_or(Dropped::Payload)?;
    *payload = rest;
    Ok(taken)
}

fn byte(payload: &mut &[u8]) -> Result<u8, Dropped> {
    let (&byte, rest) = payload.split_first().ok_or(Dropped::Payload)?;
    *payload = rest;
    Ok(byte)
}

fn id(payload: &mut &[u8]) -> Result<u8, Dropped> {
    byte(payload).and_then(|id| if id == 0 { Err(Dropped::Payload) } else { Ok(id) })
}

fn counted<'p>(payload: &mut &'p [u8]) -> Result<&'p [u8], Dropped> {
    let (&count, rest) = payload.split_first_chunk().ok_or(Dropped::Payload)?;
    *payload = rest;
    split(payload, usize::from(u16::from_be_bytes(count)))
}

#[inline]
fn data<'p>(kind: Payload, payload: &mut &'p [u8]) -> Result<&'p [u8], Dropped> {
    match kind {
        Payload::Bytes(most) => counted(payload).and_then(|data| {
            if data.len() > usize::from(most) {
                Err(Dropped::Payload)
            } else {
                Ok(data)
            }
        }),
        _ => split(payload, kind.size()),
    }
}

/// Writes a map and its payload.
#[derive(Debug)]
pub struct Writer<'b> {
    elements: &'b [Element<'b>],
    direction: Direction,
    /// Places below this one are written, or left out.
    next: usize,
    map: &'b mut [u8],
    payload: &'b mut [u8],
    used: usize,
}

impl<'b> Writer<'b> {
    /// Writes into a buffer, from its beginning; `None` if it has no space for the map.
    #[must_use]
    pub fn new(layout: &'b Layout<'b>, direction: Direction, buffer: &'b mut [u8]) -> Option<Writer<'b>> {
        let (map, payload) = buffer.split_at_mut_checked(layout.map_len())?;
        map.fill(0);
        Some(Writer {
            elements: layout.elements,
            direction,
            next: 0,
            map,
            payload,
            used: 0,
        })
    }

    /// Adds an element's item; elements go in rising order.
    ///
    /// # Errors
    ///
    /// [`Refused::Element`] for an unknown element, or one that is not above the last; [`Refused::Kind`] for an item that the kind
    /// has not in this direction; [`Refused::Size`]; [`Refused::Value`] for an id or a number that cannot be; [`Refused::Full`] where
    /// the buffer ends. Nothing is written then.
    pub fn put(&mut self, element: u8, item: Item<'_>) -> Result<(), Refused> {
        let place = usize::from(element);
        let of = self
            .elements
            .get(place)
            .filter(|_| place >= self.next)
            .ok_or(Refused::Element)?;
        let mut rest = self.payload.get_mut(self.used..).ok_or(Refused::Full)?;
        let before = rest.len();
        match (carried(self.direction, of.kind), item) {
            (_, Item::Call { id: 0, .. }) | (Bit::Ack, Item::Ack(0)) => return Err(Refused::Value),
            (Bit::Value, Item::Value(value)) => {
                if self.direction == Direction::Down && !of.payload.is_finite(value) {
                    return Err(Refused::Value);
                }
                put_data(&mut rest, of.payload, value)?;
            }
            (Bit::Ask, Item::Ask) | (Bit::Activate, Item::Activate) => {}
            (Bit::Ack | Bit::AckOrAsk, Item::Ack(id)) => put_bytes(&mut rest, &[id])?,
            (Bit::Counted, Item::Call { id, data }) => {
                if !of.payload.takes(data) {
                    return Err(Refused::Size);
                }
                put_bytes(&mut rest, &[id])?;
                put_counted(&mut rest, data)?;
            }
            (Bit::Call, Item::Call { id, data }) => {
                put_bytes(&mut rest, &[id])?;
                put_data(&mut rest, of.payload, data)?;
            }
            _ => return Err(Refused::Kind),
        }
        self.used += before - rest.len();
        self.next = place + 1;
        if let Some(byte) = self.map.get_mut(place / 8) {
            *byte |= 0x80 >> (place % 8);
        }
        Ok(())
    }

    /// Bytes that were written, map and payload.
    #[must_use]
    pub fn finish(self) -> usize {
        self.map.len() + self.used
    }
}

fn put_bytes(rest: &mut &mut [u8], bytes: &[u8]) -> Result<(), Refused> {
    let (to, after) = core::mem::take(rest)
        .split_at_mut_checked(bytes.len())
        .ok_or(Refused::Full)?;
    to.copy_from_slice(bytes);
    *rest = after;
    Ok(())
}

fn put_counted(rest: &mut &mut [u8], data: &[u8]) -> Result<(), Refused> {
    let count = u16::try_from(data.len()).map_err(|_| Refused::Size)?;
    put_bytes(rest, &count.to_be_bytes())?;
    put_bytes(rest, data)
}

fn put_data(rest: &mut &mut [u8], payload: Payload, data: &[u8]) -> Result<(), Refused> {
    match payload {
        _ if !payload.takes(data) => Err(Refused::Size),
        Payload::Bytes(_) => put_counted(rest, data),
        _ => put_bytes(rest, data),
    }
}

/// Whether an element's bit is 1 in a map.
pub(crate) fn bit(map: &[u8], place: usize) -> bool {
    map.get(place / 8)
        .is_some_and(|byte| byte << (place % 8) & 0x80 != 0)
}

/// Whether the bits behind the last element are all 0.
pub(crate) fn is_padded(map: &[u8], elements: usize) -> bool {
    (elements..map.len() * 8).all(|place| !bit(map, place))
}
