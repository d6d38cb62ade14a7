//! A link that survives its connection: what was read is counted and told, what was sent is kept until the hub has read it,
//! and another connection goes on.

use std::sync::atomic::Ordering;

use mom_net::{DropReason, Ledger, Rewound};
use mom_proto::{ContextNumber, Family, Map, Parcel, Path, ReadCount};

use crate::peer::losses::dropped;
use crate::peer::shared::Shared;
use crate::peer::state::{State, Status};
use crate::wire::link_secret::{Counted, LinkSecret, Resumption};
use crate::words::map_of;
use crate::{Event, LinkState};

/// Parcels and bytes after which the hub is told what was read.
const TELL_PARCELS: u64 = 256;
const TELL_BYTES: u64 = 64 * 1024;

/// Where so many bytes are kept that the hub has not read, no more are sent: the hub keeps no more of a lost peer either.
const KEPT: usize = 4 * 1024 * 1024;

impl Shared {
    /// Counts from here on, if the hub has given a link; else not any more.
    pub(crate) fn begin_link(&self, state: &mut State, secret: Option<LinkSecret>) {
        *self.ledger.lock() = secret.is_some().then(|| Box::new(Ledger::new(usize::MAX)));
        self.counts.store(secret.is_some(), Ordering::Relaxed);
        state.counted = secret.map(|secret| Box::new(Counted::new(secret)));
    }

    /// How many bytes may be sent before the hub has to say that it has read some: what is sent is kept until then, all of it, or a lost
    /// connection could not be resumed. A parcel that is larger goes where nothing else is kept.
    pub(crate) fn room_to_keep(&self) -> usize {
        if !self.counts.load(Ordering::Relaxed) {
            return usize::MAX;
        }
        let kept = self.ledger.lock().as_ref().map_or(0, |ledger| ledger.bytes());
        KEPT.saturating_sub(kept)
    }

    /// Counts a parcel of the hub that was read, by its word in the checksum, and tells the hub if it is time; so many bytes have come.
    pub(crate) fn count_read(&self, word: Option<u32>, received: u64) {
        if !self.counts.load(Ordering::Relaxed) {
            return;
        }
        let mut state = self.lock();
        let Some(counted) = &mut state.counted else { return };
        counted.read.count(word);
        let due = counted.read.parcels - counted.told >= TELL_PARCELS
            || received.saturating_sub(counted.told_at) >= TELL_BYTES;
        if due {
            counted.told_at = received;
            self.tell_read(&mut state);
            drop(state);
            self.outgoing.notify_one();
        }
    }

    /// Tells the hub how much was read, if it does not know.
    pub(crate) fn tell_read(&self, state: &mut State) {
        let Some(counted) = state
            .counted
            .as_mut()
            .filter(|counted| counted.read.parcels > counted.told)
        else {
            return;
        };
        counted.told = counted.read.parcels;
        let ack = Parcel::new(Family::Time, "ack").content(counted.read.put(Map::new()));
        // A lost connection needs no acknowledgement: the next one says how much was read.
        let _ = self.ask_in(state, ack, &mut None);
    }

    /// Takes in how much the hub has read.
    pub(crate) fn acknowledged(&self, ack: &Parcel) {
        let state = self.lock();
        let mut ledger = self.ledger.lock();
        let read = ReadCount::of(&map_of(ack));
        let (Some(kept), Some(read)) = (ledger.as_mut(), read) else {
            return;
        };
        if let Err(bad) = state.outbox.acknowledge(kept, read) {
            tracing::warn!(
                ?bad,
                "the hub has read parcels that differ from those sent: a lost connection will not be resumed"
            );
            *ledger = None;
        }
    }

    /// The connection is lost, and may be resumed: what waits goes on waiting, but nothing that would move a device long
    /// after it was said. False if there is nothing to resume.
    pub(crate) fn suspend(&self) -> bool {
        let mut state = self.lock();
        let mut ledger = self.ledger.lock();
        let Some(kept) = ledger.as_mut().filter(|_| state.counted.is_some()) else {
            return false;
        };
        state.status = Status::Resuming;
        let lost = state.outbox.suspend(kept);
        drop(ledger);
        state.subscribers.deliver_all(&Event::LinkDown);
        drop(state);
        self.tell_dropped(&lost);
        true
    }

    /// What a resume needs, while there is something to resume.
    pub(crate) fn resumable(&self) -> Option<Counted> {
        let state = self.lock();
        let resuming = matches!(state.status, Status::Resuming);
        state.counted.as_deref().filter(|_| resuming).cloned()
    }

    /// The numbers of the channels that this peer is in, which hold for every connection of the link.
    pub(crate) fn numbers(&self) -> Vec<(ContextNumber, Path)> {
        self.lock().places.numbers()
    }

    /// Goes on over another connection; false if that cannot be.
    pub(crate) fn go_on(&self, resumption: &Resumption) -> bool {
        let mut state = self.lock();
        let mut ledger = self.ledger.lock();
        let Some(kept) = ledger.as_mut() else { return false };
        let mut resent = Parcel::new(Family::Time, "resent").id(self.next_id());
        let Ok(outgoing) = self.prepare(&mut resent, &state.me) else {
            return false;
        };
        let resent = (&resent, outgoing);
        let (unread, late) = match state.outbox.resend(kept, resumption.read, resent) {
            Ok((Rewound::Dropped(unread), late)) => (unread, late),
            Ok((Rewound::Lost(lost), _)) => {
                tracing::warn!(lost, "more unacknowledged data was in flight than is kept");
                return false;
            }
            Err(bad) => {
                tracing::warn!(?bad, "the hub has read parcels that differ from those sent");
                return false;
            }
        };
        drop(ledger);
        state.status = Status::Up;
        if let Some(counted) = &mut state.counted {
            (counted.told, counted.told_at) = (counted.read.parcels, 0);
        }
        // The others are told one by one.
        let unknown = unread.saturating_sub(late.len() as u64);
        for (reason, count) in [
            (DropReason::Unknown, unknown),
            (DropReason::Lost, resumption.dropped),
        ] {
            if count > 0 {
                let event = dropped(&Path::root(), reason.word(), count);
                state.subscribers.deliver_unaddressed(event);
            }
        }
        self.withdraw_again(&mut state);
        state.subscribers.deliver_all(&Event::Resumed);
        drop(state);
        self.tell_dropped(&late);
        self.link.send_replace(LinkState::Connected);
        self.outgoing.notify_one();
        true
    }
}
