//! The arm as a device: which actions it has, and how its controller carries one out.

use std::collections::VecDeque;

use mom_client::{Card, FieldType, Map, Value};
use mom_device::{DeviceError, ErrorName, Machine, Sample, Word, Words};

use crate::action::{self, Action};
use crate::blocks::Block;
use crate::controller::{Controller, Grip, Instruction, Progress, Reading, Simulated, WATCHDOG};
use crate::jog::{self, Jog};
use crate::motion::ArmTime;
use crate::path;
use crate::pose::{HOME, Pose};
use crate::zones::Closed;

/// What a controller moves: the legs of a statement one after the other, each checked against the closed zones when it begins.
#[derive(Debug)]
pub struct ArmMachine {
    controller: Box<dyn Controller>,
    now: ArmTime,
    /// Where the hand will be after the last script that was planned; the next one is checked from there.
    planned: Pose,
    /// The ends of the present statement's legs that have not begun.
    legs: VecDeque<Pose>,
    /// The present statement, if that is a velocity.
    jog: Option<Jog>,
    step: Step,
    /// Where the hand is going by the controller's present instruction.
    leg: Option<Pose>,
    /// When the present statement was done, if it was.
    done: Option<ArmTime>,
    failure: Option<DeviceError>,
    /// Whether the link to the controller stood when that was looked at last.
    linked: bool,
    /// The zones into which it must not go.
    closed: Closed,
    /// µs by which a piece of a velocity may begin too late.
    patience: ArmTime,
}

/// What is being done of the present statement.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Step {
    None,
    /// The hand is there early; until this time.
    Waits(ArmTime),
    /// The controller carries out an instruction.
    Moves {
        /// It counts as done no earlier, wherever the hand is.
        lasts_until: ArmTime,
    },
}

impl ArmMachine {
    /// The lab's, simulated: at home, at rest, with open jaws and these blocks.
    #[must_use]
    pub fn with_blocks(now: ArmTime, blocks: impl IntoIterator<Item = Block>) -> Self {
        Self::new(Box::new(Simulated::new(now, blocks)))
    }

    /// One that this controller moves.
    #[must_use]
    pub fn new(controller: Box<dyn Controller>) -> Self {
        Self {
            now: 0,
            planned: controller.posture().pose,
            linked: controller.is_linked(),
            controller,
            legs: VecDeque::new(),
            jog: None,
            step: Step::None,
            leg: None,
            done: None,
            failure: None,
            closed: Closed::default(),
            patience: WATCHDOG,
        }
    }

    /// Its time passes so many times as fast as that of its program.
    #[must_use]
    pub fn at_pace(mut self, pace: u32) -> Self {
        self.patience = WATCHDOG.saturating_mul(pace.max(1).into());
        self
    }

    /// What the controller knows of hand, jaws and blocks.
    #[must_use]
    pub fn reading(&self) -> Reading {
        self.controller.reading()
    }

    /// Where the hand is.
    pub(crate) fn pose(&self) -> Pose {
        self.controller.posture().pose
    }

    /// The zones into which it must not go.
    pub(crate) fn closed(&self) -> &Closed {
        &self.closed
    }

    /// Keeps out of these zones from now on. What is under way into one of them, or through it, fails.
    pub(crate) fn close(&mut self, closed: Closed) {
        self.closed = closed;
        if self.step == Step::None {
            return;
        }
        let at = self.pose();
        if let Err(error) = self.closed.check_leg(&at, &self.leg.unwrap_or(at)) {
            self.failure = Some(error);
        }
    }

    fn check_link(&self) -> Result<(), DeviceError> {
        if self.controller.is_linked() {
            return Ok(());
        }
        let text = "the link to the controller is down; it is tried again all the time, and a state tells when it is back";
        Err(DeviceError::new(ErrorName::Link, text).with_retry())
    }

    /// Checks that the way between two poses can be gone, and keeps out of the zones that are closed.
    fn check_way(&self, from: &Pose, to: &Pose) -> Result<(), DeviceError> {
        path::check(from, to)?;
        let mut at = *from;
        for end in path::legs(from, to) {
            self.closed.check_leg(&at, &end)?;
            at = end;
        }
        Ok(())
    }

    /// Gives the controller something to do, unless it would be done in a zone that is closed.
    fn instruct(&mut self, instruction: &Instruction) -> Result<(), DeviceError> {
        let at = self.pose();
        let (leg, lasts) = match instruction {
            Instruction::Move(to) => (*to, 0),
            Instruction::Glide(to, time) => (*to, *time),
            Instruction::Grip(_) => (at, 0),
        };
        self.leg = Some(leg);
        self.closed.check_leg(&at, &leg)?;
        self.controller.begin(instruction, self.now)?;
        self.step = Step::Moves {
            lasts_until: self.now.saturating_add(lasts),
        };
        Ok(())
    }

