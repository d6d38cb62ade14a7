//! A simulated controller, like the S4 of an ABB IRB 1400: 150 mm/s, a halt at each target, a gripper by a digital output, and no sensor of
//! contact but the overload of its motors (M49); and before it the table with its blocks.

use super::Grip;
use crate::blocks::{Block, Blocks};
use crate::contact::{self, Way};
use crate::motion::{ArmTime, Leg, MAX_OPENING, Posture};
use crate::pose::HOME;
use mom_device::{DeviceError, ErrorName};

use super::link::LinkFault;
use super::{Controller, Instruction, Progress, Reading};

/// How an arm starts: at home, with open jaws.
const AT_REST: Posture = Posture {
    pose: HOME,
    opening: MAX_OPENING,
};
/// µs between two looks at what touches and what falls.
const TICK: ArmTime = 5_000;
/// µs for which the controller goes on by itself when it does not hear the program any more; then it halts.
pub const WATCHDOG: ArmTime = 200_000;
/// How often one tick looks whether a push has brought a block against something else.
const ROUNDS: usize = 12;

/// The simulated controller.
#[derive(Debug, Clone)]
pub struct Simulated {
    posture: Posture,
    grip: Grip,
    blocks: Blocks,
    /// The blocks as they were at the start.
    first_blocks: Blocks,
    motion: Option<Motion>,
    /// The time of the last tick.
    ticked: ArmTime,
    settled: bool,
    fault: Option<LinkFault>,
    /// Until when it is known how the link stood.
    heard: ArmTime,
    /// What the program knew last, while the link is down.
    lost: Option<Reading>,
}

#[derive(Debug, Clone)]
struct Motion {
    leg: Leg,
    begins: ArmTime,
    grasping: Option<usize>,
}

impl Motion {
    fn ends(&self) -> ArmTime {
        self.begins.saturating_add(self.leg.duration())
    }
}

impl Simulated {
    /// At home, at rest, with open jaws and blocks put down as by [`Blocks::new`].
    #[must_use]
    pub fn new(now: ArmTime, blocks: impl IntoIterator<Item = Block>) -> Self {
        let blocks = Blocks::new(blocks);
        Self {
            posture: AT_REST,
            grip: Grip::Open,
            settled: blocks.at_rest(),
            first_blocks: blocks.clone(),
            blocks,
            motion: None,
            ticked: now,
            fault: None,
            heard: now,
            lost: None,
        }
    }

    /// The same, behind a link that fails.
    #[must_use]
    pub fn failing(mut self, fault: LinkFault) -> Self {
        self.fault = Some(fault);
        self
    }

    /// Lets time pass until `now` or until the motion ends.
    fn run(&mut self, now: ArmTime) -> Progress {
        loop {
            let ends = self.motion.as_ref().map(Motion::ends);
            if ends.is_none() && self.settled {
                self.ticked = self.ticked.max(now);
                return Progress::Done(now);
            }
            let tick = (self.ticked.div_euclid(TICK) + 1).saturating_mul(TICK);
            let next = ends.map_or(tick, |ends| ends.min(tick));
            if next > now {
                self.take_posture(now);
                return Progress::Busy;
            }
            if let Err(error) = self.tick(next) {
                self.motion = None;
                return Progress::Failed(next, error);
            }
            if ends == Some(next) {
                self.end_motion();
                return Progress::Done(next);
            }
        }
    }

    /// The hand goes where it is at this time, with what it carries.
    fn take_posture(&mut self, time: ArmTime) {
        if let Some(motion) = &self.motion {
            self.posture = motion.leg.at(time - motion.begins);
            self.blocks.carry(&self.posture.pose);
        }
    }

    /// Moves all to this time. After an error the hand is where nothing is touched yet.
    fn tick(&mut self, time: ArmTime) -> Result<(), DeviceError> {
        let seconds = (time - self.ticked).max(0) as f64 / 1e6;
        // Where it was at the last tick, however often it was read since.
        self.take_posture(self.ticked);
        self.ticked = time;
        let before = (self.posture, self.blocks.clone());
        self.take_posture(time);
        let met = match self.motion.as_ref().map(|motion| motion.grasping) {
            Some(grasping) => self.meet(grasping),
            None => Ok(()),
        };
        if met.is_err() {
            (self.posture, self.blocks) = before;
        }
        self.blocks.fall(seconds);
        self.settled = self.blocks.at_rest();
        met
    }

    /// Pushes aside what yields.
    fn meet(&mut self, grasping: Option<usize>) -> Result<(), DeviceError> {
        if let Some(index) = grasping {
            self.blocks.square(index, &self.posture, contact::FINGER_LENGTH);
        }
        let mut last = None;
        for _ in 0..ROUNDS {
            let touches = contact::touches(&self.blocks, &self.posture, grasping);
            if let Some(pressed) = touches.iter().find(|touch| touch.way == Way::Pressed) {
                return Err(pressed.overload(&self.blocks));
            }
            let Some(touch) = touches.into_iter().next() else {
                return Ok(());
            };
            if let Way::Aside {
                block,
                at,
                direction,
                depth,
            } = touch.way
            {
                let pushed = self.blocks.push(block, at, direction, depth);
                pushed.map_err(|_| touch.overload(&self.blocks))?;
            }
            last = Some(touch);
        }
        // What is pushed back and forth is caught.
        last.map_or(Ok(()), |touch| Err(touch.overload(&self.blocks)))
    }

