//! Senders that wait for room, where their channel has them wait (design §7).
//!
//! They stand in one line: room goes to whoever came first. What waits for a receiver because of them may fill half of
//! its outbox only, so that channels in which nobody waits find room in the other half.

use std::collections::VecDeque;
use std::task::Waker;

use mom_managers::Micros;

use super::Queue;

/// The line at one outbox.
#[derive(Debug, Default)]
pub(super) struct Line {
    waiting: VecDeque<Waiter>,
    last_ticket: u64,
    /// Since when there was no room for what was asked for, and for how many bytes at least.
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

impl Queue {
    /// Bytes that may be added now by senders that would wait else, if nobody waits.
    pub(crate) fn room_left(&self) -> usize {
        match &self.line {
            Some(line) if !line.waiting.is_empty() => 0,
            _ => (self.limit / 2).saturating_sub(self.reliable_bytes),
        }
    }

    /// Whether what may not be dropped leaves room for so many bytes more within all of the bound.
    pub(crate) fn could_take(&self, need: usize) -> bool {
        self.reliable_bytes == 0 || self.reliable_bytes + need <= self.limit
    }

    /// Whether there is room for so many bytes and nobody else has waited for longer.
    pub(crate) fn has_room(&self, need: usize, ticket: Option<u64>) -> bool {
        let line = self.line.as_ref();
        let first = line.and_then(|line| line.waiting.front());
        first.is_none_or(|first| Some(first.ticket) == ticket) && self.is_room_for(need)
    }

    /// Lines up for so many bytes, or stays where one is; gives the ticket.
    pub(crate) fn line_up(&mut self, need: usize, ticket: Option<u64>, now: Micros) -> u64 {
        let full = !self.is_room_for(need);
        let line = self.line.get_or_insert_default();
        if full {
            let (since, least) = line.full.unwrap_or((now, need));
            line.full = Some((since, least.min(need)));
        }
        let own = |waiter: &&mut Waiter| Some(waiter.ticket) == ticket;
        if let Some(waiter) = line.waiting.iter_mut().find(own) {
            (waiter.need, waiter.called) = (need, false);
            return waiter.ticket;
        }
        line.last_ticket += 1;
        line.waiting.push_back(Waiter {
            ticket: line.last_ticket,
            need,
            called: false,
            waker: None,
        });
        line.last_ticket
    }

    /// Leaves the line; gives whom to wake.
    pub(crate) fn leave_line(&mut self, ticket: u64) -> Option<Waker> {
        if let Some(line) = &mut self.line {
            line.waiting.retain(|waiter| waiter.ticket != ticket);
        }
        self.call_next()
    }

    /// After room may have been made: whom to wake.
    pub(crate) fn call_next(&mut self) -> Option<Waker> {
        let mut line = self.line.take()?;
        if line.full.is_some_and(|(_, least)| self.is_room_for(least)) {
            line.full = None;
        }
        let first = line.waiting.front_mut();
        let first = first.filter(|first| !first.called && self.is_room_for(first.need));
        let waker = first.and_then(Waiter::call);
        if line.full.is_some() || !line.waiting.is_empty() {
            self.line = Some(line);
        }
        waker
    }

    /// Has all look again, for what they wait for may never come or be needed any more.
    pub(crate) fn call_all(&mut self) -> Vec<Waker> {
        let line = self.line.iter_mut();
        line.flat_map(|line| &mut line.waiting)
            .filter_map(Waiter::call)
            .collect()
    }

    /// Whether the holder of a ticket was called since it looked last; it is woken when it is.
    pub(crate) fn is_called(&mut self, ticket: u64, waker: &Waker) -> bool {
        let line = self.line.iter_mut();
        let own = line
            .flat_map(|line| &mut line.waiting)
            .find(|waiter| waiter.ticket == ticket);
        let Some(waiter) = own else { return true };
        waiter.waker = Some(waker.clone());
        waiter.called
    }

    /// Whether somebody waits, or has waited in vain since there was room last.
    pub(crate) fn is_awaited(&self) -> bool {
        self.line.is_some()
    }

    /// Since when there was no room for those who waited.
    pub(crate) fn full_since(&self) -> Option<Micros> {
        self.line.as_ref()?.full.map(|(since, _)| since)
    }

    /// One parcel may be larger than the bound: it goes where nothing waits that may not be dropped.
    fn is_room_for(&self, need: usize) -> bool {
        self.reliable_bytes == 0 || self.reliable_bytes + need <= self.limit / 2
    }
}

impl Waiter {
    fn call(&mut self) -> Option<Waker> {
        self.called = true;
        self.waker.take()
    }
}
