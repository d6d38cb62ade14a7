//! What a channel keeps for those who come later, and gives to them.

use std::sync::Arc;

use bytes::Bytes;
use mom_hub::Route;
use mom_net::Lane;
use mom_proto::{Content, Delivery, Parcel};
use mom_system::Clock;

use super::{State, expires_at, hub_origin};
use crate::traffic::encodings::Encodings;
use crate::traffic::history::History;
use crate::traffic::outbox::{Outbox, Packet};

impl State {
    /// A copy of a message that is for later too. Its content is copied out of what was read with it, or little that is
    /// kept would hold much that is not.
    pub(super) fn to_keep(&self, parcel: &Parcel) -> Option<Parcel> {
        let guarded = self.route.guard.as_ref();
        let guarded = guarded.is_some_and(|guard| guard.covers(&parcel.name));
        if self.history.is_none() || guarded || !History::covers(parcel) {
            return None;
        }
        let mut copy = parcel.clone();
        if let Some(Content::Encoded(bytes)) = &copy.content {
            copy.content = Some(Content::Encoded(Bytes::copy_from_slice(bytes)));
        }
        Some(copy)
    }

    /// After a change of the route: forgets what is not kept any more, and gives to who is new what is kept.
    pub(super) fn follow_history(&mut self, old: &Route, clock: &Clock) -> Vec<Arc<Outbox>> {
        let known = self.history.as_ref().map(|history| *history.keep());
        if known != self.route.keep {
            self.history = self.route.keep.map(History::new);
        }
        let Some(history) = &mut self.history else {
            return Vec::new();
        };
        let left = old.members.iter().map(|member| member.peer);
        for peer in left.filter(|peer| self.route.position(*peer).is_none()) {
            history.leave(peer);
        }
        let members = self.route.members.iter().zip(&self.outboxes);
        let new = members.filter(|(member, _)| old.position(member.peer).is_none());
        let new: Vec<Arc<Outbox>> = new.filter_map(|(_, outbox)| outbox.clone()).collect();
        if new.is_empty() {
            return new;
        }
        let now = clock.now();
        let guard = self.route.guard.as_ref();
        for parcel in history.give(now, clock.wall_at(now)) {
            // The guard may have come after it.
            if guard.is_some_and(|guard| guard.covers(&parcel.name)) {
                continue;
            }
            let lane = Lane::Data(parcel.priority.unwrap_or_default());
            let (origin, expires_at) = (hub_origin(&parcel), expires_at(&parcel, now));
            let forms = new.iter().map(|outbox| outbox.form());
            // What a form cannot hold was refused when it came, or its receivers were of other forms then.
            let Ok(encodings) = Encodings::with(parcel, forms, self.bounds, &mut self.scratch) else {
                continue;
            };
            let packet = Arc::new(Packet {
                encodings,
                lane,
                // Who cannot take it all has the newest.
                delivery: Delivery::Fleeting,
                origin,
                expires_at,
                gate: None,
                count: 1,
            });
            for outbox in &new {
                outbox.push(Arc::clone(&packet));
            }
        }
        new
    }
}
