//! A large parcel that is written in XML when the first of its receivers comes to it.
//!
//! It waits in the outboxes of its receivers like any other, so order, lanes, fences, expiry and replacement hold for it, and
//! what is replaced before its turn is never written at all. Receivers of other forms do not wait for it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use mom_proto::codec::Encoded;
use mom_proto::{Parcel, xml};
use mom_system::Workers;
use tokio::sync::Notify;

use crate::traffic::encodings::Bounds;

/// One parcel for all its receivers that speak XML.
#[derive(Debug)]
pub(crate) struct LaterXml {
    parcel: Parcel,
    size: usize,
    bounds: Bounds,
    workers: Arc<Workers>,
    begun: AtomicBool,
    /// None inside: it has no form in XML, or a larger one than receivers were promised.
    written: OnceLock<Option<Encoded>>,
    done: Notify,
}

impl LaterXml {
    pub(crate) fn new(parcel: Parcel, size: usize, bounds: Bounds, workers: Arc<Workers>) -> LaterXml {
        LaterXml {
            parcel,
            size,
            bounds,
            workers,
            begun: AtomicBool::new(false),
            written: OnceLock::new(),
            done: Notify::new(),
        }
    }

    /// The bytes of the parcel as it came.
    pub(crate) fn size(&self) -> usize {
        self.size
    }

    /// Its frame, once it was written; none inside if it cannot be.
    pub(crate) fn written(&self) -> Option<Option<&Encoded>> {
        self.written.get().map(Option::as_ref)
    }

    /// Has it written, if nobody has so far, and waits for that.
    pub(crate) async fn write(self: &Arc<LaterXml>) {
        if !self.begun.swap(true, Ordering::AcqRel) {
            let later = Arc::clone(self);
            self.workers.run(move || later.write_now());
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
        let written = xml::encode_within(&self.parcel, self.bounds.depth, self.bounds.parcel);
        let _ = self.written.set(written.ok());
        self.done.notify_waiters();
    }
}
