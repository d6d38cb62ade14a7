//! Commands as a device keeps them, and what its queue tells of them and of itself.

use std::sync::Arc;

use mom_client::Map;

use crate::{AtRest, DeviceError, DeviceTime, Script};

/// Whose command it is.
#[derive(Debug, Clone, PartialEq)]
pub struct Order {
    /// Who sent it.
    pub peer: Arc<str>,
    /// Its id, if it has one.
    pub id: Option<u64>,
    /// The fence under which it was sent, if its channel is guarded.
    pub fence: Option<u64>,
}

/// A command in the queue.
#[derive(Debug, Clone)]
pub struct Command<A> {
    /// Whose it is.
    pub order: Order,
    /// What is to be done.
    pub script: Script<A>,
    /// When it is too old to begin.
    pub use_by: Option<DeviceTime>,
}

/// The command being carried out, and how far it is.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress {
    /// Whose it is.
    pub order: Order,
    /// The statement being carried out, or the last one begun; 1 for the first, 0 before it.
    pub statement: u32,
    /// How many statements the command has.
    pub of: u32,
}

/// What is known of the device at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Rises with every change.
    pub seq: u64,
    /// Where it is: what commands are based on.
    pub position: Map,
    /// What else is told of it.
    pub report: Map,
    /// Whether it moves, or does not rest yet though it is to stand.
    pub moving: bool,
    /// How it is known that it rests, if it is.
    pub rest: Option<AtRest>,
    /// Whether it can tell its mechanism what to do.
    pub reached: bool,
    /// Whether it takes no command until it is released.
    pub stopped: bool,
    /// The command being carried out.
    pub executing: Option<Progress>,
    /// How many commands wait behind it.
    pub waiting: usize,
}

/// The events of a device, in order.
#[derive(Debug, Clone, PartialEq)]
pub enum QueueEvent {
    /// A command is checked and waits.
    Waiting(Progress),
    /// Its next statement began.
    Executing(Progress),
    /// It was carried out to its end.
    Finished(Progress),
    /// It ended before.
    Failed(Progress, DeviceError),
    /// The state changed: every [`Machine::PERIOD`](crate::Machine::PERIOD) while the device moves, and at rest at the end of each command.
    State(State),
}

impl<A> Command<A> {
    pub(crate) fn progress(&self, begun: usize) -> Progress {
        let count = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
        Progress {
            order: self.order.clone(),
            statement: count(begun),
            of: count(self.script.statements().len()),
        }
    }
}
