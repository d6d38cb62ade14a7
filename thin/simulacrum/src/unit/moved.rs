//! What may have moved, and what is measured of it: by that, and by nothing that was intended, a mirrored robot rests.

use std::collections::BTreeSet;

use mom_client::{Map, Value};
use mom_device::{DeviceTime, Sample};
use mom_rsp::Kind;

use super::arrival::{NEAR, measured};
use crate::Simulacrum;

/// Effectors that may have moved since the robot rested last.
#[derive(Debug, Default, Clone)]
pub(super) struct Moved {
    places: BTreeSet<u8>,
    /// When one of them last did.
    at: DeviceTime,
}

impl Moved {
    /// Something new begins: what moved longer ago than it takes to stand has come to rest meanwhile.
    pub(super) fn begin(&mut self, now: DeviceTime, stopping_time: DeviceTime) {
        if now.saturating_sub(self.at) > stopping_time {
            self.places.clear();
        }
    }

    /// One moves now.
    pub(super) fn one(&mut self, place: u8, now: DeviceTime) {
        self.places.insert(place);
        self.at = now;
    }

    /// Any may move now: nobody says what a command moves.
    pub(super) fn all(&mut self, robot: &Simulacrum, now: DeviceTime) {
        for (place, element) in (0..).zip(robot.model().elements()) {
            if element.kind == Kind::Effector && !element.quantities.is_empty() {
                self.one(place, now);
            }
        }
    }

    /// It moves on.
    pub(super) fn goes_on(&mut self, now: DeviceTime) {
        self.at = now;
    }

    /// The measurements of all that can move; none if something that may have moved has none. `position` is that of the wheels,
    /// which these effectors turn.
    pub(super) fn sample(
        &self,
        robot: &Simulacrum,
        position: Map,
        wheels: &[u8],
        at: DeviceTime,
    ) -> Option<Sample> {
        let is_known = |place: &u8| match wheels.contains(place) {
            true => !position.is_empty(),
            false => measured(robot, *place).is_some(),
        };
        if !self.places.iter().all(is_known) {
            return None;
        }
        let mut all = position;
        for place in 0..robot.model().elements().len() {
            let Ok(place) = u8::try_from(place) else { break };
            let Some((values, monitor)) = measured(robot, place) else {
                continue;
            };
            for (part, value) in values.into_iter().enumerate() {
                let quantity = monitor.quantity(part);
                let range = quantity.map_or(1.0, |quantity| quantity.max - quantity.min);
                // What is near by its range is so by the tolerance of the robot.
                let scaled = value / (range * NEAR) * super::TOLERANCE;
                all.set(&format!("{} {part}", monitor.name), Value::Double(scaled));
            }
        }
        Sample::of(&all, at)
    }
}
