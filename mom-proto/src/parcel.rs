//! The parcel: everything that is exchanged (M2–M11).

use std::sync::Arc;

use crate::content::map_size;
use crate::{Content, Delivery, Family, Map, Path, Time, Value, WireError};

/// Ids, references and fences are below 2⁵³, so that every language holds them.
pub const MAX_ID: u64 = (1 << 53) - 1;

/// The priorities that peers may use; others are brought into this range (M7).
pub const PRIORITY: std::ops::RangeInclusive<i32> = -100..=100;

/// The name of messages with pictures.
const IMAGE: &str = "image";

/// The slot by which the hub marks messages for late joiners; it is removed from peers' parcels.
pub const HISTORY: &str = "history";

/// The slot with the number of a stop: the hub's own on `stop`, on `unstop` the newest that its user has seen.
pub const STOP: &str = "stop";

/// The hub's number of a context: one for the whole hub, from 1, never reused (design §5).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ContextNumber(pub u64);

/// A list of slots; the known ones typed, any other kept in [`Parcel::extra`] and passed through (M3).
///
/// The fields are public: a parcel is data. Their consistency is checked where parcels enter: by the
/// codecs (types, ranges) and the hub (rights).
#[derive(Clone, Debug, PartialEq)]
pub struct Parcel {
    /// The peers it goes to; absent = all members (M4). Never empty.
    pub address: Option<Vec<Arc<str>>>,
    /// The peer it comes from; always overwritten by the hub (M5).
    pub sender: Option<Arc<str>>,
    /// When it was created (M6).
    pub timestamp: Option<Time>,
    /// Higher is more urgent; absent = 0 (M7).
    pub priority: Option<i32>,
    /// First half of its class (M8).
    pub family: Family,
    /// Second half of its class (M8).
    pub name: Arc<str>,
    /// Chosen by the sender, unique per sender (M9); below 2⁵³.
    pub id: Option<u64>,
    /// The `id` replied to (M9).
    pub reference: Option<u64>,
    /// The context it belongs to (M10).
    pub context: Option<Path>,
    /// The hub's number of that context, where the binary form gave it.
    pub number: Option<ContextNumber>,
    /// Anything the applications agree on (M11).
    pub content: Option<Content>,
    /// Worthless so many ms after `timestamp`.
    pub expires: Option<u64>,
    /// The delivery class; absent = the channel's default.
    pub delivery: Option<Delivery>,
    /// The fence of the token that guards the channel.
    pub fence: Option<u64>,
    /// Hub time at ingress.
    pub received: Option<Time>,
    /// From creation to ingress, in µs.
    pub age: Option<i64>,
    /// The error bound of `age`, in µs.
    pub age_error: Option<u64>,
    /// Whether a broadcast comes back to its sender; absent = yes.
    pub echo: Option<bool>,
    /// Whether an accepted send is answered; absent = no.
    pub receipt: Option<bool>,
    /// All other slots, in order.
    pub extra: Map,
}

impl Parcel {
    /// A parcel of this class, all else absent.
    pub fn new(family: Family, name: impl Into<Arc<str>>) -> Parcel {
        Parcel {
            address: None,
            sender: None,
            timestamp: None,
            priority: None,
            family,
            name: name.into(),
            id: None,
            reference: None,
            context: None,
            number: None,
            content: None,
            expires: None,
            delivery: None,
            fence: None,
            received: None,
            age: None,
            age_error: None,
            echo: None,
            receipt: None,
            extra: Map::new(),
        }
    }

    /// The second half of its class.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Sets the context.
    #[must_use]
    pub fn context(mut self, path: Path) -> Parcel {
        self.context = Some(path);
        self
    }

    /// Sets the id.
    #[must_use]
    pub fn id(mut self, id: u64) -> Parcel {
        self.id = Some(id);
        self
    }

    /// Sets the content.
    #[must_use]
    pub fn content(mut self, content: impl Into<Content>) -> Parcel {
        self.content = Some(content.into());
        self
    }

    /// Whether a channel has kept it for who joins: it was said before, and answers nobody.
    pub fn is_history(&self) -> bool {
        self.extra.get(HISTORY).and_then(Value::as_bool) == Some(true)
    }

    /// Whether this is `family name`.
    pub fn is(&self, family: Family, name: &str) -> bool {
        self.family == family && &*self.name == name
    }

    /// About how many bytes it brings: content, name, addressees, and the slots that applications agree on. Whatever is
    /// counted in bytes counts this.
    pub fn size(&self) -> usize {
        let addressees = self
            .address
            .iter()
            .flatten()
            .map(|name| name.len())
            .sum::<usize>();
        let slots = match self.extra.is_empty() {
            true => 0,
            false => map_size(&self.extra),
        };
        self.content.as_ref().map_or(0, Content::size) + self.name.len() + addressees + slots
    }

    /// Whether it is worth a try to compress its content: that of a message, unless its name says that it is a picture.
    pub fn may_be_packed(&self) -> bool {
        self.family == Family::Message && &*self.name != IMAGE
    }

    /// Opens the content; absent content and content that cannot be opened are null.
    pub fn value(&self) -> Value {
        self.content
            .as_ref()
            .and_then(|content| content.to_value().ok())
            .unwrap_or_default()
    }
}

impl WireError {
    /// The error as a parcel: family `error`, name = the code's word.
    pub fn to_parcel(&self, reference: Option<u64>) -> Parcel {
        let content = self.added_to(Map::new());
        let mut parcel = Parcel::new(Family::Error, self.code.word()).content(content);
        parcel.reference = reference;
        parcel
    }

    /// Reads an error parcel; one without readable content keeps at least its name.
    pub fn from_parcel(parcel: &Parcel) -> WireError {
        let content = parcel
            .content
            .as_ref()
            .and_then(|content| content.to_value().ok());
        let details = match content {
            Some(Value::Map(map)) => map,
            _ => Map::new(),
        };
        WireError::read(parcel.name(), details)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::Code;

    #[test]
    fn an_error_survives_the_wire() {
        let error = WireError::new(Code::HELD, "alice drives")
            .rule("lab-token")
            .owner("alice", 1)
            .retry_after(Duration::from_micros(1001));
        let parcel = error.to_parcel(Some(7));
        assert_eq!(parcel.reference, Some(7));
        let back = WireError::from_parcel(&parcel);
        assert_eq!(back, error);
        assert_eq!(
            back.retry_in(),
            Some(Duration::from_millis(2)),
            "rounded up: never too early"
        );
    }
}
