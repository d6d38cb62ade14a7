//! What a peer needs to go on with its link over another connection, and what both ends say then.

use std::time::Duration;

use hmac::{Hmac, Mac};
use mom_proto::{
    Compression, Family, LINK_CONTEXT, Map, NONCE_BYTES, Parcel, Path, ReadCount, SECRET_BYTES, Value,
    link_challenge,
};
use sha2::Sha256;

use crate::ClientError;
use crate::error::bad_reply;
use crate::wire::welcome::minor_of;
use crate::words::{map_of, number, text};

/// The minor version from which on the hub takes a checksum of what was read.
const CHECKSUMS: u64 = 3;

/// What the hub gave at login, for coming back.
#[derive(Clone)]
pub(crate) struct LinkSecret {
    pub(crate) id: String,
    secret: Vec<u8>,
    /// For how long the hub keeps this peer's place.
    pub(crate) grace: Duration,
    /// The hub takes a checksum of what was read: those of earlier versions refuse it.
    checks: bool,
    /// How all that its connections carry is compressed.
    pub(crate) stream: Option<Compression>,
}

// Logs must not hold it.
impl std::fmt::Debug for LinkSecret {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("LinkSecret")
            .field("grace", &self.grace)
            .finish_non_exhaustive()
    }
}

/// What both ends have counted.
#[derive(Clone, Debug)]
pub(crate) struct Counted {
    pub(crate) secret: LinkSecret,
    /// Parcels of the hub that were read.
    pub(crate) read: ReadCount,
    /// Those of them that the hub was told of, and how many bytes had come then.
    pub(crate) told: u64,
    pub(crate) told_at: u64,
}

/// What the hub says to a resume.
#[derive(Debug)]
pub(crate) struct Resumption {
    /// Parcels of this peer that it has read.
    pub(crate) read: ReadCount,
    /// Parcels of its own that it had sent and does not send again.
    pub(crate) dropped: u64,
    pub(crate) content: Map,
}

impl LinkSecret {
    /// From the content of a login's reply.
    pub(crate) fn read(welcome: &Map) -> Option<LinkSecret> {
        let link = welcome.get("link").and_then(Value::as_map)?;
        let secret = link.get("secret").and_then(Value::as_binary)?;
        let grace = Duration::from_millis(number(link, "grace")?);
        let known = secret.len() == SECRET_BYTES;
        known.then_some(LinkSecret {
            id: text(link, "id")?.to_owned(),
            secret: secret.to_vec(),
            grace,
            checks: minor_of(welcome).is_some_and(|minor| minor >= CHECKSUMS),
            stream: text(welcome, "compress")
                .and_then(Compression::of)
                .filter(|way| way.is_stream()),
        })
    }

    /// `login resume`
    pub(crate) fn resume(&self) -> Parcel {
        let content = Map::new().with("link", self.id.as_str());
        Parcel::new(Family::Login, "resume")
            .context(Path::root())
            .content(content)
    }

    /// `login answer` to the hub's challenge.
    ///
    /// # Errors
    /// `Local` for a hub that asks for something else.
    pub(crate) fn answer(&self, challenge: &Parcel, read: ReadCount) -> Result<Parcel, ClientError> {
        let content = map_of(challenge);
        if text(&content, "context") != Some(LINK_CONTEXT) {
            return Err(bad_reply("challenge of a resume"));
        }
        let hub = text(&content, "hub").ok_or_else(|| bad_reply("hub"))?;
        let nonce = content
            .get("nonce")
            .and_then(Value::as_binary)
            .filter(|nonce| nonce.len() == NONCE_BYTES)
            .ok_or_else(|| bad_reply("proper nonce"))?;
        let mut mac = Hmac::<Sha256>::new_from_slice(&self.secret).map_err(|_| bad_reply("secret"))?;
        mac.update(&link_challenge(hub, &self.id, nonce));
        let proof = Value::Binary(mac.finalize().into_bytes().to_vec().into());
        let checksum = read.checksum.filter(|_| self.checks);
        let read = ReadCount { checksum, ..read };
        Ok(Parcel::new(Family::Login, "answer")
            .context(Path::root())
            .content(read.put(Map::new().with("proof", proof))))
    }
}

impl Resumption {
    /// From the content of the reply.
    pub(crate) fn read(content: Map) -> Result<Resumption, ClientError> {
        let read = ReadCount::of(&content).ok_or_else(|| bad_reply("read"))?;
        let resumed = content.get("resumed").and_then(Value::as_bool) == Some(true);
        if !resumed {
            return Err(bad_reply("resumed = true"));
        }
        Ok(Resumption {
            read,
            dropped: number(&content, "dropped").unwrap_or_default(),
            content,
        })
    }
}

impl Counted {
    pub(crate) fn new(secret: LinkSecret) -> Counted {
        Counted {
            secret,
            read: ReadCount::new(),
            told: 0,
            told_at: 0,
        }
    }
}
