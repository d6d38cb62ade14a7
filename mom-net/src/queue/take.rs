//! What leaves next, and in which pieces.

use std::cmp::Reverse;
use std::collections::VecDeque;
use std::sync::Arc;

use mom_proto::Delivery;
use mom_proto::binary::{self, STREAMS};
use mom_proto::codec::Form;

use super::again::AGAIN;
use super::control_lane::DataPlace;
use super::piece::{Entry, Piece, Progress};
use super::{DropPolicy, DropReason, Item, Lane, Rest, SendQueue, reliable};
use crate::{Allowance, Part};

/// Taken at once: more than a system call gathers is not faster, and what is taken cannot be overtaken any more.
const BATCH_PIECES: usize = 256;
const BATCH_BYTES: usize = 256 * 1024;

/// What goes next.
enum Next<T, I> {
    Ready(T),
    /// This would, and is not ready.
    Unready(Arc<I>),
    None,
}

/// The number of the last word.
const LAST: u64 = u64::MAX;

impl<I: Item, P: DropPolicy<I>> SendQueue<I, P> {
    /// Adds to a batch what may be written now: what the link has begun to take, and as much more as the network has room
    /// for. Says what the rest waits for, if nothing may be written.
    pub fn take(&mut self, now: u64, allowance: Allowance, batch: &mut VecDeque<Piece<I>>) -> Rest<I> {
        batch.extend(self.begun.take().map(|piece| *piece));
        let bytes = allowance.bytes.min(BATCH_BYTES);
        let mut taken = 0;
        let mut unready = None;
        while batch.len() < BATCH_PIECES {
            let next = match bytes.checked_sub(taken) {
                // Pieces rather a little too large than very small ones.
                Some(left) if left > 0 => {
                    self.pop_next(now, allowance.piece.min(left.max(allowance.piece / 2)))
                }
                _ if taken < allowance.stops => self.pop_unpaced().map_or(Next::None, Next::Ready),
                _ => Next::None,
            };
            match next {
                Next::Ready(piece) => {
                    taken += piece.left();
                    batch.push_back(piece);
                }
                Next::Unready(item) => {
                    unready = Some(item);
                    break;
                }
                Next::None => break,
            }
        }
        match unready {
            _ if !batch.is_empty() => Rest::None,
            Some(item) => Rest::Unready(item),
            None if self.is_empty() => Rest::None,
            None => Rest::NoRoom,
        }
    }

    /// Puts others into the place of an item that is not ready and goes next of its lane; false if it is not there any
    /// more.
    pub fn replace_front(&mut self, item: &Arc<I>, others: Vec<Arc<I>>) -> bool {
        if let Some(at) = self.again.position(item) {
            return self.replace_again(at, others);
        }
        let Lane::Data(priority) = item.lane() else {
            return self.replace_control(item, others);
        };
        let Some(lane) = self.data.get_mut(&Reverse(priority)) else {
            return false;
        };
        if lane.front().is_none_or(|front| !Arc::ptr_eq(&front.item, item)) {
            return false;
        }
        let Some(entry) = lane.pop() else {
            return false;
        };
        self.forget_latest(&entry.item);
        self.leave(&entry.item);
        for other in others.into_iter().rev() {
            self.enter(&other);
            let lane = other.lane();
            if let Lane::Data(priority) = lane {
                self.put_back_data(Entry::new(other, entry.number), Reverse(priority));
            }
        }
        true
    }

    /// Control may go before data that stands before it there.
    fn replace_again(&mut self, at: usize, others: Vec<Arc<I>>) -> bool {
        others.iter().for_each(|other| self.enter(other));
        let others = others.into_iter().map(|other| Entry::new(other, AGAIN));
        if let Some(entry) = self.again.replace(at, others) {
            self.leave(&entry.item);
        }
        true
    }

