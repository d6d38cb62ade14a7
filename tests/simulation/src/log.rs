//! What has happened, in the order in which it did, by the time that nobody's clock is.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// µs since the beginning.
pub type Instant = u64;

/// Who, by the name of its user.
pub type Name = String;

/// Something that the oracle has to know. Devices are numbered; fences and stops are the hub's.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
#[expect(
    missing_docs,
    reason = "each field is what its name says, of what its variant says"
)]
pub enum Fact {
    /// An operator has sent a command; its number stands in its script.
    Sent {
        by: Name,
        device: usize,
        command: u64,
        fence: u64,
    },
    /// The hub has acknowledged it, and dropped it for nobody.
    Taken { command: u64 },
    /// A device has begun it.
    Began { device: usize, command: u64 },
    /// A device was halted by its kit while it moved.
    Halted { device: usize },
    /// A device's program has begun.
    Started { device: usize },
    /// An operator has a token.
    Granted { by: Name, device: usize, fence: u64 },
    /// It has it no more, by its own will.
    Lost { by: Name, device: usize, fence: u64 },
    /// An operator asks for a stop.
    StopAsked { by: Name, device: usize },
    /// All devices of the channel have said that they obey this stop.
    StopObeyed { by: Name, device: usize, number: u64 },
    /// An operator asks to lift the stops up to this number.
    UnstopAsked { by: Name, device: usize, number: u64 },
    /// Something was done to a part of the world.
    Fault(String),
    /// The hub was killed, and remembers nothing.
    HubKilled,
    /// The faults are over: all that is wanted has to come about now.
    Healed,
    /// A promise was seen to be broken by the one it was made to.
    Broken(String),
    /// An operator has driven a device to an end behind all faults.
    Served { by: Name, device: usize },
}

/// The log, which all parts of the world write into.
#[derive(Clone, Debug, Default)]
pub struct Log {
    facts: Arc<Mutex<Vec<(Instant, Fact)>>>,
    now: Arc<AtomicU64>,
}

impl Log {
    /// µs since the beginning.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.now.load(Ordering::Relaxed)
    }

    /// Lets the true time pass.
    pub(crate) fn set_now(&self, now: Instant) {
        self.now.store(now, Ordering::Relaxed);
    }

    /// Notes a fact of now.
    pub fn note(&self, fact: Fact) {
        let now = self.now();
        self.lock().push((now, fact));
    }

    /// All of it.
    #[must_use]
    pub fn facts(&self) -> Vec<(Instant, Fact)> {
        self.lock().clone()
    }

    /// A number that two runs share which went alike.
    #[must_use]
    pub fn fingerprint(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        for (at, fact) in self.lock().iter() {
            // The hub forms fences and stops from the time and random numbers.
            match fact {
                Fact::Sent {
                    by, device, command, ..
                } => (at, by, device, command).hash(&mut hasher),
                Fact::Granted { by, device, .. } | Fact::Lost { by, device, .. } => {
                    (at, by, device).hash(&mut hasher);
                }
                Fact::StopObeyed { by, device, .. } | Fact::UnstopAsked { by, device, .. } => {
                    (at, by, device).hash(&mut hasher);
                }
                other => (at, other).hash(&mut hasher),
            }
        }
        hasher.finish()
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<(Instant, Fact)>> {
        self.facts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
