//! The users file (M13).

use mom_login::UserEntry;
use serde::Deserialize;

use crate::source::SourceText;
use crate::{ConfigError, shape, users_schema};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct UsersFile {
    #[serde(default)]
    users: Vec<UserEntry>,
}

/// Reads a users file's text.
///
/// # Errors
/// All that is wrong, as far as it was read.
pub(super) fn parse(source: &SourceText, guests: bool) -> Result<Vec<UserEntry>, Vec<ConfigError>> {
    let schema = users_schema();
    let mut faults = shape::faults(&schema, source);
    if !faults.is_empty() {
        return Err(faults);
    }
    let UsersFile { users } = source
        .read()
        .map_err(|error| vec![shape::in_words(&schema, error)])?;
    for (index, user) in users.iter().enumerate() {
        let index_key = index.to_string();
        let at = |keys: &[&str], text: String| {
            let keys = ["users", &index_key].into_iter().chain(keys.iter().copied());
            source.error(&keys.collect::<Vec<_>>(), text)
        };
        if let Err(error) = user.check(guests) {
            faults.push(at(&error.keys(), error.text.clone()));
        } else if users[..index].iter().any(|other| other.name == user.name) {
            faults.push(at(&["name"], format!("there are two users {:?}", user.name)));
        }
    }
    match faults.is_empty() {
        true => Ok(users),
        false => Err(faults),
    }
}

/// What the parser says of a text by itself, without the schema.
#[cfg(test)]
pub(super) fn parser_error(text: &str) -> Option<String> {
    let error = toml::from_str::<UsersFile>(text).err()?;
    Some(error.message().to_owned())
}
