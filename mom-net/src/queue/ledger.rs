//! Parcels counted as they leave, and kept until the other side has read them: for a connection that can be resumed.

use std::collections::VecDeque;
use std::sync::Arc;

use mom_proto::binary;
use mom_proto::codec::Form;
use mom_proto::{Checksum, Delivery, ReadCount};

use super::piece::{Entry, Progress};
use super::{Item, Lane, Piece};

/// The words of so many parcels are kept at most for the checksum of a link: of what is before them it is not checked.
const MOST_WORDS: usize = 1 << 18;

/// What has left over a link and was not acknowledged.
#[derive(Debug)]
pub struct Ledger<I> {
    /// Parcels that have left.
    sent: u64,
    /// As many of them as the other side has said that it has read.
    acknowledged: u64,
    /// Those of the others that must not be lost, in their order.
    kept: VecDeque<Kept<I>>,
    /// What stands in the checksum for each parcel that has left since the one that `checksum` ends with.
    words: VecDeque<u32>,
    checksum: Checksum,
    bytes: usize,
    /// The most bytes that are kept.
    limit: usize,
    /// The place of the last parcel that had to be kept, and was not for want of room.
    forgotten: u64,
    /// The next parcel that is not a stop does not count: it tells the other side of the link.
    skips: bool,
    /// How many parcels of the run that the link is taking are counted already.
    part: u64,
}

/// A parcel, or several of a run.
#[derive(Debug)]
pub(super) struct Kept<I> {
    pub(super) item: Arc<I>,
    /// Where they begin in the item's frames.
    pub(super) offset: usize,
    count: u64,
    /// The place of the last one.
    last: u64,
    size: usize,
}

/// A count that cannot be: of more than was sent, of less than was acknowledged before, or of other parcels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BadCount {
    /// What the other side says that it has read.
    pub read: u64,
    /// What has left.
    pub sent: u64,
    /// What was acknowledged before.
    pub acknowledged: u64,
    /// So many were read, but they were not the first ones that have left: one side has counted wrongly.
    pub differs: bool,
}

/// What a resumed connection does not send again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rewound {
    /// So many parcels that were not kept, because they need not be.
    Dropped(u64),
    /// Some that had to be kept are lost: so many at most. The connection cannot be resumed.
    Lost(u64),
}

impl<I: Item> Ledger<I> {
    /// Counts from here on, and keeps so many bytes.
    pub fn new(limit: usize) -> Ledger<I> {
        Ledger {
            sent: 0,
            acknowledged: 0,
            kept: VecDeque::new(),
            words: VecDeque::new(),
            checksum: Checksum::default(),
            bytes: 0,
            limit,
            forgotten: 0,
            skips: false,
            part: 0,
        }
    }

    /// The same after the next parcel, which tells the other side of the link.
    pub fn after_next(limit: usize) -> Ledger<I> {
        Ledger {
            skips: true,
            ..Ledger::new(limit)
        }
    }

    /// The parcels that have left.
    pub fn sent(&self) -> u64 {
        self.sent
    }

    /// As many of them as the other side is known to have read.
    pub fn acknowledged(&self) -> u64 {
        self.acknowledged
    }

    /// The bytes that are kept.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Notes a piece that has left.
    pub fn note(&mut self, piece: &Piece<I>, form: Option<Form>) {
        let Some(item) = piece.item.as_ref().filter(|item| item.counts()) else {
            return;
        };
        if item.count() == 1 {
            return self.count(item, 0, u64::from(piece.last), form);
        }
        let (counted, bytes) = (std::mem::take(&mut self.part), piece.part.bytes());
        if piece.last && piece.before.sent == 0 && counted == 0 {
            return self.count(item, 0, u64::from(item.count()), form);
        }
        let run = item
            .frames(form)
            .map_or(&[][..], |frames| &frames.head[bytes.clone()]);
        let count = u64::from(binary::cut(run, run.len()).1);
        let offset = bytes.start + binary::first(run, counted);
        self.count(item, offset, count - counted, form);
    }

    /// Notes how much the link has taken of a run; gives the length of the parcels that it has whole.
    pub(super) fn note_part(&mut self, piece: &Piece<I>, form: Option<Form>) -> usize {
        let Some(item) = piece.item.as_ref().filter(|item| item.count() > 1) else {
            return 0;
        };
        let from = piece.part.bytes().start;
        let frames = item.frames(form).map_or(&[][..], |frames| &frames.head);
        let run = frames.get(from..).unwrap_or_default();
        let (length, count) = binary::whole(run, piece.part.written());
        let counted = std::mem::replace(&mut self.part, u64::from(count));
        if item.counts() {
            let offset = from + binary::first(run, counted);
            self.count(item, offset, u64::from(count) - counted, form);
        }
        length
    }

