//! The arm: a state machine that takes commands and the time, and emits events.

use std::collections::VecDeque;

use crate::blocks::Block;
use crate::controller::{Controller, Instruction, Progress, Simulated};
use crate::error::{ArmError, ErrorName};
use crate::jog::{self, Jog, Velocity};
use crate::motion::ArmTime;
use crate::path;
use crate::pose::Pose;
use crate::script::Statement;
use crate::state::{ArmEvent, ArmState, CommandState, Executing, Gripper, ScriptProgress};
use crate::zones::Closed;

mod command;
mod keep_out;
#[cfg(test)]
mod promises;
mod silence;
#[cfg(test)]
mod tests;

use command::{Active, QueuedScript, Step, target};

/// The initial pose of the hand, and the target of `home`.
pub const HOME: Pose = Pose::new(0.0, 0.0, 300.0, 0.0, 0.0);
/// µs between two states while the arm moves: 20 Hz.
pub const STATE_PERIOD: ArmTime = 50_000;
/// The most commands that wait behind the one being carried out.
pub const MAX_WAITING: usize = 64;
/// µs by which the driver may miss a wake before the controller treats its link as broken.
pub const LINK_TIMEOUT: ArmTime = 1_000_000;

/// The arm.
///
/// A driver calls [`Arm::advance`] whenever [`Arm::next_wake`] is due, and the other methods when
/// somebody asks for what they do. Every method that takes `now` first advances to it; a time before
/// the latest one counts as the latest. `submit`, `halt`, `stop` and `unstop` act; `advance` lets
/// time pass; `state` and `next_wake` only read. Everything that happens is reported in `events`, in order, and
/// every accepted command ends in exactly one `finished` or `error`.
///
/// If a driver falls silent while a command is carried out, the arm goes on with its present statement for [`LINK_TIMEOUT`]
/// after the missed wake and stops there with a `link` error (M53).
#[derive(Debug)]
pub struct Arm {
    now: ArmTime,
    seq: u64,
    controller: Box<dyn Controller>,
    stopped: bool,
    active: Option<Active>,
    waiting: VecDeque<QueuedScript>,
    /// Where the hand will be after the last waiting command; the next one is checked from there.
    planned: Pose,
    /// When the next state is due, while something moves.
    publish: ArmTime,
    /// Whether the last state had something in it that moves by itself.
    unsettled: bool,
    /// Whether the link to the controller stood when that was looked at last.
    linked: bool,
    /// Whether the last state that was told said that the hand moves.
    told_moving: bool,
    /// The zones into which it must not go.
    closed: Closed,
    /// µs by which the driver may miss a wake.
    patience: ArmTime,
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
        Self::with_controller(now, Box::new(Simulated::new(now, blocks)))
    }

    /// An arm that this controller moves.
    #[must_use]
    pub fn with_controller(now: ArmTime, controller: Box<dyn Controller>) -> Self {
        Self {
            now,
            seq: 0,
            planned: controller.reading().posture.pose,
            linked: controller.is_linked(),
            unsettled: controller.is_unsettled(),
            controller,
            stopped: false,
            active: None,
            waiting: VecDeque::new(),
            publish: now,
            told_moving: false,
            closed: Closed::default(),
            patience: LINK_TIMEOUT,
        }
    }

    /// Takes a command: reads its script, checks every leg of it, and queues it. It begins at once
    /// if nothing else is being carried out.
    ///
    /// # Errors
    ///
    /// `stopped`, `link`, `queue-full`, `duplicate-id`, `busy`, `syntax`, `workspace-boundary`, `joint-limit` or
    /// `singularity`. Then the command is not accepted, nothing moves, and there is no event.
    pub fn submit(
        &mut self,
        id: u64,
        script: &str,
        now: ArmTime,
        events: &mut Vec<ArmEvent>,
    ) -> Result<(), ArmError> {
        self.submit_fresh(id, script, None, now, events)
    }

    /// The same for a command that is not to begin after this time: then it ends as `too-old`.
    ///
    /// # Errors
    ///
    /// As [`Arm::submit`].
    pub fn submit_fresh(
        &mut self,
        id: u64,
        script: &str,
        use_by: Option<ArmTime>,
        now: ArmTime,
        events: &mut Vec<ArmEvent>,
    ) -> Result<(), ArmError> {
        self.advance(now, events);
        self.check_free(id)?;
        let command = QueuedScript {
            id,
            script: script.parse()?,
            use_by,
        };
        let statements = command.script.statements();
        if let [Statement::Jog(velocity, ms)] = *statements {
            return self.jog(command, velocity, ms, events);
        }
        if self.active.as_ref().is_some_and(|active| active.jog.is_some()) {
            let text = "the arm is being jogged, so where it will be is not known; send the command when it is at rest";
            return Err(ArmError::new(ErrorName::Busy, text));
        }
        let mut planned = self.planned;
        for (statement, number) in statements.iter().zip(1..) {
            if *statement == Statement::Reset {
                planned = HOME;
            } else if let Some(target) = target(statement, &planned) {
                path::check(&planned, &target)
                    .and_then(|()| self.check_zones(&planned, &target))
                    .map_err(|error| error.at_statement(number))?;
                planned = target;
            }
        }
        self.planned = planned;
        events.push(command.event(CommandState::Waiting, 0, None));
        self.waiting.push_back(command);
        self.seq += 1;
        self.run_until(self.now, events);
        Ok(())
    }

    /// Moves at a velocity from now on, in the place of another one.
    fn jog(
        &mut self,
        command: QueuedScript,
        velocity: Velocity,
        ms: u32,
        events: &mut Vec<ArmEvent>,
    ) -> Result<(), ArmError> {
        let before = self.active.take_if(|active| active.jog.is_some());
        if self.active.is_some() || !self.waiting.is_empty() {
            let text = "the arm carries out a script; jog it when it is at rest";
            return Err(ArmError::new(ErrorName::Busy, text));
        }
        if let Some(before) = &before {
            events.push(before.command.event(CommandState::Finished, before.begun, None));
        }
        events.push(command.event(CommandState::Waiting, 0, None));
        events.push(command.event(CommandState::Executing, 1, None));
        let until = self.now.saturating_add(ArmTime::from(ms) * 1000);
        let before = before.and_then(|before| before.jog);
        self.active = Some(Active {
            command,
            begun: 1,
            legs: VecDeque::new(),
            step: Step::None,
            ends: None,
            leg: None,
            jog: Some(Jog::begin(velocity, until, before.as_ref())),
        });
        self.seq += 1;
        self.run_until(self.now, events);
        Ok(())
    }

    /// Lets time pass until `now`.
    pub fn advance(&mut self, now: ArmTime, events: &mut Vec<ArmEvent>) {
        let now = now.max(self.now);
        self.make_up_for_silence(now, events);
        self.run_until(now, events);
    }

    /// When [`Arm::advance`] is to be called next; `None` while there is nothing to do.
    #[must_use]
    pub fn next_wake(&self) -> Option<ArmTime> {
        let step = match self.step() {
            Step::Waits(ends) => Some(ends),
            Step::None | Step::Moves { .. } => None,
        };
        let tell = self.is_moving().then_some(self.publish);
        [step, tell, self.controller.next_wake()]
            .into_iter()
            .flatten()
            .min()
    }

    fn step(&self) -> Step {
        self.active.as_ref().map_or(Step::None, |active| active.step)
    }

    fn has_begun_a_motion(&self) -> bool {
        matches!(self.step(), Step::Moves { .. })
    }

    /// Whether hand, jaws or anything else moves.
    fn is_moving(&self) -> bool {
        self.has_begun_a_motion() || self.controller.is_unsettled()
    }

    /// Whether it is known that the hand stands, and nothing is to begin.
    #[must_use]
    pub fn stands(&self) -> bool {
        !self.is_busy() && self.controller.is_linked()
    }

    /// Whether a command is being carried out or waits, so that the arm may be elsewhere soon.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        self.active.is_some() || !self.waiting.is_empty()
    }

    /// Stops the hand and the jaws where they are and drops every command with the error `halted`.
    /// Not latched: the next command is taken. A block in the jaws stays there.
    pub fn halt(&mut self, now: ArmTime, reason: &str, events: &mut Vec<ArmEvent>) {
        self.advance(now, events);
        self.controller.halt(self.now); // It may not do what is known of it.
        if self.active.is_some() {
            let error = ArmError::new(ErrorName::Halted, format!("the arm was halted: {reason}"));
            self.end(error.clone(), &error, events);
        }
    }

    /// Drops the commands that wait, and lets the one that is being carried out come to the end of its present statement only.
    pub fn end_statement(&mut self, now: ArmTime, reason: &str, events: &mut Vec<ArmEvent>) {
        self.advance(now, events);
        let waiting = std::mem::take(&mut self.waiting);
        let error = ArmError::new(ErrorName::Halted, format!("the arm did not begin it: {reason}"));
        for command in waiting {
            events.push(command.event(CommandState::Error, 0, Some(error.clone())));
        }
        let Some(active) = &mut self.active else { return };
        active.ends = Some(reason.to_owned());
        if let Some(jog) = &mut active.jog {
            jog.end(now);
        }
        // A wait is no motion that has to come to an end.
        if let Step::Waits(ends) = &mut active.step {
            *ends = self.now;
            self.run_until(self.now, events);
        }
    }

    /// Halts the arm, every command ending with the error `stopped`, and takes none until [`Arm::unstop`].
    pub fn stop(&mut self, now: ArmTime, reason: &str, events: &mut Vec<ArmEvent>) {
        self.advance(now, events);
        self.controller.halt(self.now);
        if !self.stopped {
            self.stopped = true;
            let error = ArmError::new(ErrorName::Stopped, format!("the arm was stopped: {reason}"));
            self.end(error.clone(), &error, events);
        }
    }

    /// Lets the arm take commands again. Nothing moves by itself: the old commands are gone.
    pub fn unstop(&mut self, now: ArmTime, events: &mut Vec<ArmEvent>) {
        self.advance(now, events);
        if self.stopped {
            self.stopped = false;
            self.publish_state(events);
        }
    }

    /// The state at the latest time given.
    #[must_use]
    pub fn state(&self) -> ArmState {
        let reading = self.controller.reading();
        let linked = self.controller.is_linked();
        ArmState {
            seq: self.seq,
            pose: reading.posture.pose,
            gripper: Gripper {
                grip: reading.grip,
                opening: reading.posture.opening,
            },
            holding: reading.holding,
            blocks: reading.blocks,
            // What is not known is not said to stand.
            moving: self.has_begun_a_motion() || !linked,
            linked,
            stopped: self.stopped,
            executing: self.active.as_ref().map(|active| {
                let ScriptProgress { statement, of } = active.command.progress(active.begun);
                Executing {
                    id: active.command.id,
                    statement,
                    of,
                }
            }),
            waiting: self.waiting.len(),
            fence: None,
        }
    }

    /// Whether the controller can be reached.
    ///
    /// # Errors
    ///
    /// `link`, which may be tried again.
    pub(crate) fn check_link(&self) -> Result<(), ArmError> {
        if self.controller.is_linked() {
            return Ok(());
        }
        let text = "the link to the controller is down; it is tried again all the time, and a state tells when it is back";
        Err(ArmError::new(ErrorName::Link, text).with_retry())
    }

    fn check_free(&self, id: u64) -> Result<(), ArmError> {
        if self.stopped {
            let text = "the arm is stopped and takes no command until the stop is released";
            return Err(ArmError::new(ErrorName::Stopped, text));
        }
        self.check_link()?;
        let active = self.active.as_ref().map(|active| &active.command);
        if active
            .into_iter()
            .chain(&self.waiting)
            .any(|command| command.id == id)
        {
            let text = format!("command {id} is still waiting or executing; choose another id");
            return Err(ArmError::new(ErrorName::DuplicateId, text));
        }
        if self.waiting.len() >= MAX_WAITING {
            let text = format!("{MAX_WAITING} commands are waiting already; try again when one has begun");
            return Err(ArmError::new(ErrorName::QueueFull, text));
        }
        Ok(())
    }

    /// Ends and begins all steps that are due until then, and moves to that time.
    fn run_until(&mut self, until: ArmTime, events: &mut Vec<ArmEvent>) {
        while self.active.is_some() || !self.waiting.is_empty() {
            match self.step() {
                Step::None => self.begin(events),
                Step::Waits(ends) if ends > until => break,
                Step::Waits(ends) => {
                    self.let_pass(ends);
                    self.end_step();
                }
                Step::Moves { lasts_until } => match self.controller.advance(until) {
                    Progress::Busy => break,
                    Progress::Done(at) => {
                        self.now = at.max(self.now);
                        self.end_step();
                        // A controller may be there early; a jog that did not wait would make no time pass.
                        if let (Some(active), true) = (&mut self.active, lasts_until > self.now) {
                            active.step = Step::Waits(lasts_until);
                        }
                    }
                    Progress::Failed(at, error) => {
                        self.now = at.max(self.now);
                        self.fail_statement(error, events);
                    }
                },
            }
        }
        self.let_pass(until);
        self.keep_telling(events);
    }

    /// Moves to this time, in which nothing of a script begins or ends.
    fn let_pass(&mut self, until: ArmTime) {
        let was_moving = self.is_moving();
        self.controller.advance(until);
        self.seq += u64::from(was_moving && until > self.now);
        self.now = until.max(self.now);
    }

    /// Tells the state when that is due, and when what moved by itself has come to rest, or the link to the controller has changed.
    fn keep_telling(&mut self, events: &mut Vec<ArmEvent>) {
        let linked = self.controller.is_linked();
        let (unsettled, was_unsettled) = (self.controller.is_unsettled(), self.unsettled);
        if linked != self.linked {
            self.linked = linked;
            // Where the hand is was not known; what waits leads elsewhere.
            if !self.is_busy() {
                self.planned = self.controller.reading().posture.pose;
            }
            self.publish_state(events);
        } else if self.is_moving() && self.now >= self.publish {
            let late = (self.now - self.publish) / STATE_PERIOD;
            self.publish = self.publish.saturating_add((late + 1) * STATE_PERIOD);
            self.publish_state(events);
        } else if was_unsettled && !unsettled {
            self.publish_state(events);
        } else if unsettled && !was_unsettled {
            self.expect_states();
        }
        self.unsettled = unsettled;
    }

    /// Something begins to move: states follow from now on.
    fn expect_states(&mut self) {
        if self.publish < self.now {
            self.publish = self.now.saturating_add(STATE_PERIOD);
        }
    }

    /// Begins what comes next: a leg, else a statement, else a command.
    fn begin(&mut self, events: &mut Vec<ArmEvent>) {
        self.seq += 1;
        let Some(active) = &mut self.active else {
            return self.begin_command(events);
        };
        if let Some(pose) = active.legs.pop_front() {
            return self.instruct(&Instruction::Move(pose), events);
        }
        if let Some(jog) = &mut active.jog {
            match jog.next(&self.controller.reading().posture.pose, self.now) {
                Some(pose) => return self.instruct(&Instruction::Glide(pose, jog::TICK), events),
                None => active.jog = None,
            }
        }
        let Some(statement) = active.command.script.statements().get(active.begun).copied() else {
            return self.finish(events);
        };
        if let Some(reason) = &active.ends {
            let text = format!(
                "the arm ended the script after statement {}: {reason}",
                active.begun
            );
            let error = ArmError::new(ErrorName::Halted, text);
            return self.end(error.clone(), &error, events);
        }
        active.begun += 1;
        events.push(active.command.event(CommandState::Executing, active.begun, None));
        match statement {
            Statement::Wait(ms) => {
                active.step = Step::Waits(self.now.saturating_add(ArmTime::from(ms) * 1000));
                // Who predicts would have the hand go on where it waits.
                if self.told_moving {
                    self.publish_state(events);
                }
            }
            Statement::Jog(velocity, ms) => {
                let until = self.now.saturating_add(ArmTime::from(ms) * 1000);
                active.jog = Some(Jog::begin(velocity, until, None));
            }
            Statement::Grip(grip) => self.instruct(&Instruction::Grip(grip), events),
            Statement::Reset => match self.reset() {
                Ok(()) => self.publish_state(events),
                Err(error) => self.fail_statement(error, events),
            },
            Statement::Move(_) | Statement::By(_) | Statement::Home => {
                let from = self.controller.reading().posture.pose;
                let target = target(&statement, &from).expect("moves have a target");
                active.legs = path::legs(&from, &target).into();
            }
        }
    }

    /// Takes the next command from the queue, unless it has become too old there.
    fn begin_command(&mut self, events: &mut Vec<ArmEvent>) {
        let Some(command) = self.waiting.pop_front() else {
            return;
        };
        let late = command.use_by.and_then(|use_by| self.now.checked_sub(use_by));
        self.active = Some(Active {
            command,
            begun: 0,
            legs: VecDeque::new(),
            step: Step::None,
            ends: None,
            leg: None,
            jog: None,
        });
        if let Some(late @ 1..) = late {
            let text = format!("the command waited {} ms longer than it is good for", late / 1000);
            self.fail(ArmError::new(ErrorName::TooOld, text), events);
        }
    }

    /// Gives the controller something to do, unless it would be done in a zone that has been closed.
    fn instruct(&mut self, instruction: &Instruction, events: &mut Vec<ArmEvent>) {
        let at = self.controller.reading().posture.pose;
        let leg = match instruction {
            Instruction::Move(to) | Instruction::Glide(to, _) => *to,
            Instruction::Grip(_) => at,
        };
        let allowed = self.closed.check_leg(&at, &leg);
        if let Some(active) = &mut self.active {
            active.leg = Some(leg);
        }
        match allowed.and_then(|()| self.controller.begin(instruction, self.now)) {
            Ok(()) => {
                let lasts = match instruction {
                    Instruction::Glide(_, time) => *time,
                    Instruction::Move(_) | Instruction::Grip(_) => 0,
                };
                if let Some(active) = &mut self.active {
                    active.step = Step::Moves {
                        lasts_until: self.now.saturating_add(lasts),
                    };
                }
                self.expect_states();
            }
            Err(error) => self.fail_statement(error, events),
        }
    }

    fn end_step(&mut self) {
        self.seq += 1;
        if let Some(active) = &mut self.active {
            active.step = Step::None;
        }
    }

    /// Ends the active command with an error of its present statement.
    fn fail_statement(&mut self, error: ArmError, events: &mut Vec<ArmEvent>) {
        let active = self.active.as_ref();
        let number = active.map_or(0, |active| active.command.progress(active.begun).statement);
        self.fail(error.at_statement(number), events);
    }

    fn finish(&mut self, events: &mut Vec<ArmEvent>) {
        if let Some(active) = self.active.take() {
            if let [Statement::Jog(..)] = active.command.script.statements() {
                self.planned = self.controller.reading().posture.pose;
            }
            self.publish_state(events);
            events.push(active.command.event(CommandState::Finished, active.begun, None));
        }
    }

    /// Ends the active command with this error. Those behind it were checked from where it should
    /// have led, so they are dropped as well.
    fn fail(&mut self, error: ArmError, events: &mut Vec<ArmEvent>) {
        let failed = self.active.as_ref().map_or(0, |active| active.command.id);
        let text = format!("command {failed} failed, so this one was not begun");
        self.end(error, &ArmError::new(ErrorName::Halted, text), events);
    }

    /// Ends the active command with one error and drops those behind it with another.
    fn end(&mut self, active_error: ArmError, waiting_error: &ArmError, events: &mut Vec<ArmEvent>) {
        self.controller.halt(self.now);
        let active = self.active.take();
        let waiting = std::mem::take(&mut self.waiting);
        self.planned = self.controller.reading().posture.pose;
        self.publish_state(events);
        if let Some(active) = active {
            events.push(
                active
                    .command
                    .event(CommandState::Error, active.begun, Some(active_error)),
            );
        }
        for command in waiting {
            events.push(command.event(CommandState::Error, 0, Some(waiting_error.clone())));
        }
    }

    fn publish_state(&mut self, events: &mut Vec<ArmEvent>) {
        self.seq += 1;
        let state = self.state();
        self.told_moving = state.moving;
        events.push(ArmEvent::State(state));
    }
}
