//! What waits to be written: stops, control, then messages by their priority, large ones in chunks between which
//! what is more urgent goes; as the hub's outbox does it for the other direction (design §7).

mod entry;
mod take;

use std::cmp::Reverse;
use std::collections::{BTreeMap, VecDeque};
use std::ops::AddAssign;
use std::sync::Arc;

use mom_net::Outgoing;
use mom_proto::{Family, Parcel, Path, Verb};

pub(crate) use entry::{Entry, Lane, Message};
use take::Open;
pub(crate) use take::{Knife, Piece};

/// The queues of one link. Control is bounded by what a peer asks at a time; for messages their senders wait for room, but for
/// stops, of which one waits for each context.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    stop: VecDeque<Arc<Entry>>,
    /// Pings and pongs, which nothing is ordered by and whose delay is what they measure.
    signs: VecDeque<Arc<Entry>>,
    control: VecDeque<Arc<Entry>>,
    data: BTreeMap<Reverse<i32>, VecDeque<Arc<Entry>>>,
    /// Of which chunks were given to the link; at most one of each urgency.
    open: Vec<Open>,
    /// Streams of chunks that the hub has to be told to forget.
    aborts: VecDeque<u64>,
    /// What the link has taken a part of.
    begun: Option<Piece>,
    last_stream: u64,
    /// Messages that were ever put in.
    put: u64,
    finished: bool,
    now: Mark,
}

/// What has become of an outbox: what a writer took before that changed is not what waits now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Mark {
    /// Links that were lost.
    pub(crate) link: u64,
    /// How often everything was forgotten.
    clears: u64,
}

/// What was not put back.
#[derive(Debug)]
pub(crate) enum Returned {
    /// A stop came after it.
    Overruled(Overruled),
    /// Everything was forgotten meanwhile, and this message with it.
    Lost(Arc<Entry>),
}

/// Room for messages, in units of 1 KiB.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Room {
    /// Of messages of no or low priority.
    pub(crate) usual: usize,
    /// Of more urgent ones: who waits for the usual room is not waited for.
    pub(crate) urgent: usize,
}

impl AddAssign for Room {
    fn add_assign(&mut self, other: Room) {
        self.usual += other.usual;
        self.urgent += other.urgent;
    }
}

/// An `unstop` that will not be sent, because a `stop` came after it.
#[derive(Debug)]
pub(crate) struct Overruled {
    pub(crate) id: Option<u64>,
    /// Whom it would have been told, if nobody waits for its answer.
    pub(crate) path: Option<Path>,
    pub(crate) room: Room,
}

impl Outbox {
    pub(crate) fn push_control(&mut self, parcel: &Parcel, outgoing: Outgoing) {
        let lane = match parcel.family {
            Family::Time => Lane::Sign,
            _ => Lane::Control,
        };
        // Control overtakes messages; but who gives up a token or a channel has sent these before.
        let after = if gives_up(parcel) { self.put } else { 0 };
        let entry = Arc::new(Entry::control(parcel, lane, after, outgoing));
        match lane {
            Lane::Sign => self.signs.push_back(entry),
            _ => self.control.push_back(entry),
        }
    }

    /// Takes in a message; gives what it overrules.
    pub(crate) fn push_message(&mut self, parcel: &Parcel, message: Message) -> Vec<Overruled> {
        match Verb::of(parcel.family, parcel.name()) {
            Ok(Verb::Stop) => return self.push_stop(parcel, message),
            // Nothing that was said to a device at rest may reach it when it moves again.
            Ok(Verb::Unstop) => {
                let entry = Entry::message(parcel, Lane::Control, self.put, message);
                self.control.push_back(Arc::new(entry));
            }
            _ => {
                self.put += 1;
                let priority = parcel.priority.unwrap_or_default();
                let entry = Entry::message(parcel, Lane::Data(priority), self.put, message);
                let lane = self.data.entry(Reverse(priority)).or_default();
                lane.push_back(Arc::new(entry));
            }
        }
        Vec::new()
    }

    /// Nothing follows what waits now.
    pub(crate) fn finish(&mut self) {
        self.finished = true;
    }

    /// Whether nothing should follow what waits.
    pub(crate) fn is_finished(&self) -> bool {
        self.finished
    }

    /// To be told again with what is put back.
    pub(crate) fn mark(&self) -> Mark {
        self.now
    }

    /// Whether nothing waits.
    pub(crate) fn is_empty(&self) -> bool {
        let queues = [&self.stop, &self.signs, &self.control];
        queues
            .into_iter()
            .chain(self.data.values())
            .all(VecDeque::is_empty)
            && self.open.is_empty()
            && self.aborts.is_empty()
            && self.begun.is_none()
    }

    /// Whether something waits that no load may hold back.
    pub(crate) fn is_urgent(&self) -> bool {
        !self.stop.is_empty() || !self.signs.is_empty()
    }

    /// Forgets everything, as the peer is another one from now on, on this link or, if that is gone, the next; gives
    /// the messages.
    pub(crate) fn clear(&mut self, link_is_gone: bool) -> Vec<Arc<Entry>> {
        self.now.clears += 1;
        self.now.link += u64::from(link_is_gone);
        self.control.retain(|entry| entry.is_message());
        self.signs.clear();
        let mut messages: Vec<Arc<Entry>> = self.stop.drain(..).chain(self.control.drain(..)).collect();
        messages.extend(std::mem::take(&mut self.data).into_values().flatten());
        for open in self.open.drain(..) {
            self.aborts.push_back(open.stream);
            messages.push(open.entry);
        }
        if link_is_gone {
            self.aborts.clear();
            let begun = self.begun.take().filter(|piece| piece.last);
            messages.extend(begun.and_then(Piece::into_entry));
        }
        messages.retain(|entry| entry.is_message());
        messages
    }

    // A second stop of a context says nothing that the first does not, unless somebody waits for its answer. But it
    // overrules an unstop that still waits: stops leave first, so that would undo the later word by the earlier one.
    fn push_stop(&mut self, parcel: &Parcel, message: Message) -> Vec<Overruled> {
        let entry = Entry::message(parcel, Lane::Stop, 0, message);
        let mut overruled = Vec::new();
        self.control.retain(|waiting| {
            let goes = waiting.is_message() && waiting.is_for_same_as(&entry);
            if goes {
                overruled.push(waiting.overruled());
            }
            !goes
        });
        let same = |waiting: &Arc<Entry>| waiting.is_for_same_as(&entry) && waiting.address == entry.address;
        if entry.is_awaited() || !self.stop.iter().any(same) {
            self.stop.push_back(Arc::new(entry));
        }
        overruled
    }
}

fn gives_up(parcel: &Parcel) -> bool {
    match (parcel.family, parcel.name()) {
        (Family::Context, "leave" | "delete") | (Family::Login, "logout") => true,
        (Family::Token, "release" | "give") => true,
        // An owner's answer to who asked; that to an offer gives nothing up.
        (Family::Token, "accept") => parcel.value().get("peer").is_some(),
        _ => false,
    }
}

#[cfg(test)]
mod tests;
