//! A key with which a peer authenticates.

use std::fmt;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use ed25519_dalek::pkcs8::spki::der::pem::LineEnding;
use ed25519_dalek::pkcs8::{DecodePrivateKey, EncodePrivateKey, KeypairBytes};
use ed25519_dalek::{Signer, SigningKey};
use mom_proto::{Code, WireError};

use crate::ClientError;

/// A private key (Ed25519). It never leaves this process; the hub knows the public one from its users file.
///
/// ```
/// use mom_client::Key;
/// let key = Key::generate().unwrap();
/// let again = Key::from_pem(&key.to_pem()).unwrap();
/// assert_eq!(again.public(), key.public());
/// assert!(key.public().starts_with("ed25519 "));
/// ```
#[derive(Clone)]
pub struct Key {
    key: SigningKey,
}

impl Key {
    /// A new one.
    ///
    /// # Errors
    /// `Local` if the system gives no random numbers.
    pub fn generate() -> Result<Key, ClientError> {
        let mut seed = [0; 32];
        getrandom::fill(&mut seed)
            .map_err(|error| local(Code::TRY_LATER, format!("no random numbers: {error}")))?;
        Ok(Key {
            key: SigningKey::from_bytes(&seed),
        })
    }

    /// Reads PKCS#8 in PEM, as `mom keygen` and `openssl genpkey -algorithm ed25519` write it.
    ///
    /// # Errors
    /// `Local` with `bad-encoding` for text that is not such a key.
    pub fn from_pem(pem: &str) -> Result<Key, ClientError> {
        // The reason only names types of ASN.1.
        let wanted = "this is not an Ed25519 private key in PEM (-----BEGIN PRIVATE KEY-----)";
        SigningKey::from_pkcs8_pem(pem)
            .map(|key| Key { key })
            .map_err(|_| local(Code::BAD_ENCODING, wanted))
    }

    /// Reads a file of PEM.
    ///
    /// # Errors
    /// As [`Key::from_pem`], naming the file, also for one that cannot be read.
    pub fn from_file(file: impl AsRef<Path>) -> Result<Key, ClientError> {
        let file = file.as_ref();
        let named = |text: String| local(Code::BAD_ENCODING, format!("{}: {text}", file.display()));
        let pem = std::fs::read_to_string(file).map_err(|error| named(format!("cannot be read: {error}")))?;
        Key::from_pem(&pem).map_err(|error| match error {
            ClientError::Local(error) => named(error.text),
            other => other,
        })
    }

    /// The private key in PEM. Anybody who reads it can log in as this user: keep it in a file of mode 0600.
    pub fn to_pem(&self) -> String {
        // Without the public half, which older programs do not expect there.
        let bytes = KeypairBytes {
            secret_key: self.key.to_bytes(),
            public_key: None,
        };
        let pem = bytes.to_pkcs8_pem(LineEnding::LF);
        pem.map(|pem| pem.to_string())
            .expect("32 bytes always have a form in PEM")
    }

    /// The public key as the users file wants it among a user's `keys`: `ed25519 BASE64`.
    pub fn public(&self) -> String {
        let bytes = self.key.verifying_key().to_bytes();
        format!("ed25519 {}", STANDARD.encode(bytes))
    }

    pub(crate) fn sign(&self, message: &[u8]) -> [u8; 64] {
        self.key.sign(message).to_bytes()
    }
}

impl fmt::Debug for Key {
    // The public half only.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Key({})", self.public())
    }
}

fn local(code: Code, text: impl Into<String>) -> ClientError {
    ClientError::Local(WireError::new(code, text))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// RFC 8410, 10.3: the private key without and with the public one.
    const OPENSSL: &str = "-----BEGIN PRIVATE KEY-----\n\
        MC4CAQAwBQYDK2VwBCIEINTuctv5E1hK1bbY8fdp+K06/nwoy/HU++CXqI9EdVhC\n\
        -----END PRIVATE KEY-----\n";

    #[test]
    fn keys_are_read_and_written_as_others_do() {
        let key = Key::from_pem(OPENSSL).expect("a key");
        assert_eq!(
            key.public(),
            "ed25519 Gb9ECWmEzf6FQbrBZ9w7lshQhqowtrbLDFw4rXAxZuE="
        );
        assert_eq!(key.to_pem(), OPENSSL);
        assert!(!format!("{key:?}").contains("MC4"));
        assert_ne!(
            Key::generate().expect("randomness").public(),
            Key::generate().expect("randomness").public()
        );
    }

    #[test]
    fn what_is_no_key_is_refused() {
        let public = "-----BEGIN PUBLIC KEY-----\nMCowBQYDK2VwAyEAGb9ECWmEzf6FQbrBZ9w7lshQhqowtrbLDFw4rXAxZuE=\n-----END PUBLIC KEY-----\n";
        for text in ["", "secret", public, &OPENSSL.replace("MC4C", "MC4D")] {
            let error = Key::from_pem(text).expect_err("no key");
            assert_eq!(error.code(), Some(&Code::BAD_ENCODING), "{error}");
        }
        let error = Key::from_file("/no/such.key").expect_err("no file");
        assert!(error.to_string().contains("/no/such.key: "), "{error}");
    }
}
