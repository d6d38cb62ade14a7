//! What waits to be written: stops, signs of life, control, then messages by their priority, in the queue that the hub
//! sends through as well (design §7).

mod entry;

use std::collections::VecDeque;
use std::sync::Arc;

use mom_net::{
    Allowance, BadCount, DropPolicy, DropReason, Item, Lane, Ledger, Outgoing, Piece, Rest, Rewound,
    SendQueue,
};
use mom_proto::codec::Form;
use mom_proto::{Limit, Parcel, ReadCount, Verb};

pub(crate) use entry::{Capacity, Entry, Follows, Message};

/// The queue of one client, over all of its links. Control is bounded by what a peer asks at a time; for messages their
/// senders wait for capacity, but for stops, of which one waits for each context.
#[derive(Debug)]
pub(crate) struct Outbox {
    queue: SendQueue<Entry, Drops>,
    finished: bool,
    now: Mark,
}

/// What an outbox has come through: what a writer took before that changed is not what waits now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Mark {
    /// Links that were lost.
    pub(crate) link: u64,
    /// How often everything was forgotten.
    clears: u64,
}

/// Messages that will not be sent, and why: `Closed` if the link was lost.
pub(crate) type Dropped = Vec<(Arc<Entry>, DropReason)>;

#[derive(Debug, Default)]
struct Drops(Dropped);

impl DropPolicy<Entry> for Drops {
    fn stale(&self, entry: &Entry, now: u64) -> Option<DropReason> {
        let over = entry.expires_at.is_some_and(|end| now >= end);
        over.then_some(DropReason::Expired)
    }

    fn dropped(&mut self, entry: &Arc<Entry>, _: u64, reason: DropReason) {
        // The newer stop says the same.
        if entry.lane() != Lane::Stop || reason != DropReason::Replaced {
            self.0.push((Arc::clone(entry), reason));
        }
    }
}

impl Outbox {
    /// For links of this form, none inside a process.
    pub(crate) fn new(form: Option<Form>) -> Outbox {
        Outbox {
            queue: SendQueue::new(form, usize::MAX, Drops::default()),
            finished: false,
            now: Mark::default(),
        }
    }

    /// Takes in a request or a sign of life, behind these of the messages that wait.
    pub(crate) fn push_control(&mut self, parcel: &Parcel, outgoing: Outgoing, follows: Follows) {
        let entry = Entry::control(parcel, outgoing, follows);
        self.queue.push(Arc::new(entry));
    }

    /// Takes in a message; gives what it replaces or withdraws.
    pub(crate) fn push_message(&mut self, parcel: &Parcel, message: Message) -> Dropped {
        let lane = match Verb::of(parcel.family, parcel.name()) {
            Ok(Verb::Stop) => Lane::Stop,
            Ok(Verb::Unstop) => Lane::Control,
            _ => Lane::Data(parcel.priority.unwrap_or_default()),
        };
        let entry = Entry::message(parcel, lane, message);
        self.queue.push(Arc::new(entry));
        self.take_dropped()
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

    /// Whether something waits that pacing does not hold back.
    pub(crate) fn has_unpaced(&self) -> bool {
        self.queue.has_unpaced()
    }

    /// Takes what the network has room for, at this time in µs of the wall clock; false if something waits and there is no
    /// room. `parcel` is the largest one that the hub takes.
    pub(crate) fn take(
        &mut self,
        now: u64,
        allowance: Allowance,
        parcel: Limit,
        batch: &mut VecDeque<Piece<Entry>>,
    ) -> bool {
        self.queue.set_limits(usize::MAX, parcel);
        matches!(self.queue.take(now, allowance, batch), Rest::None)
    }

    /// Puts back what was taken at `taken` and not written. What was forgotten meanwhile will not be sent after all.
    pub(crate) fn put_back(&mut self, batch: &mut VecDeque<Piece<Entry>>, taken: Mark) {
        while let Some(piece) = batch.pop_back() {
            let lost = if self.now.link != taken.link {
                piece.into_last()
            } else if self.now != taken && !piece.is_begun() {
                self.queue.forget(piece)
            } else {
                self.queue.put_back(piece);
                None
            };
            let lost = lost.filter(|entry| entry.is_message());
            let drops = &mut self.queue.policy().0;
            drops.extend(lost.map(|entry| (entry, DropReason::Closed)));
        }
    }

    /// The messages that were dropped since this was last asked.
    pub(crate) fn take_dropped(&mut self) -> Dropped {
        std::mem::take(&mut self.queue.policy().0)
    }

    /// Takes in how many parcels the hub has read.
    pub(crate) fn acknowledge(&self, ledger: &mut Ledger<Entry>, read: ReadCount) -> Result<(), BadCount> {
        self.queue.acknowledge(ledger, read)
    }

    /// The connection is lost and may be resumed. Gives what must not be sent late.
    pub(crate) fn suspend(&mut self, ledger: &mut Ledger<Entry>) -> Dropped {
        self.now.link += 1;
        drop(self.queue.restart(ledger));
        self.take_dropped()
    }

    /// Puts what the hub has not read in front of what waits, and behind it the parcel that tells the hub so; gives how much of it
    /// is not sent again, and what of that must not be sent late.
    pub(crate) fn resend(
        &mut self,
        ledger: &mut Ledger<Entry>,
        read: ReadCount,
        (end, outgoing): (&Parcel, Outgoing),
    ) -> Result<(Rewound, Dropped), BadCount> {
        let end = Entry::control(end, outgoing, Follows::Nothing);
        let rewound = self.queue.resend(ledger, read, Some(Arc::new(end)))?;
        Ok((rewound, self.take_dropped()))
    }

    /// Forgets everything, as the peer is another one from now on, on this link or, if that is gone, the next; gives
    /// the messages.
    pub(crate) fn clear(&mut self, link_is_gone: bool) -> Dropped {
        self.now.clears += 1;
        self.now.link += u64::from(link_is_gone);
        let entries = self.queue.clear(link_is_gone).into_iter();
        let messages = entries.filter(|entry| entry.is_message());
        messages.map(|entry| (entry, DropReason::Closed)).collect()
    }
}

#[cfg(test)]
mod cases;
#[cfg(test)]
mod tests;
