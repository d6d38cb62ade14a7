//! Checks the table `[login]` and the users.

use mom_proto::{Code, WireError};

use crate::{Config, ConfigError};

impl Config {
    /// Checks the table `[login]`, and the users against it.
    ///
    /// # Errors
    /// What is wrong, with file, line and key where it came from a file.
    pub fn check_login(&self) -> Result<(), ConfigError> {
        let wrong = |keys: &[&str], text: String| self.at(keys, &WireError::new(Code::BAD_CONTENT, text));
        self.login.check().map_err(|error| {
            let error = error.below(&["login"]);
            wrong(&error.keys(), error.text.clone())
        })?;
        // Users of a file were checked with their lines; this checks those set by a program.
        for user in &self.users {
            user.check(self.login.guests)
                .map_err(|error| wrong(&["users"], format!("user {:?}: {}", user.name, error.text)))?;
        }
        Ok(())
    }
}
