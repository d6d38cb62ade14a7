//! A large parcel that is written in another form than it came in when the first of its receivers comes to it: as text,
//! compressed or decompressed.
//!
//! It waits in the outboxes of its receivers like any other, so order, lanes, fences, expiry and replacement hold for it, and
//! what is replaced before its turn is never written at all. Receivers of other forms do not wait for it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use mom_proto::Parcel;
use mom_proto::codec::{Encoded, Form};
use mom_system::Workers;
use tokio::sync::Notify;

use crate::traffic::encodings::Bounds;
use crate::traffic::memory::{Account, Charge};

/// One parcel for all its receivers that speak this form.
#[derive(Debug)]
pub(crate) struct LaterFrame {
    form: Form,
    parcel: Parcel,
    size: usize,
    bounds: Bounds,
    workers: Arc<Workers>,
    begun: AtomicBool,
    /// The user who is charged for it, if any.
    account: OnceLock<Arc<Account>>,
    /// For what was written, beside the parcel.
    charge: OnceLock<Charge>,
    /// None inside: it has no such form, or a larger one than receivers were promised.
    written: OnceLock<Option<Encoded>>,
    done: Notify,
}

impl LaterFrame {
    pub(crate) fn new(
        form: Form,
        parcel: Parcel,
        size: usize,
        bounds: Bounds,
        workers: Arc<Workers>,
    ) -> LaterFrame {
        LaterFrame {
            form,
            parcel,
            size,
            bounds,
            workers,
            begun: AtomicBool::new(false),
            account: OnceLock::new(),
            charge: OnceLock::new(),
            written: OnceLock::new(),
            done: Notify::new(),
        }
    }

    /// What is to be written.
    pub(crate) fn parcel(&self) -> &Parcel {
        &self.parcel
    }

    /// The bytes of the parcel, decompressed.
    pub(crate) fn size(&self) -> usize {
        self.size
    }

    /// Its frame, once it was written; none inside if it cannot be.
    pub(crate) fn written(&self) -> Option<Option<&Encoded>> {
        self.written.get().map(Option::as_ref)
    }

    /// From now on, what it takes once it is written is charged there.
    pub(crate) fn charge_to(&self, account: &Arc<Account>) {
        let _ = self.account.set(Arc::clone(account));
    }

    /// Has it written, if nobody has so far, and waits for that. What was dropped everywhere before its turn is not written, and no job
    /// keeps it.
    pub(crate) async fn write(self: &Arc<LaterFrame>) {
        if !self.begun.swap(true, Ordering::AcqRel) {
            let later = Arc::downgrade(self);
            self.workers.run(move || {
                if let Some(later) = later.upgrade() {
                    later.write_now();
                }
            });
        }
        loop {
            // Made before the look, so that no end is missed.
            let done = self.done.notified();
            if self.written.get().is_some() {
                return;
            }
            done.await;
        }
    }

    fn write_now(&self) {
        let written = self.bounds.write(self.form, &self.parcel);
        if let (Some(account), Some(frame)) = (self.account.get(), &written) {
            let _ = self.charge.set(account.charge(frame.len()));
        }
        let _ = self.written.set(written);
        self.done.notify_waiters();
    }
}
