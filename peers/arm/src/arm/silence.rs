//! What becomes of commands whose program stands still.

use super::Arm;
use crate::error::{ArmError, ErrorName};
use crate::motion::ArmTime;
use crate::state::{ArmEvent, CommandState};

/// A program that ends, for whatever reason, leaves no controller to finish.
impl Drop for Arm {
    fn drop(&mut self) {
        self.controller.halt(self.now);
    }
}

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

#[cfg(test)]
mod tests {
    use super::super::tests::told;
    use super::super::{HOME, LINK_TIMEOUT, STATE_PERIOD};
    use super::*;
    use crate::motion::SPEED;

    #[test]
    fn a_silent_driver_is_a_broken_link() {
        for (silence, want) in [
            (LINK_TIMEOUT, "1 executing 1/1"),
            (LINK_TIMEOUT + 1, "1 error 1/1 link"),
            (i64::MAX - 100_000, "1 error 1/1 link"),
        ] {
            let (mut arm, mut events) = (Arm::new(0), Vec::new());
            arm.submit(1, "move 300 300 450 180 0", 0, &mut events).unwrap();
            arm.advance(STATE_PERIOD + silence, &mut events);
            let told = told(&events);
            assert_eq!(told.last().unwrap(), want);
            let way = HOME.z + SPEED * (STATE_PERIOD + LINK_TIMEOUT) as f64 / 1e6;
            let z_then_level = arm.state().pose.z + HOME.horizontal_distance(&arm.state().pose);
            assert!(z_then_level <= way + 1e-6, "{z_then_level} {way}");
        }
    }

    #[test]
    fn behind_a_silent_driver_no_statement_begins() {
        let (mut arm, mut events) = (Arm::new(0), Vec::new());
        arm.submit(1, "move 0 0 310 0 0; move 0 0 100 0 0", 0, &mut events)
            .unwrap();
        arm.submit(2, "home", 0, &mut events).unwrap();
        arm.advance(6_000_000, &mut events);
        assert_eq!(told(&events)[3..], ["2 error 0/1 halted", "1 error 1/2 halted"]);
        assert!((arm.state().pose.z - 310.0).abs() < 1e-6 && !arm.is_busy());
    }
}
