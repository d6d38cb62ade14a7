//! How a statement begins, goes on and ends.

use mom_device::{DeviceError, ErrorName, Machine as _};

use super::{Doing, Mirror, UNCONFIRMED};
use crate::{Action, Setting};

impl Mirror {
    /// Begins a statement; nothing of the robot is switched off for a stop.
    pub(super) fn start(&mut self, action: &Action) -> Result<(), DeviceError> {
        let now = self.now;
        self.moved.begin(now, Self::STOPPING_TIME);
        self.stop.acts();
        self.doing = match (action, &mut self.rover) {
            (Action::Wheels(action), Some(rover)) => {
                rover.begin(action, now)?;
                for wheel in &self.wheels {
                    self.moved.one(*wheel, now);
                }
                self.robot.hurry();
                Doing::Drives
            }
            (_, rover) => {
                if let Some(rover) = rover.as_mut().filter(|rover| rover.is_moving()) {
                    rover.halt(now);
                }
                self.begin_other(action)?
            }
        };
        Ok(())
    }

    /// Looks how far the statement is that was begun last.
    pub(super) fn go_on(&mut self) {
        let now = self.now;
        match &mut self.doing {
            // Later than its end by a moment, so that a `set` that follows at once sets other values without a rest between.
            Doing::Set(until, _) if now > *until => {
                if let Doing::Set(_, places) = std::mem::replace(&mut self.doing, Doing::Nothing) {
                    self.end_set(&places, &Action::Clear);
                }
            }
            Doing::Runs(until) if now > *until => self.doing = Doing::Nothing,
            Doing::Arrives(arrival) => match arrival.is_there(&self.robot, now) {
                Ok(true) => self.doing = Doing::Done(now),
                Ok(false) => {}
                Err(error) => self.fail(error),
            },
            // One in a module that is switched off is as it was told, and rests.
            Doing::Switches(place, active, _)
                if self.robot.with(|middle| {
                    middle.active(*place) == *active || middle.activated(*place) != *active
                }) =>
            {
                self.doing = Doing::Done(now);
            }
            Doing::Switches(_, _, since) if now > since.saturating_add(UNCONFIRMED) => {
                let text = format!("{} has not confirmed what was switched", self.robot.name());
                self.fail(DeviceError::new(ErrorName::Link, text));
            }
            Doing::Waits(_, since) if now > since.saturating_add(UNCONFIRMED) => {
                let text = format!(
                    "{} has not confirmed its last stop, so it begins nothing",
                    self.robot.name()
                );
                self.fail(DeviceError::new(ErrorName::Link, text));
            }
            _ => {}
        }
    }

    /// What was set for a time rests, unless it is set anew.
    pub(super) fn end_set(&mut self, places: &[u8], next: &Action) {
        let again: &[Setting] = match next {
            Action::Set { settings, .. } => settings,
            _ => &[],
        };
        let robot = self.robot.clone();
        for place in places {
            let Some(element) = robot.model().elements().get(usize::from(*place)) else {
                continue;
            };
            if again.iter().all(|setting| setting.element != element.name) {
                self.write_safe(*place, element);
            }
        }
    }
}
