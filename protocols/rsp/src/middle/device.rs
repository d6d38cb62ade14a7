//! What the device manager keeps of each element (S2, S7).

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use super::blobs::Incoming;

/// Values of an effector that can be on their way unconfirmed; of more the oldest are not told apart.
const CHANGES: usize = 64;

/// A value, and when it was heard or confirmed.
pub(super) struct Kept {
    pub(super) value: Vec<u8>,
    pub(super) at: u64,
    pub(super) stamp: u32,
}

/// A command that is under way.
pub(super) struct Call {
    pub(super) ticket: u32,
    pub(super) id: u8,
    pub(super) data: Vec<u8>,
    /// When it was sent first, and last.
    pub(super) sent: Option<(u64, u64)>,
}

/// The state of one element.
pub(super) struct ElementState {
    /// As the program wants it (S7).
    pub(super) wanted: bool,
    /// As the newest control says it.
    pub(super) level: bool,
    /// As the robot has said it.
    pub(super) active: bool,
    /// Of an effector: what it shall have; of an incremental one the running total.
    pub(super) value: Option<Vec<u8>>,
    /// The value was written since the last packet.
    pub(super) is_new: bool,
    /// Of an incremental effector in paper mode: the sum since the last packet.
    pub(super) step: Vec<u8>,
    /// Values that are not confirmed, each with the sequence of the first packet that had it.
    pub(super) changes: VecDeque<(u64, Vec<u8>)>,
    pub(super) confirmed: Option<Kept>,
    /// Of a sensor or monitor.
    pub(super) reading: Option<Kept>,
    /// The program was told that there is a reading, and has not looked.
    pub(super) is_told: bool,
    /// It is asked for, since the packet of this sequence.
    pub(super) asked: Option<Option<u64>>,
    pub(super) queue: VecDeque<(u32, Vec<u8>)>,
    pub(super) call: Option<Call>,
    /// Of a command: its last id; of an event: the last that was delivered. 0 before the first.
    pub(super) id: u8,
    /// Of an event: the id to acknowledge.
    pub(super) ack: Option<u8>,
    /// The number of the next blob for it.
    pub(super) blob: u16,
    pub(super) incoming: Option<Incoming>,
}

impl ElementState {
    pub(super) fn new() -> ElementState {
        ElementState {
            wanted: true,
            level: true,
            active: true,
            value: None,
            is_new: false,
            step: Vec::new(),
            changes: VecDeque::new(),
            confirmed: None,
            reading: None,
            is_told: false,
            asked: None,
            queue: VecDeque::new(),
            call: None,
            id: 0,
            ack: None,
            blob: 0,
            incoming: None,
        }
    }

    /// It is told nothing, and counts from 0 again.
    pub(super) fn rest(&mut self) {
        self.value = None;
        self.is_new = false;
        self.step.clear();
        self.changes.clear();
        self.confirmed = None;
        self.asked = None;
    }

    /// The value leaves in the packet of this sequence.
    pub(super) fn leaves(&mut self, sequence: u64) {
        let Some(value) = self.value.as_ref().filter(|_| self.is_new) else {
            return;
        };
        if self.changes.len() == CHANGES {
            self.changes.pop_front();
        }
        self.changes.push_back((sequence, value.clone()));
        self.is_new = false;
    }

    /// The next packet is without the value: so packets from there on confirm nothing, and the value begins anew in a later one.
    pub(super) fn pause(&mut self) {
        self.is_new |= !self.changes.is_empty();
        self.changes.clear();
    }

    /// The robot has the packet of this sequence: so it has what was in it.
    pub(super) fn confirm(&mut self, sequence: u64, at: u64, stamp: u32) {
        let mut newest = None;
        while let Some((_, value)) = self.changes.pop_front_if(|(first, _)| *first <= sequence) {
            newest = Some(value);
        }
        if let Some(value) = newest {
            self.confirmed = Some(Kept { value, at, stamp });
        }
    }
}
