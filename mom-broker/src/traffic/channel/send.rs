//! The one way into a channel: admit, charge, encode once for each form, put into the outboxes.

use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use bytes::Bytes;
use mom_hub::{Admission, Alike, Ingress, PeerClock, PeerId, Receivers, Route, Usage, admit};
use mom_managers::Rate;
use mom_net::Lane;
use mom_net::Reader;
use mom_proto::binary::{ParcelRun, Plain};
use mom_proto::{
    Code, Content, ContextNumber, Delivery, Fence, Map, Micros, Overflow, Parcel, ReadCount, STOP, WireError,
    outlives_loss,
};
use mom_system::Clock;

use super::{Channel, Delivered, State, expires_at, lane_of};
use crate::traffic::capacity::{NoCapacity, WhenFull};
use crate::traffic::encodings::Encodings;
use crate::traffic::memory::Account;
use crate::traffic::outbox::{Charged, Origin, Packet, WaiterHandle};
use crate::traffic::statistics::measures;

/// Bytes of messages that are admitted and passed on together, while a channel's lock is held.
const RUN: usize = 128 * 1024;

/// Larger content is not copied, so it does not go in a run.
const SMALL: usize = 8 * 1024;

/// A stop with more goes out without it.
pub(crate) const LARGEST_STOP: usize = 4 * 1024;

/// Who sends, as its connection knows it.
#[derive(Clone, Copy)]
pub(crate) struct Sender<'a> {
    pub(crate) peer: PeerId,
    /// Its clock at a time of the hub.
    pub(crate) clock: &'a dyn Fn(Micros) -> Option<PeerClock>,
    /// What it says now was said before it lost its connection.
    pub(crate) late: bool,
    /// Counts the messages of a run, where both ends count.
    pub(crate) read: Option<&'a Cell<ReadCount>>,
}

impl Sender<'_> {
    fn count(&self, plain: &Plain<'_>) {
        if let Some(read) = self.read {
            let mut count = read.get();
            count.count(Some(plain.checksum_word()));
            read.set(count);
        }
    }
}

/// What is to be sent.
pub(crate) enum Message<'a> {
    /// One message, and since when and where it has waited for capacity.
    One(Box<Parcel>, Option<(Micros, WaiterHandle)>),
    /// One that the hub has admitted, to these members of this route.
    Admitted(Box<Parcel>, &'a Route, Receivers, Option<Rate>),
    /// The plain messages in front of a reader, as long as they are alike: they leave it only as they are sent.
    Run(&'a mut Reader),
}

/// What became of it.
pub(crate) enum Outcome {
    /// It is in the outboxes of its receivers.
    Sent(Sent),
    /// No verdict stands for it: the hub has to decide.
    Consult(Box<Parcel>, Option<PeerClock>),
    /// Nobody has it.
    Unsent(Unsent),
    /// What lies in front of the reader does not go as a run.
    NoRun,
}

/// A message, or a run of them, that is in the outboxes of its receivers.
pub(crate) struct Sent {
    pub(crate) delivered: Delivered,
    pub(crate) route: Arc<Route>,
    /// The reference of the receipt that was asked for.
    pub(crate) receipt: Option<Option<u64>>,
    /// The id of a single message.
    pub(crate) reference: Option<u64>,
}

/// A message that nobody has.
pub(crate) struct Unsent {
    pub(crate) why: Why,
    pub(crate) route: Arc<Route>,
    /// Its name.
    pub(crate) message: Arc<str>,
    /// Its id.
    pub(crate) reference: Option<u64>,
}

/// Why nobody has a message.
#[derive(Debug)]
pub(crate) enum Why {
    Refused(WireError),
    /// A receiver has no capacity; since when the message waits.
    Full(Box<NoCapacity>, Micros),
}

/// An admitted message on its way into the outboxes.
struct Admitted {
    parcel: Parcel,
    receivers: Receivers,
    rate: Option<Rate>,
    now: Micros,
    when_full: WhenFull,
}

impl Channel {
    /// Sends a message, or a run of messages, in the critical section of this channel: all receivers see one order (M27).
    ///
    /// Every message is admitted by the hub's own [`admit`] on the present route, charged to its sender's rate, counted,
    /// and put into the outboxes of its receivers. In a run the first is admitted so; the others differ from it only in
    /// stamps and content, and what [`admit`] makes of these is what [`Alike`] says.
    pub(crate) fn send(&self, sender: &Sender<'_>, message: Message<'_>, clock: &Clock) -> Outcome {
        let message = self.prepared(message);
        let mut state = self.state.lock();
        match message {
            Message::One(parcel, waited) => state.send_one(sender, parcel, waited, clock),
            Message::Admitted(parcel, route, receivers, rate) => {
                // The same input may have taken members out after this was admitted.
                let receivers = state.translate(route, receivers);
                let admitted = Admitted {
                    parcel: *parcel,
                    receivers,
                    rate,
                    now: clock.now(),
                    when_full: WhenFull::Refuse,
                };
                state.deliver(sender.peer, admitted)
            }
            Message::Run(reader) => state.send_run(sender, reader, clock),
        }
    }

    /// Does before the critical section what takes time in proportion to the size of a message.
    fn prepared<'a>(&self, message: Message<'a>) -> Message<'a> {
        let own = |parcel: &mut Parcel| {
            // Or little that is kept would hold much that was read with it and is not.
            if !self.keeps.load(Ordering::Relaxed) {
                return;
            }
            match &mut parcel.content {
                Some(Content::Encoded(bytes)) => *bytes = Bytes::copy_from_slice(bytes),
                Some(Content::Packed(packed)) => packed.own(),
                Some(Content::Value(_)) | None => {}
            }
        };
        match message {
            Message::One(mut parcel, waited) => {
                own(&mut parcel);
                Message::One(parcel, waited)
            }
            Message::Admitted(mut parcel, route, receivers, rate) => {
                own(&mut parcel);
                Message::Admitted(parcel, route, receivers, rate)
            }
            run @ Message::Run(_) => run,
        }
    }
}

