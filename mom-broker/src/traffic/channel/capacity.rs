//! Whether all receivers of a message have capacity, in channels where its sender waits if not.

use std::sync::Arc;
use std::time::Duration;

use mom_hub::{PeerId, Receivers, receivers};
use mom_net::{Item, Lane};
use mom_proto::codec::Form;
use mom_proto::{Delivery, Overflow, Parcel, Path, WireError};

use super::send::Why;
use super::{Positions, State, lane_of};
use crate::traffic::capacity::{NoCapacity, WhenFull, no_capacity};
use crate::traffic::outbox::{Outbox, Packet, WaiterHandle};

/// What a message needs, about, besides its content.
const SLOTS: usize = 256;

/// When to try again where nobody has waited, as long as a sender waits by default.
const RETRY: Duration = Duration::from_secs(1);

/// The names of receivers without capacity.
type Slow = Vec<Arc<str>>;

/// A message that needs capacity.
struct Demand<'a> {
    positions: &'a Positions<'a>,
    sender: PeerId,
    /// Those who want the newest only always have capacity for it.
    thinnable: bool,
    bytes: &'a dyn Fn(Option<Form>) -> usize,
}

impl Why {
    /// The error for a sender that does not wait.
    pub(crate) fn error(self, path: &Path) -> WireError {
        match self {
            Why::Refused(error) => error,
            Why::Full(full, _) => no_capacity(&full.slow, path, None, RETRY),
        }
    }
}

impl State {
    /// Whether a message of this lane and class waits where a receiver has no capacity.
    pub(super) fn waits(&self, lane: Lane, delivery: Delivery) -> bool {
        self.route.overflow == Overflow::Wait
            && delivery == Delivery::Reliable
            && matches!(lane, Lane::Data(_))
    }

    /// Finds capacity for a packet at all of its receivers; gives the place that its sender has had among the waiters,
    /// to be kept until the packet is put in.
    pub(super) fn claim(
        &self,
        packet: &Packet,
        positions: &Positions<'_>,
        parcel: Box<Parcel>,
        when_full: WhenFull,
    ) -> Result<Option<WaiterHandle>, Why> {
        let demand = Demand {
            positions,
            sender: packet.origin.sender,
            thinnable: packet.may_be_thinned(),
            bytes: &|form| packet.charge(form),
        };
        match when_full {
            WhenFull::Wait(mut place, since) => match (self.wait(&demand, &mut place), place) {
                (Err(slow), Some(place)) => {
                    Err(Why::Full(Box::new(NoCapacity { parcel, place, slow }), since))
                }
                (_, place) => Ok(place),
            },
            WhenFull::Refuse => {
                let full =
                    |(_, outbox): &(usize, &Arc<Outbox>)| !outbox.could_take((demand.bytes)(outbox.form()));
                let slow: Slow = self
                    .bound_to_have_it(&demand)
                    .filter(full)
                    .map(|(at, _)| self.name(at))
                    .collect();
                match slow.is_empty() {
                    true => Ok(None),
                    false => Err(no_capacity(&slow, &self.route.path, None, RETRY).into()),
                }
            }
        }
    }

    /// Has all senders that wait for a member look again.
    pub(super) fn call_waiting(&self) {
        if self.route.overflow == Overflow::Wait {
            self.outboxes
                .iter()
                .flatten()
                .for_each(|outbox| outbox.call_all());
        }
    }

    /// Before the hub is asked about a message: whether there is capacity for it, as far as can be said before it is
    /// encoded. What the hub will refuse is not a question of capacity.
    pub(super) fn foresee_capacity(
        &self,
        sender: PeerId,
        parcel: Box<Parcel>,
        mut place: Option<WaiterHandle>,
    ) -> Result<Box<Parcel>, Box<NoCapacity>> {
        let delivery = parcel.delivery.unwrap_or(self.route.delivery);
        // Who is not a member any more waits for nobody: the hub says why not.
        if !self.waits(lane_of(&parcel, false), delivery) || self.route.position(sender).is_none() {
            return Ok(parcel);
        }
        let Ok(receivers) = receivers(&self.route, sender, &parcel) else {
            return Ok(parcel);
        };
        let size = SLOTS + parcel.size();
        let guard = self.route.guard.as_ref();
        let demand = Demand {
            positions: &self.positions(&receivers),
            sender,
            thinnable: guard.is_none_or(|guard| !guard.covers(&parcel.name)),
            bytes: &|_| size,
        };
        match (self.wait(&demand, &mut place), place) {
            (Err(slow), Some(place)) => Err(Box::new(NoCapacity { parcel, place, slow })),
            _ => Ok(parcel),
        }
    }

    /// How many bytes all receivers have capacity for.
    pub(super) fn capacity_left(&self, receivers: &Receivers) -> usize {
        let positions = self.positions(receivers);
        let outboxes = positions.iter().filter_map(|at| self.outboxes[at].as_ref());
        outboxes
            .map(|outbox| outbox.capacity_left())
            .min()
            .unwrap_or(usize::MAX)
    }

    pub(super) fn positions<'a>(&self, receivers: &'a Receivers) -> Positions<'a> {
        Positions {
            receivers,
            count: self.outboxes.len(),
        }
    }

    /// Waits at the first receiver without capacity; gives the names of all of those, if there are any.
    fn wait(&self, demand: &Demand<'_>, place: &mut Option<WaiterHandle>) -> Result<(), Slow> {
        let mut slow = Vec::new();
        for (at, outbox) in self.bound_to_have_it(demand) {
            let need = (demand.bytes)(outbox.form());
            // At one outbox at a time: two who wait for each other's places would both wait in vain.
            let full = match slow.is_empty() {
                true => outbox.wait_for(need, place),
                false => outbox.is_full_for(need),
            };
            if full {
                slow.push(self.name(at));
            }
        }
        if slow.is_empty() { Ok(()) } else { Err(slow) }
    }

    /// The receivers that must have capacity.
    fn bound_to_have_it(&self, demand: &Demand<'_>) -> impl Iterator<Item = (usize, &Arc<Outbox>)> {
        let thins = self.thins && demand.thinnable;
        demand.positions.iter().filter_map(move |at| {
            let member = &self.route.members[at];
            let thinned = thins && member.thinning.thins() && member.peer != demand.sender;
            let outbox = self.outboxes[at].as_ref().filter(|_| !thinned)?;
            Some((at, outbox))
        })
    }

    fn name(&self, at: usize) -> Arc<str> {
        Arc::clone(&self.route.members[at].facts.name)
    }
}
