//! What becomes of commands when the device gets another owner.

use mom_client::HUB;

use super::CommandQueue;
use crate::command::{Command, QueueEvent};
use crate::{DeviceError, DeviceTime, ErrorName, Machine, Script};

/// µs that a new owner waits beyond twice the stopping time until the device rests.
const INTERLOCK: DeviceTime = 1_000_000;

impl<M: Machine> CommandQueue<M> {
    /// It has a new owner: no motion of it begins before the device rests.
    pub fn change_hands(&mut self, now: DeviceTime, events: &mut Vec<QueueEvent>) {
        self.advance(now, events);
        self.doubt_old_news();
        self.changes_hands = self.rest.known().is_none();
        self.waits_until = None;
    }

    /// Whether the first command of a new owner has to wait. The hub's own is the safe state, for which the device was halted.
    pub(super) fn waits_for_rest(&self) -> bool {
        let is_hubs = |command: &Command<M::Action>| &*command.order.peer == HUB;
        self.changes_hands && self.waiting.front().is_some_and(|command| !is_hubs(command))
    }

    /// Lets a new owner's commands wait for rest, and refuses them where it does not come.
    pub(super) fn wait_for_rest(&mut self, events: &mut Vec<QueueEvent>) {
        let longest = 2 * M::STOPPING_TIME + INTERLOCK;
        let until = *self.waits_until.get_or_insert(self.now.saturating_add(longest));
        if self.now < until {
            return;
        }
        self.waits_until = None;
        let why = match self.machine.is_reached() {
            true => "it still moves as its old owner had it move",
            false => "it cannot be reached, so it is unknown whether it is at rest",
        };
        let text = format!(
            "{} is changing hands, and {why} {} ms after the command",
            M::NAME,
            longest / 1000
        );
        let error = DeviceError::new(ErrorName::ChangingHands, text);
        for command in std::mem::take(&mut self.waiting) {
            events.push(QueueEvent::Failed(command.progress(0), error.clone()));
        }
        // What was planned from is where those would have led.
        self.halt_machine();
        self.publish_state(events);
    }

    /// Whether a script may be queued behind what is being carried out: not where its statement waits for nothing, and not where an old
    /// owner's statement comes to its end, as where that leads is not where its script did.
    pub(super) fn check_turn(&self, script: &Script<M::Action>) -> Result<(), DeviceError> {
        if self.active.as_ref().is_some_and(|active| active.last.is_some()) {
            let text = format!(
                "{} is changing hands and still moves; send the command again when a state tells that it stands",
                M::NAME
            );
            return Err(DeviceError::new(ErrorName::ChangingHands, text).with_retry());
        }
        let gives_way = match self.active {
            Some(_) => self.machine.gives_way() && self.waiting.is_empty(),
            // Until the device rests for its new owner the newest of them waits, though.
            None => self.waiting.iter().all(|other| never_waits::<M>(&other.script)),
        };
        match never_waits::<M>(script) && self.is_busy() && !gives_way {
            true => {
                let text = format!(
                    "{} carries out a script, behind which this does not wait; send it again when the device is at rest",
                    M::NAME
                );
                Err(DeviceError::new(ErrorName::Busy, text))
            }
            false => Ok(()),
        }
    }

    /// One that never waits takes the place of those like it that wait for rest.
    pub(super) fn displace(&mut self, script: &Script<M::Action>, events: &mut Vec<QueueEvent>) {
        if self.active.is_none() && never_waits::<M>(script) {
            let displaced = self.waiting.drain(..);
            events.extend(displaced.map(|other| QueueEvent::Finished(other.progress(0))));
        }
    }

    /// Drops the commands that wait, and lets the one that is being carried out come to the end of its present statement only. What would
    /// go on until another command comes is halted, and no `wait` is waited for.
    pub fn end_statement(&mut self, now: DeviceTime, reason: &str, events: &mut Vec<QueueEvent>) {
        self.advance(now, events);
        if self.machine.gives_way() {
            return self.halt(now, reason, events);
        }
        let text = format!("{} did not begin it: {reason}", M::NAME);
        let error = DeviceError::new(ErrorName::Halted, text);
        for command in std::mem::take(&mut self.waiting) {
            events.push(QueueEvent::Failed(command.progress(0), error.clone()));
        }
        if let Some(active) = &mut self.active {
            active.last = Some(reason.to_owned());
            active.ends = active.ends.map(|_| self.now);
            self.advance(self.now, events);
        }
    }
}

/// Whether a script waits behind no other.
fn never_waits<M: Machine>(script: &Script<M::Action>) -> bool {
    script.actions().any(|(action, _)| M::never_waits(action))
}
