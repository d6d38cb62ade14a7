//! The arm: a state machine that takes commands and the time, and emits events.

use std::collections::VecDeque;

use crate::blocks::{Block, Blocks};
use crate::contact;
use crate::error::{ArmError, ErrorName};
use crate::jog::{self, Jog, Velocity};
use crate::motion::{ArmTime, Leg, MAX_OPENING, Posture};
use crate::path;
use crate::pose::Pose;
use crate::script::{Grip, Script, Statement};
use crate::state::{ArmEvent, ArmState, CommandState, Executing, Gripper, ScriptProgress};

#[cfg(test)]
mod promises;
#[cfg(test)]
mod tests;

/// The initial pose of the hand, and the target of `home`.
pub const HOME: Pose = Pose::new(0.0, 0.0, 300.0, 0.0, 0.0);
/// How an arm starts: at home, with open jaws.
const AT_REST: Posture = Posture {
    pose: HOME,
    opening: MAX_OPENING,
};
/// µs between two states while the arm moves: 20 Hz.
pub const STATE_PERIOD: ArmTime = 50_000;
/// The most commands that wait behind the one being carried out.
pub const MAX_WAITING: usize = 64;
/// µs by which the driver may miss a wake before the controller treats its link as broken.
pub const LINK_TIMEOUT: ArmTime = 3_000_000;

/// The arm.
///
/// A driver calls [`Arm::advance`] whenever [`Arm::next_wake`] is due, and the other methods when
/// somebody asks for what they do. Every method that takes `now` first advances to it; a time before
/// the latest one counts as the latest. `submit`, `halt`, `stop` and `unstop` act; `advance` lets
/// time pass; `state` and `next_wake` only read. Everything that happens is reported in `events`, in order, and
/// every accepted command ends in exactly one `finished` or `error`.
///
/// If a driver falls silent while a command is carried out, the arm goes on for [`LINK_TIMEOUT`]
/// after the missed wake and stops there with a `link` error (M53).
#[derive(Debug, Clone)]
pub struct Arm {
    now: ArmTime,
    seq: u64,
    posture: Posture,
    grip: Grip,
    blocks: Blocks,
    /// The blocks as they were at the start.
    first_blocks: Blocks,
    stopped: bool,
    active: Option<Active>,
    waiting: VecDeque<QueuedScript>,
    /// Where the hand will be after the last waiting command; the next one is checked from there.
    planned: Pose,
    /// When the next state is due, while the arm moves.
    publish: ArmTime,
}

#[derive(Debug, Clone)]
struct QueuedScript {
    id: u64,
    script: Script,
}

/// The command being carried out.
#[derive(Debug, Clone)]
struct Active {
    command: QueuedScript,
    /// How many statements have begun.
    begun: usize,
    /// The ends of the legs of this statement that have not begun.
    legs: VecDeque<Pose>,
    step: Option<MotionStep>,
    /// Why no statement begins after the present one; none if the script goes on.
    ends: Option<String>,
    /// The present statement, if that is a velocity.
    jog: Option<Jog>,
}

/// One motion or one wait.
#[derive(Debug, Clone)]
struct MotionStep {
    /// None for a wait.
    leg: Option<Leg>,
    begins: ArmTime,
    ends: ArmTime,
    then: Then,
}

/// The effect of a step at its end.
#[derive(Debug, Clone)]
enum Then {
    Next,
    Grasp(usize),
    Fail(ArmError),
}

impl Arm {
    /// An arm at home, at rest, with open jaws and the blocks of the lab.
    #[must_use]
    pub fn new(now: ArmTime) -> Self {
        Self::with_blocks(now, Block::lab())
    }

    /// An arm at home, at rest, with open jaws and blocks put down as by [`Blocks::new`].
    #[must_use]
    pub fn with_blocks(now: ArmTime, blocks: impl IntoIterator<Item = Block>) -> Self {
        let blocks = Blocks::new(blocks);
        Self {
            now,
            seq: 0,
            posture: AT_REST,
            grip: Grip::Open,
            first_blocks: blocks.clone(),
            blocks,
            stopped: false,
            active: None,
            waiting: VecDeque::new(),
            planned: HOME,
            publish: now,
        }
    }