    fn replace_control(&mut self, item: &Arc<I>, others: Vec<Arc<I>>) -> bool {
        let entry = match item.lane() {
            Lane::Control => self.control.pop_if(item),
            _ => {
                let is_front = |front: &Entry<I>| Arc::ptr_eq(&front.item, item);
                match self.unpaced.front().is_some_and(is_front) {
                    true => self.unpaced.pop_front(),
                    false => None,
                }
            }
        };
        let Some(entry) = entry else {
            return false;
        };
        self.leave(&entry.item);
        for other in others.into_iter().rev() {
            if other.lane() == Lane::Control {
                self.control_bytes += self.charge(&other);
                self.control.push_front(Entry::new(other, entry.number));
            } else {
                self.unpaced.push_front(Entry::new(other, entry.number));
            }
        }
        true
    }

    /// The next piece for the link, of about `most` bytes if there is a way to cut it; what became stale on the
    /// way is dropped.
    pub fn pop(&mut self, now: u64, most: usize) -> Option<Piece<I>> {
        match self.pop_next(now, most) {
            Next::Ready(piece) => Some(piece),
            Next::Unready(_) | Next::None => None,
        }
    }

    fn pop_next(&mut self, now: u64, most: usize) -> Next<Piece<I>, I> {
        if let Some(front) = self.unpaced.front()
            && !front.item.is_ready(self.form)
        {
            return Next::Unready(Arc::clone(&front.item));
        }
        if let Some(unpaced) = self.pop_unpaced() {
            return Next::Ready(unpaced);
        }
        if let Some(stream) = self.aborts.pop_front() {
            return Next::Ready(Piece::abort(stream));
        }
        loop {
            let entry = match self.next(now, most) {
                Next::Ready(entry) => entry,
                // The last word waits for it, too.
                Next::Unready(item) => return Next::Unready(item),
                Next::None => return self.pop_last().map_or(Next::None, Next::Ready),
            };
            let stale = self.policy.stale(&entry.item, now);
            let Some(reason) = stale.or_else(|| entry.item.fault(self.form)) else {
                return Next::Ready(self.cut(entry, most));
            };
            self.note(&entry, reason);
            self.leave(&entry.item);
            if entry.progress.stream > 0 {
                return Next::Ready(Piece::abort(entry.progress.stream));
            }
        }
    }

    /// The next piece that pacing does not hold back: a stop, or a sign of life.
    pub fn pop_unpaced(&mut self) -> Option<Piece<I>> {
        let form = self.form;
        let ready = self
            .unpaced
            .front()
            .is_some_and(|front| front.item.is_ready(form));
        let front = if ready { self.unpaced.pop_front() } else { None };
        front.map(|entry| Piece::whole(entry, form))
    }

    /// Puts a batch back, of which the link took nothing more.
    pub fn put_back_all(&mut self, batch: &mut VecDeque<Piece<I>>) {
        while let Some(piece) = batch.pop_back() {
            self.put_back(piece);
        }
    }

    /// Puts back, in front, what was taken and not written. What the link has begun to take stays the next; all else is
    /// looked at again, so that it can be overtaken, replaced or dropped. Several are put back the last one first.
    pub fn put_back(&mut self, piece: Piece<I>) {
        if piece.is_begun() {
            self.begun = Some(Box::new(piece));
            return;
        }
        let last = piece.last;
        let Some(item) = piece.item else {
            return self.aborts.push_front(piece.stream);
        };
        if piece.number == LAST {
            self.last = Some(item);
            return;
        }
        // What is left of it was put back before.
        if !last {
            self.open.retain(|open| !Arc::ptr_eq(&open.item, &item));
            self.again.remove(&item);
        }
        let entry = Entry {
            item,
            number: piece.number,
            progress: piece.before,
        };
        let lane = entry.item.lane();
        if last {
            self.enter(&entry.item);
        }
        if let Lane::Data(priority) = lane {
            self.control.note_back(&entry, Reverse(priority));
        }
        match lane {
            _ if entry.progress.stream > 0 => self.open.push(entry),
            _ if entry.number == AGAIN => self.again.push_front(entry),
            _ if entry.is_begun() => self.open.push(entry),
            Lane::Data(priority) => self.put_back_data(entry, Reverse(priority)),
            Lane::Control => self.put_back_control(entry),
            Lane::Stop | Lane::Sign => self.put_back_unpaced(entry),
        }
    }

