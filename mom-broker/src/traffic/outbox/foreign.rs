//! Parcels that were encoded for a receiver before it came back in another form.

use std::sync::Arc;

use mom_net::DropReason;
use mom_proto::{Parcel, WireError};

use super::link::Paths;
use super::{Charged, Outbox, Packet};
use crate::traffic::encodings::Encodings;

impl Outbox {
    /// Encodes a packet that goes next in the form that the receiver speaks now.
    pub(super) fn translate(&self, packet: &Arc<Packet>) {
        let paths = {
            let way = self.way();
            let link = way.link.as_ref();
            link.and_then(|link| link.paths.as_ref()?.upgrade())
        };
        let form = self.form();
        let encode = |parcel: Parcel| -> Result<Arc<Packet>, WireError> {
            let encodings = Encodings::new(named(parcel, paths.as_deref()), std::iter::once(form))?;
            Ok(Arc::new(Packet {
                encodings,
                lane: packet.lane,
                delivery: packet.delivery,
                origin: packet.origin.clone(),
                expires_at: packet.expires_at,
                gate: packet.gate.clone(),
                count: 1,
                counts: packet.counts,
                outlives_loss: packet.outlives_loss,
                charged: Charged::With(Arc::clone(packet)),
            }))
        };
        let parcels = packet.encodings.parcels().unwrap_or_default();
        let parcels: Vec<Arc<Packet>> = parcels
            .into_iter()
            .filter_map(|parcel| encode(parcel).ok())
            .collect();
        let bad = u64::from(packet.count).saturating_sub(parcels.len() as u64);
        let mut queue = self.queue.lock();
        if bad > 0 {
            queue.note_unread(packet, bad, DropReason::BadContent);
        }
        queue.replace_front(packet, parcels);
    }
}

/// A parcel that names its context by path, as the text forms need it.
fn named(mut parcel: Parcel, paths: Option<&dyn Paths>) -> Parcel {
    if parcel.context.is_none() {
        let number = parcel.number;
        parcel.context = number.zip(paths).and_then(|(number, paths)| paths.path(number));
    }
    parcel
}
