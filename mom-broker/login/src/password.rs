//! Passwords, and the bounded pool in which they are hashed (threat 16).

use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;

use argon2::Argon2;
use argon2::password_hash::phc::PasswordHash;
use argon2::password_hash::{PasswordHasher, PasswordVerifier};
use mom_proto::{Code, WireError};
use tokio::sync::{Semaphore, oneshot};

/// The argon2id hash of a password with a new salt, for the users file.
///
/// # Errors
/// The message of the hash function: no randomness, or a password that it does not accept.
pub fn hash(password: &str) -> Result<String, String> {
    Argon2::default()
        .hash_password(password.as_bytes())
        .map(|hash| hash.to_string())
        .map_err(|error| error.to_string())
}

/// Whether text is a hash that logins can be checked against.
pub(crate) fn is_hash(text: &str) -> bool {
    PasswordHash::new(text).is_ok_and(|hash| hash.algorithm.as_str() == "argon2id")
}

/// Refuses a secret that others could have read on its way.
pub(super) fn check_private(from: Option<IpAddr>, what: &str) -> Result<(), WireError> {
    // A dual-stack listener sees IPv4 loopback as an IPv4-mapped IPv6 address.
    if from.is_none_or(|from| from.to_canonical().is_loopback()) {
        return Ok(());
    }
    let text = format!(
        "a {what} is taken only over loopback: others could read it on the way; log in with a key from elsewhere"
    );
    Err(WireError::new(Code::INSECURE, text))
}

/// Statistics of password hashing since the broker's start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct LoginStats {
    /// Logins whose password waits to be hashed, or is being hashed.
    pub waiting: usize,
    /// Passwords that were hashed.
    pub hashed: u64,
    /// Those that are being hashed now.
    pub hashing: usize,
    /// The most that were hashed at one time.
    pub most: usize,
}

/// The niceness of hashing threads. An idle core is still used for hashing.
const GIVES_WAY: i32 = 5;

/// The pool. Hashing takes a core for some 20 ms, so only so many passwords are hashed at once and only so many
/// logins wait for that. It has threads of its own, one for each hash, because a thread cannot lower its niceness
/// again: a renewal or a stop must not wait until a stranger's password is hashed.
#[derive(Debug)]
pub(super) struct Hashing {
    pub(super) hashers: usize,
    permits: Arc<Semaphore>,
    waiting: AtomicUsize,
    count: Arc<Count>,
}

#[derive(Debug, Default)]
struct Count {
    hashed: AtomicU64,
    hashing: AtomicUsize,
    most: AtomicUsize,
}

impl Hashing {
    pub(super) fn new(hashers: usize) -> Hashing {
        Hashing {
            hashers,
            permits: Arc::new(Semaphore::new(hashers)),
            waiting: AtomicUsize::new(0),
            count: Arc::default(),
        }
    }

    /// Whether the password belongs to the hash.
    ///
    /// # Errors
    /// `try-later` when `most` logins are waiting here.
    pub(super) async fn verify(
        &self,
        password: String,
        hash: String,
        most: usize,
    ) -> Result<bool, WireError> {
        let _place = HashPlace::enter(&self.waiting, most).ok_or_else(|| {
            WireError::new(Code::TRY_LATER, "too many logins at once").retry_after(Duration::from_secs(1))
        })?;
        let stopped = |_| WireError::new(Code::SHUTDOWN, "the hub is shutting down");
        let permit = Arc::clone(&self.permits).acquire_owned().await.map_err(stopped)?;
        let count = Arc::clone(&self.count);
        let (answer, answered) = oneshot::channel();
        let check = move || {
            // The permit moves along: when a login is abandoned its hash is still being computed.
            let _permit = permit;
            give_way();
            count.begin();
            let matches = matches(&password, &hash);
            count.end();
            // The receiver is gone if the login was abandoned.
            let _ = answer.send(matches);
        };
        let failed = || WireError::new(Code::TRY_LATER, "the login failed here");
        thread::Builder::new()
            .name("hash".to_owned())
            .spawn(check)
            .map_err(|_| failed())?;
        answered.await.map_err(|_| failed())
    }

    pub(super) fn stats(&self) -> LoginStats {
        LoginStats {
            waiting: self.waiting.load(Ordering::Acquire),
            hashed: self.count.hashed.load(Ordering::Acquire),
            hashing: self.count.hashing.load(Ordering::Acquire),
            most: self.count.most.load(Ordering::Acquire),
        }
    }

    #[cfg(feature = "occupy")]
    pub(super) async fn occupy(&self) -> tokio::sync::OwnedSemaphorePermit {
        let all = u32::try_from(self.hashers).expect("few hashers");
        let permits = Arc::clone(&self.permits).acquire_many_owned(all).await;
        permits.expect("never closed")
    }
}

impl Count {
    fn begin(&self) {
        let now = self.hashing.fetch_add(1, Ordering::AcqRel) + 1;
        self.most.fetch_max(now, Ordering::AcqRel);
    }

    fn end(&self) {
        self.hashing.fetch_sub(1, Ordering::AcqRel);
        self.hashed.fetch_add(1, Ordering::AcqRel);
    }
}

/// Lowers the priority of the current thread for good.
fn give_way() {
    // On Linux this applies to the thread, not to the process. It cannot fail: every process may raise its niceness.
    let _ = rustix::process::nice(GIVES_WAY);
}

fn matches(password: &str, hash: &str) -> bool {
    PasswordHash::new(hash).is_ok_and(|hash| {
        Argon2::default()
            .verify_password(password.as_bytes(), &hash)
            .is_ok()
    })
}

/// A place among the waiting logins; given up on drop.
struct HashPlace<'a>(&'a AtomicUsize);

impl<'a> HashPlace<'a> {
    fn enter(waiting: &'a AtomicUsize, most: usize) -> Option<HashPlace<'a>> {
        let before = waiting.fetch_add(1, Ordering::AcqRel);
        let place = HashPlace(waiting);
        (before < most).then_some(place)
    }
}

impl Drop for HashPlace<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_are_taken_over_loopback_only() {
        for (from, taken) in [
            (None, true),
            (Some("127.0.0.1"), true),
            (Some("127.9.8.7"), true),
            (Some("::1"), true),
            (Some("::ffff:127.0.0.1"), true),
            (Some("192.0.2.1"), false),
            (Some("::ffff:192.0.2.1"), false),
            (Some("2001:db8::1"), false),
            (Some("0.0.0.0"), false),
        ] {
            let from = from.map(|from| from.parse().expect("an address"));
            let checked = check_private(from, "password");
            match checked {
                Ok(()) => assert!(taken, "{from:?}"),
                Err(error) => assert!(!taken && error.code == Code::INSECURE, "{from:?}"),
            }
        }
    }

    #[test]
    fn a_hash_knows_its_password() {
        let hash = hash("secret").expect("a hash");
        assert!(matches("secret", &hash) && !matches("Secret", &hash) && !matches("", &hash));
        assert!(!matches("", "") && !matches("secret", "secret"));
    }
}
