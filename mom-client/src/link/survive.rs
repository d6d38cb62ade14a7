//! A link that survives its connection: what was read is counted and told, what was sent is kept until the hub has read it,
//! and another connection goes on.

use std::sync::atomic::Ordering;
use std::time::Duration;

use hmac::{Hmac, Mac};
use mom_net::{DropReason, Ledger, Rewound};
use mom_proto::{
    Compression, ContextNumber, Family, LINK_CONTEXT, Map, NONCE_BYTES, Parcel, Path, ReadCount,
    SECRET_BYTES, Value, link_challenge,
};
use sha2::Sha256;

use crate::error::bad_reply;
use crate::link::driver::dropped;
use crate::peer::shared::{Shared, State, Status};
use crate::said::info::{map_of, number, text};
use crate::{ClientError, Event, LinkState};

/// Parcels and bytes after which the hub is told what was read.
const TELL_PARCELS: u64 = 256;
const TELL_BYTES: u64 = 64 * 1024;

/// Where so many bytes are kept that the hub has not read, no more are sent: the hub keeps no more of a lost peer either.
const KEPT: usize = 4 * 1024 * 1024;

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
    told: u64,
    told_at: u64,
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
        let version = welcome.get("protocol").and_then(Value::as_map);
        let minor = version.and_then(|version| number(version, "minor"));
        let known = secret.len() == SECRET_BYTES;
        known.then_some(LinkSecret {
            id: text(link, "id")?.to_owned(),
            secret: secret.to_vec(),
            grace,
            checks: minor.is_some_and(|minor| minor >= CHECKSUMS),
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
    fn new(secret: LinkSecret) -> Counted {
        Counted {
            secret,
            read: ReadCount::new(),
            told: 0,
            told_at: 0,
        }
    }
}

impl Shared {
    /// Counts from here on, if the hub has given a link; else not any more.
    pub(crate) fn begin_link(&self, state: &mut State, secret: Option<LinkSecret>) {
        *self.ledger.lock() = secret.is_some().then(|| Box::new(Ledger::new(usize::MAX)));
        self.counts.store(secret.is_some(), Ordering::Relaxed);
        state.counted = secret.map(|secret| Box::new(Counted::new(secret)));
    }

    /// How many bytes may be sent before the hub has to say that it has read some: what is sent is kept until then, all of it, or a lost
    /// connection could not be resumed. A parcel that is larger goes where nothing else is kept.
    pub(crate) fn room_to_keep(&self) -> usize {
        if !self.counts.load(Ordering::Relaxed) {
            return usize::MAX;
        }
        let kept = self.ledger.lock().as_ref().map_or(0, |ledger| ledger.bytes());
        KEPT.saturating_sub(kept)
    }

    /// Counts a parcel of the hub that was read, by its word in the checksum, and tells the hub if it is time; so many bytes have come.
    pub(crate) fn count_read(&self, word: Option<u32>, received: u64) {
        if !self.counts.load(Ordering::Relaxed) {
            return;
        }
        let mut state = self.lock();
        let Some(counted) = &mut state.counted else { return };
        counted.read.count(word);
        let due = counted.read.parcels - counted.told >= TELL_PARCELS
            || received.saturating_sub(counted.told_at) >= TELL_BYTES;
        if due {
            counted.told_at = received;
            self.tell_read(&mut state);
            drop(state);
            self.outgoing.notify_one();
        }
    }

    /// Tells the hub how much was read, if it does not know.
    pub(crate) fn tell_read(&self, state: &mut State) {
        let Some(counted) = state
            .counted
            .as_mut()
            .filter(|counted| counted.read.parcels > counted.told)
        else {
            return;
        };
        counted.told = counted.read.parcels;
        let ack = Parcel::new(Family::Time, "ack").content(counted.read.put(Map::new()));
        // A lost connection needs no acknowledgement: the next one says how much was read.
        let _ = self.ask_in(state, ack, &mut None);
    }

    /// Takes in how much the hub has read.
    pub(crate) fn acknowledged(&self, ack: &Parcel) {
        let state = self.lock();
        let mut ledger = self.ledger.lock();
        let read = ReadCount::of(&map_of(ack));
        let (Some(kept), Some(read)) = (ledger.as_mut(), read) else {
            return;
        };
        if let Err(bad) = state.outbox.acknowledge(kept, read) {
            tracing::warn!(
                ?bad,
                "the hub has read other parcels than those that were sent: a lost connection will not be resumed"
            );
            *ledger = None;
        }
    }

    /// The connection is lost, and may be resumed: what waits goes on waiting, but nothing that would move a device long
    /// after it was said. False if there is nothing to resume.
    pub(crate) fn suspend(&self) -> bool {
        let mut state = self.lock();
        let mut ledger = self.ledger.lock();
        let Some(kept) = ledger.as_mut().filter(|_| state.counted.is_some()) else {
            return false;
        };
        state.status = Status::Resuming;
        let lost = state.outbox.suspend(kept);
        drop(ledger);
        state.subscribers.deliver_all(&Event::LinkDown);
        drop(state);
        self.tell_dropped(&lost);
        true
    }

    /// What a resume needs, while there is something to resume.
    pub(crate) fn resumable(&self) -> Option<Counted> {
        let state = self.lock();
        let resuming = matches!(state.status, Status::Resuming);
        state.counted.as_deref().filter(|_| resuming).cloned()
    }

    /// The numbers of the channels that this peer is in, which hold for every connection of the link.
    pub(crate) fn numbers(&self) -> Vec<(ContextNumber, Path)> {
        self.lock().places.numbers()
    }

    /// Goes on over another connection; false if that cannot be.
    pub(crate) fn go_on(&self, resumption: &Resumption) -> bool {
        let mut state = self.lock();
        let mut ledger = self.ledger.lock();
        let Some(kept) = ledger.as_mut() else { return false };
        let mut resent = Parcel::new(Family::Time, "resent").id(self.next_id());
        let Ok(outgoing) = self.prepare(&mut resent, &state.me) else {
            return false;
        };
        let resent = (&resent, outgoing);
        let (unread, late) = match state.outbox.resend(kept, resumption.read, resent) {
            Ok((Rewound::Dropped(unread), late)) => (unread, late),
            Ok((Rewound::Lost(lost), _)) => {
                tracing::warn!(lost, "more was under way than is kept");
                return false;
            }
            Err(bad) => {
                tracing::warn!(?bad, "the hub has read other parcels than those that were sent");
                return false;
            }
        };
        drop(ledger);
        state.status = Status::Up;
        if let Some(counted) = &mut state.counted {
            (counted.told, counted.told_at) = (counted.read.parcels, 0);
        }
        // The others are told one by one.
        let unknown = unread.saturating_sub(late.len() as u64);
        for (reason, count) in [
            (DropReason::Unknown, unknown),
            (DropReason::Lost, resumption.dropped),
        ] {
            if count > 0 {
                let event = dropped(&Path::root(), reason.word(), count);
                state.subscribers.deliver_unaddressed(event);
            }
        }
        self.withdraw_again(&mut state);
        state.subscribers.deliver_all(&Event::Resumed);
        drop(state);
        self.tell_dropped(&late);
        self.link.send_replace(LinkState::Connected);
        self.outgoing.notify_one();
        true
    }
}
