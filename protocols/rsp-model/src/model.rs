//! A model that has been read and checked.

use mom_rsp::{Element, Kind, Layout, Motion, Number, Payload, Sound};

/// Bytes of a packet's header (S14).
pub const HEADER: usize = 20;
/// Bytes that a sealed packet has more.
pub const TAG: usize = 16;
/// The most elements of a model: a place among them is one byte.
pub const MOST_ELEMENTS: usize = 256;
/// The most bytes of a packet: what a UDP datagram over IPv4 holds.
pub const HIGHEST_PACKET: u16 = 65_507;
/// The most characters of a name.
pub const LONGEST_NAME: usize = 48;

/// Which way a packet goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Direction {
    /// From the middle to the robot.
    Down,
    /// From the robot to the middle.
    Up,
}

/// What one number of an element means.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Quantity {
    /// What it is called among the numbers of its element, if it has a name.
    pub part: Option<String>,
    /// Its unit, such as `mm/s`; empty for none.
    pub unit: String,
    /// The value in the unit is the number on the wire times this; more than 0.
    pub scale: f64,
    /// The least value, in the unit.
    pub min: f64,
    /// The greatest value, in the unit.
    pub max: f64,
    /// Of an effector: the value when there is nobody to command it, in the unit. Of others: 0.
    pub safe: f64,
}

/// One element of a model.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ModelElement {
    /// Its name: a word of lower-case letters, digits and `-`.
    pub name: String,
    /// What it is (S5).
    pub kind: Kind,
    /// What its data are; a monitor's are those of its effector.
    pub payload: Payload,
    /// Of an effector, sensor or monitor whose longest value does not fit a packet: its most bytes. It travels in fragments
    /// (S13, S27), and its payload is `Bytes(0)`.
    pub blob: Option<u16>,
    /// Of an effector or a sensor of type bytes: that they are sound, and of what make.
    pub sound: Option<Sound>,
    /// What its numbers mean: one for each of them, or one for all. Empty where it has none.
    pub quantities: Vec<Quantity>,
    /// Of an effector: how its values are used; limits are in units of the wire.
    pub motion: Motion,
    /// Of an effector: the most change, in its unit a second.
    pub rate: Option<f64>,
    /// Of an effector: the safe value as on the wire.
    pub safe: Vec<u8>,
    /// Of a sensor or monitor: it is sent at most so often, in ms; 0 for each packet.
    pub period: u16,
    /// Of a command or memory command: what it begins goes on for so long at most, in ms; 0 where nothing does.
    pub lasts: u16,
    /// Of a monitor: the place of its effector.
    pub of: Option<u8>,
    /// The place of the module that it is a member of.
    pub module: Option<u8>,
    /// What people should know of it.
    pub doc: String,
    /// A digest of all that both ends must agree on.
    pub digest: u32,
}

impl ModelElement {
    /// What its number `index` means.
    #[must_use]
    pub fn quantity(&self, index: usize) -> Option<&Quantity> {
        match self.payload {
            Payload::Numbers(_, count) if index < usize::from(count) => {
                self.quantities.get(index).or_else(|| self.quantities.first())
            }
            _ => None,
        }
    }

    /// The most bytes of its payload in a packet of this direction (S5).
    #[must_use]
    pub const fn payload_size(&self, direction: Direction) -> usize {
        let data = self.payload.size();
        match (self.kind, direction) {
            (Kind::Effector, Direction::Down) | (Kind::Sensor | Kind::Monitor, Direction::Up) => data,
            (Kind::Command | Kind::MemoryCommand, Direction::Down) | (Kind::Event, Direction::Up) => 1 + data,
            (Kind::MemoryEvent, Direction::Up) => match self.payload {
                // The length of bytes and that of a memory event are one.
                Payload::Bytes(most) => 3 + most as usize,
                _ => 3 + data,
            },
            (Kind::Effector, Direction::Up)
            | (Kind::Sensor | Kind::Monitor, Direction::Down)
            | (Kind::Module, _) => 0,
            (Kind::Command | Kind::MemoryCommand, Direction::Up)
            | (Kind::Event | Kind::MemoryEvent, Direction::Down) => 1,
        }
    }
}

/// A model that has been read and checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    pub(crate) name: String,
    pub(crate) id: u16,
    pub(crate) doc: String,
    pub(crate) period: u16,
    pub(crate) largest_packet: u16,
    pub(crate) watchdog: u16,
    pub(crate) elements: Vec<ModelElement>,
    pub(crate) hash: [u8; 32],
}

impl Model {
    /// What the robot is called.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The model's number in each header.
    #[must_use]
    pub const fn id(&self) -> u16 {
        self.id
    }

    /// What people should know of it.
    #[must_use]
    pub fn doc(&self) -> &str {
        &self.doc
    }

    /// The period T when nobody says otherwise, in ms (S9, S10).
    #[must_use]
    pub const fn period(&self) -> u16 {
        self.period
    }

    /// The most bytes of a packet, sealed.
    #[must_use]
    pub const fn largest_packet(&self) -> u16 {
        self.largest_packet
    }

