//! What stops mean for the arm.

use mom_client::{Event, Family, Map, Parcel, Reaction, event};

use mom_device::{Rest, Sample};

use super::RobotServer;
use crate::ArmTime;

/// mm and degrees by which the hand's pose differs from that before, at most, while it rests.
const TOLERANCE: f64 = 0.5;

impl RobotServer {
    /// Says what it is called at the hub, so that it can stop itself there.
    pub fn set_name(&mut self, name: String) {
        self.name = Some(name);
    }

    /// Does what an event about stops means.
    pub(super) fn react(&mut self, event: &Event, reaction: Reaction, now: ArmTime, out: &mut Vec<Parcel>) {
        match reaction {
            Reaction::Stop(reason) => {
                // It always measures: without the link to its controller it is not said to rest.
                let rest = self
                    .rest
                    .get_or_insert_with(|| Rest::new(TOLERANCE, ArmTime::MAX));
                if self.arm.is_busy() {
                    rest.disturb(now);
                }
                self.obey_stop(out, |arm, events| arm.stop(now, &reason, events));
            }
            Reaction::Free => {
                self.rest = None;
                self.obey_stop(out, |arm, events| arm.unstop(now, events));
            }
            Reaction::Halt if matches!(event, Event::LinkDown) => {
                self.halt("the link to the hub was lost", now, out);
            }
            Reaction::Halt => self.obey_stop(out, |arm, events| {
                arm.halt(now, "a stop has come that was lifted before", events);
            }),
            Reaction::Same => self.report(out),
        }
        if matches!(event, Event::Lagged(_)) {
            self.tell_own_stop(out);
        }
    }

    /// Says that it rests, once it does since it was stopped.
    pub(super) fn watch_rest(&mut self, out: &mut Vec<Parcel>) {
        let stands = self.arm.stands();
        let Some(rest) = &mut self.rest else { return };
        let before = rest.known();
        match stands {
            true => {
                let state = self.arm.state();
                let pose = state.pose;
                let numbers = vec![
                    pose.x,
                    pose.y,
                    pose.z,
                    pose.spin,
                    pose.tilt,
                    state.gripper.opening,
                ];
                rest.observe(Some(Sample::new(numbers, self.now)), self.now);
            }
            false => rest.disturb(self.now),
        }
        if rest.known().is_some() && rest.known() != before {
            self.report(out);
        }
    }

    /// Tells the hub that it has stopped itself, if the hub does not know: from then on it is a stop like any other.
    pub(super) fn tell_own_stop(&self, out: &mut Vec<Parcel>) {
        let Some(name) = self.name.as_deref().filter(|_| self.latch.is_own()) else {
            return;
        };
        let reason = self.latch.may_move().err().map(|held| held.to_string());
        let content = Map::new().with("reason", reason.unwrap_or_default());
        let mut stop = Parcel::new(Family::Message, event::STOP)
            .context(self.channel.clone())
            .content(content);
        stop.address = Some(vec![name.into()]);
        out.push(stop);
    }
}
