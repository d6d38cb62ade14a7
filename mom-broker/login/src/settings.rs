//! How logins are checked: the table `[login]`.

use mom_proto::check_name;
use serde::Deserialize;

use crate::{JwtConfig, SettingError, Verifier};

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
            return Err(SettingError::new(&keys, format!("{key} must be a number from 1")));
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