    /// Counts parcels of an item that have left, from this byte of its frames on.
    fn count(&mut self, item: &Arc<I>, offset: usize, count: u64, form: Option<Form>) {
        if count == 0 {
            return;
        }
        // A stop may overtake the parcel that tells the other side of the link; that side counts from behind it, too.
        if self.skips {
            self.skips = item.lane() == Lane::Stop;
            return;
        }
        self.sent += count;
        self.note_words(item, offset, count, form);
        if is_sent_once(&**item) && !item.is_awaited() {
            return;
        }
        // Of a run its part.
        let parcels = u64::from(item.count()).max(1);
        let size = item.charge(form) * to_usize(count) / to_usize(parcels);
        self.bytes += size;
        // Only what has left without anything between, kept or not, is one entry: its places are those up to the last.
        if let Some(before) = self.kept.back_mut()
            && before.last + count == self.sent
            && Arc::ptr_eq(&before.item, item)
        {
            before.count += count;
            before.last = self.sent;
            before.size += size;
            return;
        }
        self.kept.push_back(Kept {
            item: Arc::clone(item),
            offset,
            count,
            last: self.sent,
            size,
        });
        while self.bytes > self.limit
            && let Some(kept) = self.kept.pop_front()
        {
            self.bytes -= kept.size;
            if !is_sent_once(&*kept.item) {
                self.forgotten = kept.last;
            }
        }
    }

    fn note_words(&mut self, item: &Arc<I>, offset: usize, count: u64, form: Option<Form>) {
        if item.count() == 1 {
            self.words.push_back(item.checksum_word());
        } else {
            let frames = item.frames(form).map_or(&[][..], |frames| &frames.head);
            let mut run = frames.get(offset..).unwrap_or_default();
            for _ in 0..count {
                self.words.push_back(binary::checksum_word(run));
                run = &run[binary::first(run, 1)..];
            }
        }
        while self.words.len() > MOST_WORDS {
            self.pass_word();
        }
    }

    /// Goes on with the checksum by one parcel.
    fn pass_word(&mut self) {
        if let Some(word) = self.words.pop_front() {
            self.checksum = self.checksum.with(word);
        }
    }

    /// Whether the other side has read other parcels than the first ones that have left.
    fn differs(&mut self, read: ReadCount) -> bool {
        let unread = to_usize(self.sent - read.parcels);
        // What is said of too long ago cannot be checked.
        let is_known = unread <= self.words.len();
        while self.words.len() > unread {
            self.pass_word();
        }
        is_known && read.checksum.is_some_and(|told| told != self.checksum.value())
    }

    /// Takes in how many parcels the other side has read.
    pub(super) fn acknowledge(&mut self, count: ReadCount, form: Option<Form>) -> Result<(), BadCount> {
        let read = count.parcels;
        let is_possible = read <= self.sent && read >= self.acknowledged;
        let differs = is_possible && self.differs(count);
        if !is_possible || differs {
            return Err(BadCount {
                read,
                sent: self.sent,
                acknowledged: self.acknowledged,
                differs,
            });
        }
        self.acknowledged = read;
        while let Some(kept) = self.kept.front_mut() {
            if kept.last <= read {
                self.bytes -= kept.size;
                self.kept.pop_front();
                continue;
            }
            // The first ones of a run.
            let over = (kept.count + read).saturating_sub(kept.last);
            if over > 0 {
                let frames = kept.item.frames(form).map_or(&[][..], |frames| &frames.head);
                let run = frames.get(kept.offset..).unwrap_or_default();
                kept.offset += binary::first(run, over);
                kept.count -= over;
            }
            break;
        }
        // What was kept in a burst is not kept for ever.
        if self.kept.is_empty() {
            self.kept = VecDeque::new();
        }
        if self.words.is_empty() {
            self.words = VecDeque::new();
        }
        Ok(())
    }

    /// Forgets what `goes` says, which is not to be sent again; gives the items and how many parcels of each.
    pub fn drop_kept(&mut self, goes: impl Fn(&I) -> bool) -> Vec<(Arc<I>, u64)> {
        let mut dropped = Vec::new();
        self.kept.retain(|kept| {
            let goes = goes(&kept.item);
            if goes {
                self.bytes -= kept.size;
                dropped.push((Arc::clone(&kept.item), kept.count));
            }
            !goes
        });
        dropped
    }

    /// Goes back to what the other side has read, and gives what has to be sent again.
    ///
    /// # Errors
    /// A count that cannot be.
    pub(super) fn rewind(
        &mut self,
        count: ReadCount,
        form: Option<Form>,
    ) -> Result<(Rewound, VecDeque<Kept<I>>), BadCount> {
        self.acknowledge(count, form)?;
        let read = count.parcels;
        if self.forgotten > read {
            return Ok((Rewound::Lost(self.forgotten - read), VecDeque::new()));
        }
        let again: u64 = self.kept.iter().map(|kept| kept.count).sum();
        let dropped = self.sent - read - again;
        self.sent = read;
        self.words.clear();
        self.skips = false;
        self.part = 0;
        self.bytes = 0;
        Ok((Rewound::Dropped(dropped), std::mem::take(&mut self.kept)))
    }
}

fn to_usize(count: u64) -> usize {
    usize::try_from(count).unwrap_or(usize::MAX)
}

/// Whether it is not sent again: only messages may be dropped, and no stop.
pub(super) fn is_sent_once<I: Item>(item: &I) -> bool {
    matches!(item.lane(), Lane::Data(_)) && item.delivery() != Delivery::Reliable
}

impl<I> Kept<I> {
    pub(super) fn into_entry(self, number: u64) -> Entry<I> {
        Entry {
            item: self.item,
            number,
            progress: Progress {
                sent: self.offset,
                stream: 0,
            },
        }
    }
}
