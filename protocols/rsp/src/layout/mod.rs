//! What both ends know of a robot before the first packet: its elements, in the order of the device map.

mod size;

pub use size::LayoutFault;
pub(crate) use size::TAG;

/// What an element is (S5).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Takes values: a motor, a display, a lamp.
    Effector,
    /// Gives values.
    Sensor,
    /// Gives the present values of an effector.
    Monitor,
    /// Is executed once, and sent until it is acknowledged (S19).
    Command,
    /// Activates and deactivates its members (S6).
    Module,
    /// Is generated on a condition, and sent until it is acknowledged (S21).
    Event,
    /// Is executed once; sent once, and again only after a while (S20).
    MemoryCommand,
    /// Is held by the robot until the middle has it (S22).
    MemoryEvent,
}

/// The type of one number on the wire, big-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Number {
    /// One byte.
    U8,
    /// One byte, two's complement.
    I8,
    /// Two bytes.
    U16,
    /// Two bytes, two's complement.
    I16,
    /// Four bytes.
    U32,
    /// Four bytes, two's complement.
    I32,
    /// Four bytes, IEEE 754.
    F32,
}

impl Number {
    /// Bytes on the wire.
    #[must_use]
    pub const fn size(self) -> usize {
        match self {
            Number::U8 | Number::I8 => 1,
            Number::U16 | Number::I16 => 2,
            Number::U32 | Number::I32 | Number::F32 => 4,
        }
    }
}

/// What an element's data are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Payload {
    /// Nothing, as of a module, or of a command without parameters.
    Nothing,
    /// So many numbers of one type.
    Numbers(Number, u16),
    /// At most so many bytes; on the wire their number (u16) goes before them.
    Bytes(u16),
}

impl Payload {
    /// The most bytes that it takes on the wire.
    #[must_use]
    pub const fn size(self) -> usize {
        match self {
            Payload::Nothing => 0,
            Payload::Numbers(number, count) => number.size() * count as usize,
            Payload::Bytes(most) => 2 + most as usize,
        }
    }
}

/// What a robot does with the values of an effector (S12). Limits are in the units of the wire.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// The newest value counts.
    Absolute {
        /// Each output lies between the last two values, one period later.
        interpolate: bool,
        /// The most change a second, `None` for no limit.
        rate: Option<f32>,
    },
    /// Values are steps that add up.
    Incremental {
        /// The most change a second, `None` for no limit.
        rate: Option<f32>,
    },
}

/// One element of a model, which is one bit of the device map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Element<'m> {
    /// A word: lower-case letters, digits and `-`, a letter first.
    pub name: &'m str,
    /// What it is.
    pub kind: Kind,
    /// What its data are; a monitor's are those of its effector.
    pub payload: Payload,
    /// Of an effector: how its values are used.
    pub motion: Motion,
    /// Of an effector: the bytes (as on the wire) that it takes when there is nobody to command it. Of others: empty.
    pub safe: &'m [u8],
    /// Of a sensor: it is sent at most so often, in ms; 0 for each packet.
    pub period: u16,
    /// The module that it is a member of, by its place among the elements.
    pub module: Option<u8>,
    /// The effector whose states it tells, of a monitor, by its place among the elements.
    pub of: Option<u8>,
    /// A digest of all that the model says of it: two ends compare it and name what differs.
    pub digest: u32,
}

/// The model of a robot, as its packets need it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout<'m> {
    pub(crate) id: u16,
    pub(crate) hash: [u8; 32],
    pub(crate) elements: &'m [Element<'m>],
}

impl<'m> Layout<'m> {
    /// A model by which packets can be made: its number in each header, its hash (SHA-256), of which both ends must have the same, and
    /// its elements in the order of the device map.
    ///
    /// # Panics
    ///
    /// Where [`try_new`](Self::try_new) has an error. Of a constant, that is when it is compiled: the program has no code that checks it.
    #[must_use]
    pub const fn new(id: u16, hash: [u8; 32], elements: &'m [Element<'m>]) -> Layout<'m> {
        match Layout::try_new(id, hash, elements) {
            Ok(layout) => layout,
            Err(_) => panic!("no packets can be made by this model"),
        }
    }

    /// As [`new`](Self::new), of a model that is not known to be one.
    ///
    /// # Errors
    ///
    /// Why no packets can be made by it.
    pub const fn try_new(
        id: u16,
        hash: [u8; 32],
        elements: &'m [Element<'m>],
    ) -> Result<Layout<'m>, LayoutFault> {
        let layout = Layout { id, hash, elements };
        match layout.fault() {
            Some(fault) => Err(fault),
            None => Ok(layout),
        }
    }

    /// The model's number.
    #[must_use]
    pub const fn id(&self) -> u16 {
        self.id
    }

    /// The model's hash.
    #[must_use]
    pub const fn hash(&self) -> &[u8; 32] {
        &self.hash
    }

    /// The elements, 1 to 256.
    #[must_use]
    pub const fn elements(&self) -> &'m [Element<'m>] {
        self.elements
    }
}
