//! Messages: one by one, as runs, and those for which some receiver had no room.

use std::sync::Arc;
use std::time::Duration;

use mom_hub::{Admission, Alike, Ingress, Input, PeerClock, PeerId, Route, admit};
use mom_managers::Micros;
use mom_net::Reader;
use mom_proto::binary::{Plain, Run};
use mom_proto::{Code, Delivery, Limits, Overflow, Parcel, Verb, WireError};

use super::{Switchboard, Touched, receipt_of};
use crate::traffic::capacity::{Full, Held, Room, no_room};
use crate::traffic::channel::Undelivered;
use crate::traffic::outbox::{Outbox, Place};

/// Bytes of messages that are admitted and passed on together, while a channel's lock is held.
const RUN: usize = 128 * 1024;

/// Larger content is not copied, so it does not go in a run.
const SMALL: usize = 8 * 1024;

/// Who sends, as its connection knows it.
#[derive(Clone, Copy)]
pub(crate) struct Sender<'a> {
    pub(crate) peer: PeerId,
    /// Its clock at a time of the hub.
    pub(crate) clock: &'a dyn Fn(Micros) -> Option<PeerClock>,
    pub(crate) limits: &'a Limits,
}

/// What became of a message that was not refused.
#[derive(Debug)]
pub(crate) enum Sent {
    /// Its receivers have it, or the hub has.
    Taken,
    /// It has to wait for room; nobody has it.
    Waits(Box<Held>),
}

/// Since when a message waits, and its sender's place in a line.
type Waited = (Micros, Place);

impl Switchboard {
    /// A message of a peer: by the channel's route if a verdict stands, else by the hub.
    ///
    /// # Errors
    /// Why it was refused.
    pub(crate) fn message(
        &self,
        sender: &Sender<'_>,
        parcel: Box<Parcel>,
        touched: &mut Touched,
    ) -> Result<Sent, WireError> {
        self.send(sender, parcel, None, touched)
    }

    /// Looks again whether a message can go that has waited for room: all that had to hold for it has to hold still.
    ///
    /// # Errors
    /// As [`Switchboard::message`], and `try-later` if there was no room for as long as its sender may wait.
    pub(crate) fn resume(
        &self,
        sender: &Sender<'_>,
        held: Held,
        touched: &mut Touched,
    ) -> Result<Sent, WireError> {
        self.send(sender, held.parcel, Some((held.since, held.place)), touched)
    }

    fn send(
        &self,
        sender: &Sender<'_>,
        mut parcel: Box<Parcel>,
        waited: Option<Waited>,
        touched: &mut Touched,
    ) -> Result<Sent, WireError> {
        let peer = sender.peer;
        let Some(channel) = self.channel_of(&parcel) else {
            let clock = (sender.clock)(self.clock.now());
            self.decide(Input::Request { peer, parcel, clock }, touched);
            return Ok(Sent::Taken);
        };
        let (since, place) = waited.unzip();
        let mut inner = channel.lock();
        // Inside the critical section, so that hub time never runs against the channel's order.
        let ingress = self.ingress(sender, since);
        let now = ingress.now;
        let message = Arc::clone(&parcel.name);
        let admission = admit(&inner.route, peer, &mut parcel, &ingress);
        let admission = admission.inspect_err(|error| self.note_refused(peer, &inner.route, &message, error));
        let undelivered = match admission? {
            Admission::Consult => {
                // The hub's lock is no place to wait, so there is room before it is asked.
                match inner.foresee_room(peer, parcel, place) {
                    Ok(parcel) => {
                        drop(inner);
                        let clock = ingress.clock;
                        self.decide(Input::Request { peer, parcel, clock }, touched);
                        return Ok(Sent::Taken);
                    }
                    Err(full) => Undelivered::Full(full),
                }
            }
            Admission::Pass(receivers, rate) => {
                let receipt = receipt_of(&parcel);
                match inner.deliver(peer, *parcel, &receivers, rate, now, Room::Waits(place)) {
                    Ok(delivered) => {
                        let path = inner.route.path.clone();
                        drop(inner);
                        self.settle(peer, receipt, &path, delivered, touched);
                        return Ok(Sent::Taken);
                    }
                    Err(undelivered) => undelivered,
                }
            }
        };
        let route = Arc::clone(&inner.route);
        drop(inner);
        let result = match undelivered {
            Undelivered::Refused(error) => Err(error),
            Undelivered::Full(full) => self.hold(sender, *full, &route, since.unwrap_or(now)),
        };
        result.inspect_err(|error| self.note_refused(peer, &route, &message, error))
    }

