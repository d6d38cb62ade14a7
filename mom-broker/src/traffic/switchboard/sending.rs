//! Messages: one by one, as runs, and those for which a receiver had no capacity.

use std::sync::Arc;
use std::time::Duration;

use mom_hub::{Input, PeerId, Receivers, Route};
use mom_net::Reader;
use mom_proto::{Code, Family, Limits, Map, Micros, Parcel, Path, WireError};

use super::{Switchboard, Touched, flush};
use crate::traffic::capacity::{NoCapacity, WaitingMessage, no_capacity};
use crate::traffic::channel::{Channel, HUB_PEER, Message, Outcome, Sender, Unsent, Why, run_ahead, stamped};
use crate::traffic::outbox::{Outbox, WaiterHandle};
use crate::traffic::trace;

/// What became of a message that was not refused.
#[derive(Debug)]
pub(crate) enum Handled {
    /// Its receivers have it, or the hub has.
    Done,
    /// It has to wait for capacity; nobody has it.
    Waits(Box<WaitingMessage>),
}

impl Switchboard {
    /// A message of a peer: by the channel's route if a verdict stands, else by the hub.
    ///
    /// # Errors
    /// Why it was refused.
    pub(crate) fn message(
        &self,
        sender: &Sender<'_>,
        limits: &Limits,
        parcel: Box<Parcel>,
        touched: &mut Touched,
    ) -> Result<Handled, WireError> {
        self.send(sender, limits, (parcel, None), touched)
    }

    /// Looks again whether a message can go that has waited for capacity: all that had to hold for it has to hold still.
    ///
    /// # Errors
    /// As [`Switchboard::message`], and `try-later` if there was no capacity for as long as its sender may wait.
    pub(crate) fn resume(
        &self,
        sender: &Sender<'_>,
        limits: &Limits,
        held: WaitingMessage,
        touched: &mut Touched,
    ) -> Result<Handled, WireError> {
        let waited = Some((held.since, held.place));
        self.send(sender, limits, (held.parcel, waited), touched)
    }

    /// Sends the plain messages that lie in front of a reader, as long as they are alike, and takes them from it.
    /// False if there are none, or if what lies there needs [`Switchboard::message`]; nothing is taken then.
    pub(crate) fn run(&self, sender: &Sender<'_>, reader: &mut Reader, touched: &mut Touched) -> bool {
        let channel = run_ahead(reader).and_then(|number| self.channel(number));
        let outcome = channel.map(|channel| channel.send(sender, Message::Run(reader), &self.clock));
        let Some(Outcome::Sent(sent)) = outcome else {
            return false;
        };
        self.settle(sender.peer, sent, touched);
        true
    }

    /// Says something in the hub's own name to all members of a channel, and to those who come later; false if there is no such
    /// channel.
    pub(crate) fn say(&self, path: &Path, name: &str, content: Map) -> bool {
        let number = self.by_path.get(path).map(|number| *number);
        let Some((number, channel)) = number.and_then(|number| Some((number, self.channel(number)?))) else {
            return false;
        };
        let mut parcel = Parcel::new(Family::Message, name)
            .context(path.clone())
            .content(content);
        parcel.number = Some(number);
        parcel.received = Some(self.clock.wall());
        let parcel = Box::new(stamped(parcel, self.clock.wall()));
        let route = channel.route();
        let mut touched = Touched::new();
        let message = Message::Admitted(parcel, &route, Receivers::All, None);
        self.send_admitted(HUB_PEER, message, &channel, &mut touched);
        flush(&mut touched);
        true
    }

    /// Sends a message that the hub has admitted.
    pub(super) fn send_admitted(
        &self,
        from: PeerId,
        message: Message<'_>,
        channel: &Channel,
        touched: &mut Touched,
    ) {
        let sender = Sender {
            peer: from,
            clock: &|_| None,
            late: false,
            read: None,
        };
        match channel.send(&sender, message, &self.clock) {
            Outcome::Sent(sent) => self.settle(from, sent, touched),
            Outcome::Unsent(unsent) => {
                let error = unsent.why.error(&unsent.route.path);
                self.note_refused(from, &unsent.route, &unsent.message, &error);
                self.tell(from, error.to_parcel(unsent.reference), touched);
            }
            Outcome::Consult(..) | Outcome::NoRun => {}
        }
    }

