//! The users file (M13).

use mom_hub::User;
use mom_proto::{Map, check_name};
use serde::Deserialize;

use super::ConfigError;
use super::locate::Source;
use super::login::is_reserved;
use crate::login::{is_hash, parse_key};

/// Keys of one user: all are tried at a login, so that the time says nothing.
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
    /// The authority level; higher is more.
    #[serde(default)]
    pub level: i32,
    /// The groups.
    #[serde(default)]
    pub groups: Vec<String>,
    /// What the user likes; given back at login.
    #[serde(default)]
    pub preferences: Map,
    /// What is known of the user; given back at login.
    #[serde(default)]
    pub personal: Map,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    users: Vec<UserEntry>,
}

/// What is wrong with a user, at which of its keys.
pub(crate) struct Fault {
    keys: Vec<String>,
    pub(crate) text: String,
}

impl UserEntry {
    /// The user as the hub knows it.
    pub(crate) fn to_user(&self) -> User {
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

    /// What is wrong with it by itself.
    pub(crate) fn fault(&self, guests: bool) -> Option<Fault> {
        let fault = |keys: &[&str], text: String| {
            let keys = keys.iter().map(|&key| key.to_owned()).collect();
            Some(Fault { keys, text })
        };
        if let Err(error) = check_name(&self.name) {
            return fault(&["name"], error.text);
        }
        if is_reserved(&self.name, guests) {
            let text = format!("guests are let in under the name {:?}", self.name);
            return fault(&["name"], text);
        }
        if self.password.as_deref().is_some_and(|hash| !is_hash(hash)) {
            let text = format!("no argon2id hash; make one with: mom-broker passwd {}", self.name);
            return fault(&["password"], text);
        }
        for (index, key) in self.keys.iter().enumerate() {
            if let Err(text) = parse_key(key) {
                return fault(&["keys", &index.to_string()], text);
            }
        }
        if self.keys.len() > KEYS {
            return fault(&["keys"], format!("a user has at most {KEYS} keys"));
        }
        if self.password.is_none() && self.keys.is_empty() {
            let text = format!(
                "{} has neither password nor keys; make one with: mom-broker passwd {0}, or: mom keygen",
                self.name
            );
            return fault(&["name"], text);
        }
        None
    }
}

/// Reads a users file's text.
pub(super) fn parse(source: &Source, guests: bool) -> Result<Vec<UserEntry>, ConfigError> {
    let File { users } = toml::from_str(&source.text).map_err(|error| source.syntax(&error))?;
    for (index, user) in users.iter().enumerate() {
        let index_key = index.to_string();
        let at = |keys: &[&str], text: String| {
            let keys = ["users", &index_key].into_iter().chain(keys.iter().copied());
            source.error(&keys.collect::<Vec<_>>(), text)
        };
        if let Some(Fault { keys, text }) = user.fault(guests) {
            let keys: Vec<&str> = keys.iter().map(String::as_str).collect();
            return Err(at(&keys, text));
        }
        if users[..index].iter().any(|other| other.name == user.name) {
            return Err(at(&["name"], format!("there are two users {:?}", user.name)));
        }
    }
    Ok(users)
}
