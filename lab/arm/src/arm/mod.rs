//! The arm with its queue, as a pure function of commands and time: what plans, rehearsals and benchmarks drive without a hub.

use mom_client::{Map, from_value};
use mom_device::{Command, CommandQueue, DeviceError, ErrorName, Order, Progress, QueueEvent, State};

use crate::blocks::Block;
use crate::controller::Controller;
use crate::machine::ArmMachine;
use crate::motion::ArmTime;
use crate::script::Script;
use crate::state::{ArmEvent, ArmState, CommandState, Executing, ScriptProgress};

#[cfg(test)]
mod halts;
#[cfg(test)]
mod promises;
#[cfg(test)]
mod silence;
#[cfg(test)]
mod tests;

pub use mom_device::{MAX_WAITING, STATE_PERIOD};

/// The arm.
///
/// A driver calls [`Arm::advance`] whenever [`Arm::next_wake`] is due, and the other methods when
/// they are needed. Every method that takes `now` first advances to it; a time before
/// the latest one counts as the latest. Everything that happens is reported in `events`, in order, and
/// every accepted command ends in exactly one `finished` or `error`. Its rules are those of every device's [`CommandQueue`]: at a hub
/// the same queue is driven by a [`DeviceServer`](mom_device::DeviceServer).
#[derive(Debug)]
pub struct Arm {
    queue: CommandQueue<ArmMachine>,
}

impl Arm {
    /// An arm at home, at rest, with open jaws and the blocks of the lab.
    #[must_use]
    pub fn new(now: ArmTime) -> Self {
        Self::with_blocks(now, Block::lab())
    }

    /// An arm at home, at rest, with open jaws and blocks put down as by [`Blocks::new`](crate::blocks::Blocks::new).
    #[must_use]
    pub fn with_blocks(now: ArmTime, blocks: impl IntoIterator<Item = Block>) -> Self {
        Self::of(now, ArmMachine::with_blocks(now, blocks))
    }

    /// An arm that this controller moves.
    #[must_use]
    pub fn with_controller(now: ArmTime, controller: Box<dyn Controller>) -> Self {
        Self::of(now, ArmMachine::new(controller))
    }

    fn of(now: ArmTime, machine: ArmMachine) -> Self {
        let mut queue = CommandQueue::new(machine);
        queue.advance(now, &mut Vec::new());
        Self { queue }
    }

    /// Takes a command: reads its script, checks every leg of it, and queues it. It begins at once
    /// if nothing else is being carried out.
    ///
    /// # Errors
    ///
    /// `stopped`, `link`, `queue-full`, `duplicate-id`, `busy`, `syntax`, `workspace-boundary`, `joint-limit` or
    /// `singularity`. Then the command is not accepted, nothing moves, and there is no event but of the time that passed.
    pub fn submit(
        &mut self,
        id: u64,
        script: &str,
        now: ArmTime,
        events: &mut Vec<ArmEvent>,
    ) -> Result<(), DeviceError> {
        let order = Order {
            peer: "".into(),
            id: Some(id),
            fence: None,
        };
        self.act(events, |queue, events| {
            queue.advance(now, events);
            if queue.orders().any(|other| *other == order) {
                let text = format!("command {id} is still waiting or executing; choose another id");
                return Err(DeviceError::new(ErrorName::DuplicateId, text));
            }
            queue.check_free()?;
            let command = Command {
                order,
                script: script.parse::<Script>()?.into_inner(),
                use_by: None,
            };
            queue.submit(command, now, events)
        })
    }

    /// Lets time pass until `now`.
    pub fn advance(&mut self, now: ArmTime, events: &mut Vec<ArmEvent>) {
        self.act(events, |queue, events| queue.advance(now, events));
    }

    /// When [`Arm::advance`] is to be called next; `None` while there is nothing to do.
    #[must_use]
    pub fn next_wake(&self) -> Option<ArmTime> {
        self.queue.next_wake()
    }

    /// Whether a command is being carried out or waits, so that the arm may be elsewhere soon.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        self.queue.is_busy()
    }

    /// Stops the hand and the jaws where they are and drops every command with the error `halted`.
    /// Not latched: the next command is taken. A block in the jaws stays there.
    pub fn halt(&mut self, now: ArmTime, reason: &str, events: &mut Vec<ArmEvent>) {
        self.act(events, |queue, events| queue.halt(now, reason, events));
    }

    /// Halts the arm, every command ending with the error `stopped`, and takes none until [`Arm::unstop`].
    pub fn stop(&mut self, now: ArmTime, reason: &str, events: &mut Vec<ArmEvent>) {
        self.act(events, |queue, events| {
            queue.stop(now, reason, ErrorName::Stopped, events);
        });
    }

    /// Lets the arm take commands again. Nothing moves by itself: the old commands are gone.
    pub fn unstop(&mut self, now: ArmTime, events: &mut Vec<ArmEvent>) {
        self.act(events, |queue, events| queue.unstop(now, events));
    }

    /// The state at the latest time given.
    #[must_use]
    pub fn state(&self) -> ArmState {
        state_of(&self.queue.state())
    }

    fn act<T>(
        &mut self,
        events: &mut Vec<ArmEvent>,
        action: impl FnOnce(&mut CommandQueue<ArmMachine>, &mut Vec<QueueEvent>) -> T,
    ) -> T {
        let mut happened = Vec::new();
        let outcome = action(&mut self.queue, &mut happened);
        events.extend(happened.into_iter().map(event_of));
        outcome
    }
}

fn event_of(event: QueueEvent) -> ArmEvent {
    match event {
        QueueEvent::Waiting(progress) => command(&progress, CommandState::Waiting, None),
        QueueEvent::Executing(progress) => command(&progress, CommandState::Executing, None),
        QueueEvent::Finished(progress) => command(&progress, CommandState::Finished, None),
        QueueEvent::Failed(progress, error) => command(&progress, CommandState::Error, Some(error)),
        QueueEvent::State(state) => ArmEvent::State(state_of(&state)),
    }
}

fn command(progress: &Progress, state: CommandState, error: Option<DeviceError>) -> ArmEvent {
    ArmEvent::Command {
        id: progress.order.id.unwrap_or_default(),
        state,
        progress: ScriptProgress {
            statement: progress.statement,
            of: progress.of,
        },
        error,
    }
}

fn state_of(state: &State) -> ArmState {
    let mut map = Map::new()
        .with("seq", i64::try_from(state.seq).unwrap_or(i64::MAX))
        .with("moving", state.moving)
        .with("stopped", state.stopped)
        .with("waiting", i64::try_from(state.waiting).unwrap_or(i64::MAX));
    for (key, value) in state.position.iter().chain(state.report.iter()) {
        map.set(key, value.clone());
    }
    let read: ArmState = from_value(map.into()).expect("the machine writes what the state reads");
    ArmState {
        executing: state.executing.as_ref().map(|progress| Executing {
            id: progress.order.id.unwrap_or_default(),
            statement: progress.statement,
            of: progress.of,
        }),
        ..read
    }
}