    fn end_motion(&mut self) {
        if let Some(index) = self.motion.take().and_then(|motion| motion.grasping) {
            self.blocks.grasp(index, &self.posture.pose);
            self.settled = self.blocks.at_rest();
        }
    }

    fn begin_grip(&mut self, grip: Grip) -> (Posture, Option<usize>) {
        self.grip = grip;
        if grip == Grip::Open {
            self.blocks.release();
            self.settled = self.blocks.at_rest();
        }
        let grasping = match (grip, self.blocks.held()) {
            (Grip::Close, None) => self.blocks.within_jaws(&self.posture),
            _ => None,
        };
        let opening = match (grip, grasping) {
            (Grip::Open, _) => MAX_OPENING,
            (Grip::Close, Some(index)) => self.blocks.all()[index].size,
            (Grip::Close, None) if self.blocks.held().is_some() => self.posture.opening,
            (Grip::Close, None) => 0.0,
        };
        let to = Posture {
            opening,
            ..self.posture
        };
        (to, grasping)
    }

    /// What it knows itself, whether or not the program hears of it.
    fn own_reading(&self) -> Reading {
        Reading {
            posture: self.posture,
            grip: self.grip,
            holding: self.blocks.held().map(|block| block.name.clone()),
            blocks: self.blocks.all().to_vec(),
        }
    }

    /// The link fails at this time: the controller goes on until its watchdog halts it, and the program knows nothing of that.
    fn lose_link(&mut self, at: ArmTime, back: ArmTime) {
        self.lost = Some(self.own_reading());
        let halts = at.saturating_add(WATCHDOG);
        let halts = halts.min(back);
        self.run(halts);
        self.stand(halts);
    }

    /// Stops the motion at this time; what the hand met since the last tick yields, or keeps it from where it is.
    fn stand(&mut self, at: ArmTime) {
        if self.motion.is_some() {
            // An overload in the moment of a halt is one more reason to stand.
            let _ = self.tick(at);
            self.motion = None;
        }
    }
}

impl Controller for Simulated {
    fn begin(&mut self, instruction: &Instruction, now: ArmTime) -> Result<(), DeviceError> {
        if !self.is_linked() {
            return Err(link_error("the controller cannot be reached"));
        }
        let (to, grasping) = match *instruction {
            Instruction::Move(pose) | Instruction::Glide(pose, _) => (Posture { pose, ..self.posture }, None),
            Instruction::Grip(grip) => self.begin_grip(grip),
        };
        let leg = match *instruction {
            Instruction::Glide(_, time) => Leg::lasting(self.posture, to, time),
            _ => Leg::new(self.posture, to),
        };
        self.motion = Some(Motion {
            leg,
            begins: now,
            grasping,
        });
        Ok(())
    }

    fn advance(&mut self, now: ArmTime) -> Progress {
        let Some(fault) = self.fault else {
            return self.run(now);
        };
        // From one change of the link to the next.
        loop {
            let busy = self.motion.is_some();
            let change = fault.next_change(self.heard);
            match fault.is_down(self.heard) {
                true if self.lost.is_none() => {
                    self.lose_link(self.heard, change);
                    if busy {
                        let error = link_error("the controller no longer answers");
                        return Progress::Failed(self.heard, error);
                    }
                }
                true => {}
                false => self.lost = None,
            }
            let until = change.min(now);
            let progress = self.run(until);
            if let (true, Progress::Done(at) | Progress::Failed(at, _)) = (busy, &progress) {
                self.heard = *at;
                return progress;
            }
            self.heard = until;
            if change > now {
                return match self.motion {
                    Some(_) => Progress::Busy,
                    None => Progress::Done(now),
                };
            }
        }
    }

    fn halt(&mut self, now: ArmTime) {
        self.advance(now);
        if self.is_linked() {
            self.stand(now);
        }
    }

    fn next_wake(&self) -> Option<ArmTime> {
        let ends = self.motion.as_ref().map(Motion::ends);
        let change = self.fault.map(|fault| fault.next_change(self.heard));
        ends.into_iter().chain(change).min()
    }

    fn reading(&self) -> Reading {
        self.lost.clone().unwrap_or_else(|| self.own_reading())
    }

    // Often asked: without copies of all blocks.
    fn posture(&self) -> Posture {
        self.lost.as_ref().map_or(self.posture, |lost| lost.posture)
    }

    fn is_unsettled(&self) -> bool {
        !self.settled && self.is_linked()
    }

    fn is_linked(&self) -> bool {
        self.lost.is_none()
    }

    fn reset(&mut self, now: ArmTime) -> Result<(), DeviceError> {
        if !self.is_linked() {
            return Err(link_error("the controller cannot be reached"));
        }
        *self = Self {
            ticked: now,
            settled: self.first_blocks.at_rest(),
            posture: AT_REST,
            grip: Grip::Open,
            blocks: self.first_blocks.clone(),
            motion: None,
            first_blocks: self.first_blocks.clone(),
            fault: self.fault,
            heard: self.heard,
            lost: None,
        };
        Ok(())
    }
}

/// The link between program and controller is down (M53).
fn link_error(what: &str) -> DeviceError {
    let text = format!(
        "{what}; it halts by itself within {} ms, and where it stands is told when the link is back",
        WATCHDOG / 1000
    );
    DeviceError::new(ErrorName::Link, text)
}
