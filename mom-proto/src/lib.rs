//! The vocabulary of MOM: the values, parcels, paths, verbs, codes, limits and codecs.
//!
//! Everything that peers and the hub exchange is a [`Parcel`] (M2, M3): a list of slots, some of them
//! known and typed, any other passed through unchanged. This crate does no IO, reads no clock and knows
//! no runtime; it turns bytes into parcels and parcels into bytes.
//!
//! ```
//! use mom_proto::{Family, Parcel, Path};
//!
//! let parcel = Parcel::new(Family::Message, "chat")
//!     .context(Path::parse("/chat").unwrap())
//!     .content("good morning");
//! assert_eq!(parcel.name(), "chat");
//! ```

#[cfg(test)]
mod arbitrary;
pub mod binary;
mod card;
mod challenge;
mod checksum;
mod clock_offset;
pub mod codec;
mod codes;
mod compression;
mod content;
mod context_kind;
mod delivery;
mod error;
pub mod event;
mod family;
mod fence;
mod fingerprint;
mod frame;
mod gcra;
pub mod json;
mod limits;
mod loss;
pub mod msgpack;
mod names;
mod packed;
mod parcel;
mod path;
mod pattern;
pub mod serde_value;
mod slots;
mod stamp;
mod text_form;
mod thinning;
mod trace;
mod value;
mod verb;
mod visible;
pub mod xml;

pub use card::{CARD_VERSION, Card, CardArg, CardField, CardType, CardVerb, FieldType, MAX_CARD, OnLoss};
pub use challenge::{
    LINK_CONTEXT, LOGIN_CONTEXT, NONCE_BYTES, SECRET_BYTES, link_challenge, login_challenge,
};
pub use checksum::{Checksum, ReadCount};
pub use clock_offset::{ClockOffset, Exchange, OffsetEstimator};
pub use codes::Code;
pub use compression::{Compression, STREAM_MARK, STREAM_WINDOW_LOG};
pub use content::Content;
pub use context_kind::ContextKind;
pub use delivery::{Delivery, Overflow};
pub use error::WireError;
pub use family::Family;
pub use fence::Fence;
pub use fingerprint::{BadFingerprint, Fingerprint};
pub use gcra::{Gcra, Pace, Wait};
pub use limits::{HARD_DEPTH, Limit, Limits, PROTOCOL_VERSION};
pub use loss::{answers_request, outlives_loss};
pub use mom_nearest as nearest;
pub use names::{
    HUB, check_message_name, check_name, check_text, folds_of, is_xml_char, looks_of, numbered_name,
    resembles, xml_violation,
};
pub use packed::Packed;
pub use parcel::{ContextNumber, HISTORY, MAX_ID, PRIORITY, Parcel, STOP};
pub use path::Path;
pub use pattern::Pattern;
pub use serde_value::{from_value, to_value};
pub use slots::{ReadSlots, SlotValue, write_slots};
pub use stamp::{Micros, Time};
pub use thinning::{MessageRate, Thinning};
pub use trace::{TRACE, TraceParent};
pub use value::{Map, Value, ValueKind};
pub use verb::Verb;
pub use visible::visible;

#[cfg(test)]
mod tests;