    /// Begins the next piece of the present statement; `false` if there is none.
    fn go_on(&mut self) -> Result<bool, DeviceError> {
        if let Some(pose) = self.legs.pop_front() {
            self.instruct(&Instruction::Move(pose))?;
            return Ok(true);
        }
        let at = self.pose();
        let next = self.jog.as_mut().map(|jog| jog.next(&at, self.now));
        match next {
            Some(Some(pose)) => self.instruct(&Instruction::Glide(pose, jog::TICK)).map(|()| true),
            Some(None) => {
                self.jog = None;
                self.planned = at;
                Ok(false)
            }
            None => Ok(false),
        }
    }

    /// Carries the present statement on until then; it is done, or has failed, once `done` is set.
    fn carry_on(&mut self, until: ArmTime) {
        while self.done.is_none() && self.failure.is_none() {
            match self.step {
                // Each piece has to be said in time: a controller would have stood after the last one.
                Step::None if self.jog.is_some() && until - self.now > self.patience => {
                    let late = u32::try_from((until - self.now) / 1000).unwrap_or(u32::MAX);
                    let text = format!(
                        "the program of the arm stood still for {late} ms, and no piece of a velocity begins so late"
                    );
                    // It was to move and does not: where it stands it can be told anew.
                    self.fail(
                        DeviceError::new(ErrorName::Halted, text)
                            .with_retry()
                            .late_by(late),
                    );
                }
                Step::None => match self.go_on() {
                    Ok(true) => {}
                    Ok(false) => self.done = Some(self.now),
                    Err(error) => self.fail(error),
                },
                Step::Waits(ends) if ends > until => break,
                Step::Waits(ends) => {
                    self.controller.advance(ends);
                    (self.now, self.step) = (ends, Step::None);
                }
                Step::Moves { lasts_until } => match self.controller.advance(until) {
                    Progress::Busy => break,
                    Progress::Done(at) => {
                        self.now = at.max(self.now);
                        // A controller may be there early; a jog that did not wait would make no time pass.
                        self.step = match lasts_until > self.now {
                            true => Step::Waits(lasts_until),
                            false => Step::None,
                        };
                    }
                    Progress::Failed(at, error) => {
                        self.now = at.max(self.now);
                        self.fail(error);
                    }
                },
            }
        }
    }

    fn fail(&mut self, error: DeviceError) {
        (self.failure, self.done) = (Some(error), Some(self.now));
        self.forget();
    }

    /// Nothing of the present statement goes on.
    fn forget(&mut self) {
        self.legs.clear();
        (self.jog, self.step, self.leg) = (None, Step::None, None);
    }

    fn is_carrying_on(&self) -> bool {
        self.done.is_none() && (self.step != Step::None || !self.legs.is_empty() || self.jog.is_some())
    }
}

/// A program that ends, for whatever reason, leaves no controller to finish.
impl Drop for ArmMachine {
    fn drop(&mut self) {
        self.controller.halt(self.now);
    }
}

impl Machine for ArmMachine {
    type Action = Action;

    const NAME: &str = "the arm";
    const VERBS: &[&str] = action::VERBS;
    const TOLERANCE: f64 = 0.5;
    const COMPLETES: bool = true;

    fn card(&self) -> Card {
        Card::new("arm", "A robot arm with jaws")
            .verbs(Action::verbs())
            .measures("pose.x", "mm", "Where the hand is: to the right")
            .measures("pose.y", "mm", "Where the hand is: forwards")
            .measures("pose.z", "mm", "Where the hand is: upwards")
            .measures("pose.spin", "°", "How far the hand is turned about the vertical")
            .measures("pose.tilt", "°", "How far the hand leans")
            .tells("gripper.grip", FieldType::Word, "What the jaws were told last")
            .measures("gripper.opening", "mm", "How far the jaws are open")
            .tells("holding", FieldType::Word, "The block in the jaws")
    }

    fn read(verb: Word<'_>, words: &mut Words<'_>) -> Option<Result<Action, DeviceError>> {
        Action::read(verb, words)
    }

    fn is_relative(action: &Action) -> Option<bool> {
        match action {
            Action::Move(_) | Action::Home | Action::Reset => Some(false),
            Action::By(_) => Some(true),
            Action::Grip(_) | Action::Jog(..) => None,
        }
    }

    fn never_waits(action: &Action) -> bool {
        matches!(action, Action::Jog(..))
    }

    fn is_moving(&self) -> bool {
        self.is_carrying_on()
    }

