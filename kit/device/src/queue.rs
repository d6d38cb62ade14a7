//! The queue: a state machine that takes commands and the time, and emits events.

use std::collections::VecDeque;
use std::fmt::Debug;

use crate::command::{Command, Order, QueueEvent, State};
use crate::rest::Rest;
use crate::{AtRest, DeviceError, DeviceTime, ErrorName, MAX_ATTACHED, Machine, REST, Script, Statement};

mod hand_over;

/// The most commands that wait behind the one being carried out.
pub const MAX_WAITING: usize = 64;

/// A device that carries out one command after the other.
///
/// A driver calls `advance` whenever `next_wake` is due, and the other methods when what they do is asked for.
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
    /// Whether it was changing by itself when that was looked at last.
    was_changing: bool,
    /// What the last state that was told said of its rest, and whether it is reached.
    told_rest: Option<AtRest>,
    told_reached: bool,
    rest: Rest,
    /// It was to stand while it moved, and does not rest yet.
    halting: bool,
    /// When it was told to stand last, or had something under way after that; none if an action has begun since.
    stands_since: Option<DeviceTime>,
    /// It has a new owner, whose first motion waits until it rests.
    changes_hands: bool,
    /// Until when the new owner's command waits, if there is one.
    waits_until: Option<DeviceTime>,
    /// For how long the program has stood still, while that is made up for.
    silence: Option<DeviceTime>,
    /// How many times as fast as its users' time its own passes.
    pace: DeviceTime,
}

/// µs after which what was heard of a device that rests does not say that it still does.
const OLD: DeviceTime = 3_000_000;

/// The command being carried out.
#[derive(Debug)]
struct Active<A> {
    command: Command<A>,
    /// How many statements have begun.
    begun: usize,
    /// When the present statement ends, if it is a `wait`, or none has begun; else when its action is done.
    ends: Option<DeviceTime>,
    /// Why no statement begins after the present one; none if the script goes on.
    last: Option<String>,
}

impl<M: Machine> CommandQueue<M> {
    /// A device with nothing to do.
    pub fn new(machine: M) -> Self {
        Self {
            told_reached: machine.is_reached(),
            was_changing: machine.is_changing(),
            machine,
            now: 0,
            seq: 0,
            stopped: false,
            active: None,
            waiting: VecDeque::new(),
            publish: 0,
            told_moving: false,
            told_rest: None,
            rest: Rest::new(M::TOLERANCE, M::STOPPING_TIME),
            halting: false,
            // It has to stand before anything has begun.
            stands_since: Some(0),
            changes_hands: false,
            waits_until: None,
            silence: None,
            pace: 1,
        }
    }

    /// This queue, for a device whose time passes so many times as fast as that of its users and of its program.
    #[must_use]
    pub fn at_pace(mut self, pace: u32) -> Self {
        self.pace = pace.max(1).into();
        self
    }

    /// How many times as fast as its users' time its own passes.
    pub(crate) fn pace(&self) -> DeviceTime {
        self.pace
    }

    /// The latest time that was given.
    pub fn now(&self) -> DeviceTime {
        self.now
    }

    /// The device itself.
    pub fn machine(&self) -> &M {
        &self.machine
    }

    /// The device itself, without its commands.
    pub(crate) fn into_machine(self) -> M {
        self.machine
    }

    /// Lets something be done to the device that no command does, such as that news of it have come; a state follows if it moves now, or
    /// stands.
    pub fn note(&mut self, now: DeviceTime, what: impl FnOnce(&mut M), events: &mut Vec<QueueEvent>) {
        self.advance(now, events);
        what(&mut self.machine);
        self.seq += 1;
        self.advance(self.now, events);
        if self.told_moving != self.is_moving() {
            self.publish_state(events);
        }
    }

    /// Whether it moves, or is to stand and does not rest yet. Where it is not reached nobody knows.
    pub(crate) fn is_moving(&self) -> bool {
        self.machine.is_moving() || self.halting || !self.machine.is_reached()
    }