impl State {
    fn send_one(
        &mut self,
        sender: &Sender<'_>,
        mut parcel: Box<Parcel>,
        waited: Option<(Micros, WaiterHandle)>,
        clock: &Clock,
    ) -> Outcome {
        let (since, place) = waited.unzip();
        // Inside the critical section, so that hub time never runs against the channel's order.
        let ingress = ingress(sender, since, clock);
        let (message, reference) = (Arc::clone(&parcel.name), parcel.id);
        if let Some(error) = self.too_late(sender, &parcel) {
            return self.unsent(Why::Refused(error), message, reference);
        }
        match admit(&self.route, sender.peer, &mut parcel, &ingress) {
            Ok(Admission::Pass(receivers, rate)) => {
                let now = ingress.now;
                let admitted = Admitted {
                    parcel: *parcel,
                    receivers,
                    rate,
                    now,
                    when_full: WhenFull::Wait(place, since.unwrap_or(now)),
                };
                self.deliver(sender.peer, admitted)
            }
            // The hub's lock is not a place to wait, so there is capacity before it is asked.
            Ok(Admission::Consult) => match self.foresee_capacity(sender.peer, parcel, place) {
                Ok(parcel) => Outcome::Consult(parcel, ingress.clock),
                Err(full) => self.unsent(Why::Full(full, since.unwrap_or(ingress.now)), message, reference),
            },
            Err(error) => self.unsent(Why::Refused(error), message, reference),
        }
    }

    /// Why a message may not come after its sender's loss, and the safe state that this has caused.
    fn too_late(&self, sender: &Sender<'_>, parcel: &Parcel) -> Option<WireError> {
        if !sender.late {
            return None;
        }
        let guard = self.route.guard.as_ref();
        if let Some(guard) = guard.filter(|guard| guard.covers(&parcel.name)) {
            let text = format!(
                "it was sent before the connection was lost, and the safe state of {} has gone out since",
                guard.token
            );
            return Some(WireError::new(Code::OLDER_FENCE, text).detail("fence", Fence::from(guard.fence)));
        }
        (!outlives_loss(parcel, false)).then(said_before_the_loss)
    }

    fn deliver(&mut self, sender: PeerId, admitted: Admitted) -> Outcome {
        let receipt = (admitted.parcel.receipt == Some(true)).then_some(admitted.parcel.id);
        let (message, reference) = (Arc::clone(&admitted.parcel.name), admitted.parcel.id);
        match self.try_deliver(sender, admitted) {
            Ok(delivered) => self.sent(delivered, receipt, reference),
            Err(why) => self.unsent(why, message, reference),
        }
    }

