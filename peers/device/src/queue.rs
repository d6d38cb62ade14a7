//! The queue: a state machine that takes commands and the time, and emits events.

use std::collections::VecDeque;
use std::fmt::Debug;
use std::sync::Arc;

use mom_client::Map;

use crate::{DeviceError, DeviceTime, ErrorName, MAX_ATTACHED, Machine, Script, Statement};

/// µs between two states while a device moves, unless its machine says otherwise: 20 Hz.
pub const STATE_PERIOD: DeviceTime = 50_000;
/// The most commands that wait behind the one being carried out.
pub const MAX_WAITING: usize = 64;

/// A device that carries out one command after the other.
///
/// A driver calls `advance` whenever `next_wake` is due, and the other methods when somebody asks for what they do.
/// Every method that takes `now` first advances to it; a time before the latest one counts as the latest. Everything
/// that happens is reported in `events`, in order, and every accepted command ends in exactly one `Finished` or `Failed`.
#[derive(Debug)]
pub struct CommandQueue<M: Machine> {
    machine: M,
    now: DeviceTime,
    seq: u64,
    stopped: bool,
    active: Option<Active<M::Action>>,
    waiting: VecDeque<Command<M::Action>>,
    /// When the next state is due, while it moves.
    publish: DeviceTime,
    /// Whether the last state that was told said that it moves.
    told_moving: bool,
}

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

/// The command being carried out.
#[derive(Debug)]
struct Active<A> {
    command: Command<A>,
    /// How many statements have begun.
    begun: usize,
    /// When the present statement ends, if it is a `wait`, or none has begun; else when its action is done.
    ends: Option<DeviceTime>,
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
    /// Whether it moves.
    pub moving: bool,
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
    /// The state changed: every [`Machine::PERIOD`] while the device moves, and at rest at the end of each command.
    State(State),
}

impl<A> Command<A> {
    fn progress(&self, begun: usize) -> Progress {
        let count = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
        Progress {
            order: self.order.clone(),
            statement: count(begun),
            of: count(self.script.statements().len()),
        }
    }
}

impl<M: Machine> CommandQueue<M> {
    /// A device with nothing to do.
    pub fn new(machine: M) -> Self {
        Self {
            machine,
            now: 0,
            seq: 0,
            stopped: false,
            active: None,
            waiting: VecDeque::new(),
            publish: 0,
            told_moving: false,
        }
    }

    /// The device itself.
    pub fn machine(&self) -> &M {
        &self.machine
    }

    /// Lets something be done to the device that no command does, such as that news of it have come; a state follows if it moves now, or
    /// stands.
    pub fn note(&mut self, now: DeviceTime, what: impl FnOnce(&mut M), events: &mut Vec<QueueEvent>) {
        self.advance(now, events);
        what(&mut self.machine);
        self.seq += 1;
        self.advance(self.now, events);
        if self.told_moving != self.machine.is_moving() {
            self.publish_state(events);
        }
    }

    /// Whether a command could be taken now.
    ///
    /// # Errors
    ///
    /// `stopped` or `queue-full`.
    pub fn check_free(&self) -> Result<(), DeviceError> {
        if self.stopped {
            let text = format!(
                "{} is stopped and takes no command until the stop is released",
                M::NAME
            );
            return Err(DeviceError::new(ErrorName::Stopped, text));
        }
        if self.waiting.len() >= MAX_WAITING {
            let text = format!("{MAX_WAITING} commands are waiting already; try again when one has begun");
            return Err(DeviceError::new(ErrorName::QueueFull, text));
        }
        Ok(())
    }

    /// Takes a command: has the machine check it, and queues it. It begins at once if nothing else is being carried out.
    ///
    /// # Errors
    ///
    /// `stopped`, `queue-full`, or why the machine cannot carry it out. Then nothing moves, and there is no event but of the
    /// time that passed.
    pub fn submit(
        &mut self,
        command: Command<M::Action>,
        now: DeviceTime,
        events: &mut Vec<QueueEvent>,
    ) -> Result<(), DeviceError> {
        self.advance(now, events);
        self.check_free()?;
        self.check_attached(&command.script)?;
        self.machine.plan(&command.script)?;
        events.push(QueueEvent::Waiting(command.progress(0)));
        self.waiting.push_back(command);
        self.seq += 1;
        self.advance(now, events);
        Ok(())
    }

