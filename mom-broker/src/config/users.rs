//! The users file (M13).

use mom_proto::{Map, check_name};
use serde::Deserialize;

use super::ConfigError;
use super::locate::Source;
use crate::login::is_hash;

/// A user: human, server or agent.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UserEntry {
    /// The name.
    pub name: String,
    /// The argon2id hash of its password, as `mom-broker passwd` writes it.
    pub password: String,
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

/// Reads a users file's text.
pub(super) fn parse(source: &Source) -> Result<Vec<UserEntry>, ConfigError> {
    let File { users } = toml::from_str(&source.text).map_err(|error| source.syntax(&error))?;
    for (index, user) in users.iter().enumerate() {
        let index_key = index.to_string();
        let at = |key: &str, text: String| source.error(&["users", &index_key, key], text);
        check_name(&user.name).map_err(|error| at("name", error.text))?;
        if users[..index].iter().any(|other| other.name == user.name) {
            return Err(at("name", format!("there are two users {:?}", user.name)));
        }
        if !is_hash(&user.password) {
            let text = format!("no argon2id hash; make one with: mom-broker passwd {}", user.name);
            return Err(at("password", text));
        }
    }
    Ok(users)
}
