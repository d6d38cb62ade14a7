//! The commands that wait to be written.

use std::collections::VecDeque;

use mom_brs::{Code, Frame};

use super::{Refusal, Taken};

/// The most commands that wait for one robot.
pub const MOST_WAITING: usize = 64;

/// A bounded queue, in which a newer MOTOR takes the place of a waiting one when it is full.
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

    pub(super) fn push(&mut self, frame: Frame) -> Result<Taken, Refusal> {
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
                Ok(Taken::Replaced)
            }
            _ => Err(Refusal::Full),
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