    /// Whether there is room for what came with a script.
    fn check_attached(&self, script: &Script<M::Action>) -> Result<(), DeviceError> {
        let active = self.active.iter().map(|active| &active.command);
        let held = active
            .chain(&self.waiting)
            .map(|command| command.script.attached())
            .sum::<usize>();
        let more = script.attached();
        if more > 0 && held + more > MAX_ATTACHED {
            let text = match more > MAX_ATTACHED {
                true => format!("{more} bytes came with the command, and {MAX_ATTACHED} at most are taken"),
                false => format!(
                    "{held} bytes came with commands that wait already, and {more} more are more than {MAX_ATTACHED}; try again when one has ended"
                ),
            };
            return Err(DeviceError::new(ErrorName::QueueFull, text));
        }
        Ok(())
    }

    /// Lets time pass until `now`.
    pub fn advance(&mut self, now: DeviceTime, events: &mut Vec<QueueEvent>) {
        loop {
            match self.active.as_ref().map(|active| self.ends(active)) {
                // An action that was done without word of it, or before it was looked at, ends now.
                Some(Some(ends)) if ends <= now => {
                    self.pass(ends);
                    if self.machine.gives_way() {
                        self.machine.halt(self.now);
                    }
                    self.begin_statement(events);
                }
                Some(_) => break,
                None if self.waiting.is_empty() => break,
                None => self.begin_command(events),
            }
        }
        self.pass(now);
        if self.machine.is_moving() && self.now >= self.publish {
            let late = (self.now - self.publish) / M::PERIOD;
            self.publish = self.publish.saturating_add((late + 1) * M::PERIOD);
            self.publish_state(events);
        }
    }

    fn ends(&self, active: &Active<M::Action>) -> Option<DeviceTime> {
        let done = || self.machine.done_at();
        let given_way = || (self.machine.gives_way() && !self.waiting.is_empty()).then_some(self.now);
        active.ends.or_else(done).or_else(given_way)
    }

    /// When `advance` is to be called next; `None` while there is nothing to do.
    pub fn next_wake(&self) -> Option<DeviceTime> {
        let ends = self.active.as_ref().and_then(|active| self.ends(active));
        let tell = self.machine.is_moving().then_some(self.publish);
        [ends, tell, self.machine.next_wake()].into_iter().flatten().min()
    }

    /// Whether a command is being carried out or waits, so that the device may be elsewhere soon.
    pub fn is_busy(&self) -> bool {
        self.active.is_some() || !self.waiting.is_empty()
    }

    /// Whether a halt would change nothing.
    pub fn is_at_rest(&self) -> bool {
        !self.is_busy() && self.machine.is_at_rest()
    }

    /// Whose commands are being carried out or wait.
    pub fn orders(&self) -> impl Iterator<Item = &Order> {
        let active = self.active.iter().map(|active| &active.command);
        active.chain(&self.waiting).map(|command| &command.order)
    }

    /// Stands, and drops every command with the error `halted`. Not latched: the next command is taken.
    pub fn halt(&mut self, now: DeviceTime, reason: &str, events: &mut Vec<QueueEvent>) {
        self.advance(now, events);
        // What goes on after its command, as a wheel does, is halted too.
        if !self.is_at_rest() {
            let error = DeviceError::new(ErrorName::Halted, format!("{} was halted: {reason}", M::NAME));
            self.end(error.clone(), &error, events);
        }
    }

    /// Ends every command with this error, because the device cannot carry it out.
    pub fn fail(&mut self, now: DeviceTime, error: &DeviceError, events: &mut Vec<QueueEvent>) {
        self.advance(now, events);
        self.end(error.clone(), error, events);
    }

