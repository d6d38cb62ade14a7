//! What leaves next, and in which pieces.

use std::cmp::Reverse;
use std::collections::VecDeque;
use std::sync::Arc;

use mom_managers::Micros;
use mom_net::Part;
use mom_proto::binary::{self, STREAMS};
use mom_proto::codec::{Encoded, Form};
use mom_proto::{Delivery, event};

use super::{Queue, reliable};
use crate::traffic::outbox::packet::{DropReason, Entry, Lane, Packet, Piece, Progress};

impl Queue {
    /// The next piece for the link, of about `most` bytes if there is a way to cut it; what became stale on the
    /// way is dropped.
    pub(crate) fn pop(&mut self, now: Micros, most: usize) -> Option<Piece> {
        if let Some(urgent) = self.pop_urgent() {
            return Some(urgent);
        }
        if let Some((packet, stream)) = self.aborts.pop_front() {
            return Some(Piece::abort(packet, stream));
        }
        loop {
            let Some(entry) = self.next(most) else {
                return self.pop_farewell();
            };
            let Some(reason) = entry.packet.stale(now) else {
                return Some(self.cut(entry, most));
            };
            self.note(&entry, reason);
            self.leave(&entry);
            if let Some(stream) = entry.progress.stream {
                return Some(Piece::abort(entry.packet, stream));
            }
        }
    }

    /// The next piece that no load may hold back: a stop.
    pub(crate) fn pop_urgent(&mut self) -> Option<Piece> {
        let form = self.form;
        self.stop.pop_front().map(|entry| whole(entry, form))
    }

    /// Puts back, in front, what was taken and of which nothing was written: so that it is looked at again, and
    /// what is more urgent can overtake it.
    pub(crate) fn put_back(&mut self, piece: Piece) {
        if piece.part.is_abort() {
            if let Some(stream) = piece.before.stream {
                self.aborts.push_front((piece.packet, stream));
            }
            return;
        }
        if let Some((packet, waits)) = &mut self.farewell
            && Arc::ptr_eq(packet, &piece.packet)
        {
            *waits = true;
            return;
        }
        if !piece.last {
            self.open.retain(|open| !Arc::ptr_eq(&open.packet, &piece.packet));
        }
        let entry = Entry {
            packet: piece.packet,
            progress: piece.before,
        };
        let size = self.size(&entry.packet);
        match entry.packet.lane {
            Lane::Stop => return self.put_back_stop(entry),
            Lane::Control => self.control_bytes += if piece.last { size } else { 0 },
            Lane::Data(_) if piece.last => {
                self.data_bytes += size;
                self.reliable_bytes += reliable(&entry.packet, size);
            }
            Lane::Data(_) => {}
        }
        match entry.packet.lane {
            _ if entry.begun() => self.open.push(entry),
            Lane::Data(priority) => self.put_back_data(entry, Reverse(priority)),
            _ => self.put_back_control(entry),
        }
    }

    fn pop_farewell(&mut self) -> Option<Piece> {
        let (packet, waits) = self.farewell.as_mut().filter(|(_, waits)| *waits)?;
        *waits = false;
        Some(whole(Entry::new(Arc::clone(packet)), self.form))
    }

    fn put_back_stop(&mut self, entry: Entry) {
        let same = |waiting: &Entry| waiting.packet.origin == entry.packet.origin;
        if !self.stop.iter().any(same) {
            self.stop.push_front(entry);
        }
    }

    fn put_back_control(&mut self, entry: Entry) {
        let context = entry.packet.origin.context;
        let stopped = |stop: &Entry| stop.packet.origin.context == context;
        if &*entry.packet.origin.name == event::UNSTOP && self.stop.iter().any(stopped) {
            self.leave(&entry);
            return self.note(&entry, DropReason::Replaced);
        }
        self.control.push_front(entry);
    }

    fn put_back_data(&mut self, entry: Entry, priority: Reverse<i32>) {
        let latest = (entry.packet.delivery == Delivery::Latest).then(|| entry.packet.origin.clone());
        if latest
            .as_ref()
            .is_some_and(|origin| self.latest.contains_key(origin))
        {
            self.leave(&entry);
            return self.note(&entry, DropReason::Replaced);
        }
        let number = self.data.entry(priority).or_default().push_front(entry);
        if let Some(origin) = latest {
            self.latest.insert(origin, (priority, number));
        }
    }

    /// The most urgent entry, taken out of its lane.
    fn next(&mut self, most: usize) -> Option<Entry> {
        let open = (0..self.open.len()).max_by_key(|at| self.open[*at].packet.lane);
        let waiting = match self.control.front() {
            Some(_) => Some(Lane::Control),
            None => self.first_priority().map(|priority| Lane::Data(priority.0)),
        };
        match (open, waiting) {
            // What was begun goes on before another of the same urgency begins.
            (Some(open), waiting)
                if Some(self.open[open].packet.lane) >= waiting || !self.may_begin(most) =>
            {
                Some(self.open.remove(open))
            }
            (_, Some(Lane::Control)) => self.pop_control(),
            (_, Some(Lane::Data(priority))) => self.pop_data(Reverse(priority)),
            _ => None,
        }
    }

