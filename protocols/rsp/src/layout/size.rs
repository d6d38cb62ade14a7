//! What follows from a model: whether packets can be made by it, and how large they are.

use core::fmt;

use super::{Element, Kind, Layout, Motion, Number, Payload};
use crate::fragment::{FRAGMENT, HEAD};
use crate::header::{Direction, Header};

/// Bytes behind a sealed packet.
pub(crate) const TAG: usize = 16;

/// The most bytes that a datagram over IPv4 takes.
const DATAGRAM: usize = 65_507;

/// Why no packets can be made by a model, with the place of the element.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LayoutFault {
    /// There is no element, or there are more than 256.
    Count,
    /// The effector's safe value has not the size of its values.
    Safe(u8),
    /// The element is a member of what is not a module, or a module is a member.
    Module(u8),
    /// The monitor is of no effector, or its size is another one.
    Monitor(u8),
    /// An effector adds up what is not a number.
    Motion(u8),
    /// The limit of change is not a number above 0.
    Rate(u8),
    /// Values or data have no bytes, or a module has some.
    Payload(u8),
    /// The name has no bytes, or more than 255.
    Name(u8),
    /// With all elements in it a packet would not fit a datagram.
    Large,
}

impl fmt::Display for LayoutFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (place, what) = match self {
            LayoutFault::Count => return f.write_str("the model has no elements, or more than 256"),
            LayoutFault::Large => {
                return f.write_str("the largest packet of the model does not fit a datagram");
            }
            LayoutFault::Safe(place) => (place, "its safe value has not the size of its values"),
            LayoutFault::Module(place) => (
                place,
                "it is a member of what is not a module, or a module in a module",
            ),
            LayoutFault::Monitor(place) => (place, "it monitors no effector, or its size is another one"),
            LayoutFault::Motion(place) => (place, "only numbers can be added up or interpolated"),
            LayoutFault::Rate(place) => (place, "the most change a second is not above 0"),
            LayoutFault::Payload(place) => (place, "values need at least one byte, and a module has none"),
            LayoutFault::Name(place) => (place, "its name has no bytes, or more than 255"),
        };
        write!(f, "element {place}: {what}")
    }
}

impl core::error::Error for LayoutFault {}

