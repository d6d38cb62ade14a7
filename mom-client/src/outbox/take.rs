//! What leaves next, and in which pieces.

use std::cmp::Reverse;
use std::collections::VecDeque;
use std::io::IoSlice;
use std::sync::Arc;

use mom_net::{Outgoing, Part};
use mom_proto::Limit;
use mom_proto::binary::STREAMS;

use super::{Entry, Lane, Mark, Outbox, Returned, Room};

/// A parcel of which chunks were given to the link.
#[derive(Debug)]
pub(super) struct Open {
    pub(super) entry: Arc<Entry>,
    /// The bytes that its chunks carried.
    sent: usize,
    pub(super) stream: u64,
}

/// How pieces are to be cut.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Knife {
    /// A frame of more bytes goes in chunks.
    pub(crate) most: usize,
    /// The largest parcel that the hub takes; all that go to it in chunks at a time together too.
    pub(crate) parcel: Limit,
}

impl Knife {
    /// For links whose form has no chunks.
    pub(crate) fn blunt() -> Knife {
        Knife {
            most: usize::MAX,
            parcel: Limit::Unlimited,
        }
    }
}

/// What is given to the link at once.
#[derive(Debug)]
pub(crate) struct Piece {
    /// None where a stream is given up.
    entry: Option<Arc<Entry>>,
    part: Part,
    /// What its parcel's chunks had carried before it, and the stream they go in.
    before: usize,
    stream: Option<u64>,
    /// Nothing of its parcel comes after it.
    pub(super) last: bool,
}

impl Piece {
    fn whole(entry: Arc<Entry>) -> Piece {
        Piece {
            part: Part::plain(0..entry.length()),
            entry: Some(entry),
            before: 0,
            stream: None,
            last: true,
        }
    }

    fn abort(stream: u64) -> Piece {
        Piece {
            entry: None,
            part: Part::abort(stream),
            before: 0,
            stream: Some(stream),
            last: true,
        }
    }

    /// The bytes that are not written yet.
    pub(crate) fn left(&self) -> usize {
        self.part.left()
    }

    pub(crate) fn is_begun(&self) -> bool {
        self.part.is_begun()
    }

    /// The room that is free again when it has left.
    pub(crate) fn room(&self) -> Room {
        let entry = self.entry.as_ref().filter(|_| self.last);
        entry.map_or_else(Room::default, |entry| entry.room())
    }

    /// What it carries, for a peer in this process.
    pub(crate) fn parcel(&self) -> Option<&Arc<mom_proto::Parcel>> {
        match &self.entry.as_ref()?.outgoing {
            Outgoing::Parcel(parcel) => Some(parcel),
            Outgoing::Encoded(_) => None,
        }
    }

    pub(crate) fn append_to<'a>(&'a self, slices: &mut Vec<IoSlice<'a>>) {
        let frame = match self.entry.as_ref().map(|entry| &entry.outgoing) {
            Some(Outgoing::Encoded(frame)) => Some(frame),
            _ => None,
        };
        self.part.append_to(frame, slices);
    }

    /// Counts written bytes; gives back how many were not its own.
    pub(crate) fn advance(&mut self, written: usize) -> usize {
        self.part.advance(written)
    }

    pub(super) fn into_entry(self) -> Option<Arc<Entry>> {
        self.entry
    }

    /// A message that will not be sent; of one that was open its chunks are not what tells it.
    fn lost(self) -> Option<Returned> {
        let entry = self.entry.filter(|entry| self.last && entry.is_message());
        entry.map(Returned::Lost)
    }
}

impl Outbox {
    /// What the link has begun to take: it goes on with that.
    pub(crate) fn take_begun(&mut self) -> Option<Piece> {
        self.begun.take()
    }

    /// The next piece for the link.
    pub(crate) fn pop(&mut self, knife: Knife) -> Option<Piece> {
        if let Some(urgent) = self.pop_urgent() {
            return Some(urgent);
        }
        if let Some(stream) = self.aborts.pop_front() {
            return Some(Piece::abort(stream));
        }
        let open = (0..self.open.len()).max_by_key(|at| self.open[*at].entry.lane);
        let waiting = self.front_lane();
        match (open, waiting) {
            // What was begun goes on before another of the same urgency begins.
            (Some(at), waiting)
                if Some(self.open[at].entry.lane) >= waiting
                    || waiting.is_some_and(|lane| !self.may_begin(lane, knife)) =>
            {
                let open = self.open.remove(at);
                Some(self.cut(open.entry, open.sent, Some(open.stream), knife))
            }
            (_, Some(lane)) => {
                let entry = self.lane(lane)?.pop_front()?;
                self.data.retain(|_, lane| !lane.is_empty());
                Some(self.cut(entry, 0, None, knife))
            }
            (_, None) => None,
        }
    }