    /// After so much silence, in ms, the robot takes its safe values; 0 for never.
    #[must_use]
    pub const fn watchdog(&self) -> u16 {
        self.watchdog
    }

    /// The elements, in the order of the device map.
    #[must_use]
    pub fn elements(&self) -> &[ModelElement] {
        &self.elements
    }

    /// The hash (SHA-256) of all that both ends must agree on: white space, comments, the order of keys and doc texts
    /// do not count.
    #[must_use]
    pub const fn hash(&self) -> [u8; 32] {
        self.hash
    }

    /// Bytes of the device map (S17).
    #[must_use]
    pub const fn map_size(&self) -> usize {
        self.elements.len().div_ceil(8)
    }

    /// The bytes of a data packet in which every bit is 1 and every value is as long as it may be, without the tag of a
    /// sealed one.
    #[must_use]
    pub fn packet_size(&self, direction: Direction) -> usize {
        let payloads = self
            .elements
            .iter()
            .map(|element| element.payload_size(direction));
        HEADER + self.map_size() + payloads.sum::<usize>()
    }

    /// The elements as packets need them, for [`layout`](Model::layout).
    #[must_use]
    pub fn wire_elements<'m>(&'m self) -> Vec<Element<'m>> {
        let wire = |element: &'m ModelElement| {
            let ModelElement { name, safe, .. } = element;
            Element {
                name,
                kind: element.kind,
                payload: element.payload,
                motion: element.motion,
                safe,
                period: element.period,
                module: element.module,
                of: element.of,
                digest: element.digest,
            }
        };
        self.elements.iter().map(wire).collect()
    }

    /// The model as packets need it, around what [`wire_elements`](Model::wire_elements) gave.
    ///
    /// # Panics
    ///
    /// By elements that are not the model's and of which no packets can be made.
    #[must_use]
    pub const fn layout<'m>(&self, elements: &'m [Element<'m>]) -> Layout<'m> {
        Layout::new(self.id, self.hash, elements)
    }

    /// The model as packets need it, for as long as the program runs.
    ///
    /// It stays in memory until then, whatever becomes of it: a program calls this once for each model, at its start.
    #[must_use]
    pub fn into_layout(self) -> Layout<'static> {
        let model: &'static Model = Box::leak(Box::new(self));
        model.layout(model.wire_elements().leak())
    }

    /// The place of an element by its name.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<(usize, &ModelElement)> {
        self.elements
            .iter()
            .enumerate()
            .find(|(_, element)| element.name == name)
    }
}

/// The word of a kind.
pub(crate) const KINDS: [(&str, Kind); 8] = [
    ("effector", Kind::Effector),
    ("sensor", Kind::Sensor),
    ("monitor", Kind::Monitor),
    ("command", Kind::Command),
    ("module", Kind::Module),
    ("event", Kind::Event),
    ("memory-command", Kind::MemoryCommand),
    ("memory-event", Kind::MemoryEvent),
];

pub(crate) fn kind_word(kind: Kind) -> &'static str {
    KINDS
        .iter()
        .find(|(_, other)| *other == kind)
        .map_or("", |(word, _)| word)
}

/// The word of a type of numbers.
pub(crate) const NUMBERS: [(&str, Number); 7] = [
    ("u8", Number::U8),
    ("i8", Number::I8),
    ("u16", Number::U16),
    ("i16", Number::I16),
    ("u32", Number::U32),
    ("i32", Number::I32),
    ("f32", Number::F32),
];

pub(crate) fn number_word(number: Number) -> &'static str {
    NUMBERS
        .iter()
        .find(|(_, other)| *other == number)
        .map_or("", |(word, _)| word)
}

/// The least and the greatest number of a type.
pub(crate) fn bounds(number: Number) -> (f64, f64) {
    match number {
        Number::U8 => (0.0, f64::from(u8::MAX)),
        Number::I8 => (f64::from(i8::MIN), f64::from(i8::MAX)),
        Number::U16 => (0.0, f64::from(u16::MAX)),
        Number::I16 => (f64::from(i16::MIN), f64::from(i16::MAX)),
        Number::U32 => (0.0, f64::from(u32::MAX)),
        Number::I32 => (f64::from(i32::MIN), f64::from(i32::MAX)),
        Number::F32 => (f64::from(f32::MIN), f64::from(f32::MAX)),
    }
}

/// A number as on the wire, rounded to what its type holds.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a cast saturates, which is what is meant"
)]
pub(crate) fn write_number(number: Number, value: f64, to: &mut Vec<u8>) {
    let whole = value.round();
    match number {
        Number::U8 => to.push(whole as u8),
        Number::I8 => to.extend((whole as i8).to_be_bytes()),
        Number::U16 => to.extend((whole as u16).to_be_bytes()),
        Number::I16 => to.extend((whole as i16).to_be_bytes()),
        Number::U32 => to.extend((whole as u32).to_be_bytes()),
        Number::I32 => to.extend((whole as i32).to_be_bytes()),
        Number::F32 => to.extend((value as f32).to_be_bytes()),
    }
}
