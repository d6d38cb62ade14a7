//! What a robot's end keeps of each element, and where the bytes are.

use crate::{Kind, Layout, Motion, Payload};

/// Events of one element that can wait for their acknowledgement, the one under way among them.
pub(crate) const EVENTS: usize = 4;

/// The element is activated by itself (its module may not be).
pub(crate) const ACTIVE: u8 = 1;
/// A sensor has a value.
pub(crate) const HAS: u8 = 2;
/// A sensor's value was set after its last packet was taken for it; an effector's value was not put out yet.
pub(crate) const NEW: u8 = 4;
/// A sensor's value was sent and is not acknowledged; an event was sent.
pub(crate) const SENT: u8 = 8;
/// A sensor was asked for.
pub(crate) const ASKED: u8 = 16;

/// The state of one element.
#[derive(Clone, Copy)]
pub(crate) struct Cell {
    /// Where its bytes begin among the values.
    pub(crate) start: u16,
    /// Of a sensor: the sequence of the first packet with this value.
    pub(crate) first: u16,
    /// Of a sensor: when a value was last taken; of an effector: when its value arrived. Low bits of µs.
    pub(crate) at: u32,
    /// Of an effector: the change that its rate allows and that was too little for a whole unit.
    pub(crate) credit: f32,
    /// Of a command: the last id that was executed; of an event: that of the oldest that waits. 0 before the first.
    pub(crate) id: u8,
    /// Of a command: the id to acknowledge, 0 for none; of an event: how many wait.
    pub(crate) count: u8,
    /// Of an event: the place of the oldest.
    pub(crate) head: u8,
    pub(crate) flags: u8,
}

impl Cell {
    pub(crate) const NEW: Cell = Cell {
        start: 0,
        first: 0,
        at: 0,
        credit: 0.0,
        id: 0,
        count: 0,
        head: 0,
        flags: ACTIVE,
    };

    pub(crate) fn is(&self, flags: u8) -> bool {
        self.flags & flags == flags
    }

    pub(crate) fn set(&mut self, flags: u8) {
        self.flags |= flags;
    }

    pub(crate) fn clear(&mut self, flags: u8) {
        self.flags &= !flags;
    }
}

/// The bytes that an element has among the values.
///
/// An effector of numbers has three parts: its newest value, its last output, and where it came from when it arrived; an incremental
/// one the total that was heard, the total that was put out, and its step. One of bytes has its value, a sensor has one, an event as
/// many as can wait.
pub(crate) const fn bytes(kind: Kind, payload: Payload) -> usize {
    let size = payload.size();
    match (kind, payload) {
        (Kind::Effector, Payload::Numbers(..)) => 3 * size,
        (Kind::Effector | Kind::Sensor | Kind::Monitor, _) => size,
        (Kind::Event, _) => EVENTS * size,
        (Kind::Command | Kind::MemoryCommand | Kind::MemoryEvent | Kind::Module, _) => 0,
    }
}

/// Bytes for the values of a model: the `V` of its [`Robot`](super::Robot).
#[must_use]
pub const fn values(layout: &Layout<'_>) -> usize {
    let mut sum = 0;
    let mut at = 0;
    while at < layout.elements.len() {
        let element = &layout.elements[at];
        sum += bytes(element.kind, element.payload);
        at += 1;
    }
    sum
}

/// Bytes of one buffer of memory events of a model: the `S` of its [`Robot`](super::Robot).
#[must_use]
pub const fn slot(layout: &Layout<'_>) -> usize {
    let mut most = 0;
    let mut at = 0;
    while at < layout.elements.len() {
        let element = &layout.elements[at];
        let size = element.payload.most();
        if matches!(element.kind, Kind::MemoryEvent) && size > most {
            most = size;
        }
        at += 1;
    }
    most
}

/// A buffer of a memory event (S22).
#[derive(Clone, Copy)]
pub(crate) struct Buffer<const S: usize> {
    pub(crate) element: u8,
    /// Its id; 0 until it is sent for the first time.
    pub(crate) id: u8,
    /// It waits to be sent.
    pub(crate) waits: bool,
    /// Buffers are used in the order of this number, 0 for a free one.
    pub(crate) order: u32,
    pub(crate) len: u16,
    pub(crate) data: [u8; S],
}

impl<const S: usize> Buffer<S> {
    pub(crate) const FREE: Buffer<S> = Buffer {
        element: 0,
        id: 0,
        waits: false,
        order: 0,
        len: 0,
        data: [0; S],
    };
}

/// The limit of change a second of an effector.
pub(crate) const fn rate(motion: Motion) -> Option<f32> {
    match motion {
        Motion::Absolute { rate, .. } | Motion::Incremental { rate } => rate,
    }
}

/// Writes data as on the wire: of type bytes their number goes before them.
pub(crate) fn store(payload: Payload, to: &mut [u8], data: &[u8]) {
    let to = match payload {
        Payload::Bytes(_) => {
            let Some((count, to)) = to.split_first_chunk_mut() else {
                return;
            };
            *count = (data.len() as u16).to_be_bytes();
            to
        }
        _ => to,
    };
    if let Some(to) = to.get_mut(..data.len()) {
        to.copy_from_slice(data);
    }
}

/// The data that [`store`] wrote.
pub(crate) fn stored(payload: Payload, from: &[u8]) -> &[u8] {
    match (payload, from.split_first_chunk()) {
        (Payload::Bytes(_), Some((&count, data))) => data
            .get(..usize::from(u16::from_be_bytes(count)))
            .unwrap_or_default(),
        (Payload::Bytes(_), None) => &[],
        _ => from,
    }
}
