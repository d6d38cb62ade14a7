//! What the whole hub has counted.

use std::collections::BTreeMap;

use mom_proto::codec::Form;

use crate::traffic::statistics::Counts;
use crate::traffic::switchboard::Switchboard;

/// The figures of a hub at one moment, of all its channels, those that are gone too.
#[derive(Debug, Default)]
pub(crate) struct Totals {
    /// Connections by the form that they speak; none inside this process.
    pub(crate) connections: BTreeMap<Option<&'static str>, usize>,
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
            let form = outbox.form().map(Form::word);
            *totals.connections.entry(form).or_default() += 1;
            totals.queued += outbox.queued();
        }
        totals
    }
}
