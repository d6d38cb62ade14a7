//! Checks a whole configuration, and makes the hub of it.

use mom_hub::{Hub, Settings};
use mom_proto::Value;

use crate::{Config, ConfigError, ConfigErrors};

impl Config {
    /// Checks everything that can be checked without starting: managers, contexts, paths.
    ///
    /// # Errors
    /// What is wrong, with file, line and key where it came from a file.
    pub fn check(&self) -> Result<(), ConfigErrors> {
        let faults = self.faults();
        match faults.is_empty() {
            true => Ok(()),
            false => Err(ConfigErrors(faults)),
        }
    }

    /// What [`Config::check`] finds; of contexts only the first that is wrong, because others may lie below it.
    pub(crate) fn faults(&self) -> Vec<ConfigError> {
        let registry = self.registry();
        let built = |name: &String| registry.build(&Value::from(name.as_str()));
        let managers = self.managers.keys();
        let mut found: Vec<ConfigError> = managers
            .filter_map(|name| Some(self.locate_manager(name, &built(name).err()?)))
            .collect();
        found.extend(self.check_login().err());
        // A manager that cannot be made would be told again by each of its contexts.
        if found.is_empty() {
            found.extend(self.hub().err());
            found.extend(self.unsafe_states());
            found.extend(self.misplaced_log());
        }
        found
    }

    /// A hub of this configuration without peers, for hypothetical requests.
    ///
    /// # Errors
    /// As [`Config::check`].
    pub fn hub(&self) -> Result<Hub, ConfigError> {
        self.make_hub(Settings {
            limits: self.limits.clone(),
            ..Settings::default()
        })
    }

    /// The hub of this configuration.
    ///
    /// # Errors
    /// As [`Config::check`].
    pub fn make_hub(&self, settings: Settings) -> Result<Hub, ConfigError> {
        Hub::new(settings, self.registry(), &self.root, &self.contexts).map_err(|error| self.locate(&error))
    }
}