impl Layout<'_> {
    /// Why no packets can be made by the model: the first fault.
    pub(crate) const fn fault(&self) -> Option<LayoutFault> {
        let elements = self.elements;
        if elements.is_empty() || elements.len() > 256 {
            return Some(LayoutFault::Count);
        }
        let mut at = 0;
        while at < elements.len() {
            let fault = self.element_fault(at);
            if fault.is_some() {
                return fault;
            }
            at += 1;
        }
        match self.largest() > DATAGRAM {
            true => Some(LayoutFault::Large),
            false => None,
        }
    }

    const fn element_fault(&self, at: usize) -> Option<LayoutFault> {
        let element = &self.elements[at];
        let place = at as u8;
        let size = element.payload.size();
        if element.name.is_empty() || element.name.len() > 255 {
            return Some(LayoutFault::Name(place));
        }
        // No bytes at most is what travels in fragments alone.
        let empty = match element.payload {
            Payload::Bytes(_) => false,
            _ => size == 0,
        };
        let has_value = matches!(element.kind, Kind::Effector | Kind::Sensor | Kind::Monitor);
        if has_value && empty || matches!(element.kind, Kind::Module) && size > 0 {
            return Some(LayoutFault::Payload(place));
        }
        if let Some(module) = element.module {
            let module = module as usize;
            let is_module =
                module < self.elements.len() && matches!(self.elements[module].kind, Kind::Module);
            if !is_module || matches!(element.kind, Kind::Module) {
                return Some(LayoutFault::Module(place));
            }
        }
        match element.kind {
            Kind::Effector => self.effector_fault(at),
            Kind::Monitor => {
                let of = match element.of {
                    Some(of) => of as usize,
                    None => return Some(LayoutFault::Monitor(place)),
                };
                let fits = of < self.elements.len()
                    && matches!(self.elements[of].kind, Kind::Effector)
                    && self.elements[of].payload.size() == size;
                if fits {
                    None
                } else {
                    Some(LayoutFault::Monitor(place))
                }
            }
            _ => None,
        }
    }

    const fn effector_fault(&self, at: usize) -> Option<LayoutFault> {
        let element = &self.elements[at];
        let place = at as u8;
        let safe = element.safe;
        let fits = match element.payload {
            Payload::Bytes(_) => {
                safe.len() >= 2
                    && safe.len() <= element.payload.size()
                    && safe.len() - 2 == u16::from_be_bytes([safe[0], safe[1]]) as usize
            }
            _ => safe.len() == element.payload.size(),
        };
        if !fits {
            return Some(LayoutFault::Safe(place));
        }
        let (adds, rate) = match element.motion {
            Motion::Absolute { interpolate, rate } => (interpolate, rate),
            Motion::Incremental { rate } => (true, rate),
        };
        let is_number = matches!(element.payload, Payload::Numbers(..));
        if !is_number && (adds || rate.is_some()) {
            return Some(LayoutFault::Motion(place));
        }
        match rate {
            Some(rate) if !(rate > 0.0 && rate.is_finite()) => Some(LayoutFault::Rate(place)),
            _ => None,
        }
    }

    /// Bytes of the device map: a bit for each element (S17).
    #[must_use]
    pub const fn map_len(&self) -> usize {
        self.elements.len().div_ceil(8)
    }

    /// The most bytes of a packet of either direction, sealed or not: a robot needs two buffers of this size.
    #[must_use]
    pub const fn largest(&self) -> usize {
        let (down, up) = (
            self.largest_data(Direction::Down),
            self.largest_data(Direction::Up),
        );
        let data = if down > up { down } else { up };
        let fragment = Header::LEN + HEAD + FRAGMENT + TAG;
        if data > fragment { data } else { fragment }
    }

    /// The most bytes of a data packet of one direction, sealed.
    #[must_use]
    pub const fn largest_data(&self, direction: Direction) -> usize {
        let mut sum = Header::LEN + self.map_len() + TAG;
        let mut at = 0;
        while at < self.elements.len() {
            let element = &self.elements[at];
            sum += match direction {
                Direction::Down => down_size(element.kind, element.payload),
                Direction::Up => up_size(element.kind, element.payload),
            };
            at += 1;
        }
        sum
    }

    /// The place of an element by its name.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<u8> {
        let place = self.elements.iter().position(|element| element.name == name)?;
        u8::try_from(place).ok()
    }

    /// An element by its place.
    pub(crate) fn element(&self, place: u8) -> Option<&Element<'_>> {
        self.elements.get(usize::from(place))
    }
}

const fn down_size(kind: Kind, payload: Payload) -> usize {
    match kind {
        Kind::Effector => payload.size(),
        Kind::Command | Kind::MemoryCommand => 1 + payload.size(),
        Kind::Event | Kind::MemoryEvent => 1,
        Kind::Sensor | Kind::Monitor | Kind::Module => 0,
    }
}

const fn up_size(kind: Kind, payload: Payload) -> usize {
    match kind {
        Kind::Sensor | Kind::Monitor => payload.size(),
        Kind::Command | Kind::MemoryCommand => 1,
        Kind::Event => 1 + payload.size(),
        Kind::MemoryEvent => 3 + payload.most(),
        Kind::Effector | Kind::Module => 0,
    }
}

impl Payload {
    /// The most bytes of data, without their number.
    pub(crate) const fn most(self) -> usize {
        match self {
            Payload::Bytes(most) => most as usize,
            _ => self.size(),
        }
    }

    /// Whether these are data of this payload.
    pub(crate) fn takes(self, data: &[u8]) -> bool {
        match self {
            Payload::Bytes(most) => data.len() <= usize::from(most),
            _ => data.len() == self.size(),
        }
    }

    /// Whether all numbers of these data are finite.
    pub(crate) fn is_finite(self, data: &[u8]) -> bool {
        let Payload::Numbers(Number::F32, _) = self else {
            return true;
        };
        let (numbers, _) = data.as_chunks::<4>();
        numbers.iter().all(|&bytes| f32::from_be_bytes(bytes).is_finite())
    }
}