    fn pop_control(&mut self) -> Option<Entry> {
        let entry = self.control.pop_front();
        // Most peers hear what they are told at login and no more for a long time.
        if self.control.is_empty() {
            self.control = VecDeque::new();
        }
        entry
    }

    /// The highest priority at which something waits. The lane of the default priority stays, to be filled again;
    /// others go when they are empty.
    fn first_priority(&mut self) -> Option<Reverse<i32>> {
        loop {
            let (priority, lane) = self.data.iter_mut().find(|(_, lane)| !lane.is_empty())?;
            let priority = *priority;
            if lane.front().is_some() {
                return Some(priority);
            }
            if priority != Reverse(0) {
                self.data.remove(&priority);
            }
        }
    }

    fn pop_data(&mut self, priority: Reverse<i32>) -> Option<Entry> {
        let lane = self.data.get_mut(&priority)?;
        let entry = lane.pop()?;
        if lane.is_empty() && priority != Reverse(0) {
            self.data.remove(&priority);
        }
        if entry.packet.delivery == Delivery::Latest {
            self.latest.remove(&entry.packet.origin);
        }
        Some(entry)
    }

    /// Whether what waits in front may begin beside what is open: a receiver keeps so many streams open, and no
    /// more bytes in them than one parcel may have.
    fn may_begin(&mut self, most: usize) -> bool {
        let form = self.form;
        let front = match self.control.front() {
            Some(entry) => Some(entry.packet.length(form)),
            None => self.first_priority().and_then(|priority| {
                let front = self.data.get_mut(&priority)?.front()?;
                Some(front.packet.length(form))
            }),
        };
        let Some(length) = front.filter(|length| *length > most) else {
            return true;
        };
        let announced: usize = self.open.iter().map(|open| open.packet.length(form)).sum();
        self.open.len() < STREAMS && self.parcel.allows(announced.saturating_add(length))
    }

    /// The next piece of an entry; what is left of it stays open.
    fn cut(&mut self, entry: Entry, most: usize) -> Piece {
        let Entry { packet, progress } = entry;
        let length = packet.length(self.form);
        if self.form != Some(Form::Binary) || (progress == Progress::default() && length <= most) {
            self.leave(&Entry {
                packet: Arc::clone(&packet),
                progress,
            });
            return whole(Entry { packet, progress }, self.form);
        }
        let run = packet.count > 1;
        let piece = match run {
            true => self.cut_run(Arc::clone(&packet), progress, most),
            false => self.cut_chunk(Arc::clone(&packet), progress, most),
        };
        if piece.last {
            self.leave(&Entry { packet, progress });
            return piece;
        }
        let progress = Progress {
            sent: progress.sent + piece.part.size(),
            stream: match run {
                true => None,
                false => progress.stream.or(Some(self.last_stream)),
            },
        };
        self.open.push(Entry { packet, progress });
        piece
    }

    /// Whole frames, one at least.
    fn cut_run(&self, packet: Arc<Packet>, before: Progress, most: usize) -> Piece {
        let from = before.sent;
        let (length, whole) = packet.frames(self.form).map_or((0, 0), |frames| {
            let rest = &frames.head[from.min(frames.head.len())..];
            (binary::cut(rest, most).0, frames.head.len())
        });
        Piece {
            packet,
            part: Part::plain(from..from + length),
            before,
            last: from + length >= whole,
        }
    }

    /// A chunk: the bytes of its stream are the frame without the length in front.
    fn cut_chunk(&mut self, packet: Arc<Packet>, before: Progress, most: usize) -> Piece {
        let length = packet.length(self.form);
        let stream = before.stream.unwrap_or_else(|| {
            self.last_stream += 1;
            self.last_stream
        });
        let part = Part::chunk(stream, length, before.sent, most);
        Piece {
            last: part.reaches(length),
            packet,
            part,
            before,
        }
    }

    /// An entry is the queue's no more.
    fn leave(&mut self, entry: &Entry) {
        let size = self.size(&entry.packet);
        match entry.packet.lane {
            Lane::Stop => {}
            Lane::Control => self.control_bytes -= size,
            Lane::Data(_) => {
                self.data_bytes -= size;
                self.reliable_bytes -= reliable(&entry.packet, size);
            }
        }
    }
}

/// All of an entry at once.
fn whole(entry: Entry, form: Option<Form>) -> Piece {
    Piece {
        part: Part::plain(0..entry.packet.frames(form).map_or(0, Encoded::len)),
        packet: entry.packet,
        before: entry.progress,
        last: true,
    }
}
