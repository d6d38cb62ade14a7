//! Keys: a challenge, and the signature that answers it (threat 14).

use std::hint::black_box;
use std::time::Duration;

use crate::content::Wishes;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use ed25519_dalek::{Signature, VerifyingKey};
use mom_proto::{Code, LOGIN_CONTEXT, Map, Micros, NONCE_BYTES, Value, WireError, login_challenge};

/// RFC 8032, 7.1, test 1: checked in place of keys that a user does not have. The result is discarded.
const DUMMY: [u8; 32] = [
    0xd7, 0x5a, 0x98, 0x01, 0x82, 0xb1, 0x0a, 0xb7, 0xd5, 0x4b, 0xfe, 0xd3, 0xc9, 0x64, 0x07, 0x3a, 0x0e,
    0xe1, 0x72, 0xf3, 0xda, 0xa6, 0x23, 0x25, 0xaf, 0x02, 0x1a, 0x68, 0xf7, 0x07, 0x51, 0x1a,
];

/// What a login asks for beside who it is.
#[derive(Debug, Default)]
pub(super) struct Asked {
    pub(super) nickname: Option<String>,
    pub(super) wishes: Wishes,
}

/// A challenge to one connection, to be answered once and soon.
#[derive(Debug)]
pub struct Challenge {
    pub(super) user: String,
    pub(super) asked: Asked,
    hub: String,
    nonce: [u8; NONCE_BYTES],
    until: Micros,
}

impl Challenge {
    /// A new one.
    ///
    /// # Errors
    /// `try-later` if the system gives no randomness.
    pub(super) fn new(user: String, asked: Asked, hub: &str, until: Micros) -> Result<Challenge, WireError> {
        let mut nonce = [0; NONCE_BYTES];
        getrandom::fill(&mut nonce).map_err(|_| {
            WireError::new(Code::TRY_LATER, "the system gives no random numbers now")
                .retry_after(Duration::from_secs(1))
        })?;
        Ok(Challenge {
            user,
            asked,
            hub: hub.to_owned(),
            nonce,
            until,
        })
    }

    /// The user who wants to log in, whether or not it exists.
    pub fn user(&self) -> &str {
        &self.user
    }

    /// The content of `reply challenge`.
    pub fn content(&self) -> Map {
        Map::new()
            .with("nonce", Value::Binary(self.nonce.to_vec().into()))
            .with("hub", self.hub.as_str())
            .with("context", LOGIN_CONTEXT)
    }

    /// Whether it may still be answered.
    pub(super) fn is_open(&self, now: Micros) -> bool {
        now < self.until
    }

    /// Whether one of these keys made the signature; as many keys are tried for every user.
    pub(super) fn is_answered(
        &self,
        keys: &[VerifyingKey],
        rounds: usize,
        signature: &[u8; 64],
    ) -> Option<VerifyingKey> {
        let message = login_challenge(&self.hub, &self.user, &self.nonce);
        let signature = Signature::from_bytes(signature);
        let proves = |key: &VerifyingKey| key.verify_strict(&message, &signature).is_ok();
        // Checks all keys even after a match, so that the time reveals nothing.
        let latter = |found, key: &VerifyingKey| if proves(key) { Some(*key) } else { found };
        let proven = keys.iter().fold(None, latter);
        if let Ok(dummy) = VerifyingKey::from_bytes(&DUMMY) {
            (keys.len()..rounds).for_each(|_| {
                black_box(proves(black_box(&dummy)));
            });
        }
        proven
    }
}

