//! Waiting for capacity in an outbox, without holding anything that others need.

use std::future::poll_fn;
use std::sync::Arc;
use std::task::{Poll, Waker};

use mom_proto::Micros;
use mom_system::sync::atomic::Ordering;

use super::{Outbox, PeerQueue};

/// A sender among the waiters of an outbox. Dropping it makes way for the next.
#[derive(Debug)]
pub(crate) struct WaiterHandle {
    outbox: Arc<Outbox>,
    ticket: u64,
}

impl WaiterHandle {
    /// Waits until it is worth looking again: there may be capacity, or the wait may be of no use any more.
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

    /// Since when there was no capacity for anybody who waited.
    pub(crate) fn full_since(&self) -> Option<Micros> {
        self.outbox.queue.lock().full_since()
    }

    fn ticket_at(&self, outbox: &Arc<Outbox>) -> Option<u64> {
        Arc::ptr_eq(&self.outbox, outbox).then_some(self.ticket)
    }
}

impl Drop for WaiterHandle {
    fn drop(&mut self) {
        let mut queue = self.outbox.queue.lock();
        let next = queue.stop_waiting(self.ticket);
        self.outbox.note_awaited(&queue);
        drop(queue);
        next.into_iter().for_each(Waker::wake);
    }
}

impl Outbox {
    /// Waits for capacity for so many bytes; false if there is some, and for a connection that is closed. `own` is where
    /// the sender waits so far: it is kept if that is here.
    pub(crate) fn wait_for(self: &Arc<Outbox>, need: usize, own: &mut Option<WaiterHandle>) -> bool {
        let ticket = own.as_ref().and_then(|place| place.ticket_at(self));
        let mut queue = self.queue.lock();
        if self.is_closed() || queue.has_capacity(need, ticket) {
            return false;
        }
        let ticket_here = queue.wait_for(need, ticket, self.clock.now());
        self.note_awaited(&queue);
        drop(queue);
        if ticket.is_none() {
            // What it had elsewhere is given up, after this lock is.
            *own = Some(WaiterHandle {
                outbox: Arc::clone(self),
                ticket: ticket_here,
            });
        }
        true
    }

    /// Whether there is no capacity for so many bytes, looked at in passing.
    pub(crate) fn is_full_for(&self, need: usize) -> bool {
        !self.is_closed() && !self.queue.lock().has_capacity(need, None)
    }

    /// Whether there is capacity for so many bytes for which nobody waits.
    pub(crate) fn could_take(&self, need: usize) -> bool {
        self.is_closed() || self.queue.lock().could_take(need)
    }

    /// Bytes that may be put in without waiting.
    pub(crate) fn capacity_left(&self) -> usize {
        match self.is_closed() {
            true => usize::MAX,
            false => self.queue.lock().capacity_left(),
        }
    }

    /// Has those who wait for capacity here look again whether they still have to.
    pub(crate) fn call_all(&self) {
        if self.awaited.load(Ordering::SeqCst) {
            let called = self.queue.lock().call_all();
            called.into_iter().for_each(Waker::wake);
        }
    }

    /// Whether a sender waits for capacity here, or has waited in vain.
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

    /// A taker looks at this without the lock afterwards; it is set under that lock, so nobody who still
    /// finds none is overlooked.
    fn note_awaited(&self, queue: &PeerQueue) {
        self.awaited.store(queue.is_awaited(), Ordering::SeqCst);
    }
}
