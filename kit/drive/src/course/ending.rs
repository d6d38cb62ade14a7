//! How a command, and the work, come to their end.

use mom_client::Lost;

use super::wait::Wait;
use super::{ANSWER, Course, HALTED_MS, RELEASED};
use crate::end::{CommandEnd, Halt, How};
use crate::heard::Report;
use crate::step::Step;

impl Course {
    /// A device that was halted because the token is lost may say so before the hub does.
    pub(super) fn ask(&mut self, end: How) {
        self.steps.push_back(Step::Ask);
        self.wait = Wait::Asked {
            until: self.now + ANSWER,
            end,
        };
    }

    /// The hub has answered, after all that it had to say before.
    pub(crate) fn asked(&mut self) {
        match std::mem::replace(&mut self.wait, Wait::Nothing) {
            Wait::Asked { end, .. } => self.end(end),
            other => self.wait = other,
        }
    }

    /// The token is lost, and the hub halts the device.
    pub(crate) fn lost(&mut self, lost: Lost) {
        // Nobody would be heard.
        if lost.reason == "disconnected" {
            return self.link_down();
        }
        match &self.wait {
            Wait::Nothing | Wait::Release { .. } | Wait::Ended { .. } | Wait::Loss { .. } => {}
            Wait::Asked {
                end: How::Failed(_), ..
            } if self.left.is_empty() => self.end(How::Lost {
                lost,
                ended: Some(true),
            }),
            _ if !self.may_run() => self.end(How::Lost { lost, ended: None }),
            _ => {
                let until = self.now + HALTED_MS;
                let ended = self.ended_early();
                self.wait = Wait::Loss { until, lost };
                if ended {
                    self.has_ended();
                }
            }
        }
    }

    /// A peer has left, or the hub misses it.
    pub(crate) fn gone(&mut self, peer: &str, missed: bool) {
        if self.worker.as_deref().or(self.device.as_deref()) == Some(peer) {
            let device = peer.to_owned();
            self.breaks(How::Gone { device, missed });
        }
    }

    /// The link to the hub is down.
    pub(crate) fn link_down(&mut self) {
        self.breaks(How::Disconnected);
    }

    /// So many events were lost.
    pub(crate) fn lagged(&mut self, count: u64) {
        self.breaks(How::Lagged(count));
    }

    pub(super) fn breaks(&mut self, end: How) {
        match &self.wait {
            // What it says may come all the same, or nobody knows soon enough.
            Wait::Nothing | Wait::Release { .. } | Wait::Ended { .. } | Wait::Loss { .. } => {}
            _ => self.end(end),
        }
    }

    /// Ends the work: the token is given back, and the device heard to have ended what runs.
    pub(crate) fn cancel(&mut self) {
        self.steps.clear();
        self.steps.push_back(Step::Release);
        self.runs &= !self.ended_early();
        let patience = if self.may_run() { RELEASED } else { ANSWER };
        self.wait = Wait::Release {
            until: self.now + patience,
        };
    }

    /// The hub has the token back, or has refused it.
    pub(crate) fn released(&mut self) {
        if !matches!(self.wait, Wait::Release { .. }) {
            return;
        }
        match self.may_run() {
            true => {
                let until = self.now + HALTED_MS;
                self.wait = Wait::Ended { until, stops: 0 };
            }
            false => self.halted(Halt::Confirmed),
        }
    }

    /// Whether something may run that was commanded here.
    pub(super) fn may_run(&self) -> bool {
        self.runs || !self.left.is_empty()
    }

    /// Whether the device has said before the receipt that a command has ended.
    pub(super) fn ended_early(&self) -> bool {
        self.ids.is_empty() && self.early.iter().any(Report::is_end)
    }

    /// What runs has ended.
    pub(crate) fn has_ended(&mut self) {
        self.runs = false;
        self.left.clear();
        match std::mem::replace(&mut self.wait, Wait::Nothing) {
            Wait::Ended { stops: 0, .. } => self.halted(Halt::Confirmed),
            Wait::Ended { .. } => self.halted(Halt::Stopped),
            Wait::Loss { lost, .. } => self.end(How::Lost {
                lost,
                ended: Some(true),
            }),
            other => self.wait = other,
        }
    }

    pub(super) fn halted(&mut self, halt: Halt) {
        self.wait = Wait::Nothing;
        self.steps.push_back(Step::Halted(halt));
    }

    pub(super) fn end(&mut self, how: How) {
        self.wait = Wait::Nothing;
        let end = CommandEnd::new(how, &self.whose, &self.text, self.runs);
        // The device is another owner's by then, whom a stop would meet.
        if matches!(end.how, How::Lost { .. }) {
            self.runs = false;
            self.left.clear();
        }
        self.steps.push_back(Step::End(end));
    }
}
