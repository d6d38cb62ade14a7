//! Waiting for room in an outbox, without holding anything that others need.

use std::future::poll_fn;
use std::sync::Arc;
use std::task::{Poll, Waker};

use mom_managers::Micros;
use mom_system::sync::atomic::Ordering;

use super::{Outbox, Queue};

/// A place in the line of those who wait for room in an outbox. Whoever drops it makes way for the next.
#[derive(Debug)]
pub(crate) struct Place {
    outbox: Arc<Outbox>,
    ticket: u64,
}

impl Place {
    /// Waits until it is worth looking again: there may be room, or the wait may be of no use any more.
    pub(crate) async fn called(&self) {
        poll_fn(
            |context| match self.outbox.queue.lock().is_called(self.ticket, context.waker()) {
                true => Poll::Ready(()),
                false => Poll::Pending,
            },
        )
        .await;
    }

    /// Whose outbox it is.
    pub(crate) fn outbox(&self) -> &Arc<Outbox> {
        &self.outbox
    }

    /// Since when there was no room for anybody who waited.
    pub(crate) fn full_since(&self) -> Option<Micros> {
        self.outbox.queue.lock().full_since()
    }

    fn ticket_at(&self, outbox: &Arc<Outbox>) -> Option<u64> {
        Arc::ptr_eq(&self.outbox, outbox).then_some(self.ticket)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut queue = self.outbox.queue.lock();
        let next = queue.leave_line(self.ticket);
        self.outbox.note_awaited(&queue);
        drop(queue);
        next.into_iter().for_each(Waker::wake);
    }
}

impl Outbox {
    /// Lines up for room for so many bytes; false if there is room, and for a connection that is closed. `own` is the
    /// place that the sender has in some line so far: it is kept if it is in this one.
    pub(crate) fn line_up(self: &Arc<Outbox>, need: usize, own: &mut Option<Place>) -> bool {
        let ticket = own.as_ref().and_then(|place| place.ticket_at(self));
        let mut queue = self.queue.lock();
        if self.is_closed() || queue.has_room(need, ticket) {
            return false;
        }
        let lined = queue.line_up(need, ticket, self.clock.now());
        self.note_awaited(&queue);
        drop(queue);
        if ticket.is_none() {
            // What it had elsewhere is given up, after this lock is.
            *own = Some(Place {
                outbox: Arc::clone(self),
                ticket: lined,
            });
        }
        true
    }

    /// Whether so many bytes find no room, looked at in passing.
    pub(crate) fn is_full_for(&self, need: usize) -> bool {
        !self.is_closed() && !self.queue.lock().has_room(need, None)
    }

    /// Whether there is room for so many bytes for which nobody waits.
    pub(crate) fn could_take(&self, need: usize) -> bool {
        self.is_closed() || self.queue.lock().could_take(need)
    }

    /// Bytes that may be put in without waiting.
    pub(crate) fn room_left(&self) -> usize {
        match self.is_closed() {
            true => usize::MAX,
            false => self.queue.lock().room_left(),
        }
    }

    /// Has those who wait for room here look again whether they still have to.
    pub(crate) fn call_all(&self) {
        if self.awaited.load(Ordering::SeqCst) {
            let called = self.queue.lock().call_all();
            called.into_iter().for_each(Waker::wake);
        }
    }

    /// Whether somebody waits for room here, or has waited in vain.
    #[cfg(all(test, feature = "shuttle"))]
    pub(crate) fn is_awaited(&self) -> bool {
        self.queue.lock().is_awaited()
    }

    /// After something has left: calls who waits for that.
    pub(super) fn call_next(&self) {
        if self.awaited.load(Ordering::SeqCst) {
            let mut queue = self.queue.lock();
            let next = queue.call_next();
            self.note_awaited(&queue);
            drop(queue);
            next.into_iter().for_each(Waker::wake);
        }
    }

    /// Whoever has taken something out looks at this without the lock; it is set under that lock, so nobody who still
    /// finds no room is overlooked.
    fn note_awaited(&self, queue: &Queue) {
        self.awaited.store(queue.is_awaited(), Ordering::SeqCst);
    }
}
