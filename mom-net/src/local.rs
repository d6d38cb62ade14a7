//! Two ends inside one process (M18): parcels pass as they are.

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
