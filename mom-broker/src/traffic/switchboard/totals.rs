//! What the whole hub has counted.

use crate::traffic::statistics::Counts;
use crate::traffic::switchboard::Switchboard;

/// The figures of a hub at one moment, of all its channels, those that are gone too.
#[derive(Debug, Default)]
pub(crate) struct Totals {
    pub(crate) channels: usize,
    pub(crate) counts: Counts,
    /// Bytes that wait for receivers.
    pub(crate) queued: usize,
}

impl Switchboard {
    pub(crate) fn totals(&self) -> Totals {
        let mut totals = Totals {
            counts: self.gone.lock().clone(),
            ..Totals::default()
        };
        for channel in &self.channels {
            totals.channels += 1;
            totals.counts.add(&channel.counts());
        }
        for outbox in &self.outboxes {
            totals.queued += outbox.queued();
        }
        totals
    }
}
