//! What becomes of commands whose program stands still.

use super::Arm;
use crate::error::{ArmError, ErrorName};
use crate::motion::ArmTime;
use crate::state::{ArmEvent, CommandState};

impl Arm {
    /// Ends all commands where the driver has missed its wake by more than its patience: the controller goes on by itself for that long,
    /// and no statement begins for which the driver would have had to be there.
    pub(super) fn make_up_for_silence(&mut self, now: ArmTime, events: &mut Vec<ArmEvent>) {
        let Some(due) = self.next_wake().filter(|_| self.is_busy()) else {
            return;
        };
        let silence = now.saturating_sub(due);
        if silence <= self.patience {
            return;
        }
        let text = format!(
            "the program that drives the arm was silent for {} ms; the arm stopped",
            silence / 1000
        );
        for command in std::mem::take(&mut self.waiting) {
            let error = ArmError::new(ErrorName::Halted, text.clone());
            events.push(command.event(CommandState::Error, 0, Some(error)));
        }
        if let Some(active) = &mut self.active {
            active.ends = Some(text.clone());
        }
        self.run_until(due.saturating_add(self.patience), events);
        if self.active.is_some() {
            self.fail(ArmError::new(ErrorName::Link, text), events);
        }
    }
}
