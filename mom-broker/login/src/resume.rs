//! Links: the secret that a login gets, and the proof by it with which its peer comes back (threat 14).

use std::fmt;
use std::time::Duration;

use hmac::{Hmac, Mac};
use mom_proto::{
    Code, LINK_CONTEXT, Map, Micros, NONCE_BYTES, Parcel, SECRET_BYTES, Value, WireError, link_challenge,
};
use sha2::Sha256;

use crate::content::{self, ResumeAnswer};

/// The longest id of a link that is looked at.
const LONGEST_ID: usize = 64;

/// What only the hub and one peer know.
#[derive(Clone, PartialEq, Eq)]
pub struct Secret([u8; SECRET_BYTES]);

/// A question to a connection that wants to go on with a link: to be answered once and soon.
#[derive(Debug)]
pub struct ResumeChallenge {
    link: String,
    hub: String,
    nonce: [u8; NONCE_BYTES],
    until: Micros,
}

impl Secret {
    /// A new one; none where the system has no randomness.
    pub fn random() -> Option<Secret> {
        let mut bits = [0; SECRET_BYTES];
        getrandom::fill(&mut bits).ok()?;
        Some(Secret(bits))
    }

    /// For the peer that has it.
    pub fn to_value(&self) -> Value {
        Value::Binary(self.0.to_vec().into())
    }
}

/// Logs must not hold it.
impl fmt::Debug for Secret {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Secret(…)")
    }
}

impl ResumeChallenge {
    /// To the content of a `login resume`, whether there is such a link or not.
    ///
    /// # Errors
    /// `bad-content`; `try-later` if the system gives no randomness.
    pub(super) fn new(parcel: &Parcel, hub: &str, until: Micros) -> Result<ResumeChallenge, WireError> {
        let link = content::read_link(parcel, LONGEST_ID)?;
        let mut nonce = [0; NONCE_BYTES];
        getrandom::fill(&mut nonce).map_err(|_| {
            WireError::new(Code::TRY_LATER, "the system gives no random numbers now")
                .retry_after(Duration::from_secs(1))
        })?;
        Ok(ResumeChallenge {
            link,
            hub: hub.to_owned(),
            nonce,
            until,
        })
    }

    /// The link that it is about.
    pub fn link(&self) -> &str {
        &self.link
    }

    /// The content of `reply challenge`.
    pub fn content(&self) -> Map {
        Map::new()
            .with("nonce", Value::Binary(self.nonce.to_vec().into()))
            .with("hub", self.hub.as_str())
            .with("context", LINK_CONTEXT)
    }

    /// Whether this is the answer of one who knows the secret, in time.
    pub fn is_answered(&self, secret: &Secret, answer: &ResumeAnswer, now: Micros) -> bool {
        let Ok(mut mac) = Hmac::<Sha256>::new_from_slice(&secret.0) else {
            return false;
        };
        mac.update(&link_challenge(&self.hub, &self.link, &self.nonce));
        // In constant time.
        mac.verify_slice(&answer.proof).is_ok() && now < self.until
    }
}

impl ResumeAnswer {
    /// Reads the content of the `login answer` to it.
    ///
    /// # Errors
    /// `bad-content`.
    pub fn read(parcel: &Parcel) -> Result<ResumeAnswer, WireError> {
        content::read_proof(parcel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mom_proto::{Family, ReadCount};

    fn challenge(link: &str) -> Result<ResumeChallenge, WireError> {
        let parcel = Parcel::new(Family::Login, "resume").content(Map::new().with("link", link));
        ResumeChallenge::new(&parcel, "mom", 10)
    }

    fn answer(challenge: &ResumeChallenge, secret: &Secret, hub: &str) -> ResumeAnswer {
        let mut mac = Hmac::<Sha256>::new_from_slice(&secret.0).expect("a key");
        mac.update(&link_challenge(hub, &challenge.link, &challenge.nonce));
        ResumeAnswer {
            proof: mac.finalize().into_bytes().to_vec(),
            read: ReadCount::new(),
        }
    }

    #[test]
    fn only_who_knows_the_secret_answers_and_in_time() {
        let (secret, other) = (Secret::random().expect("one"), Secret::random().expect("one"));
        let asked = challenge("07").expect("a challenge");
        assert!(asked.is_answered(&secret, &answer(&asked, &secret, "mom"), 9));
        assert!(
            !asked.is_answered(&secret, &answer(&asked, &secret, "mom"), 10),
            "too late"
        );
        assert!(!asked.is_answered(&secret, &answer(&asked, &other, "mom"), 9));
        assert!(
            !asked.is_answered(&secret, &answer(&asked, &secret, "other"), 9),
            "for another hub"
        );
        let again = challenge("07").expect("a challenge");
        assert!(
            !again.is_answered(&secret, &answer(&asked, &secret, "mom"), 9),
            "a replay"
        );
        let link = challenge("08").expect("a challenge");
        assert!(
            !link.is_answered(&secret, &answer(&asked, &secret, "mom"), 9),
            "for another link"
        );
        assert_eq!(format!("{secret:?}"), "Secret(…)");
    }

    #[test]
    fn what_is_no_resume_is_refused_at_its_place() {
        let read = |map: Map| ResumeAnswer::read(&Parcel::new(Family::Login, "answer").content(map));
        let proof = || Value::Binary(vec![0; 32].into());
        for (map, slot) in [
            (Map::new(), "content/proof"),
            (Map::new().with("proof", "text"), "content/proof"),
            (
                Map::new().with("proof", Value::Binary(vec![0; 31].into())),
                "content/proof",
            ),
            (Map::new().with("proof", proof()), "content/read"),
            (Map::new().with("proof", proof()).with("read", -1), "content/read"),
            (
                Map::new().with("proof", proof()).with("read", 1).with("more", 1),
                "content/more",
            ),
            (
                Map::new()
                    .with("proof", proof())
                    .with("read", 1)
                    .with("checksum", 1_i64 << 32),
                "content/checksum",
            ),
        ] {
            let error = read(map).expect_err(slot);
            assert_eq!(
                (&error.code, error.get("slot").and_then(Value::as_str)),
                (&Code::BAD_CONTENT, Some(slot))
            );
        }
        for checksum in [None, Some(0), Some(u32::MAX)] {
            let count = ReadCount { parcels: 1, checksum };
            let answer = read(count.put(Map::new().with("proof", proof())));
            assert_eq!(answer.expect("an answer").read, count);
        }
        let long = "0".repeat(65);
        assert_eq!(challenge(&long).expect_err("too long").code, Code::BAD_CONTENT);
    }
}
