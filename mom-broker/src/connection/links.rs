//! Links: peers whose connection may be lost and come back over another one.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use mom_hub::PeerId;
use mom_login::{ResumeAnswer, ResumeChallenge, Secret};
use mom_net::SecretId;
use mom_proto::{Map, Micros, ReadCount};
use parking_lot::Mutex;
use tokio::sync::oneshot;

use super::parked::Parked;
use crate::traffic::outbox::Outbox;

/// For how long a peer may be away that does not say.
const GRACE: Duration = Duration::from_secs(30);

/// All links of a broker.
#[derive(Debug, Default)]
pub(crate) struct Links {
    known: Mutex<HashMap<SecretId, Arc<PeerLink>>>,
    /// Challenges that were made.
    challenges: AtomicU64,
}

/// One link. The task that serves its peer looks here when it is woken: another connection may go on with it.
#[derive(Debug)]
pub(super) struct PeerLink {
    id: SecretId,
    secret: Secret,
    pub(super) outbox: Arc<Outbox>,
    /// For how long its peer may be away.
    pub(super) grace: Duration,
    claim: Mutex<Claim>,
}

/// Who wants to go on with a link.
#[derive(Debug, Default)]
struct Claim {
    /// The number of the newest challenge that was answered.
    newest: u64,
    give: Option<oneshot::Sender<Parked>>,
}

/// A link as the connection sees it that serves its peer now.
#[derive(Debug)]
pub(super) struct Served {
    pub(super) link: Arc<PeerLink>,
    /// The parcels of the peer that were read whole and handled.
    pub(super) read: ReadCount,
    /// Those of them that the peer knows of, and when it was told, by the bytes that had come.
    pub(super) told: u64,
    pub(super) told_at: u64,
    /// What comes was said before the connection was lost.
    pub(super) resending: bool,
}

/// Parcels and bytes after which a peer is told what was read.
const TELL_PARCELS: u64 = 256;
const TELL_BYTES: u64 = 64 * 1024;

impl Links {
    /// A link for a peer that may be away for so long; none where the system has no randomness.
    pub(super) fn open(&self, outbox: &Arc<Outbox>, grace: Option<u64>, most: u64) -> Option<Arc<PeerLink>> {
        let grace = grace.map_or(GRACE, Duration::from_millis);
        let link = Arc::new(PeerLink {
            id: SecretId::random()?,
            secret: Secret::random()?,
            outbox: Arc::clone(outbox),
            grace: grace.min(Duration::from_millis(most)),
            claim: Mutex::default(),
        });
        self.known.lock().insert(link.id, Arc::clone(&link));
        Some(link)
    }

    /// The link has ended.
    pub(super) fn close(&self, link: &PeerLink) {
        self.known.lock().remove(&link.id);
    }

    /// The number of the next challenge.
    pub(super) fn next_number(&self) -> u64 {
        self.challenges.fetch_add(1, Ordering::Relaxed) + 1
    }

    /// The link that a challenge was about, if there is one.
    pub(super) fn find(&self, challenge: &ResumeChallenge) -> Option<Arc<PeerLink>> {
        let id = challenge.link().parse().ok()?;
        self.known.lock().get(&id).map(Arc::clone)
    }
}

impl PeerLink {
    /// For the reply to the login.
    pub(super) fn to_map(&self) -> Map {
        let grace = i64::try_from(self.grace.as_millis()).unwrap_or(i64::MAX);
        Map::new()
            .with("id", self.id.to_string())
            .with("secret", self.secret.to_value())
            .with("grace", grace)
    }

    pub(super) fn peer(&self) -> PeerId {
        self.outbox.peer
    }

    /// Whether this answer to a challenge proves the secret.
    pub(super) fn is_proven(&self, challenge: &ResumeChallenge, answer: &ResumeAnswer, now: Micros) -> bool {
        challenge.is_answered(&self.secret, answer, now)
    }

    /// Asks the connection that serves the peer to give it up, for an answer to the challenge of this number that has read so many
    /// parcels; one that has asked before and waits still gets nothing. None if a later one was answered, or more was
    /// read since.
    pub(super) fn claim(&self, number: u64, read: u64) -> Option<oneshot::Receiver<Parked>> {
        if read < self.outbox.acknowledged_count() {
            return None;
        }
        let (give, given) = oneshot::channel();
        let mut claim = self.claim.lock();
        if number < claim.newest {
            return None;
        }
        *claim = Claim {
            newest: number,
            give: Some(give),
        };
        drop(claim);
        self.outbox.end.notify_one();
        Some(given)
    }

    /// Who wants to go on with the peer.
    pub(super) fn claimed(&self) -> Option<oneshot::Sender<Parked>> {
        self.claim.lock().give.take()
    }

    pub(super) fn is_claimed(&self) -> bool {
        self.claim.lock().give.is_some()
    }
}

impl Served {
    pub(super) fn new(link: Arc<PeerLink>) -> Box<Served> {
        Box::new(Served {
            link,
            read: ReadCount::new(),
            told: 0,
            told_at: 0,
            resending: false,
        })
    }

    /// How many of them the peer does not know to be read.
    pub(super) fn untold(&self) -> u64 {
        self.read.parcels - self.told
    }

    /// Notes what was handled; whether the peer has to be told, at so many bytes that have come.
    pub(super) fn is_due(&self, bytes: u64) -> bool {
        self.untold() >= TELL_PARCELS
            || (self.untold() > 0 && bytes.saturating_sub(self.told_at) >= TELL_BYTES)
    }
}
