//! A stop of a session is also for devices that were there before and are away with their channels, such as those that a
//! gateway makes: they find it when they come back.

use mom_proto::{ContextKind, Path, Verb};

use super::call::NAMED;
use crate::Effect;
use crate::asking::wish::Wish;
use crate::world::World;
use crate::world::steps::Sweep;
use crate::world::stops::{Kept, Order, Storing};

impl World {
    /// The next channel of a session that had a device and is not there.
    pub(super) fn next_away(&self, sweep: &mut Sweep) -> Option<Path> {
        if sweep.order.verb != Verb::Stop {
            return None;
        }
        let exists = |path: &Path| self.tree.find(path).is_some();
        let away = sweep
            .away
            .get_or_insert_with(|| self.stops.away_below(&sweep.top, exists));
        std::iter::from_fn(|| away.pop()).find(|path| !exists(path))
    }

    /// Stops what comes back to a channel that is not there, where the peer has the right to.
    pub(super) fn stop_away(&mut self, order: &Order, path: Path, out: &mut Vec<Effect>) {
        let above = std::iter::successors(path.parent(), Path::parent);
        let Some(at) = above
            .filter_map(|above| self.tree.find(&above))
            .map(|above| above.number)
            .next()
        else {
            return;
        };
        let wish = Wish {
            path: Some(&path),
            kind: Some(ContextKind::Channel),
            message: Some(order.verb.word()),
            ..Wish::new(order.verb, at)
        };
        if self.ask(order.peer, &wish, &[]).is_err() {
            return;
        }
        let number = self.stops.next(&path, self.settings.epoch);
        let Some(stop) = self.stop_by(order.peer, number, order.reason.clone()) else {
            return;
        };
        self.stops.latch_mut(&path).issue(stop, None);
        let kept = if self.settings.keeps_stops {
            Kept::Waits
        } else {
            Kept::No
        };
        if let Some(call) = self.stops.calls.get_mut(&order.call) {
            match call.channels.len() + call.away.len() < NAMED {
                true => drop(call.away.insert(path.clone(), (number, kept))),
                false => call.others += 1,
            }
        }
        let storing = Storing::Away {
            call: order.call,
            channel: path.clone(),
        };
        self.keep_record(self.stops.record(&path), Some(storing), out);
        self.audit_stop(order.peer, path, (number, order.reason.as_deref()), out);
    }

    /// The stop of a channel that is not there is kept, or will never be.
    pub(super) fn note_away(&mut self, call: u64, channel: &Path, kept: Kept, out: &mut Vec<Effect>) {
        let known = self.stops.calls.get_mut(&call);
        if let Some((_, known)) = known.and_then(|known| known.away.get_mut(channel)) {
            *known = kept;
        }
        self.settle_call(call, out);
    }
}
