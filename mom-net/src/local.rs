//! Two ends inside one process (M18): parcels pass as they are.

use std::sync::Arc;

use mom_proto::{Parcel, WireError, check_message_name};
use tokio::sync::mpsc;

use crate::reader::{Reader, Source};
use crate::writer::{Sink, Writer};
use crate::{Privacy, Transceiver};

/// Parcels that may wait between the ends; the queue with a policy is the broker's outbox.
const WAITING: usize = 64;

/// Two connected transceivers.
pub fn pair() -> (Transceiver, Transceiver) {
    let (to_there, from_here) = mpsc::channel(WAITING);
    let (to_here, from_there) = mpsc::channel(WAITING);
    let end = |sender, receiver| Transceiver {
        reader: Reader::new(Source::Local {
            receiver,
            arrived: None,
        }),
        writer: Writer::new(Sink::Local(sender)),
        privacy: Privacy::Local,
    };
    (end(to_there, from_there), end(to_here, from_here))
}

/// Checks what a codec would have checked.
pub(crate) fn check(parcel: &Parcel) -> Result<(), WireError> {
    check_message_name(&parcel.name)?;
    match &parcel.address {
        Some(address) if address.is_empty() => {
            let text = "the slot address is empty: leave it out to reach all members";
            Err(WireError::new(mom_proto::Code::BAD_SLOT, text).slot("address"))
        }
        _ => Ok(()),
    }
}

pub(crate) fn unshare(parcel: Arc<Parcel>) -> Box<Parcel> {
    Box::new(Arc::unwrap_or_clone(parcel))
}