    /// Encodes an admitted message once for each form and puts it into the outboxes.
    fn try_deliver(&mut self, sender: PeerId, admitted: Admitted) -> Result<Delivered, Why> {
        let Admitted {
            mut parcel,
            receivers,
            rate,
            now,
            when_full,
        } = admitted;
        let lane = lane_of(&parcel, parcel.fence.is_some());
        let shortened = (lane == Lane::Stop && shorten(&mut parcel)).then_some(parcel.id);
        // Stops and unstops are never refused for load.
        let rate = rate.filter(|_| matches!(lane, Lane::Data(_)));
        let (size, age) = measures(&parcel);
        let unused = rate
            .map(|rate| self.charge(sender, &rate, size, now))
            .transpose()?;
        let delivery = parcel.delivery.unwrap_or(self.route.delivery);
        let waiting = self.waits(lane, delivery).then(|| Box::new(parcel.clone()));
        let origin = self.origin(sender, &parcel.name);
        let outlives_loss = outlives_loss(&parcel, parcel.fence.is_some());
        // A device must halt also if its operator's clock is wrong.
        let expires_at = expires_at(&parcel, now).filter(|_| lane != Lane::Stop);
        let gate = parcel.fence.map(|fence| (Arc::clone(&self.gate), fence));
        let kept = self.to_keep(&parcel);
        let positions = self.positions(&receivers);
        let outboxes = &self.outboxes;
        let form = |at: usize| outboxes[at].as_ref().map(|outbox| outbox.form());
        let forms = positions.iter().filter_map(form);
        let encodings = self.encoder.encode(parcel, forms)?;
        let (place, account) = self.place_and_account(sender);
        let packet = Arc::new(Packet {
            charged: Charged::to(account.as_ref(), &encodings),
            encodings,
            lane,
            delivery,
            origin,
            expires_at,
            gate,
            count: 1,
            counts: true,
            outlives_loss,
        });
        let claimed = waiting.map(|parcel| self.claim(&packet, &positions, parcel, when_full));
        // Given up when all is put in, so that the next one sees it.
        let _place = claimed.transpose().inspect_err(|_| {
            if let Some(usage) = unused {
                self.used.insert(sender, usage);
            }
        })?;
        if let (Some(history), Some(parcel)) = (&mut self.history, kept) {
            history.note(sender, parcel, now, account.as_ref());
        }
        self.statistics.sent(place, size, age);
        let delivered = self.put(&packet, &positions, now);
        Ok(Delivered {
            shortened,
            ..delivered
        })
    }

    /// Sends the plain messages in front of a reader that differ from the first in stamps and content only.
    fn send_run(&mut self, sender: &Sender<'_>, reader: &mut Reader, clock: &Clock) -> Outcome {
        let peer = sender.peer;
        let Some(mut first) = reader.plain_head().filter(|_| self.takes_runs()) else {
            return Outcome::NoRun;
        };
        if !matches!(lane_of(&first, false), Lane::Data(_)) {
            return Outcome::NoRun;
        }
        let ingress = ingress(sender, None, clock);
        // What is refused, asked about or of another class is decided, told and counted where single messages are.
        let Ok(Admission::Pass(receivers, rate)) = admit(&self.route, peer, &mut first, &ingress) else {
            return Outcome::NoRun;
        };
        if first.delivery.unwrap_or(self.route.delivery) != Delivery::Reliable {
            return Outcome::NoRun;
        }
        let alike = Alike::new(&self.route, peer, &first.name, &ingress);
        let most = match self.route.overflow {
            Overflow::Close => RUN,
            // What finds no capacity waits as a single message.
            Overflow::Wait => self.capacity_left(&receivers).min(RUN),
        };
        let used = self.used.get(&peer).cloned().unwrap_or_default();
        let mut budget = rate.map(|rate| used.budget(&rate, ingress.now));
        let position = self.route.position(peer);
        let reserve = (reader.waiting() * 3 / 2).min(most) + 256;
        let mut run: Option<ParcelRun> = None;
        while let Some(plain) = reader.plain().filter(is_small) {
            let run = run.get_or_insert_with(|| ParcelRun::begin(&plain, &first, reserve));
            let length = plain.length();
            if !run.takes(&plain) || run.length() >= RUN || run.length() + length > most {
                break;
            }
            let Some(age) = alike.age(plain.timestamp()) else {
                break;
            };
            let size = plain.content_length() + first.name.len();
            if budget.as_mut().is_some_and(|budget| !budget.take(size)) {
                break;
            }
            run.push(&plain, age);
            sender.count(&plain);
            self.statistics.sent(position, size, first.age_error.map(|_| age));
            reader.consume(length);
        }
        let Some(run) = run.filter(|run| run.count() > 0) else {
            return Outcome::NoRun;
        };
        if let Some(budget) = budget {
            self.used.entry(peer).or_default().settle(&budget);
        }
        let count = run.count();
        let encodings = Encodings::of_run(run.finish());
        let packet = Arc::new(Packet {
            charged: Charged::to(self.place_and_account(peer).1.as_ref(), &encodings),
            encodings,
            lane: lane_of(&first, first.fence.is_some()),
            delivery: Delivery::Reliable,
            origin: self.origin(peer, &first.name),
            expires_at: None,
            gate: first.fence.map(|fence| (Arc::clone(&self.gate), fence)),
            count,
            counts: true,
            outlives_loss: outlives_loss(&first, first.fence.is_some()),
        });
        let delivered = self.put(&packet, &self.positions(&receivers), ingress.now);
        self.sent(delivered, None, None)
    }