    fn send(
        &self,
        sender: &Sender<'_>,
        limits: &Limits,
        (parcel, waited): (Box<Parcel>, Option<(Micros, WaiterHandle)>),
        touched: &mut Touched,
    ) -> Result<Handled, WireError> {
        let span = trace::span(&parcel, sender.peer);
        let begin = if span.is_disabled() { 0 } else { self.clock.now() };
        let sent = span.in_scope(|| self.try_send(sender, limits, (parcel, waited), touched));
        if !span.is_disabled() {
            let result = match &sent {
                Ok(Handled::Done) => "passed on",
                Ok(Handled::Waits(_)) => "waits for capacity",
                Err(_) => "refused",
            };
            trace::end(&span, result, self.clock.now().saturating_sub(begin));
        }
        sent
    }

    fn try_send(
        &self,
        sender: &Sender<'_>,
        limits: &Limits,
        (parcel, waited): (Box<Parcel>, Option<(Micros, WaiterHandle)>),
        touched: &mut Touched,
    ) -> Result<Handled, WireError> {
        let peer = sender.peer;
        let outcome = match self.channel_of(&parcel) {
            Some(channel) => channel.send(sender, Message::One(parcel, waited), &self.clock),
            None => Outcome::Consult(parcel, (sender.clock)(self.clock.now())),
        };
        match outcome {
            Outcome::Sent(sent) => self.settle(peer, sent, touched),
            Outcome::Consult(parcel, clock) => {
                self.decide(Input::Request { peer, parcel, clock }, touched);
            }
            Outcome::Unsent(Unsent {
                why, route, message, ..
            }) => {
                let held = match why {
                    Why::Refused(error) => Err(error),
                    Why::Full(full, since) => self.hold(limits, *full, &route.path, since),
                };
                return held.inspect_err(|error| self.note_refused(peer, &route, &message, error));
            }
            Outcome::NoRun => {}
        }
        Ok(Handled::Done)
    }

    /// A message without capacity: it waits on, unless it has done so for long enough. A receiver that has made no room
    /// for too long is closed, and is not a hindrance any more.
    fn hold(
        &self,
        limits: &Limits,
        full: NoCapacity,
        path: &Path,
        since: Micros,
    ) -> Result<Handled, WireError> {
        let now = self.clock.now();
        let wait = Duration::from_millis(limits.send_wait);
        let end = since.saturating_add(millis(limits.send_wait));
        let NoCapacity { parcel, place, slow } = full;
        let full_since = place.full_since();
        let stalled_at = full_since.map(|since| since.saturating_add(millis(limits.stalled)));
        if stalled_at.is_some_and(|at| at <= now) {
            self.close_stalled(place.outbox(), path);
        } else if end <= now {
            let waited = Duration::from_micros(now.saturating_sub(since));
            return Err(no_capacity(&slow, path, Some(waited), wait));
        }
        Ok(Handled::Waits(Box::new(WaitingMessage {
            parcel,
            since,
            until: stalled_at.map_or(end, |at| at.min(end)),
            place,
        })))
    }

    fn close_stalled(&self, outbox: &Outbox, path: &Path) {
        tracing::info!(peer = outbox.peer.0, context = %path, "stalled receiver closed");
        let text = "this peer's outbox was full, and it did not read fast enough for waiting senders";
        self.close(outbox, Some(WireError::new(Code::SLOW_RECEIVER, text)));
    }

    /// Writes down a message that was refused without the hub.
    fn note_refused(&self, peer: PeerId, route: &Route, message: &Arc<str>, error: &WireError) {
        let name = self.outbox(peer).map(|outbox| outbox.name());
        self.tap.refused((peer, name), route, message, error);
    }
}

fn millis(millis: u64) -> Micros {
    millis.saturating_mul(1000)
}
