//! The users file (M13).

use mom_login::UserEntry;
use serde::Deserialize;

use crate::ConfigError;
use crate::locate::SourceText;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct UsersFile {
    #[serde(default)]
    users: Vec<UserEntry>,
}

/// Reads a users file's text.
pub(super) fn parse(source: &SourceText, guests: bool) -> Result<Vec<UserEntry>, ConfigError> {
    let UsersFile { users } = toml::from_str(&source.text).map_err(|error| source.syntax(&error))?;
    for (index, user) in users.iter().enumerate() {
        let index_key = index.to_string();
        let at = |keys: &[&str], text: String| {
            let keys = ["users", &index_key].into_iter().chain(keys.iter().copied());
            source.error(&keys.collect::<Vec<_>>(), text)
        };
        user.check(guests)
            .map_err(|error| at(&error.keys(), error.text.clone()))?;
        if users[..index].iter().any(|other| other.name == user.name) {
            return Err(at(&["name"], format!("there are two users {:?}", user.name)));
        }
    }
    Ok(users)
}
