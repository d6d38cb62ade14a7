//! How logins are checked: the table `[login]`.

use std::fmt;

use mom_proto::check_name;
use serde::{Deserialize, Deserializer};

use crate::{SettingError, Verifier};

/// How logins are checked.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct LoginConfig {
    /// Passwords hashed at once.
    pub hashers: usize,
    /// Logins that may wait for hashing; more get `try-later`.
    pub waiting: usize,
    /// Failed logins after which a connection is closed.
    pub attempts: u32,
    /// The name of this hub in challenges to keys, so that a signature is of no use at another hub.
    pub hub: String,
    /// How long a challenge may be answered, in ms.
    pub challenge_time: u64,
    /// Whether anybody may log in as a guest.
    pub guests: bool,
    /// How often logins may fail.
    pub throttle: ThrottleConfig,
    /// The issuer of accepted tokens; none = no tokens.
    pub jwt: Option<JwtConfig>,
}

/// How often logins may fail before later ones have to wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ThrottleConfig {
    /// From one address; of IPv6, from one network of 64 bits.
    pub per_address: FailureRate,
    /// At one account by its password, from all addresses together, except those from which it has logged in before.
    pub per_account: FailureRate,
    /// At one account by its password, from one address from which it has logged in before.
    pub per_place: FailureRate,
}

/// A rate of failures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct FailureRate {
    /// Failures a minute in the long run.
    pub per_minute: u32,
    /// Failures at once before the rate applies.
    pub burst: u32,
}

/// The issuer of accepted tokens (JWT, RFC 7519).
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct JwtConfig {
    /// The one issuer, as the claim `iss` has it.
    pub issuer: String,
    /// This hub, as the claim `aud` has it.
    pub audience: String,
    /// The accepted algorithms, such as `EdDSA`; all use the same key.
    pub algorithms: Vec<String>,
    /// The issuer's public key, or the secret shared with it.
    pub key: KeyFile,
    /// How far the issuer's clock may be off, in ms.
    #[serde(default)]
    pub leeway: u64,
    /// The source of the user's level and groups.
    #[serde(default)]
    pub users: JwtUsers,
    /// The highest level that a claim gives.
    #[serde(default)]
    pub max_level: i32,
}

/// The source of level and groups for logins with a token.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum JwtUsers {
    /// From the users file; the claim `sub` names the user there.
    #[default]
    File,
    /// From the claims `level` and `groups`; `sub` need not be in a file.
    FromClaims,
}

/// The key against which tokens are checked; in a configuration file the name of its file.
#[derive(Clone, PartialEq, Eq, Default)]
pub struct KeyFile {
    file: String,
    text: String,
}

impl KeyFile {
    /// A public key as PEM, or a shared secret.
    pub fn from_text(text: impl Into<String>) -> KeyFile {
        KeyFile {
            file: String::new(),
            text: text.into(),
        }
    }

    /// The text, without the line end that editors put after a secret.
    pub fn text(&self) -> &str {
        self.text.trim_end_matches(['\r', '\n'])
    }

    /// Reads the file that the configuration names.
    ///
    /// # Errors
    /// As `read`, which gives a file's text.
    pub fn read<E>(&mut self, read: impl FnOnce(&str) -> Result<String, E>) -> Result<(), E> {
        self.text = read(&self.file)?;
        Ok(())
    }
}

impl fmt::Debug for KeyFile {
    // It may be a secret.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "KeyFile({:?})", self.file)
    }
}

impl<'de> Deserialize<'de> for KeyFile {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<KeyFile, D::Error> {
        let file = String::deserialize(deserializer)?;
        Ok(KeyFile {
            file,
            text: String::new(),
        })
    }
}

impl Default for LoginConfig {
    fn default() -> LoginConfig {
        LoginConfig {
            hashers: 1,
            waiting: 64,
            attempts: 3,
            hub: "mom".to_owned(),
            challenge_time: 10_000,
            guests: false,
            throttle: ThrottleConfig::default(),
            jwt: None,
        }
    }
}

impl Default for ThrottleConfig {
    fn default() -> ThrottleConfig {
        let rate = |per_minute, burst| FailureRate { per_minute, burst };
        ThrottleConfig {
            per_address: rate(30, 30),
            per_account: rate(10, 10),
            per_place: rate(30, 100),
        }
    }
}

impl LoginConfig {
    /// Checks all settings.
    ///
    /// # Errors
    /// The first that is wrong, by its keys inside the table.
    pub fn check(&self) -> Result<(), SettingError> {
        if let Some(keys) = self.zero() {
            let key = keys.last().copied().unwrap_or_default();
            return Err(SettingError::new(&keys, format!("{key} is a number from 1")));
        }
        check_name(&self.hub).map_err(|error| SettingError::new(&["hub"], error.text))?;
        match self.jwt.as_ref().map(Verifier::new) {
            Some(Err(error)) => Err(error.below(&["jwt"])),
            _ => Ok(()),
        }
    }

    /// The number that is 0 and must not be.
    fn zero(&self) -> Option<Vec<&'static str>> {
        let ThrottleConfig {
            per_address,
            per_account,
            per_place,
        } = self.throttle;
        let numbers: [(u64, &[&'static str]); 10] = [
            (self.hashers as u64, &["hashers"]),
            (self.waiting as u64, &["waiting"]),
            (self.attempts.into(), &["attempts"]),
            (self.challenge_time, &["challenge-time"]),
            (
                per_address.per_minute.into(),
                &["throttle", "per-address", "per-minute"],
            ),
            (per_address.burst.into(), &["throttle", "per-address", "burst"]),
            (
                per_account.per_minute.into(),
                &["throttle", "per-account", "per-minute"],
            ),
            (per_account.burst.into(), &["throttle", "per-account", "burst"]),
            (
                per_place.per_minute.into(),
                &["throttle", "per-place", "per-minute"],
            ),
            (per_place.burst.into(), &["throttle", "per-place", "burst"]),
        ];
        numbers
            .into_iter()
            .find(|(number, _)| *number == 0)
            .map(|(_, keys)| keys.to_vec())
    }
}
