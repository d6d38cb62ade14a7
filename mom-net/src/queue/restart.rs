//! A queue between two connections of the same peer: nothing of the first one reaches into the second.

use std::cmp::Reverse;
use std::sync::Arc;

use mom_proto::codec::Form;

use super::ledger::{BadCount, Kept, Ledger, Rewound};
use super::piece::{Entry, Piece, Progress};
use super::{DropPolicy, DropReason, Item, Lane, SendQueue, reliable};

impl<I: Item, P: DropPolicy<I>> SendQueue<I, P> {
    /// The connection is lost: what it has taken a part of begins anew on the next one. Parcels of a run that it has taken
    /// whole are counted.
    pub fn restart(&mut self, ledger: &mut Ledger<I>) {
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
    }

    /// Takes in how many parcels the other side has read: as many as it acknowledges are kept no longer.
    ///
    /// # Errors
    /// A count that cannot be.
    pub fn acknowledge(&self, ledger: &mut Ledger<I>, read: u64) -> Result<(), BadCount> {
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

    /// Puts what has to be sent again in front of what waits.
    ///
    /// # Errors
    /// A count that cannot be.
    pub fn resend(&mut self, ledger: &mut Ledger<I>, read: u64) -> Result<Rewound, BadCount> {
        let (rewound, kept) = ledger.rewind(read, self.form)?;
        for kept in kept.into_iter().rev() {
            self.send_again(kept);
        }
        Ok(rewound)
    }

    fn send_again(&mut self, kept: Kept<I>) {
        let entry = kept.into_entry();
        // The rest of a run that has not left yet goes with it.
        if let Lane::Data(priority) = entry.item.lane()
            && let Some(lane) = self.data.get_mut(&Reverse(priority))
            && let Some(front) = lane.front_mut()
            && Arc::ptr_eq(&front.item, &entry.item)
        {
            front.progress = entry.progress;
            return;
        }
        let size = self.charge(&entry.item);
        match entry.item.lane() {
            Lane::Control => self.control_bytes += size,
            Lane::Data(_) => {
                self.data_bytes += size;
                self.reliable_bytes += reliable(&*entry.item, size);
            }
            Lane::Stop | Lane::Sign => {}
        }
        self.put_in_front(entry);
    }

    fn put_in_front(&mut self, entry: Entry<I>) {
        match entry.item.lane() {
            Lane::Data(priority) => self.put_back_data(entry, Reverse(priority)),
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
        for lane in self.data.values_mut() {
            if let Some(front) = lane.front_mut().filter(|front| front.is_begun()) {
                front.item = rest(&front.item, front.progress.sent);
                front.progress = Progress::default();
            }
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
        for entry in data.chain(&self.open) {
            let size = entry.item.charge(form);
            match entry.item.lane() {
                Lane::Data(_) => {
                    self.data_bytes += size;
                    self.reliable_bytes += reliable(&*entry.item, size);
                }
                _ => self.control_bytes += size,
            }
        }
    }

    /// Tells the policy of parcels that had left and are not sent again.
    pub fn note_unread(&mut self, item: &Arc<I>, parcels: u64, reason: DropReason) {
        self.policy.dropped(item, parcels, reason);
    }
}
