//! Messages for a receiver that asked for fewer.

use std::sync::Arc;

use mom_net::{DropReason, Taken};
use mom_proto::{ContextNumber, Micros};

use super::PeerQueue;
use super::thinner::Thinned;
use crate::traffic::outbox::packet::Packet;

impl PeerQueue {
    /// Takes in a message of which the receiver wants the newest only, and one in `interval` µs at most. None: it waits for
    /// its time, and there is nothing to write before.
    pub(crate) fn push_thinned(
        &mut self,
        packet: Arc<Packet>,
        interval: Micros,
        now: Micros,
    ) -> Option<Taken> {
        if self.is_too_late(&packet) {
            return Some(Taken::Dropped);
        }
        if interval == 0 {
            return Some(self.queue.push(packet));
        }
        let capacity = (self.queue.charge(&packet), self.queue.limit());
        let thinner = self.thinner.get_or_insert_default();
        let (thinned, replaced) = thinner.offer(packet, capacity, interval, now);
        if let Some(replaced) = replaced {
            self.queue.note_dropped(&replaced, DropReason::Rate);
        }
        match thinned {
            Thinned::Now(packet) => Some(self.queue.push(packet)),
            Thinned::Later => None,
            Thinned::Full(packet) => {
                self.queue.note_dropped(&packet, DropReason::Full);
                Some(Taken::Dropped)
            }
        }
    }

    /// When the next of what thinning holds back may leave.
    pub(crate) fn due(&self) -> Option<Micros> {
        self.thinner.as_ref().and_then(|thinner| thinner.due())
    }

    /// Lets go what thinning has held back for long enough.
    pub(super) fn release_due(&mut self, now: Micros) {
        if self.due().is_some_and(|at| at <= now) {
            let released = self.thinner.as_mut().map(|thinner| thinner.release(now));
            released.into_iter().flatten().for_each(|packet| {
                self.queue.push(packet);
            });
        }
    }

    /// Lets go what thinning holds back of a channel, for a member that wants something else from now on.
    pub(crate) fn release_thinned(&mut self, channel: ContextNumber) {
        let held = self.thinner.as_mut().map(|thinner| thinner.forget(Some(channel)));
        held.into_iter().flatten().for_each(|packet| {
            self.queue.push(packet);
        });
    }

    /// Drops what thinning holds back of a channel that was left, or of all, and gives it: nobody hears it any more.
    pub(crate) fn drop_thinned(&mut self, channel: Option<ContextNumber>) -> Vec<Arc<Packet>> {
        let held = self.thinner.as_mut().map(|thinner| thinner.forget(channel));
        let held: Vec<_> = held.into_iter().flatten().collect();
        for packet in &held {
            self.queue.note_dropped(packet, DropReason::Closed);
        }
        held
    }
}
