//! Plain messages of one sender that go through a channel together (docs/performance.md).

use std::sync::Arc;

use mom_hub::{Budget, PeerId, Receivers, Usage};
use mom_proto::binary::Run;
use mom_proto::{Delivery, Parcel};

use super::{Delivered, Inner};
use crate::traffic::encodings::Encodings;
use crate::traffic::outbox::{Lane, Origin, Packet};

impl Inner {
    /// Whether plain messages may go through here as a run: nobody needs another form or
    /// only some of them, and nothing is kept.
    pub(crate) fn takes_runs(&self) -> bool {
        self.binary && !self.thins && self.history.is_none()
    }

    /// What a member has used of its rate.
    pub(crate) fn usage(&self, peer: PeerId) -> Usage {
        self.used.get(&peer).cloned().unwrap_or_default()
    }

    /// Charges a member for a run.
    pub(crate) fn settle(&mut self, peer: PeerId, budget: &Budget) {
        self.used.entry(peer).or_default().settle(budget);
    }

    /// Counts a message of a run.
    pub(crate) fn note_sent(&mut self, sender: Option<usize>, size: usize, age: Option<i64>) {
        self.figures.sent(sender, size, age);
    }

    /// Puts a run of a member's messages into the outboxes; all of them were admitted as `stamped` was.
    pub(crate) fn deliver_run(
        &mut self,
        sender: PeerId,
        run: Run,
        stamped: &Parcel,
        receivers: &Receivers,
        now: u64,
    ) -> Delivered {
        let count = run.count();
        let packet = Arc::new(Packet {
            encodings: Encodings::of_run(run.finish()),
            lane: Lane::Data(stamped.priority.unwrap_or_default()),
            delivery: Delivery::Reliable,
            origin: Origin {
                context: self.route.number,
                sender,
                name: Arc::clone(&stamped.name),
            },
            expires_at: None,
            gate: stamped.fence.map(|fence| (Arc::clone(&self.gate), fence)),
            count,
        });
        self.put(&packet, &self.places(receivers), now)
    }
}