    /// Whether plain messages may go through here as a run: nobody needs another form or only some of them, nothing is
    /// kept, and whatever is small enough for a run is within what receivers take, with all slots and stamps.
    fn takes_runs(&self) -> bool {
        self.binary && !self.thins && self.history.is_none() && self.encoder.allows(2 * SMALL)
    }

    /// Where a sender is among the members, and what its messages are charged to; none of both if it has left.
    fn place_and_account(&self, sender: PeerId) -> (Option<usize>, Option<Arc<Account>>) {
        let place = self.route.position(sender);
        let outbox = place.and_then(|place| self.outboxes[place].as_ref());
        (place, outbox.and_then(|outbox| outbox.account()))
    }

    /// Charges a message to its sender's rate; gives what was used before.
    fn charge(&mut self, sender: PeerId, rate: &Rate, size: usize, now: Micros) -> Result<Usage, WireError> {
        let usage = self.used.entry(sender).or_default();
        let before = usage.clone();
        usage.charge(rate, size, now)?;
        Ok(before)
    }

    fn origin(&self, sender: PeerId, name: &Arc<str>) -> Origin {
        Origin {
            context: self.route.number,
            sender,
            name: Arc::clone(name),
        }
    }

    fn sent(&self, delivered: Delivered, receipt: Option<Option<u64>>, reference: Option<u64>) -> Outcome {
        let route = Arc::clone(&self.route);
        Outcome::Sent(Sent {
            delivered,
            route,
            receipt,
            reference,
        })
    }

    fn unsent(&self, why: Why, message: Arc<str>, reference: Option<u64>) -> Outcome {
        let route = Arc::clone(&self.route);
        Outcome::Unsent(Unsent {
            why,
            route,
            message,
            reference,
        })
    }
}

impl From<WireError> for Why {
    fn from(error: WireError) -> Why {
        Why::Refused(error)
    }
}

/// Why nothing comes of what moves a device, lets it move or changes who drives it, and was said before its sender's loss.
pub(crate) fn said_before_the_loss() -> WireError {
    let text =
        "it was sent before the connection was lost, and comes too late: say it again if it is still meant";
    WireError::new(Code::TOO_LATE, text)
}

/// For a message that is here now, and has been since then if it had to wait.
fn ingress(sender: &Sender<'_>, since: Option<Micros>, clock: &Clock) -> Ingress {
    let now = clock.now();
    Ingress {
        now,
        wall: clock.wall_at(now),
        clock: (sender.clock)(now),
        waited: since.map_or(0, |since| now.saturating_sub(since)),
    }
}

/// Takes from a stop what makes it large: it has to get through when nothing else does. Its number stays, by which a device knows it from
/// one that was lifted before.
fn shorten(parcel: &mut Parcel) -> bool {
    let large = parcel.size() > LARGEST_STOP;
    if large {
        let number = parcel.extra.get(STOP).cloned();
        (parcel.content, parcel.extra) = (None, Map::new());
        if let Some(number) = number {
            parcel.extra.set(STOP, number);
        }
    }
    large
}

/// The channel of the plain messages in front of a reader, if they are small enough for a run.
pub(crate) fn run_ahead(reader: &mut Reader) -> Option<ContextNumber> {
    reader.plain().filter(is_small).map(|plain| plain.number())
}

fn is_small(plain: &Plain<'_>) -> bool {
    plain.content_length() <= SMALL
}
