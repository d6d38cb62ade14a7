//! A queue between two connections of the same peer: nothing of the first one reaches into the second.

use std::cmp::Reverse;
use std::sync::Arc;

use mom_proto::ReadCount;
use mom_proto::codec::Form;

use super::again::AGAIN;
use super::data_lane::DataLane;
use super::ledger::{BadCount, Ledger, Rewound, is_sent_once};
use super::piece::{Entry, Piece, Progress};
use super::{DropPolicy, DropReason, Item, Lane, SendQueue, reliable};

impl<I: Item, P: DropPolicy<I>> SendQueue<I, P> {
    /// The connection is lost: what it has taken a part of begins anew on the next one, but what does not outlive it is dropped,
    /// and given. Parcels of a run that it has taken whole are counted.
    #[must_use = "freeing it takes its time, which is better done where nobody waits"]
    pub fn restart(&mut self, ledger: &mut Ledger<I>) -> Vec<Arc<I>> {
        if let Some(begun) = self.begun.take() {
            self.put_back_begun(*begun, ledger);
        }
        self.aborts.clear();
        self.last_stream = 0;
        for mut entry in std::mem::take(&mut self.open) {
            if entry.progress.stream > 0 {
                entry.progress = Progress::default();
            }
            self.put_in_front(entry);
        }
        // Signs of life are of the connection that they were said on.
        self.unpaced.retain(|entry| entry.item.counts());
        for entry in self.again.take_all(|item| !item.counts()) {
            self.leave(&entry.item);
        }
        for entry in self.control.take_all(|item| !item.counts()) {
            self.leave(&entry.item);
        }
        self.drop_control(DropReason::Lost, |item| !item.outlives_loss());
        self.drop_data_of(DropReason::Lost, |item| !item.outlives_loss())
            .0
    }

    /// Takes in how many parcels the other side has read: as many as it acknowledges are kept no longer.
    ///
    /// # Errors
    /// A count that cannot be.
    pub fn acknowledge(&self, ledger: &mut Ledger<I>, read: ReadCount) -> Result<(), BadCount> {
        if let Some(begun) = &self.begun {
            ledger.note_part(begun, self.form);
        }
        ledger.acknowledge(read, self.form)
    }

    fn put_back_begun(&mut self, mut piece: Piece<I>, ledger: &mut Ledger<I>) {
        let length = ledger.note_part(&piece, self.form);
        if length > 0 {
            piece.before.sent = piece.part.bytes().start + length;
        }
        piece.part.restart();
        self.put_back(piece);
    }

    /// Puts what has to be sent again in front of what waits, and `end` behind it: it tells the other side that all that follows
    /// was not sent before. What does not outlive the loss is dropped.
    ///
    /// # Errors
    /// A count that cannot be.
    pub fn resend(
        &mut self,
        ledger: &mut Ledger<I>,
        read: ReadCount,
        end: Option<Arc<I>>,
    ) -> Result<Rewound, BadCount> {
        self.acknowledge(ledger, read)?;
        for (item, parcels) in ledger.drop_kept(|item| !item.outlives_loss() || is_sent_once(item)) {
            self.policy.dropped(&item, parcels, DropReason::Unknown);
        }
        let (rewound, kept) = ledger.rewind(read, self.form)?;
        for kept in kept.into_iter().rev() {
            self.send_again(kept.into_entry(AGAIN));
        }
        if let Some(end) = end {
            self.enter(&end);
            self.again.push(Entry::new(end, AGAIN));
        }
        Ok(rewound)
    }

    fn send_again(&mut self, entry: Entry<I>) {
        if entry.item.lane() == Lane::Stop {
            return self.put_back_unpaced(entry);
        }
        self.enter(&entry.item);
        // The rest of a run goes with its beginning.
        if entry.item.count() > 1 {
            self.take_rest(&entry.item);
        }
        self.again.push_front(entry);
    }

    /// Takes out what waits of a run of which more is sent again.
    fn take_rest(&mut self, run: &Arc<I>) {
        let rest = match (self.again.remove(run), run.lane()) {
            (None, Lane::Data(priority)) => {
                let lane = self.data.get_mut(&Reverse(priority));
                lane.and_then(|lane| lane.pop_if(run))
            }
            (rest, _) => rest,
        };
        if let Some(rest) = rest {
            self.leave(&rest.item);
        }
    }

    fn put_in_front(&mut self, entry: Entry<I>) {
        match entry.item.lane() {
            _ if entry.number == AGAIN => self.again.push_front(entry),
            Lane::Data(priority) => {
                self.control.note_back(&entry, Reverse(priority));
                self.put_back_data(entry, Reverse(priority));
            }
            Lane::Control => self.put_back_control(entry),
            Lane::Stop | Lane::Sign => self.put_back_unpaced(entry),
        }
    }

    /// Whether the link has taken a part of something.
    pub fn has_begun(&self) -> bool {
        self.begun.is_some()
    }

    /// Puts what is left of a run, as `rest` makes it of the run and the bytes that have left, in the place of the run: what
    /// has left of it has no meaning in another form. For a queue that was restarted.
    pub fn split_begun(&mut self, rest: impl Fn(&Arc<I>, usize) -> Arc<I>) {
        let fronts = self.data.values_mut().filter_map(DataLane::front_mut);
        for begun in fronts
            .chain(self.again.iter_mut())
            .filter(|entry| entry.is_begun())
        {
            begun.item = rest(&begun.item, begun.progress.sent);
            begun.progress = Progress::default();
        }
    }

    /// Goes on in another form: what waits counts what it takes there.
    pub fn change_form(&mut self, form: Option<Form>) {
        if form == self.form {
            return;
        }
        self.form = form;
        let control = self.control.iter().map(|entry| entry.item.charge(form));
        self.control_bytes = control.sum();
        (self.data_bytes, self.reliable_bytes) = (0, 0);
        let data = self.data.values().flat_map(|lane| lane.iter());
        for entry in data.chain(&self.open).chain(self.again.iter()) {
            let size = entry.item.charge(form);
            match entry.item.lane() {
                Lane::Data(_) => {
                    self.data_bytes += size;
                    self.reliable_bytes += reliable(&*entry.item, size);
                }
                Lane::Control => self.control_bytes += size,
                Lane::Stop | Lane::Sign => {}
            }
        }
    }

    /// Tells the policy of parcels that had left and are not sent again.
    pub fn note_unread(&mut self, item: &Arc<I>, parcels: u64, reason: DropReason) {
        self.policy.dropped(item, parcels, reason);
    }
}