    /// Takes back a piece of what was cleared after it was taken: the receiver is told to forget the chunks that it has of
    /// it. Gives the item if [`SendQueue::clear`] did not.
    pub fn forget(&mut self, piece: Piece<I>) -> Option<Arc<I>> {
        let stream = piece.stream;
        if piece.item.is_some() && stream > 0 {
            if piece.before.sent == 0 {
                self.aborts.retain(|abort| *abort != stream);
            } else if piece.last {
                self.aborts.push_back(stream);
            }
        }
        let last = piece.last;
        piece.item.filter(|_| last)
    }

    fn pop_last(&mut self) -> Option<Piece<I>> {
        let item = self.last.take()?;
        Some(Piece::whole(Entry::new(item, LAST), self.form))
    }

    pub(super) fn put_back_unpaced(&mut self, entry: Entry<I>) {
        if self
            .unpaced
            .iter()
            .any(|waiting| waiting.item.repeats(&entry.item))
        {
            return self.note(&entry, DropReason::Replaced);
        }
        let lane = entry.item.lane();
        let behind = self
            .unpaced
            .iter()
            .position(|waiting| waiting.item.lane() <= lane);
        self.unpaced.insert(behind.unwrap_or(self.unpaced.len()), entry);
    }

    pub(super) fn put_back_control(&mut self, entry: Entry<I>) {
        let is_repeated = || self.control.iter().any(|newer| newer.item.repeats(&entry.item));
        let reason = if self.unpaced.iter().any(|stop| stop.item.withdraws(&entry.item)) {
            Some(DropReason::Withdrawn)
        } else if entry.item.waits_behind_data() && is_repeated() {
            Some(DropReason::Replaced)
        } else {
            None
        };
        if let Some(reason) = reason {
            self.leave(&entry.item);
            return self.note(&entry, reason);
        }
        self.control.push_front(entry);
    }

    pub(super) fn put_back_data(&mut self, entry: Entry<I>, priority: Reverse<i32>) {
        let key = (entry.item.delivery() == Delivery::Latest).then(|| entry.item.key());
        if key.as_ref().is_some_and(|key| self.latest.contains_key(key)) {
            self.leave(&entry.item);
            return self.note(&entry, DropReason::Replaced);
        }
        let number = self.data.entry(priority).or_default().push_front(entry);
        if let Some(key) = key {
            self.latest.insert(key, (priority, number));
        }
    }

    /// What is sent again and goes next, taken out if it is ready; none where something else goes next. Where nothing says that it has
    /// ended, new control waits behind no data, but behind older control.
    fn next_again(&mut self) -> Option<Next<Entry<I>, I>> {
        let begun = self.open.iter().position(|open| open.number == AGAIN);
        let begun_lane = begun.map(|begun| self.open[begun].item.lane());
        let overtakes = |control: &Entry<I>| !control.item.waits_behind_data();
        let waits = self.control.front().is_some_and(overtakes);
        if waits && !self.again.has_end() && begun_lane != Some(Lane::Control) {
            match self.again.first_of(Lane::Control) {
                None => return None,
                Some(older) if overtakes(older) => {
                    return match older.item.is_ready(self.form) {
                        false => Some(Next::Unready(Arc::clone(&older.item))),
                        true => self.again.take_first_of(Lane::Control).map(Next::Ready),
                    };
                }
                // It stays behind it.
                Some(_) => {}
            }
        }
        match (begun, self.again.front()) {
            (Some(begun), _) => Some(Next::Ready(self.open.remove(begun))),
            (None, Some(front)) if !front.item.is_ready(self.form) => {
                Some(Next::Unready(Arc::clone(&front.item)))
            }
            (None, _) => self.again.pop().map(Next::Ready),
        }
    }

