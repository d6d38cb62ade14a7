//! The arm keeps out of zones (M40).

use super::{Arm, HOME, LINK_TIMEOUT};
use crate::error::ArmError;
use crate::motion::ArmTime;
use crate::path;
use crate::pose::Pose;
use crate::state::ArmEvent;
use crate::zones::Closed;

impl Arm {
    /// Its time passes so many times as fast as its driver's.
    pub(crate) fn set_pace(&mut self, pace: ArmTime) {
        self.patience = LINK_TIMEOUT.saturating_mul(pace);
    }

    /// Whether the controller can be reached, so that it is known where the hand is.
    pub(crate) fn is_linked(&self) -> bool {
        self.controller.is_linked()
    }

    /// Keeps out of these zones from now on. What is under way into one of them, or through it, ends at once.
    pub fn close(&mut self, closed: Closed, now: ArmTime, events: &mut Vec<ArmEvent>) {
        if self.closed == closed {
            return;
        }
        self.advance(now, events);
        self.closed = closed;
        let Some(active) = self.active.as_ref().filter(|_| self.has_begun_a_motion()) else {
            return;
        };
        let at = self.controller.reading().posture.pose;
        if let Err(error) = self.closed.check_leg(&at, &active.leg.unwrap_or(at)) {
            self.fail_statement(error, events);
        }
    }

    /// Checks that the way between two poses keeps out of the zones that are closed.
    pub(super) fn check_zones(&self, from: &Pose, to: &Pose) -> Result<(), ArmError> {
        let mut at = *from;
        for end in path::legs(from, to) {
            self.closed.check_leg(&at, &end)?;
            at = end;
        }
        Ok(())
    }

    /// Puts hand and blocks back.
    pub(super) fn reset(&mut self) -> Result<(), ArmError> {
        let from = self.controller.reading().posture.pose;
        self.closed.check_leg(&from, &HOME)?;
        self.controller.reset(self.now)
    }
}