    /// A message without room: it waits on, unless it has done so for long enough. A receiver that has made no room
    /// for too long is closed, and is no hindrance any more.
    fn hold(&self, sender: &Sender<'_>, full: Full, route: &Route, since: Micros) -> Result<Sent, WireError> {
        let now = self.clock.now();
        let wait = Duration::from_millis(sender.limits.send_wait);
        let end = since.saturating_add(millis(sender.limits.send_wait));
        let Full { parcel, place, slow } = full;
        let full_since = place.full_since();
        let stalled_at = full_since.map(|since| since.saturating_add(millis(sender.limits.stalled)));
        if stalled_at.is_some_and(|at| at <= now) {
            self.close_stalled(place.outbox(), &route.path);
        } else if end <= now {
            let waited = Duration::from_micros(now.saturating_sub(since));
            return Err(no_room(&slow, &route.path, Some(waited), wait));
        }
        Ok(Sent::Waits(Box::new(Held {
            parcel,
            since,
            until: stalled_at.map_or(end, |at| at.min(end)),
            place,
        })))
    }

    fn close_stalled(&self, outbox: &Outbox, path: &mom_proto::Path) {
        tracing::info!(peer = outbox.peer.0, context = %path, "stalled receiver closed");
        let text =
            "what waited for this peer filled its share, and it made no room for those who waited to send";
        self.close(outbox, Some(WireError::new(Code::SLOW_RECEIVER, text)));
    }

    /// Passes on the plain messages that lie in front of a reader, as long as they are alike, and takes them from it.
    /// False if there are none, or if what lies there needs [`Switchboard::message`]; nothing is taken then.
    pub(crate) fn run(&self, sender: &Sender<'_>, reader: &mut Reader, touched: &mut Touched) -> bool {
        let peer = sender.peer;
        let Some(number) = reader.plain().filter(is_small).map(|plain| plain.number()) else {
            return false;
        };
        let Some(channel) = self.channels.get(&number).map(|channel| Arc::clone(&channel)) else {
            return false;
        };
        let Some(mut stamped) = reader.plain_head() else {
            return false;
        };
        let mut inner = channel.lock();
        if !inner.takes_runs() || Verb::of(stamped.family, &stamped.name).is_ok_and(is_urgent) {
            return false;
        }
        let ingress = self.ingress(sender, None);
        let admission = admit(&inner.route, peer, &mut stamped, &ingress);
        // All else is decided, told and counted where single messages are.
        let Ok(Admission::Pass(receivers, rate)) = admission else {
            return false;
        };
        if stamped.delivery.unwrap_or(inner.route.delivery) != Delivery::Reliable {
            return false;
        }
        let place = inner.route.position(peer);
        let alike = Alike::new(&inner.route, peer, &stamped.name, &ingress);
        let most = match inner.route.overflow {
            Overflow::Close => RUN,
            // What finds no room waits as a single message.
            Overflow::Wait => inner.room_left(&receivers).min(RUN),
        };
        let room = (reader.waiting() * 3 / 2).min(most) + 256;
        let mut budget = rate.map(|rate| inner.usage(peer).budget(&rate, ingress.now));
        let mut run: Option<Run> = None;
        while let Some(plain) = reader.plain().filter(is_small) {
            let run = run.get_or_insert_with(|| Run::begin(&plain, &stamped, room));
            let length = plain.length();
            if !run.takes(&plain) || run.length() >= RUN || run.length() + length > most {
                break;
            }
            let Some(age) = alike.age(plain.timestamp()) else {
                break;
            };
            let size = plain.content_length();
            if budget.as_mut().is_some_and(|budget| !budget.take(size)) {
                break;
            }
            run.push(&plain, age);
            inner.note_sent(place, size, stamped.age_error.map(|_| age));
            reader.consume(length);
        }
        let Some(run) = run.filter(|run| run.count() > 0) else {
            return false;
        };
        if let Some(budget) = budget {
            inner.settle(peer, &budget);
        }
        let delivered = inner.deliver_run(peer, run, &stamped, &receivers, ingress.now);
        let path = inner.route.path.clone();
        drop(inner);
        self.settle(peer, None, &path, delivered, touched);
        true
    }

    /// For a message that is here now, and has been since then if it had to wait.
    fn ingress(&self, sender: &Sender<'_>, since: Option<Micros>) -> Ingress {
        let now = self.clock.now();
        Ingress {
            now,
            wall: self.clock.wall_at(now),
            clock: (sender.clock)(now),
            waited: since.map_or(0, |since| now.saturating_sub(since)),
        }
    }

    /// Writes down a message that was refused without the hub.
    pub(super) fn note_refused(&self, peer: PeerId, route: &Route, message: &Arc<str>, error: &WireError) {
        let name = self.outbox(peer).map(|outbox| outbox.name());
        self.tap.refused((peer, name), route, message, error);
    }
}

fn millis(millis: u64) -> Micros {
    millis.saturating_mul(1000)
}

fn is_small(plain: &Plain<'_>) -> bool {
    plain.content_length() <= SMALL
}

fn is_urgent(verb: Verb) -> bool {
    matches!(verb, Verb::Stop | Verb::Unstop)
}