    /// Takes a command: reads its script, checks every leg of it, and queues it. It begins at once
    /// if nothing else is being carried out.
    ///
    /// # Errors
    ///
    /// `stopped`, `queue-full`, `duplicate-id`, `busy`, `syntax`, `workspace-boundary`, `joint-limit` or
    /// `singularity`. Then the command is not accepted, nothing moves, and there is no event.
    pub fn submit(
        &mut self,
        id: u64,
        script: &str,
        now: ArmTime,
        events: &mut Vec<ArmEvent>,
    ) -> Result<(), ArmError> {
        self.advance(now, events);
        self.check_free(id)?;
        let script: Script = script.parse()?;
        if let [Statement::Jog(velocity, ms)] = *script.statements() {
            return self.jog(QueuedScript { id, script }, velocity, ms, events);
        }
        if self.active.as_ref().is_some_and(|active| active.jog.is_some()) {
            let text = "the arm is being jogged, so where it will be is not known; send the command when it is at rest";
            return Err(ArmError::new(ErrorName::Busy, text));
        }
        let mut planned = self.planned;
        for (statement, number) in script.statements().iter().zip(1..) {
            if *statement == Statement::Reset {
                planned = HOME;
            } else if let Some(target) = target(statement) {
                path::check(&planned, &target).map_err(|error| error.at_statement(number))?;
                planned = target;
            }
        }
        self.planned = planned;
        let command = QueuedScript { id, script };
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
            step: None,
            ends: None,
            jog: Some(Jog::begin(velocity, until, before.as_ref())),
        });
        self.seq += 1;
        self.run_until(self.now, events);
        Ok(())
    }

    /// Lets time pass until `now`.
    pub fn advance(&mut self, now: ArmTime, events: &mut Vec<ArmEvent>) {
        let now = now.max(self.now);
        if let Some(due) = self.next_wake()
            && now.saturating_sub(due) > LINK_TIMEOUT
        {
            self.run_until(due.saturating_add(LINK_TIMEOUT), events);
            if self.active.is_some() {
                let silence = now.saturating_sub(due) / 1000;
                let text =
                    format!("the program that drives the arm was silent for {silence} ms; the arm stopped");
                self.fail(ArmError::new(ErrorName::Link, text), events);
            }
        }
        self.run_until(now, events);
    }

    /// When [`Arm::advance`] is to be called next; `None` while there is nothing to do.
    #[must_use]
    pub fn next_wake(&self) -> Option<ArmTime> {
        let step = self.active.as_ref()?.step.as_ref()?;
        Some(if step.leg.is_some() {
            step.ends.min(self.publish)
        } else {
            step.ends
        })
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
        if let Some(step) = active.step.as_mut().filter(|step| step.leg.is_none()) {
            step.ends = self.now;
            self.run_until(self.now, events);
        }
    }

    /// Halts the arm, every command ending with the error `stopped`, and takes none until [`Arm::unstop`].
    pub fn stop(&mut self, now: ArmTime, reason: &str, events: &mut Vec<ArmEvent>) {
        self.advance(now, events);
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
        let step = self.active.as_ref().and_then(|active| active.step.as_ref());
        ArmState {
            seq: self.seq,
            pose: self.posture.pose,
            gripper: Gripper {
                grip: self.grip,
                opening: self.posture.opening,
            },
            holding: self.blocks.held().map(|block| block.name.clone()),
            blocks: self.blocks.all().to_vec(),
            moving: step.is_some_and(|step| step.leg.is_some()),
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

    fn check_free(&self, id: u64) -> Result<(), ArmError> {
        if self.stopped {
            let text = "the arm is stopped and takes no command until the stop is released";
            return Err(ArmError::new(ErrorName::Stopped, text));
        }
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
            match self.active.as_ref().and_then(|active| active.step.as_ref()) {
                None => self.begin(events),
                Some(step) if step.ends <= until => {
                    self.now = step.ends;
                    self.end_step(events);
                }
                Some(_) => return self.move_to(until, events),
            }
        }
        self.now = until;
    }

    /// Begins what comes next: a leg, else a statement, else a command.
    fn begin(&mut self, events: &mut Vec<ArmEvent>) {
        self.seq += 1;
        let Some(active) = &mut self.active else {
            let command = self.waiting.pop_front();
            self.active = command.map(|command| Active {
                command,
                begun: 0,
                legs: VecDeque::new(),
                step: None,
                ends: None,
                jog: None,
            });
            return;
        };
        if let Some(pose) = active.legs.pop_front() {
            return self.begin_leg(Posture { pose, ..self.posture }, None, None);
        }
        if let Some(jog) = &mut active.jog {
            match jog.next(&self.posture.pose, self.now) {
                Some(pose) => return self.begin_leg(Posture { pose, ..self.posture }, None, Some(jog::TICK)),
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
                let ends = self.now.saturating_add(ArmTime::from(ms) * 1000);
                active.step = Some(MotionStep {
                    leg: None,
                    begins: self.now,
                    ends,
                    then: Then::Next,
                });
            }
            Statement::Jog(velocity, ms) => {
                let until = self.now.saturating_add(ArmTime::from(ms) * 1000);
                active.jog = Some(Jog::begin(velocity, until, None));
            }
            Statement::Grip(grip) => self.begin_grip(grip),
            Statement::Reset => {
                (self.posture, self.grip) = (AT_REST, Grip::Open);
                self.blocks = self.first_blocks.clone();
                self.publish_state(events);
            }
            Statement::Move(_) | Statement::Home => {
                let target = target(&statement).expect("moves have a target");
                active.legs = path::legs(&self.posture.pose, &target).into();
            }
        }
    }

    fn begin_grip(&mut self, grip: Grip) {
        self.grip = grip;
        if grip == Grip::Open {
            self.blocks.release();
        }
        let grasping = self
            .blocks
            .within_jaws(&self.posture)
            .filter(|_| grip == Grip::Close);
        let opening = match (grip, grasping) {
            (Grip::Open, _) => MAX_OPENING,
            (Grip::Close, Some(index)) => self.blocks.all()[index].size,
            (Grip::Close, None) if self.blocks.held().is_some() => self.posture.opening,
            (Grip::Close, None) => 0.0,
        };
        self.begin_leg(
            Posture {
                opening,
                ..self.posture
            },
            grasping,
            None,
        );
    }

    /// Begins a leg, which ends early where something is in the way, and takes as long as it is told or as it has to.
    fn begin_leg(&mut self, to: Posture, grasping: Option<usize>, lasting: Option<ArmTime>) {
        let Some(active) = &mut self.active else { return };
        let (to, then) = match (
            contact::first(&self.blocks, &self.posture, &to, grasping),
            grasping,
        ) {
            (Some(contact), _) => {
                let number = active.command.progress(active.begun).statement;
                (contact.last, Then::Fail(contact.error.at_statement(number)))
            }
            (None, Some(index)) => (to, Then::Grasp(index)),
            (None, None) => (to, Then::Next),
        };
        let leg = match lasting {
            Some(time) => Leg::lasting(self.posture, to, time),
            None => Leg::new(self.posture, to),
        };
        let ends = self.now.saturating_add(leg.duration());
        active.step = Some(MotionStep {
            leg: Some(leg),
            begins: self.now,
            ends,
            then,
        });
        if self.publish < self.now {
            self.publish = self.now.saturating_add(STATE_PERIOD);
        }
    }

    /// Takes the posture of this time, which lies within the step, and tells it if that is due.
    fn move_to(&mut self, now: ArmTime, events: &mut Vec<ArmEvent>) {
        let passed = now > self.now;
        self.now = now;
        let step = self.active.as_ref().and_then(|active| active.step.as_ref());
        let Some((leg, begins)) = step.and_then(|step| Some((step.leg?, step.begins))) else {
            return;
        };
        self.take(leg.at(now - begins));
        self.seq += u64::from(passed);
        if now >= self.publish {
            let late = (now - self.publish) / STATE_PERIOD;
            self.publish = self.publish.saturating_add((late + 1) * STATE_PERIOD);
            self.publish_state(events);
        }
    }

    fn end_step(&mut self, events: &mut Vec<ArmEvent>) {
        let Some(step) = self.active.as_mut().and_then(|active| active.step.take()) else {
            return;
        };
        self.seq += 1;
        if let Some(leg) = step.leg {
            self.take(leg.at(leg.duration()));
        }
        match step.then {
            Then::Next => {}
            Then::Grasp(index) => self.blocks.grasp(index, &self.posture.pose),
            Then::Fail(error) => self.fail(error, events),
        }
    }

    fn take(&mut self, posture: Posture) {
        self.posture = posture;
        self.blocks.carry(&posture.pose);
    }

    fn finish(&mut self, events: &mut Vec<ArmEvent>) {
        if let Some(active) = self.active.take() {
            if let [Statement::Jog(..)] = active.command.script.statements() {
                self.planned = self.posture.pose;
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
        let active = self.active.take();
        let waiting = std::mem::take(&mut self.waiting);
        self.planned = self.posture.pose;
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
        events.push(ArmEvent::State(self.state()));
    }
}

impl QueuedScript {
    fn progress(&self, begun: usize) -> ScriptProgress {
        let count = |count: usize| u32::try_from(count).expect("a script has at most 1000 statements");
        ScriptProgress {
            statement: count(begun),
            of: count(self.script.statements().len()),
        }
    }

    fn event(&self, state: CommandState, begun: usize, error: Option<ArmError>) -> ArmEvent {
        ArmEvent::Command {
            id: self.id,
            state,
            progress: self.progress(begun),
            error,
        }
    }
}

/// Where a statement moves the hand, if it does.
fn target(statement: &Statement) -> Option<Pose> {
    match statement {
        Statement::Move(pose) => Some(*pose),
        Statement::Home => Some(HOME),
        Statement::Grip(_) | Statement::Wait(_) | Statement::Jog(..) | Statement::Reset => None,
    }
}
