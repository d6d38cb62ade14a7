//! Another configuration for the same hub and users, from a text that a user has sent.

use super::faults::Reading;
use super::source::SourceText;
use super::{Config, ConfigErrors};

/// What a hub does not decide by, with all that names files.
const NOT_READ: [&[&str]; 9] = [
    &["listen"],
    &["tls"],
    &["web"],
    &["log"],
    &["reload"],
    &["store"],
    &["audit"],
    &["record"],
    &["login", "jwt"],
];

impl Config {
    /// A configuration from this text, with the users of this one. It is for trying only: no file that the text names is
    /// read, and what names files is left out.
    ///
    /// # Errors
    /// All that is wrong with it, with line and key.
    pub fn variant(&self, text: &str) -> Result<Config, ConfigErrors> {
        let name = self.file().name.unwrap_or_else(|| "configuration".to_owned());
        let mut source = SourceText::new(name, text);
        for keys in NOT_READ {
            source.strike(keys.iter().map(|key| (*key).to_owned()).collect(), None);
        }
        // Whatever file it names, it has these users.
        let users = self.users_source.clone();
        let users = users.unwrap_or_else(|| SourceText::new("the users file", "users = []"));
        let mut config = Reading::new(source, |_: &str| Ok(users.clone())).finish()?;
        // What was at fault beside what is left out anyway is not told, as it may come of that.
        let not_read = |keys: &Vec<String>| NOT_READ.iter().any(|known| keys == known);
        if let Some(source) = &config.source
            && let Some(keys) = source.struck().find(|keys| !not_read(keys))
        {
            let keys: Vec<&str> = keys.iter().map(String::as_str).collect();
            return Err(source.error(&keys, "cannot be read".to_owned()).into());
        }
        config.users.clone_from(&self.users);
        Ok(config)
    }

    /// The text that it was read from; none for a configuration that was made in a program.
    pub fn text(&self) -> Option<&str> {
        self.source.as_ref().map(|source| source.text.as_str())
    }
}
