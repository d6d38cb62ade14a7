//! A simulated controller whose hand's way is written into a file.

use mom_device::DeviceError;
use mom_trace::Trace;

use super::{Controller, Instruction, Posture, Progress, Reading, Simulated};
use crate::motion::ArmTime;

/// A simulated controller that writes where its hand is: x, y and z in mm, and how far the jaws are open.
#[derive(Debug)]
pub struct Traced {
    controller: Simulated,
    trace: Trace,
}

impl Traced {
    /// This controller, whose hand's way is written there.
    #[must_use]
    pub fn new(controller: Simulated, trace: Trace) -> Self {
        Self { controller, trace }
    }

    /// By a copy: the program has to hear itself of what ends until then.
    fn trace(&mut self, now: ArmTime) {
        let mut body = self.controller.clone();
        self.trace.until(now, |at| {
            body.advance(at);
            let posture = body.reading().posture;
            [posture.pose.x, posture.pose.y, posture.pose.z, posture.opening]
        });
    }
}

impl Controller for Traced {
    fn begin(&mut self, instruction: &Instruction, now: ArmTime) -> Result<(), DeviceError> {
        self.trace(now);
        self.controller.begin(instruction, now)
    }

    fn advance(&mut self, now: ArmTime) -> Progress {
        self.trace(now);
        self.controller.advance(now)
    }

    fn halt(&mut self, now: ArmTime) {
        self.trace(now);
        self.controller.halt(now);
    }

    fn next_wake(&self) -> Option<ArmTime> {
        self.controller.next_wake()
    }

    fn reading(&self) -> Reading {
        self.controller.reading()
    }

    fn posture(&self) -> Posture {
        self.controller.posture()
    }

    fn is_unsettled(&self) -> bool {
        self.controller.is_unsettled()
    }

    fn is_linked(&self) -> bool {
        self.controller.is_linked()
    }

    fn reset(&mut self, now: ArmTime) -> Result<(), DeviceError> {
        self.trace(now);
        self.controller.reset(now)
    }
}
