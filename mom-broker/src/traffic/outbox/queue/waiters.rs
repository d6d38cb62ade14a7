//! Senders that wait for capacity, where their channel has them wait (design §7).
//!
//! Capacity goes to the first waiter. What waits for a receiver because of them may fill half of its outbox only, so that
//! channels in which nobody waits have the other half.

use std::collections::VecDeque;
use std::task::Waker;

use mom_proto::Micros;

use super::PeerQueue;

/// The senders that wait for capacity in one outbox.
#[derive(Debug, Default)]
pub(super) struct Waiters {
    waiting: VecDeque<Waiter>,
    last_ticket: u64,
    /// Since when there was no capacity for what was asked for, and for how many bytes at least.
    full: Option<(Micros, usize)>,
}

#[derive(Debug)]
struct Waiter {
    ticket: u64,
    need: usize,
    /// It was told to look again, and has not done so.
    called: bool,
    waker: Option<Waker>,
}

impl PeerQueue {
    /// Bytes that may be added now by senders that would wait else, if nobody waits.
    pub(crate) fn capacity_left(&self) -> usize {
        match &self.waiters {
            Some(waiters) if !waiters.waiting.is_empty() => 0,
            _ => (self.queue.limit() / 2).saturating_sub(self.queue.reliable_bytes()),
        }
    }

    /// Whether what may not be dropped leaves capacity for so many bytes more within all of the bound.
    pub(crate) fn could_take(&self, need: usize) -> bool {
        self.queue.reliable_bytes() == 0 || self.queue.reliable_bytes() + need <= self.queue.limit()
    }

    /// Whether there is capacity for so many bytes and nobody else has waited for longer.
    pub(crate) fn has_capacity(&self, need: usize, ticket: Option<u64>) -> bool {
        let waiters = self.waiters.as_ref();
        let first = waiters.and_then(|waiters| waiters.waiting.front());
        first.is_none_or(|first| Some(first.ticket) == ticket) && self.fits(need)
    }

    /// Waits for so many bytes, or goes on waiting; gives the ticket.
    pub(crate) fn wait_for(&mut self, need: usize, ticket: Option<u64>, now: Micros) -> u64 {
        let full = !self.fits(need);
        let waiters = self.waiters.get_or_insert_default();
        if full {
            let (since, least) = waiters.full.unwrap_or((now, need));
            waiters.full = Some((since, least.min(need)));
        }
        let own = |waiter: &&mut Waiter| Some(waiter.ticket) == ticket;
        if let Some(waiter) = waiters.waiting.iter_mut().find(own) {
            (waiter.need, waiter.called) = (need, false);
            return waiter.ticket;
        }
        waiters.last_ticket += 1;
        waiters.waiting.push_back(Waiter {
            ticket: waiters.last_ticket,
            need,
            called: false,
            waker: None,
        });
        waiters.last_ticket
    }

    /// Waits no more; gives whom to wake.
    pub(crate) fn stop_waiting(&mut self, ticket: u64) -> Option<Waker> {
        if let Some(waiters) = &mut self.waiters {
            waiters.waiting.retain(|waiter| waiter.ticket != ticket);
        }
        self.call_next()
    }

    /// After capacity may have been made: whom to wake.
    pub(crate) fn call_next(&mut self) -> Option<Waker> {
        let mut waiters = self.waiters.take()?;
        if waiters.full.is_some_and(|(_, least)| self.fits(least)) {
            waiters.full = None;
        }
        let first = waiters.waiting.front_mut();
        let first = first.filter(|first| !first.called && self.fits(first.need));
        let waker = first.and_then(Waiter::call);
        if waiters.full.is_some() || !waiters.waiting.is_empty() {
            self.waiters = Some(waiters);
        }
        waker
    }

    /// Has all look again, for what they wait for may never come or be needed any more.
    pub(crate) fn call_all(&mut self) -> Vec<Waker> {
        let waiters = self.waiters.iter_mut();
        waiters
            .flat_map(|waiters| &mut waiters.waiting)
            .filter_map(Waiter::call)
            .collect()
    }

    /// Whether the holder of a ticket was called since it looked last; it is woken when it is.
    pub(crate) fn is_called(&mut self, ticket: u64, waker: &Waker) -> bool {
        let waiters = self.waiters.iter_mut();
        let own = waiters
            .flat_map(|waiters| &mut waiters.waiting)
            .find(|waiter| waiter.ticket == ticket);
        let Some(waiter) = own else { return true };
        waiter.waker = Some(waker.clone());
        waiter.called
    }

    /// Whether a sender waits, or has waited in vain since there was capacity last.
    pub(crate) fn is_awaited(&self) -> bool {
        self.waiters.is_some()
    }

    /// Since when there was no capacity for those who waited.
    pub(crate) fn full_since(&self) -> Option<Micros> {
        self.waiters.as_ref()?.full.map(|(since, _)| since)
    }

    /// One parcel may be larger than the bound: it goes where nothing waits that may not be dropped.
    fn fits(&self, need: usize) -> bool {
        self.queue.reliable_bytes() == 0 || self.queue.reliable_bytes() + need <= self.queue.limit() / 2
    }
}

impl Waiter {
    fn call(&mut self) -> Option<Waker> {
        self.called = true;
        self.waker.take()
    }
}
