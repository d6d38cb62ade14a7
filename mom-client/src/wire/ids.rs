//! The ids of messages that a receiver answers.

use mom_proto::{Family, Parcel, event};

use crate::wire::clock::uptime;

/// Whether a device answers it by its status, or the hub by a receipt.
pub(crate) fn is_answered(parcel: &Parcel) -> bool {
    parcel.family == Family::Message && (parcel.name() == event::COMMAND || parcel.receipt == Some(true))
}

/// Any id from the upper half of those that there are, with room for all that follow.
pub(crate) fn any() -> u64 {
    let mut bits = [0; 8];
    // Without randomness the time since the system began is as good: what matters is that no other connection begins there.
    if getrandom::fill(&mut bits).is_err() {
        bits = uptime().to_le_bytes();
    }
    (1 << 52) | (u64::from_le_bytes(bits) >> 13)
}