    fn is_changing(&self) -> bool {
        self.controller.is_unsettled()
    }

    fn is_reached(&self) -> bool {
        self.controller.is_linked()
    }

    fn plan(&mut self, script: &mom_device::Script<Action>) -> Result<(), DeviceError> {
        self.check_link()?;
        action::check_jogs(script)?;
        let never_waits = script.actions().any(|(action, _)| Self::never_waits(action));
        if self.jog.is_some() && !never_waits {
            let text = "the arm is being jogged, so where it will be is not known; send the command when it is at rest";
            return Err(DeviceError::new(ErrorName::Busy, text));
        }
        let mut planned = self.planned;
        for (action, number) in script.actions() {
            if *action == Action::Reset {
                planned = HOME;
            } else if let Some(target) = action.target(&planned) {
                let checked = self.check_way(&planned, &target);
                checked.map_err(|error| error.at_statement(number))?;
                planned = target;
            }
        }
        self.planned = planned;
        Ok(())
    }

    fn begin(&mut self, action: &Action, now: ArmTime) -> Result<(), DeviceError> {
        let before = self.jog.take();
        self.forget();
        (self.now, self.done) = (now, None);
        let at = self.pose();
        match *action {
            Action::Grip(grip) => return self.instruct(&Instruction::Grip(grip)),
            Action::Jog(velocity, ms) => {
                let until = now.saturating_add(ArmTime::from(ms) * 1000);
                self.jog = Some(Jog::begin(velocity, until, before.as_ref()));
            }
            Action::Reset => {
                self.closed.check_leg(&at, &HOME)?;
                return self.controller.reset(now);
            }
            Action::Move(_) | Action::By(_) | Action::Home => {
                let target = action.target(&at).unwrap_or(at);
                self.legs = path::legs(&at, &target).into();
            }
        }
        self.go_on().map(|_| ())
    }

    fn done_at(&self) -> Option<ArmTime> {
        self.done
    }

    fn pursue(&mut self, until: ArmTime) -> Option<ArmTime> {
        self.carry_on(until);
        self.done.filter(|done| *done <= until)
    }

    fn take_failure(&mut self) -> Option<DeviceError> {
        self.failure.take()
    }

    fn gives_way(&self) -> bool {
        self.jog.is_some() && self.done.is_none()
    }

    /// The next velocity begins with the speed that the hand has.
    fn give_way(&mut self, _now: ArmTime) {}

    fn halt(&mut self, now: ArmTime) {
        self.now = now.max(self.now);
        self.controller.halt(self.now);
        self.forget();
        (self.planned, self.done) = (self.pose(), Some(self.now));
    }

    fn advance(&mut self, now: ArmTime) {
        match self.is_carrying_on() {
            true => self.carry_on(now),
            false => {
                self.controller.advance(now);
            }
        }
        self.now = now.max(self.now);
        let was_linked = std::mem::replace(&mut self.linked, self.controller.is_linked());
        if was_linked && !self.linked && self.failure.is_none() {
            // Where the hand is is not known any more, nor where what waits would lead from.
            self.failure = self.check_link().err();
        } else if self.linked && !was_linked {
            // What it was told meanwhile has not reached it.
            self.controller.halt(self.now);
            self.planned = self.pose();
        }
    }

    fn next_wake(&self) -> Option<ArmTime> {
        let waits = match self.step {
            Step::Waits(ends) => Some(ends),
            Step::None | Step::Moves { .. } => None,
        };
        waits.into_iter().chain(self.controller.next_wake()).min()
    }

    fn position(&self) -> Map {
        let reading = self.controller.reading();
        let grip = match reading.grip {
            Grip::Open => "open",
            Grip::Close => "close",
        };
        let gripper = Map::new().with("grip", grip);
        let opening = Value::Double(reading.posture.opening);
        let position = Map::new()
            .with("pose", reading.posture.pose)
            .with("gripper", gripper.with("opening", opening));
        match reading.holding {
            Some(block) => position.with("holding", block),
            None => position,
        }
    }

    fn measured(&self, at: ArmTime) -> Option<Sample> {
        let posture = self.controller.posture();
        let Pose { x, y, z, spin, tilt } = posture.pose;
        Some(Sample::new(vec![x, y, z, spin, tilt, posture.opening], at))
    }

    fn report(&self) -> Map {
        let blocks = self.controller.reading().blocks;
        let blocks = blocks.iter().filter_map(|block| mom_client::to_value(block).ok());
        let report = Map::new().with("blocks", blocks.collect::<Vec<Value>>());
        match self.is_reached() {
            true => report,
            false => report.with("linked", false),
        }
    }
}
