//! Files that a running broker does not go by although they can be read: they were lost or cut off on their way to the disk.

use super::source::SourceText;
use super::{Config, ConfigError};

impl Config {
    /// Checks that a configuration that was read again is not an accident: an empty file would close the broker, or take all
    /// its users from it, and a file that was cut off would do a part of that.
    ///
    /// # Errors
    /// Which file, and what to write if that is meant.
    pub fn check_replacement(&self, new: &Config) -> Result<(), ConfigError> {
        let meant = "if the broker is to be closed, write root = \"closed\"";
        check(self.source.as_ref(), new.source.as_ref(), meant)?;
        let meant = "if there are to be no users, write users = []";
        check(self.users_source.as_ref(), new.users_source.as_ref(), meant)
    }
}

fn check(old: Option<&SourceText>, new: Option<&SourceText>, meant: &str) -> Result<(), ConfigError> {
    let (Some(old), Some(new)) = (old, new) else {
        return Ok(());
    };
    if says_nothing(&new.text) && !says_nothing(&old.text) {
        let text = format!("is empty, or has comments only; {meant}");
        return Err(ConfigError::of_file(&new.name, text));
    }
    match old.text.strip_prefix(&new.text) {
        // A file that ends with a line may have been shortened by hand; within a line nobody stops.
        Some(rest) if old.name == new.name && !new.text.ends_with('\n') && !rest.trim().is_empty() => {
            let text = format!(
                "was cut off after {} of {} bytes; write the whole of it, or end it with a line end if that is meant",
                new.text.len(),
                old.text.len()
            );
            Err(ConfigError::of_file(&new.name, text))
        }
        _ => Ok(()),
    }
}

fn says_nothing(text: &str) -> bool {
    let says = |line: &str| !line.is_empty() && !line.starts_with('#');
    !text.lines().map(str::trim).any(says)
}
