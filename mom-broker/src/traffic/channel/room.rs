//! Whether all receivers of a message have room, in channels where its sender waits if not.

use std::sync::Arc;

use mom_hub::{PeerId, Receivers, receivers};
use mom_proto::codec::Form;
use mom_proto::{Content, Delivery, Overflow, Parcel};

use super::{Inner, Places, RETRY, Undelivered, lane_of};
use crate::traffic::capacity::{Full, Room, no_room};
use crate::traffic::outbox::{Lane, Outbox, Packet, Place};

/// What a message needs, about, besides its content.
const SLOTS: usize = 256;

/// The names of receivers without room.
type Slow = Vec<Arc<str>>;

/// A message that looks for room.
struct Seeker<'a> {
    places: &'a Places<'a>,
    sender: PeerId,
    /// Those who want the newest only always have room for it.
    thinnable: bool,
    bytes: &'a dyn Fn(Option<Form>) -> usize,
}

impl Inner {
    /// Whether a message of this lane and class waits where a receiver has no room.
    pub(super) fn waits(&self, lane: Lane, delivery: Delivery) -> bool {
        self.route.overflow == Overflow::Wait
            && delivery == Delivery::Reliable
            && matches!(lane, Lane::Data(_))
    }

    /// Finds room for a packet at all of its receivers; gives the place that its sender has had in a line, to be kept
    /// until the packet is put in.
    pub(super) fn claim(
        &self,
        packet: &Packet,
        places: &Places<'_>,
        parcel: Box<Parcel>,
        room: Room,
    ) -> Result<Option<Place>, Undelivered> {
        let seeker = Seeker {
            places,
            sender: packet.origin.sender,
            thinnable: packet.may_be_thinned(),
            bytes: &|form| packet.charge(form),
        };
        match room {
            Room::Waits(mut place) => match (self.line_up(&seeker, &mut place), place) {
                (Err(slow), Some(place)) => Err(Undelivered::Full(Box::new(Full { parcel, place, slow }))),
                (_, place) => Ok(place),
            },
            Room::Whole => {
                let full =
                    |(_, outbox): &(usize, &Arc<Outbox>)| !outbox.could_take((seeker.bytes)(outbox.form()));
                let slow: Slow = self
                    .asked(&seeker)
                    .filter(full)
                    .map(|(at, _)| self.name(at))
                    .collect();
                match slow.is_empty() {
                    true => Ok(None),
                    false => Err(no_room(&slow, &self.route.path, None, RETRY).into()),
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

    /// Before the hub is asked about a message: whether there is room for it, as far as can be said before it is
    /// encoded. What the hub will refuse is no question of room.
    pub(crate) fn foresee_room(
        &self,
        sender: PeerId,
        parcel: Box<Parcel>,
        mut place: Option<Place>,
    ) -> Result<Box<Parcel>, Box<Full>> {
        let delivery = parcel.delivery.unwrap_or(self.route.delivery);
        if !self.waits(lane_of(&parcel), delivery) {
            return Ok(parcel);
        }
        let Ok(receivers) = receivers(&self.route, sender, &parcel) else {
            return Ok(parcel);
        };
        let size = SLOTS + parcel.content.as_ref().map_or(0, Content::size);
        let guard = self.route.guard.as_ref();
        let seeker = Seeker {
            places: &self.places(&receivers),
            sender,
            thinnable: guard.is_none_or(|guard| !guard.covers(&parcel.name)),
            bytes: &|_| size,
        };
        match (self.line_up(&seeker, &mut place), place) {
            (Err(slow), Some(place)) => Err(Box::new(Full { parcel, place, slow })),
            _ => Ok(parcel),
        }
    }

    /// How many bytes all receivers have room for.
    pub(crate) fn room_left(&self, receivers: &Receivers) -> usize {
        let places = self.places(receivers);
        let outboxes = places.iter().filter_map(|place| self.outboxes[place].as_ref());
        outboxes
            .map(|outbox| outbox.room_left())
            .min()
            .unwrap_or(usize::MAX)
    }

    pub(super) fn places<'a>(&self, receivers: &'a Receivers) -> Places<'a> {
        Places {
            receivers,
            count: self.outboxes.len(),
        }
    }

    fn line_up(&self, seeker: &Seeker<'_>, place: &mut Option<Place>) -> Result<(), Slow> {
        let mut slow = Vec::new();
        for (at, outbox) in self.asked(seeker) {
            let need = (seeker.bytes)(outbox.form());
            // In one line at a time: two who wait for each other's places would both wait in vain.
            let full = match slow.is_empty() {
                true => outbox.line_up(need, place),
                false => outbox.is_full_for(need),
            };
            if full {
                slow.push(self.name(at));
            }
        }
        if slow.is_empty() { Ok(()) } else { Err(slow) }
    }

    /// The receivers that have to have room.
    fn asked(&self, seeker: &Seeker<'_>) -> impl Iterator<Item = (usize, &Arc<Outbox>)> {
        let thins = self.thins && seeker.thinnable;
        seeker.places.iter().filter_map(move |at| {
            let member = &self.route.members[at];
            let thinned = thins && member.thinning.thins() && member.peer != seeker.sender;
            let outbox = self.outboxes[at].as_ref().filter(|_| !thinned)?;
            Some((at, outbox))
        })
    }

    fn name(&self, at: usize) -> Arc<str> {
        Arc::clone(&self.route.members[at].facts.name)
    }
}
