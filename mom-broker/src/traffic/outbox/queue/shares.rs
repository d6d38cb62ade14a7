//! What of a device's queue others than the owner of its token may fill: it is not closed because of what somebody sends to it.
//!
//! What needs no token may fill three quarters of the bound, and what one user says of it a quarter. More is refused, to its sender: the
//! rest is for the owner's commands.

use std::sync::Arc;

use mom_net::{Item as _, Lane};
use mom_proto::{Delivery, Micros};

use super::PeerQueue;
use crate::traffic::memory::Account;
use crate::traffic::outbox::Packet;

/// Who has how much is looked up at most so often, µs: that takes as long as much waits.
const LOOK: Micros = 20_000;

/// Who has how much waiting, as of the last look, with what came since. What has left since counts until the next.
#[derive(Debug, Default)]
pub(super) struct Shares {
    looked_at: Option<Micros>,
    users: Vec<(Arc<Account>, usize)>,
    /// Of all, also of who has no account.
    all: usize,
}

/// Whether what waits is within the shares: it may not be dropped, and needs no token.
fn is_shared(packet: &Packet) -> bool {
    matches!(packet.lane, Lane::Data(_)) && packet.gate.is_none() && packet.delivery == Delivery::Reliable
}

impl PeerQueue {
    /// It is a device's from now on.
    pub(crate) fn note_device(&mut self) {
        self.shares.get_or_insert_default();
    }

    /// Whether it is a device's.
    pub(crate) fn is_device(&self) -> bool {
        self.shares.is_some()
    }

    /// Whether one more is beyond what its sender may have waiting for a device.
    pub(super) fn is_beyond_share(&mut self, packet: &Packet, now: Micros) -> bool {
        let Some(shares) = self.shares.as_mut().filter(|_| is_shared(packet)) else {
            return false;
        };
        let (form, limit) = (self.queue.form(), self.queue.limit());
        let size = packet.charge(form);
        let few = self.queue.data_bytes() == 0 || self.queue.data_bytes() + size <= limit / 4;
        if shares.looked_at.is_none_or(|at| now.saturating_sub(at) >= LOOK) {
            **shares = Shares::default();
            if few {
                return false;
            }
            shares.looked_at = Some(now);
            let waiting = self.queue.data().filter(|waiting| is_shared(waiting));
            waiting.for_each(|waiting| shares.add(waiting.account(), waiting.charge(form)));
        }
        let beyond = shares.all + size > limit / 4 * 3 || shares.of(packet.account()) + size > limit / 4;
        if beyond && !few {
            return true;
        }
        shares.add(packet.account(), size);
        false
    }
}

impl Shares {
    fn of(&self, account: Option<&Arc<Account>>) -> usize {
        let own =
            |(known, _): &&(Arc<Account>, usize)| account.is_some_and(|account| Arc::ptr_eq(known, account));
        self.users.iter().find(own).map_or(0, |(_, held)| *held)
    }

    fn add(&mut self, account: Option<&Arc<Account>>, bytes: usize) {
        self.all += bytes;
        let Some(account) = account else { return };
        match self
            .users
            .iter_mut()
            .find(|(known, _)| Arc::ptr_eq(known, account))
        {
            Some((_, held)) => *held += bytes,
            None => self.users.push((Arc::clone(account), bytes)),
        }
    }
}