    /// Stands, drops every command with the error `stopped`, and takes none until `unstop`.
    pub fn stop(&mut self, now: DeviceTime, reason: &str, events: &mut Vec<QueueEvent>) {
        self.advance(now, events);
        if !self.stopped {
            self.stopped = true;
            let error = DeviceError::new(ErrorName::Stopped, format!("{} was stopped: {reason}", M::NAME));
            self.end(error.clone(), &error, events);
        }
    }

    /// Takes commands again. Nothing moves by itself: the old commands are gone.
    pub fn unstop(&mut self, now: DeviceTime, events: &mut Vec<QueueEvent>) {
        self.advance(now, events);
        if self.stopped {
            self.stopped = false;
            self.publish_state(events);
        }
    }

    /// The state at the latest time given.
    pub fn state(&self) -> State {
        let active = self.active.as_ref();
        State {
            seq: self.seq,
            position: self.machine.position(),
            report: self.machine.report(),
            moving: self.machine.is_moving(),
            stopped: self.stopped,
            executing: active.map(|active| active.command.progress(active.begun)),
            waiting: self.waiting.len(),
        }
    }

    fn pass(&mut self, until: DeviceTime) {
        self.seq += u64::from(self.machine.is_moving() && until > self.now);
        self.now = until.max(self.now);
        self.machine.advance(self.now);
    }

    /// Takes the next command from the queue, unless it has become too old there.
    fn begin_command(&mut self, events: &mut Vec<QueueEvent>) {
        let Some(command) = self.waiting.pop_front() else {
            return;
        };
        let late = command.use_by.and_then(|use_by| self.now.checked_sub(use_by));
        self.active = Some(Active {
            command,
            begun: 0,
            ends: Some(self.now),
        });
        if let Some(late @ 1..) = late {
            let text = format!("the command waited {} ms longer than it is good for", late / 1000);
            // Those behind it were checked from where it should have led.
            let behind = "the command before it was too old, so this one was not begun";
            self.end(
                DeviceError::new(ErrorName::TooOld, text),
                &DeviceError::new(ErrorName::Halted, behind),
                events,
            );
        }
    }

    /// Begins what comes next of the active command, or finishes it.
    fn begin_statement(&mut self, events: &mut Vec<QueueEvent>) {
        self.seq += 1;
        let Some(active) = &mut self.active else { return };
        let Some(statement) = active.command.script.statements().get(active.begun).cloned() else {
            let progress = active.command.progress(active.begun);
            self.active = None;
            self.publish_state(events);
            events.push(QueueEvent::Finished(progress));
            return;
        };
        active.begun += 1;
        events.push(QueueEvent::Executing(active.command.progress(active.begun)));
        match statement {
            Statement::Do(action) => {
                active.ends = None;
                if let Err(error) = self.machine.begin(&action, self.now) {
                    let behind = "the command before it failed, so this one was not begun";
                    self.end(error, &DeviceError::new(ErrorName::Halted, behind), events);
                    return;
                }
                if self.publish <= self.now {
                    self.publish = self.now.saturating_add(M::PERIOD);
                }
            }
            Statement::Wait(ms) => {
                active.ends = Some(self.now.saturating_add(DeviceTime::from(ms) * 1000));
                if self.told_moving != self.machine.is_moving() {
                    self.publish_state(events);
                }
            }
        }
    }

    /// Ends the active command with one error and those behind it with another.
    fn end(&mut self, error: DeviceError, behind: &DeviceError, events: &mut Vec<QueueEvent>) {
        self.machine.halt(self.now);
        let active = self.active.take();
        let waiting = std::mem::take(&mut self.waiting);
        self.publish_state(events);
        if let Some(active) = active {
            events.push(QueueEvent::Failed(active.command.progress(active.begun), error));
        }
        for command in waiting {
            events.push(QueueEvent::Failed(command.progress(0), behind.clone()));
        }
    }

    fn publish_state(&mut self, events: &mut Vec<QueueEvent>) {
        self.seq += 1;
        let state = self.state();
        self.told_moving = state.moving;
        events.push(QueueEvent::State(state));
    }
}
