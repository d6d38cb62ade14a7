//! What waits for one peer: the queue of `mom-net`, with senders that wait for capacity and receivers that want fewer
//! (design §7).

mod shares;
mod thinner;
mod thinning;
mod waiters;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use mom_net::{
    Allowance, BadCount, DropPolicy, DropReason, Lane, Ledger, Piece, Rest, Rewound, SendQueue, Taken,
};
use mom_proto::codec::Form;
use mom_proto::{Limits, Micros, ReadCount};

use mom_system::Clock;

use super::packet::{Dropped, Packet};

use shares::Shares;
use thinner::Thinner;
use waiters::Waiters;

/// The queue of one peer.
#[derive(Debug)]
pub(crate) struct PeerQueue {
    queue: SendQueue<Packet, Drops>,
    /// What may not be dropped may take so many bytes for a while.
    burst: usize,
    /// For so long, ms; a small number, as ten thousand idle peers have one.
    patience: u32,
    /// Since when more waits than the bound; 0 = it does not.
    behind_since: Micros,
    /// Senders that wait for capacity; most of the time there is none.
    waiters: Option<Box<Waiters>>,
    /// What waits for its time, where the receiver asked for a rate.
    thinner: Option<Box<Thinner>>,
    /// Who may have how much waiting, where it is a device's.
    shares: Option<Box<Shares>>,
    /// The connection is lost, and may come back.
    lost: bool,
}

/// What was dropped since the last look, and how many.
#[derive(Debug, Default)]
struct Drops {
    lately: BTreeMap<Dropped, u64>,
    /// Since the connection began.
    all: u64,
}

impl DropPolicy<Packet> for Drops {
    fn stale(&self, packet: &Packet, now: Micros) -> Option<DropReason> {
        packet.stale(now)
    }

    fn dropped(&mut self, packet: &Arc<Packet>, parcels: u64, reason: DropReason) {
        // A stop that gave way to a newer one is as good as delivered.
        if packet.lane == Lane::Stop && reason == DropReason::Replaced {
            return;
        }
        // Its sender has a connection of its own: for it the receiver is what was lost.
        let reason = match reason {
            DropReason::Unknown => DropReason::Lost,
            reason => reason,
        };
        let key = Dropped {
            context: packet.origin.context,
            sender: packet.origin.sender,
            reason,
            class: packet.delivery,
        };
        *self.lately.entry(key).or_default() += parcels;
        self.all += parcels;
    }
}

impl PeerQueue {
    pub(crate) fn new(form: Option<Form>, limit: usize) -> PeerQueue {
        PeerQueue {
            queue: SendQueue::new(form, limit, Drops::default()),
            burst: limit,
            patience: 0,
            behind_since: 0,
            waiters: None,
            thinner: None,
            shares: None,
            lost: false,
        }
    }

    /// Puts a packet in. A receiver is slow if it stays behind, not if it is behind: for a while more may wait than the
    /// bound says.
    pub(crate) fn push(&mut self, packet: Arc<Packet>, clock: &Clock) -> Taken {
        if self.is_too_late(&packet) {
            return Taken::Dropped;
        }
        // Most peers are no devices: they need not look at the clock.
        let others = match self.shares.is_some() {
            false => 0,
            true => match self.share_out(&packet, clock.now()) {
                Some(others) => others,
                None => return Taken::Overflow,
            },
        };
        let limit = self.queue.limit();
        if self.lost {
            return self.queue.push_up_to(packet, limit.saturating_add(others));
        }
        let is_behind = |queue: &SendQueue<Packet, Drops>| queue.data_bytes().saturating_sub(others) > limit;
        if !is_behind(&self.queue) {
            self.behind_since = 0;
        }
        let stays_behind = self.behind_since > 0
            && clock.now().saturating_sub(self.behind_since) >= Micros::from(self.patience) * 1000;
        let most = match stays_behind {
            true => limit,
            false => self.burst,
        };
        let taken = self.queue.push_up_to(packet, most.saturating_add(others));
        if self.behind_since == 0 && is_behind(&self.queue) {
            self.behind_since = clock.now().max(1);
        }
        taken
    }

    /// Drops what must not wait for a peer that has lost its connection: it would move a device when that comes back,
    /// long after it was said.
    fn is_too_late(&mut self, packet: &Arc<Packet>) -> bool {
        let late = self.lost && !packet.outlives_loss;
        if late {
            self.queue.note_dropped(packet, DropReason::Lost);
        }
        late
    }

