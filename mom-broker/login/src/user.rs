//! A user as the users file has it (M13).

use mom_hub::User;
use mom_proto::{Fingerprint, Map, check_name};
use serde::Deserialize;

use crate::SettingError;
use crate::key::parse_key;
use crate::password;

/// The user and the group of guests.
pub const GUEST: &str = "guest";
/// The most keys of one user: all are tried at each login, so that the time reveals nothing.
const KEYS: usize = 16;

/// A user: human, server or agent.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UserEntry {
    /// The name.
    pub name: String,
    /// The argon2id hash of its password, as `mom-broker passwd` writes it.
    #[serde(default)]
    pub password: Option<String>,
    /// Its public keys, as `mom keygen` writes them: `ed25519 BASE64`, and a comment.
    #[serde(default)]
    pub keys: Vec<String>,
    /// The fingerprints of its certificates, as `openssl x509 -fingerprint -sha256` prints them.
    #[serde(default)]
    pub certificates: Vec<String>,
    /// The authority level; higher is more.
    #[serde(default)]
    pub level: i32,
    /// The groups.
    #[serde(default)]
    pub groups: Vec<String>,
    /// The user's preferences; returned at login.
    #[serde(default)]
    pub preferences: Map,
    /// Personal information; returned at login.
    #[serde(default)]
    pub personal: Map,
}

impl UserEntry {
    /// The user as the hub knows it.
    pub fn to_user(&self) -> User {
        let details = Map::new()
            .with("preferences", self.preferences.clone())
            .with("personal", self.personal.clone());
        User {
            name: self.name.clone(),
            level: self.level,
            groups: self.groups.clone(),
            details,
        }
    }

    /// Checks one user.
    ///
    /// # Errors
    /// The first key that is wrong.
    pub fn check(&self, guests: bool) -> Result<(), SettingError> {
        let wrong = |keys: &[&str], text: String| Err(SettingError::new(keys, text));
        if let Err(error) = check_name(&self.name) {
            return wrong(&["name"], error.text);
        }
        if guests && self.name == GUEST {
            let text = format!("guests are let in under the name {:?}", self.name);
            return wrong(&["name"], text);
        }
        if let Some(fault) = self.password.as_deref().and_then(password::fault) {
            let text = format!("{fault}; make one with: mom-broker passwd {}", self.name);
            return wrong(&["password"], text);
        }
        for (index, key) in self.keys.iter().enumerate() {
            if let Err(text) = parse_key(key) {
                return wrong(&["keys", &index.to_string()], text);
            }
        }
        for (index, certificate) in self.certificates.iter().enumerate() {
            if let Err(error) = certificate.parse::<Fingerprint>() {
                return wrong(&["certificates", &index.to_string()], error.to_string());
            }
        }
        if self.keys.len() > KEYS {
            return wrong(&["keys"], format!("a user has at most {KEYS} keys"));
        }
        if self.password.is_none() && self.keys.is_empty() && self.certificates.is_empty() {
            let text = format!(
                "{} has no password, key or certificate; make one with: mom-broker passwd {0}, or: mom keygen",
                self.name
            );
            return wrong(&[], text);
        }
        Ok(())
    }
}
