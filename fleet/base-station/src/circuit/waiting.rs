//! The commands that wait to be written.

use std::collections::VecDeque;

use mom_brs::{Code, Frame};

use super::{Refusal, Taken, is_stop};

/// The most commands that wait for one robot, but for a stop: a way of 64 points, with a stop before and questions after it.
pub const MOST_WAITING: usize = 96;

/// A bounded queue, in which a newer MOTOR takes the place of a waiting one when it is full. One more place is for a stop.
#[derive(Debug, Default)]
pub(super) struct Waiting {
    frames: VecDeque<Frame>,
}

impl Waiting {
    pub(super) fn len(&self) -> usize {
        self.frames.len()
    }

    pub(super) fn nulls(&self) -> usize {
        let null = |frame: &&Frame| frame.code() == Code::NULL;
        self.frames.iter().filter(null).count()
    }

    /// Whether what waits last of what can move the robot is a stop; none if nothing that can waits.
    pub(super) fn ends_in_stop(&self) -> Option<bool> {
        let moves = |frame: &&Frame| matches!(frame.code(), Code::MOTOR | Code::GOTO | Code::VIA);
        self.frames.iter().rev().find(moves).map(is_stop)
    }

    pub(super) fn push(&mut self, frame: Frame) -> Result<Taken, Refusal> {
        if is_stop(&frame) {
            return Ok(self.stop(frame));
        }
        if self.frames.len() < MOST_WAITING {
            self.frames.push_back(frame);
            return Ok(Taken::Queued);
        }
        let is_motor = |frame: &Frame| frame.code() == Code::MOTOR;
        // The newest of them: those before it keep their order, and the last word is the latest.
        let newest = self.frames.iter_mut().rev().find(|waiting| is_motor(waiting));
        match newest {
            Some(waiting) if is_motor(&frame) => {
                *waiting = frame;
                Ok(Taken::Replaced(1))
            }
            _ => Err(Refusal::Full),
        }
    }

    /// Takes a stop, and drops all motion before it, which would only be late. So there is never a second stop, and this
    /// one always has its place.
    fn stop(&mut self, stop: Frame) -> Taken {
        let before = self.frames.len();
        self.frames
            .retain(|frame| !matches!(frame.code(), Code::MOTOR | Code::GOTO | Code::VIA));
        let dropped = before - self.frames.len();
        self.frames.push_back(stop);
        match dropped {
            0 => Taken::Queued,
            dropped => Taken::Replaced(dropped),
        }
    }

    pub(super) fn pop(&mut self) -> Option<Frame> {
        let frame = self.frames.pop_front();
        if self.frames.is_empty() {
            // Most robots have nothing that waits, most of the time.
            self.frames = VecDeque::new();
        }
        frame
    }

    pub(super) fn clear(&mut self) {
        self.frames.clear();
    }
}