    /// Whether its position may change meanwhile: what is not reached tells nothing new.
    fn is_lively(&self) -> bool {
        let moves = self.machine.is_moving() || self.machine.is_changing();
        self.machine.is_reached() && (moves || self.halting)
    }

    /// That it rests is found out anew where what is known of it is old: it may have moved since.
    fn doubt_old_news(&mut self) {
        let known_at = self.machine.known_at().unwrap_or(self.now);
        if self.now.saturating_sub(known_at) > OLD {
            self.rest.disturb(self.now);
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
    /// `stopped`, `queue-full`, `busy`, `changing-hands`, or why the machine cannot carry it out. Then nothing moves, and there is no event
    /// but of the time that passed.
    pub fn submit(
        &mut self,
        command: Command<M::Action>,
        now: DeviceTime,
        events: &mut Vec<QueueEvent>,
    ) -> Result<(), DeviceError> {
        self.advance(now, events);
        self.check_free()?;
        self.check_attached(&command.script)?;
        self.check_turn(&command.script)?;
        self.machine.plan(&command.script)?;
        self.displace(&command.script, events);
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
    ///
    /// Where that is more than [`Machine::PATIENCE`] later than [`CommandQueue::next_wake`], the program has stood still: no statement
    /// begins for which it would have had to be there, and all commands end.
    pub fn advance(&mut self, now: DeviceTime, events: &mut Vec<QueueEvent>) {
        let silence = self.next_wake().map_or(0, |due| now.saturating_sub(due));
        let patience = M::PATIENCE.saturating_mul(self.pace);
        if silence > patience && self.is_busy() {
            self.silence = Some(silence);
            // For so long the mechanism has gone on by itself.
            self.carry_on(now - silence + patience, events);
            if self.is_busy() {
                self.end_silent(silence, events);
            }
            self.silence = None;
        }
        if silence > patience {
            // What was measured meanwhile is heard only now, and would pass for new.
            self.rest.disturb(now);
        }
        self.carry_on(now, events);
    }

    /// Ends all commands, as their program has stood still.
    fn end_silent(&mut self, silence: DeviceTime, events: &mut Vec<QueueEvent>) {
        let text = format!(
            "{} was halted: its program stood still for {} ms",
            M::NAME,
            silence / 1000
        );
        let error = DeviceError::new(ErrorName::Halted, text);
        self.end(error.clone(), &error, events);
    }

    fn carry_on(&mut self, now: DeviceTime, events: &mut Vec<QueueEvent>) {
        loop {
            match self.active.is_some().then(|| self.pursue(now)) {
                // An action that was done without word of it, or before it was looked at, ends now.
                Some(Some(ends)) => {
                    self.pass(ends);
                    if self.heed_failure(events) {
                        continue;
                    }
                    if self.machine.gives_way() {
                        self.machine.give_way(self.now);
                        self.stands_since = Some(self.now);
                    }
                    self.begin_statement(events);
                }
                Some(None) => break,
                None if self.waiting.is_empty() || self.silence.is_some() => break,
                None if self.waits_for_rest() => {
                    self.pass(now);
                    if self.waits_for_rest() {
                        self.wait_for_rest(events);
                        break;
                    }
                    // That it rests is told before the new owner moves it.
                    if self.told_rest.is_none() {
                        self.publish_state(events);
                    }
                }
                None => self.begin_command(events),
            }
        }
        self.pass(now);
        self.heed_failure(events);
        self.tell_rest(events);
        let was_changing = std::mem::replace(&mut self.was_changing, self.machine.is_changing());
        if self.is_lively() && self.now >= self.publish {
            let late = (self.now - self.publish) / M::PERIOD;
            self.publish = self.publish.saturating_add((late + 1) * M::PERIOD);
            self.publish_state(events);
        } else if was_changing && !self.was_changing {
            self.publish_state(events);
        }
    }

    /// When the present statement ended, if it did until then.
    fn pursue(&mut self, until: DeviceTime) -> Option<DeviceTime> {
        let active = self.active.as_ref()?;
        if let Some(ends) = active.ends {
            return (ends <= until).then_some(ends);
        }
        let done = self.machine.pursue(until);
        done.or_else(|| self.gives_way().then_some(self.now.min(until)))
    }

    /// Whether what is being carried out ends as another command waits.
    fn gives_way(&self) -> bool {
        self.machine.gives_way() && !self.waiting.is_empty()
    }

    /// Ends all commands where the machine has failed.
    fn heed_failure(&mut self, events: &mut Vec<QueueEvent>) -> bool {
        let failure = self.machine.take_failure().filter(|_| self.is_busy());
        let failed = failure.is_some();
        if let Some(error) = failure {
            self.fail_statement(error, events);
        }
        failed
    }

    /// Ends the active command with an error of its present statement. Those behind it were checked from where it should have led.
    fn fail_statement(&mut self, error: DeviceError, events: &mut Vec<QueueEvent>) {
        let begun = self.active.as_ref().map_or(0, |active| active.begun);
        let error = match u32::try_from(begun) {
            Ok(statement @ 1..) => error.at_statement(statement),
            _ => error,
        };
        let behind = "the command before it failed, so this one was not begun";
        self.end(error, &DeviceError::new(ErrorName::Halted, behind), events);
    }

    /// Tells when it has come to rest, and when it rests no more though nothing drives it.
    fn tell_rest(&mut self, events: &mut Vec<QueueEvent>) {
        if self.told_reached != self.machine.is_reached() {
            self.publish_state(events);
        }
        let known = self.rest.known();
        let comes = known.is_some() && (known != self.told_rest || self.told_moving);
        // Such as by a push.
        let goes = known.is_none() && self.told_rest.is_some();
        if (comes || goes) && !self.is_busy() {
            self.publish_state(events);
        }
    }

    fn ends(&self, active: &Active<M::Action>) -> Option<DeviceTime> {
        let done = || self.machine.done_at();
        let given_way = || self.gives_way().then_some(self.now);
        active.ends.or_else(done).or_else(given_way)
    }

    /// When `advance` is to be called next; `None` while there is nothing to do.
    pub fn next_wake(&self) -> Option<DeviceTime> {
        let ends = self.active.as_ref().and_then(|active| self.ends(active));
        let tell = self.is_lively().then_some(self.publish);
        // While it is carrying something out there is no rest to be looked for, and none of what is not reached.
        let stands = self.active.is_none() && !self.machine.is_moving() && self.machine.is_reached();
        let look = stands.then(|| self.rest.next_look(self.now)).flatten();
        let waits = self
            .waits_until
            .filter(|_| self.active.is_none() && self.waits_for_rest());
        [ends, tell, look, waits, self.machine.next_wake()]
            .into_iter()
            .flatten()
            .min()
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
        if self.is_at_rest() {
            self.doubt_old_news();
            self.halt_machine();
        } else {
            let error = DeviceError::new(ErrorName::Halted, format!("{} was halted: {reason}", M::NAME));
            self.end(error.clone(), &error, events);
        }
    }

    /// Ends every command with this error, because the device cannot carry it out.
    pub fn fail(&mut self, now: DeviceTime, error: &DeviceError, events: &mut Vec<QueueEvent>) {
        self.advance(now, events);
        self.end(error.clone(), error, events);
    }

    /// Stands, drops every command with this error, `stopped` or `estop`, and takes none until `unstop`.
    pub fn stop(&mut self, now: DeviceTime, reason: &str, name: ErrorName, events: &mut Vec<QueueEvent>) {
        self.advance(now, events);
        self.doubt_old_news();
        if !self.stopped {
            self.stopped = true;
            let error = DeviceError::new(name, format!("{} was stopped: {reason}", M::NAME));
            self.end(error.clone(), &error, events);
        } else {
            self.halt_machine();
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
            moving: self.is_moving(),
            rest: self.rest.known(),
            reached: self.machine.is_reached(),
            stopped: self.stopped,
            executing: active.map(|active| active.command.progress(active.begun)),
            waiting: self.waiting.len(),
        }
    }

    fn pass(&mut self, until: DeviceTime) {
        self.seq += u64::from(self.is_lively() && until > self.now);
        self.now = until.max(self.now);
        self.machine.advance(self.now);
        self.watch_rest();
        self.insist();
    }

    /// Has it stand.
    fn halt_machine(&mut self) {
        self.machine.halt(self.now);
        self.stands_since = Some(self.now);
    }

    /// Has it stand again where it was to, has nothing under way and does not rest by when it should: something moves it that no command
    /// began.
    fn insist(&mut self) {
        let Some(since) = self.stands_since else { return };
        // Commands that wait were planned from where it stands; its own motion ends by itself.
        if self.is_busy() || self.machine.is_moving() {
            self.stands_since = Some(self.now);
            return;
        }
        let is_due = since.saturating_add(M::STOPPING_TIME + REST) <= self.now;
        if is_due && self.rest.known().is_none() && self.machine.is_reached() {
            self.halt_machine();
        }
    }

    /// Looks whether it rests: not while it is carrying something out, and not where nothing is heard of it.
    fn watch_rest(&mut self) {
        let acts = self.active.as_ref().is_some_and(|active| active.begun > 0);
        if acts || self.machine.is_moving() || !self.machine.is_reached() {
            return self.rest.disturb(self.now);
        }
        let measured_at = self.machine.known_at().unwrap_or(self.now);
        self.rest.observe(self.machine.measured(measured_at), self.now);
        if self.rest.known().is_some() {
            (self.halting, self.changes_hands, self.waits_until) = (false, false, None);
        }
    }

    /// Takes the next command from the queue, unless it has become too old there.
    fn begin_command(&mut self, events: &mut Vec<QueueEvent>) {
        // That it stands is told before it moves again.
        if self.told_moving && !self.is_moving() {
            self.publish_state(events);
        }
        let Some(command) = self.waiting.pop_front() else {
            return;
        };
        let late = command.use_by.and_then(|use_by| self.now.checked_sub(use_by));
        self.waits_until = None;
        self.active = Some(Active {
            command,
            begun: 0,
            ends: Some(self.now),
            last: None,
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
            // Who predicts goes on where it does.
            let goes_on = self.machine.is_moving() && !self.waiting.is_empty();
            if !goes_on {
                self.publish_state(events);
            }
            events.push(QueueEvent::Finished(progress));
            return;
        };
        if let Some(silence) = self.silence {
            return self.end_silent(silence, events);
        }
        if let Some(reason) = &active.last {
            let text = format!(
                "{} ended the script after statement {}: {reason}",
                M::NAME,
                active.begun
            );
            let error = DeviceError::new(ErrorName::Halted, text);
            return self.end(error.clone(), &error, events);
        }
        active.begun += 1;
        events.push(QueueEvent::Executing(active.command.progress(active.begun)));
        match statement {
            Statement::Do(action) => {
                active.ends = None;
                self.stands_since = None;
                if let Err(error) = self.machine.begin(&action, self.now) {
                    return self.fail_statement(error, events);
                }
                // From here on it moves as this command says, not as one that was to stand.
                self.halting &= !self.machine.is_moving();
                if self.publish <= self.now {
                    self.publish = self.now.saturating_add(M::PERIOD);
                }
            }
            Statement::Wait(ms) => {
                active.ends = Some(self.now.saturating_add(DeviceTime::from(ms) * 1000));
                if self.told_moving != self.is_moving() {
                    self.publish_state(events);
                }
            }
        }
    }

    /// Ends the active command with one error and those behind it with another.
    fn end(&mut self, error: DeviceError, behind: &DeviceError, events: &mut Vec<QueueEvent>) {
        let began = self.active.as_ref().is_some_and(|active| active.begun > 0);
        let was_moving = began || !self.machine.is_at_rest();
        self.halt_machine();
        let active = self.active.take();
        let waiting = std::mem::take(&mut self.waiting);
        self.waits_until = None;
        if was_moving {
            self.halting = true;
            self.rest.disturb(self.now);
            self.publish = self.publish.max(self.now.saturating_add(M::PERIOD));
        }
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
        (self.told_moving, self.told_rest, self.told_reached) = (state.moving, state.rest, state.reached);
        events.push(QueueEvent::State(state));
    }
}
