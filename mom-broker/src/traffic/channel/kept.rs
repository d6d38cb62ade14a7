//! What a channel keeps for those who come later, and gives to them.

use std::sync::Arc;

use mom_hub::Route;
use mom_proto::Parcel;
use mom_system::Clock;

use super::State;
use crate::traffic::history::History;
use crate::traffic::outbox::Outbox;
use crate::traffic::replay::Replay;

impl State {
    /// A copy of a message that is for later too.
    pub(super) fn to_keep(&self, parcel: &Parcel) -> Option<Parcel> {
        let guarded = self.route.guard.as_ref();
        let guarded = guarded.is_some_and(|guard| guard.covers(&parcel.name));
        let kept = self.history.is_some() && !guarded && History::covers(parcel);
        kept.then(|| parcel.clone())
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
        // The guard may have come after what is kept.
        let guard = self.route.guard.as_ref();
        let unguarded = |parcel: &Parcel| guard.is_none_or(|guard| !guard.covers(&parcel.name));
        let kept = history.snapshot(clock.now(), unguarded);
        if kept.is_empty() {
            return Vec::new();
        }
        for outbox in &new {
            let replay = Replay::new(self.route.number, Arc::clone(&kept), self.encoder.another());
            outbox.push(replay.into_packet(outbox.account().as_ref()));
        }
        new
    }
}