    /// The most urgent entry, taken out of its lane if it is ready.
    fn next(&mut self, now: u64, most: usize) -> Next<Entry<I>, I> {
        if (!self.again.is_empty() || self.open.iter().any(|open| open.number == AGAIN))
            && let Some(next) = self.next_again()
        {
            return next;
        }
        let open = (0..self.open.len()).max_by_key(|at| self.open[*at].item.lane());
        let waiting = self.front();
        match (open, waiting) {
            // What was begun goes on before another of the same urgency begins.
            (Some(open), waiting)
                if Some(self.open[open].item.lane()) >= waiting
                    || waiting.is_some_and(|lane| !self.may_begin(lane, most)) =>
            {
                Next::Ready(self.open.remove(open))
            }
            (_, Some(Lane::Data(priority))) => self.next_data(Reverse(priority), now),
            (_, Some(_)) => match self.control.front() {
                Some(front) if !front.item.is_ready(self.form) => Next::Unready(Arc::clone(&front.item)),
                _ => self.control.pop().map_or(Next::None, Next::Ready),
            },
            (_, None) => Next::None,
        }
    }

    /// The lane of what goes next of all that has not begun.
    fn front(&mut self) -> Option<Lane> {
        let up_to = match self.control.front_place() {
            None => u64::MAX,
            // Nothing that was put in after it goes before it.
            Some((number, Some(behind))) if self.has_data_before(number, behind) => number,
            Some(_) => return Some(Lane::Control),
        };
        self.first_priority(up_to).map(|priority| Lane::Data(priority.0))
    }

    /// Whether data that was put in no later than this number, and leaves no later than what has this place, is still here.
    fn has_data_before(&mut self, number: u64, last: DataPlace) -> bool {
        let is_before = |priority: Reverse<i32>, entry: &Entry<I>| {
            entry.number <= number && (priority, entry.number) <= last
        };
        let mut lanes = self.data.range_mut(..=last.0);
        let open = |open: &Entry<I>| match open.item.lane() {
            Lane::Data(priority) => is_before(Reverse(priority), open),
            _ => false,
        };
        lanes.any(|(priority, lane)| lane.front().is_some_and(|front| is_before(*priority, front)))
            || self.open.iter().any(open)
    }

    /// What is in front of a lane, taken out if it is ready. What may not leave any more need not be.
    #[inline]
    fn next_data(&mut self, priority: Reverse<i32>, now: u64) -> Next<Entry<I>, I> {
        let Some(lane) = self.data.get_mut(&priority) else {
            return Next::None;
        };
        if let Some(front) = lane.front()
            && !front.item.is_ready(self.form)
            && self.policy.stale(&front.item, now).is_none()
        {
            return Next::Unready(Arc::clone(&front.item));
        }
        let Some(entry) = lane.pop() else {
            return Next::None;
        };
        if lane.is_empty() && priority != Reverse(0) {
            self.data.remove(&priority);
        }
        self.forget_latest(&entry.item);
        Next::Ready(entry)
    }

    /// The highest priority at which something waits that was put in so early. The lane of the default priority stays, to
    /// be filled again; others go when they are empty.
    fn first_priority(&mut self, up_to: u64) -> Option<Reverse<i32>> {
        let mut after = None;
        loop {
            let above = |priority: &Reverse<i32>| after.is_some_and(|after| *priority <= after);
            let (priority, lane) = self
                .data
                .iter_mut()
                .find(|(priority, lane)| !above(priority) && !lane.is_empty())?;
            let priority = *priority;
            match lane.front().map(|front| front.number) {
                Some(number) if number <= up_to => return Some(priority),
                Some(_) => after = Some(priority),
                None if priority == Reverse(0) => {}
                None => drop(self.data.remove(&priority)),
            }
        }
    }