/// Reads `ed25519 BASE64 [comment]`.
///
/// # Errors
/// What is wrong with it.
pub(crate) fn parse_key(text: &str) -> Result<VerifyingKey, String> {
    const WANTED: &str = "a key is written: ed25519 BASE64 comment, as mom keygen prints it";
    let mut words = text.split_whitespace();
    match words.next() {
        Some("ed25519") => {}
        Some(word) if word.starts_with("ssh-") => {
            return Err(format!("keys of SSH are not taken; {WANTED}"));
        }
        _ => return Err(WANTED.to_owned()),
    }
    let bytes = words.next().and_then(|word| STANDARD.decode(word).ok());
    let bytes = bytes.ok_or_else(|| format!("that is not base64; {WANTED}"))?;
    let bytes = <[u8; 32]>::try_from(bytes)
        .map_err(|bytes| format!("this has {} bytes, a public key has 32; {WANTED}", bytes.len()))?;
    VerifyingKey::from_bytes(&bytes)
        .ok()
        .filter(|key| !key.is_weak())
        .ok_or_else(|| format!("that is not a public key; {WANTED}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ed25519_dalek::{Signer, SigningKey};

    fn signer(seed: u8) -> SigningKey {
        SigningKey::from_bytes(&[seed; 32])
    }

    fn challenge(user: &str, hub: &str) -> Challenge {
        Challenge::new(user.to_owned(), Asked::default(), hub, 10).expect("randomness")
    }

    fn sign(challenge: &Challenge, hub: &str, user: &str, key: &SigningKey) -> [u8; 64] {
        key.sign(&login_challenge(hub, user, &challenge.nonce)).to_bytes()
    }

    #[test]
    fn a_signature_is_for_one_hub_one_user_and_one_nonce() {
        let keys = [signer(1).verifying_key(), signer(2).verifying_key()];
        let asked = challenge("arm", "mom");
        let proves = |signature: [u8; 64]| asked.is_answered(&keys, 4, &signature).is_some();
        assert!(proves(sign(&asked, "mom", "arm", &signer(1))));
        assert!(proves(sign(&asked, "mom", "arm", &signer(2))), "either key");
        assert!(
            !proves(sign(&asked, "mom", "arm", &signer(3))),
            "another user's key"
        );
        assert!(!proves(sign(&asked, "dad", "arm", &signer(1))), "another hub's");
        assert!(
            !proves(sign(&asked, "mom", "camera", &signer(1))),
            "another user's"
        );
        let other = challenge("arm", "mom");
        assert!(
            !proves(sign(&other, "mom", "arm", &signer(1))),
            "another challenge's"
        );
        assert_eq!(
            asked.is_answered(&[], 4, &sign(&asked, "mom", "arm", &signer(1))),
            None
        );
        assert!(!proves([0; 64]));
        assert!(asked.is_open(9) && !asked.is_open(10));
    }

    /// The dummy's private key, which is printed in the RFC, must not let anybody in.
    #[test]
    fn the_dummy_opens_nothing() {
        let seed = [
            0x9d, 0x61, 0xb1, 0x9d, 0xef, 0xfd, 0x5a, 0x60, 0xba, 0x84, 0x4a, 0xf4, 0x92, 0xec, 0x2c, 0xc4,
            0x44, 0x49, 0xc5, 0x69, 0x7b, 0x32, 0x69, 0x19, 0x70, 0x3b, 0xac, 0x03, 0x1c, 0xae, 0x7f, 0x60,
        ];
        let dummy = SigningKey::from_bytes(&seed);
        assert_eq!(
            dummy.verifying_key().to_bytes(),
            DUMMY,
            "it is a key that can be checked"
        );
        let asked = challenge("arm", "mom");
        assert_eq!(
            asked.is_answered(&[], 4, &sign(&asked, "mom", "arm", &dummy)),
            None
        );
    }

    #[test]
    fn keys_are_read() {
        let public = STANDARD.encode(signer(1).verifying_key().to_bytes());
        assert_eq!(
            parse_key(&format!("ed25519 {public} arm of lab 3")),
            Ok(signer(1).verifying_key())
        );
        for (text, words) in [
            (String::new(), "mom keygen"),
            (public.clone(), "mom keygen"),
            (format!("rsa {public}"), "mom keygen"),
            (format!("ssh-ed25519 {public}"), "SSH"),
            ("ed25519".to_owned(), "base64"),
            ("ed25519 §".to_owned(), "base64"),
            ("ed25519 AAAA".to_owned(), "3 bytes"),
            // The neutral element: every signature of zeros would fit it.
            (format!("ed25519 AQ{}=", "A".repeat(41)), "not a public key"),
        ] {
            let error = parse_key(&text).expect_err("no key");
            assert!(error.contains(words), "{text:?}: {error}");
        }
    }
}