    /// The next piece that no load may hold back: a stop, or a sign of life.
    pub(crate) fn pop_urgent(&mut self) -> Option<Piece> {
        let entry = self.stop.pop_front().or_else(|| self.signs.pop_front());
        entry.map(Piece::whole)
    }

    /// Puts back, in front, what was taken and not written: what the link has begun to take stays the next, all else is
    /// looked at again, so that what is more urgent can overtake it. `taken` is the mark when it was taken. Gives what
    /// will not be sent after all. Several are put back the last one first.
    pub(crate) fn put_back(&mut self, piece: Piece, taken: Mark) -> Option<Returned> {
        if self.now.link != taken.link {
            return piece.lost();
        }
        if piece.is_begun() {
            self.begun = Some(piece);
            return None;
        }
        if self.now != taken && piece.entry.is_some() {
            return self.forget(piece);
        }
        let Some(entry) = piece.entry else {
            self.aborts.extend(piece.stream);
            return None;
        };
        if !piece.last {
            self.open.retain(|open| !Arc::ptr_eq(&open.entry, &entry));
        }
        match piece.stream.filter(|_| piece.before > 0) {
            Some(stream) => self.open.push(Open {
                entry,
                sent: piece.before,
                stream,
            }),
            None => match entry.lane {
                Lane::Stop => self.stop.push_front(entry),
                Lane::Sign => self.signs.push_front(entry),
                Lane::Control if entry.is_message() && self.is_stopped(&entry) => {
                    return Some(Returned::Overruled(entry.overruled()));
                }
                Lane::Control => self.control.push_front(entry),
                Lane::Data(priority) => self.data.entry(Reverse(priority)).or_default().push_front(entry),
            },
        }
        None
    }

    /// Forgets, as all else was forgotten while it was taken; the hub is told to forget only what it knows.
    fn forget(&mut self, piece: Piece) -> Option<Returned> {
        match piece.stream {
            Some(stream) if piece.before == 0 => self.aborts.retain(|abort| *abort != stream),
            Some(stream) if piece.last => self.aborts.push_back(stream),
            _ => {}
        }
        piece.lost()
    }

    fn is_stopped(&self, unstop: &Entry) -> bool {
        self.stop.iter().any(|stop| stop.is_for_same_as(unstop))
    }

    /// The lane of what goes next of all that has not begun.
    fn front_lane(&self) -> Option<Lane> {
        let mut up_to = u64::MAX;
        if let Some(control) = self.control.front() {
            if !self.has_messages_up_to(control.number) {
                return Some(Lane::Control);
            }
            // Nothing that was sent after it goes before it.
            up_to = control.number;
        }
        let mut fronts = self.data.values().filter_map(VecDeque::front);
        fronts.find(|front| front.number <= up_to).map(|front| front.lane)
    }

    /// Whether a message that was sent so early has not left.
    fn has_messages_up_to(&self, number: u64) -> bool {
        let fronts = self.data.values().filter_map(VecDeque::front);
        let open = self.open.iter().map(|open| &open.entry);
        let mut messages = fronts
            .chain(open)
            .filter(|entry| matches!(entry.lane, Lane::Data(_)));
        messages.any(|entry| entry.number <= number)
    }

    fn lane(&mut self, lane: Lane) -> Option<&mut VecDeque<Arc<Entry>>> {
        match lane {
            Lane::Stop => Some(&mut self.stop),
            Lane::Sign => Some(&mut self.signs),
            Lane::Control => Some(&mut self.control),
            Lane::Data(priority) => self.data.get_mut(&Reverse(priority)),
        }
    }

    /// Whether what is in front of a lane may begin beside what is open: the hub keeps so many streams open, and no
    /// more bytes in them than one parcel may have.
    fn may_begin(&mut self, lane: Lane, knife: Knife) -> bool {
        let front = self
            .lane(lane)
            .and_then(|lane| lane.front())
            .map(|front| front.length());
        let Some(length) = front.filter(|length| *length > knife.most) else {
            return true;
        };
        let announced: usize = self.open.iter().map(|open| open.entry.length()).sum();
        self.open.len() < STREAMS && knife.parcel.allows(announced.saturating_add(length))
    }

    /// The next piece of a parcel; what is left of it stays open.
    fn cut(&mut self, entry: Arc<Entry>, sent: usize, stream: Option<u64>, knife: Knife) -> Piece {
        let length = entry.length();
        if stream.is_none() && length <= knife.most {
            return Piece::whole(entry);
        }
        let stream = stream.unwrap_or_else(|| {
            self.last_stream += 1;
            self.last_stream
        });
        let part = Part::chunk(stream, length, sent, knife.most);
        let last = part.reaches(length);
        if !last {
            self.open.push(Open {
                entry: Arc::clone(&entry),
                sent: sent + part.size(),
                stream,
            });
        }
        Piece {
            entry: Some(entry),
            part,
            before: sent,
            stream: Some(stream),
            last,
        }
    }
}
