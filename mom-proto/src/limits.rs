//! The limits of one hub, advertised in the login reply (design §5).

use std::fmt;

use serde::de::{self, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::{Map, Value};

/// The version of the protocol that this crate speaks: major, minor. A higher minor only adds.
pub const PROTOCOL_VERSION: (u8, u8) = (1, 4);

/// The deepest nesting that any configuration allows: reading recurses, and stacks are finite.
pub const HARD_DEPTH: usize = 128;

/// A bound: a number, or the word `unlimited`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limit {
    /// At most so many.
    At(u64),
    /// No bound; only ever by the word.
    Unlimited,
}

impl Limit {
    /// Whether an amount is within the bound.
    pub fn allows(self, amount: usize) -> bool {
        match self {
            Limit::At(most) => amount as u64 <= most,
            Limit::Unlimited => true,
        }
    }

    /// The bound as a number, `usize::MAX` for `unlimited`.
    pub fn get(self) -> usize {
        match self {
            Limit::At(most) => usize::try_from(most).unwrap_or(usize::MAX),
            Limit::Unlimited => usize::MAX,
        }
    }
}

impl fmt::Display for Limit {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Limit::At(most) => most.fmt(formatter),
            Limit::Unlimited => formatter.write_str("unlimited"),
        }
    }
}

impl Serialize for Limit {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Limit::At(most) => serializer.serialize_u64(*most),
            Limit::Unlimited => serializer.serialize_str("unlimited"),
        }
    }
}

impl<'de> Deserialize<'de> for Limit {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Limit, D::Error> {
        struct LimitVisitor;

        impl Visitor<'_> for LimitVisitor {
            type Value = Limit;

            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("a number from 1 or the word \"unlimited\"")
            }

            fn visit_i64<E: de::Error>(self, number: i64) -> Result<Limit, E> {
                u64::try_from(number)
                    .map_err(E::custom)
                    .and_then(|number| self.visit_u64(number))
            }

            fn visit_u64<E: de::Error>(self, number: u64) -> Result<Limit, E> {
                match number {
                    0 => Err(E::custom(
                        "0 is not a limit: write a number from 1, or \"unlimited\"",
                    )),
                    _ => Ok(Limit::At(number)),
                }
            }

            fn visit_str<E: de::Error>(self, word: &str) -> Result<Limit, E> {
                match word {
                    "unlimited" => Ok(Limit::Unlimited),
                    _ => Err(E::invalid_value(de::Unexpected::Str(word), &self)),
                }
            }
        }

        deserializer.deserialize_any(LimitVisitor)
    }
}

/// The limits of a hub; sizes in bytes, times in ms.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct Limits {
    /// One parcel with its headers and parts.
    pub parcel: Limit,
    /// All slots of one parcel but its content.
    pub slots: usize,
    /// The content of a parcel that is not a message.
    pub control: usize,
    /// Lists and maps inside each other.
    pub depth: usize,
    /// Attributes of one XML element.
    pub attributes: usize,
    /// One XML attribute's value.
    pub attribute_size: usize,
    /// A path's text.
    pub path: usize,
    /// A path's segments.
    pub path_levels: usize,
    /// The header lines before an XML entity, and of each MIME part.
    pub header: usize,
    /// Parts of one multipart entity.
    pub parts: usize,
    /// One parcel before login.
    pub before_login: usize,
    /// From connection to login.
    pub login_time: u64,
    /// The parcels that wait for one peer.
    pub outbox: usize,
    /// As many may wait for a while if none of them may be dropped.
    pub burst: usize,
    /// How long a sender waits for a receiver without capacity, where the channel makes senders wait.
    pub send_wait: u64,
    /// A receiver for which more than `outbox` waits for so long is closed, as is one that frees no capacity for so long
    /// while senders wait for it.
    pub stalled: u64,
    /// How often an idle peer sends `time ping`.
    pub heartbeat: u64,
    /// A peer that sends nothing for so long is closed as `silent`.
    pub gone: u64,
    /// For how long a peer with a link may be away at most.
    pub grace: u64,
    /// How far beyond the error of its clock a peer's stamp may lie in the future.
    pub future: u64,
    /// Contexts in the whole tree.
    pub contexts: Limit,
    /// Contexts of the tree that peers of one user have made.
    pub user_contexts: Limit,
    /// Contexts that one peer may have joined.
    pub joined: Limit,
    /// Requests about contexts and tokens per second and connection; as many more at once after a pause.
    pub requests: Limit,
}

impl Default for Limits {
    fn default() -> Limits {
        Limits {
            parcel: Limit::At(8 * 1024 * 1024),
            slots: 64 * 1024,
            control: 64 * 1024,
            depth: 32,
            attributes: 64,
            attribute_size: 8 * 1024,
            path: 1024,
            path_levels: 32,
            header: 1024,
            parts: 256,
            before_login: 16 * 1024,
            login_time: 10_000,
            outbox: 4 * 1024 * 1024,
            burst: 32 * 1024 * 1024,
            send_wait: 1_000,
            stalled: 5_000,
            heartbeat: 10_000,
            gone: 30_000,
            grace: 300_000,
            future: 1_000,
            contexts: Limit::At(100_000),
            user_contexts: Limit::At(10_000),
            joined: Limit::At(1024),
            requests: Limit::At(2000),
        }
    }
}

impl Limits {
    /// These limits as they apply before login: parcels of at most `before_login` bytes.
    #[must_use]
    pub fn before_login(&self) -> Limits {
        let most = self.parcel.get().min(self.before_login);
        Limits {
            parcel: Limit::At(most as u64),
            ..self.clone()
        }
    }

    /// The limits in the login reply.
    pub fn to_map(&self) -> Map {
        let limit = |limit: Limit| match limit {
            Limit::At(most) => Value::Int(i64::try_from(most).unwrap_or(i64::MAX)),
            Limit::Unlimited => Value::from("unlimited"),
        };
        let size = |size: usize| Value::Int(i64::try_from(size).unwrap_or(i64::MAX));
        let time = |time: u64| Value::Int(i64::try_from(time).unwrap_or(i64::MAX));
        Map::new()
            .with("parcel", limit(self.parcel))
            .with("slots", size(self.slots))
            .with("control", size(self.control))
            .with("depth", size(self.depth))
            .with("attributes", size(self.attributes))
            .with("attribute-size", size(self.attribute_size))
            .with("path", size(self.path))
            .with("path-levels", size(self.path_levels))
            .with("header", size(self.header))
            .with("parts", size(self.parts))
            .with("outbox", size(self.outbox))
            .with("send-wait", time(self.send_wait))
            .with("heartbeat", time(self.heartbeat))
            .with("gone", time(self.gone))
            .with("joined", limit(self.joined))
            .with("future", time(self.future))
    }
}
