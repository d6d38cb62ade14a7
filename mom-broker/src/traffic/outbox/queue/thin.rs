//! Messages for a receiver that wants fewer.

use std::sync::Arc;

use mom_managers::Micros;
use mom_proto::ContextNumber;

use super::turns::Offered;
use super::{Queue, Taken};
use crate::traffic::outbox::packet::{DropReason, Entry, Packet};

impl Queue {
    /// Takes in a message of which the receiver wants the newest only, and one in `interval` µs at most.
    pub(crate) fn push_thinned(&mut self, packet: Arc<Packet>, interval: Micros, now: Micros) -> Taken {
        if interval == 0 {
            return self.push(packet);
        }
        let room = (self.size(&packet), self.limit);
        let turns = self.turns.get_or_insert_default();
        let (offered, replaced) = turns.offer(packet, room, interval, now);
        if let Some(replaced) = replaced {
            self.note(&Entry::new(replaced), DropReason::Rate);
        }
        match offered {
            Offered::Now(packet) => self.push(packet),
            Offered::Later => Taken::Later,
            Offered::Full(packet) => {
                self.note(&Entry::new(packet), DropReason::Full);
                Taken::Dropped
            }
        }
    }

    /// When the next turn comes for which something waits.
    pub(crate) fn due(&self) -> Option<Micros> {
        self.turns.as_ref().and_then(|turns| turns.due())
    }

    /// Lets those go whose turn has come.
    pub(crate) fn take_turns(&mut self, now: Micros) {
        if self.due().is_some_and(|at| at <= now) {
            let released = self.turns.as_mut().map(|turns| turns.release(now));
            released.into_iter().flatten().for_each(|packet| {
                self.push(packet);
            });
        }
    }

    /// Ends all turns of a channel, for a member that wants something else from now on: what waited for them goes now.
    pub(crate) fn hand_out_turns(&mut self, channel: ContextNumber) {
        let held = self.turns.as_mut().map(|turns| turns.forget(Some(channel)));
        held.into_iter().flatten().for_each(|packet| {
            self.push(packet);
        });
    }

    /// Ends all turns of a channel that was left, or of all: nobody hears any more what waited for them.
    pub(crate) fn drop_turns(&mut self, channel: Option<ContextNumber>) {
        let held = self.turns.as_mut().map(|turns| turns.forget(channel));
        for packet in held.into_iter().flatten() {
            self.note(&Entry::new(packet), DropReason::Closed);
        }
    }
}
