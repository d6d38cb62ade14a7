//! What stops mean for the arm.

use mom_client::{Event, Family, Map, Parcel, Reaction, event};

use super::RobotServer;
use crate::ArmTime;

impl RobotServer {
    /// Says what it is called at the hub, so that it can stop itself there.
    pub fn set_name(&mut self, name: String) {
        self.name = Some(name);
    }

    /// Does what an event about stops means.
    pub(super) fn react(&mut self, event: &Event, reaction: Reaction, now: ArmTime, out: &mut Vec<Parcel>) {
        match reaction {
            Reaction::Stop(reason) => self.obey_stop(out, |arm, events| arm.stop(now, &reason, events)),
            Reaction::Free => self.obey_stop(out, |arm, events| arm.unstop(now, events)),
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