    /// The connection is lost; says whether it has taken whole parcels only, and gives what was dropped for that.
    #[must_use = "freeing it takes its time, which is better done where nobody waits"]
    pub(crate) fn lose(&mut self, ledger: &mut Ledger<Packet>) -> (bool, Vec<Arc<Packet>>) {
        let is_whole = !self.queue.has_begun();
        self.lost = true;
        let mut dropped = self.queue.restart(ledger);
        let held = self.thinner.as_mut().map(|thinner| thinner.take_late());
        for packet in held.into_iter().flatten() {
            self.queue.note_dropped(&packet, DropReason::Lost);
            dropped.push(packet);
        }
        (is_whole, dropped)
    }

    /// The peer has come back.
    pub(crate) fn find(&mut self) {
        self.lost = false;
        self.behind_since = 0;
    }

    /// Puts what the peer has not read in front of what waits, but what does not outlive the loss.
    pub(crate) fn resend(
        &mut self,
        ledger: &mut Ledger<Packet>,
        read: ReadCount,
    ) -> Result<Rewound, BadCount> {
        self.queue.resend(ledger, read, None)
    }

    /// Takes in how many parcels the peer has read.
    pub(crate) fn acknowledge(&self, ledger: &mut Ledger<Packet>, read: ReadCount) -> Result<(), BadCount> {
        self.queue.acknowledge(ledger, read)
    }

    /// Goes on with compressed content, where what waits is not compressed.
    pub(crate) fn begin_packing(&mut self) {
        self.queue.change_form(Some(Form::Packed));
    }

    /// Goes on in another form.
    pub(crate) fn change_form(&mut self, form: Option<Form>) {
        self.queue.split_begun(|packet, sent| Arc::new(packet.rest(sent)));
        self.queue.change_form(form);
    }

    /// Notes parcels that will not be sent, or not again.
    pub(crate) fn note_unread(&mut self, packet: &Arc<Packet>, count: u64, reason: DropReason) {
        self.queue.note_unread(packet, count, reason);
    }

    /// Whether nothing waits.
    pub(crate) fn is_empty(&self) -> bool {
        self.queue.is_empty()
    }

    /// Takes in the last word to a connection, however much waits: it leaves after all else.
    pub(crate) fn push_last(&mut self, packet: Arc<Packet>) {
        self.queue.push_last(packet);
    }

    /// Changes the bounds, as after login.
    pub(crate) fn set_limits(&mut self, limits: &Limits) {
        self.queue.set_limits(limits.outbox, limits.parcel);
        self.burst = limits.burst.max(limits.outbox);
        self.patience = u32::try_from(limits.stalled).unwrap_or(u32::MAX);
    }

    /// Takes what the network has room for; says what the rest waits for, if nothing may be written.
    pub(crate) fn take(
        &mut self,
        now: Micros,
        allowance: Allowance,
        batch: &mut VecDeque<Piece<Packet>>,
    ) -> Rest<Packet> {
        self.release_due(now);
        self.queue.take(now, allowance, batch)
    }

    /// Puts others into the place of a packet that goes next and is not ready.
    pub(crate) fn replace_front(&mut self, packet: &Arc<Packet>, others: Vec<Arc<Packet>>) {
        self.queue.replace_front(packet, others);
    }

    /// Puts back what the link did not take.
    pub(crate) fn put_back(&mut self, batch: &mut VecDeque<Piece<Packet>>) {
        self.queue.put_back_all(batch);
    }

    /// Forgets all messages and gives them, for a connection that is to hear only why it ends.
    #[must_use = "freeing it takes its time, which is better done where nobody waits"]
    pub(crate) fn drop_data(&mut self) -> Vec<Arc<Packet>> {
        let mut dropped = self.queue.drop_data();
        dropped.extend(self.drop_thinned(None));
        dropped
    }

    /// Drops what waits and of which `goes` says so, for want of memory; gives it, and its bytes.
    #[must_use = "freeing it takes its time, which is better done where nobody waits"]
    pub(crate) fn drop_for_memory(&mut self, goes: impl Fn(&Packet) -> bool) -> (Vec<Arc<Packet>>, usize) {
        self.queue.drop_data_of(DropReason::Memory, goes)
    }

    /// What was dropped since the last call.
    pub(crate) fn take_drops(&mut self) -> BTreeMap<Dropped, u64> {
        std::mem::take(&mut self.queue.policy().lately)
    }

    /// How many parcels were dropped since the connection began.
    pub(crate) fn dropped(&mut self) -> u64 {
        self.queue.policy().all
    }

    /// The bytes of messages, replies and events that wait.
    pub(crate) fn bytes(&self) -> usize {
        self.queue.bytes()
    }
}

#[cfg(test)]
mod cases;

#[cfg(test)]
mod tests;

#[cfg(test)]
mod thinning_tests;

#[cfg(test)]
mod waiters_tests;