    /// Lets an item that has left its lane be replaced no more.
    fn forget_latest(&mut self, item: &I) {
        if item.delivery() == Delivery::Latest {
            self.latest.remove(&item.key());
        }
    }

    /// Whether what is in front of a lane may begin beside what is open: a receiver keeps so many streams open, and no
    /// more bytes in them than one parcel may have.
    fn may_begin(&mut self, lane: Lane, most: usize) -> bool {
        let form = self.form;
        let front = match lane {
            Lane::Data(priority) => self
                .data
                .get_mut(&Reverse(priority))
                .and_then(|lane| lane.front()),
            _ => self.control.front(),
        };
        let Some(length) = front
            .map(|front| front.length(form))
            .filter(|length| *length > most)
        else {
            return true;
        };
        let announced: usize = self.open.iter().map(|open| open.length(form)).sum();
        self.open.len() < STREAMS && self.parcel.allows(announced.saturating_add(length))
    }

    /// The next piece of an entry; what is left of it stays open.
    fn cut(&mut self, entry: Entry<I>, most: usize) -> Piece<I> {
        let length = entry.length(self.form);
        if !self.form.is_some_and(Form::is_binary) || (!entry.is_begun() && length <= most) {
            self.leave(&entry.item);
            return Piece::whole(entry, self.form);
        }
        let piece = match entry.item.count() > 1 {
            true => cut_run(&entry, self.form, most),
            false => self.cut_chunk(&entry, length, most),
        };
        if piece.last {
            self.leave(&entry.item);
            return piece;
        }
        let progress = Progress {
            sent: entry.progress.sent + piece.part.size(),
            stream: piece.stream,
        };
        self.open.push(Entry { progress, ..entry });
        piece
    }

    /// A chunk: the bytes of its stream are the frame without the length in front.
    fn cut_chunk(&mut self, entry: &Entry<I>, length: usize, most: usize) -> Piece<I> {
        let stream = match entry.progress.stream {
            0 => {
                self.last_stream += 1;
                self.last_stream
            }
            stream => stream,
        };
        let part = Part::chunk(stream, length, entry.progress.sent, most);
        Piece {
            last: part.reaches(length),
            item: Some(Arc::clone(&entry.item)),
            part,
            number: entry.number,
            before: entry.progress,
            stream,
        }
    }

    /// An item is the queue's again.
    pub(super) fn enter(&mut self, item: &I) {
        let size = self.charge(item);
        match item.lane() {
            Lane::Stop | Lane::Sign => {}
            Lane::Control => self.control_bytes += size,
            Lane::Data(_) => {
                self.data_bytes += size;
                self.reliable_bytes += reliable(item, size);
            }
        }
    }

    /// An item is the queue's no more.
    pub(super) fn leave(&mut self, item: &I) {
        let size = self.charge(item);
        match item.lane() {
            Lane::Stop | Lane::Sign => {}
            Lane::Control => self.control_bytes -= size,
            Lane::Data(_) => {
                self.data_bytes -= size;
                self.reliable_bytes -= reliable(item, size);
            }
        }
    }
}

/// Whole frames of an item that has several, one at least.
fn cut_run<I: Item>(entry: &Entry<I>, form: Option<Form>, most: usize) -> Piece<I> {
    let from = entry.progress.sent;
    let (length, whole) = entry.item.frames(form).map_or((0, 0), |frames| {
        let rest = &frames.head[from.min(frames.head.len())..];
        (binary::cut(rest, most).0, frames.head.len())
    });
    Piece {
        item: Some(Arc::clone(&entry.item)),
        part: Part::plain(from..from + length),
        number: entry.number,
        before: entry.progress,
        stream: 0,
        last: from + length >= whole,
    }
}
