//! The table `[store]` of the configuration.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::StoreError;

/// What outlives the broker: who owns which token, and the fences.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct StoreConfig {
    /// A directory of this broker's own; it is made if it is not there. None = only the epoch of fences outlives it.
    pub path: Option<PathBuf>,
    /// Where the epoch of fences is kept without a `path`; several brokers may share it. None = nowhere: fences begin
    /// by the wall clock, and may fall if a broker starts twice in a second.
    pub state: Option<PathBuf>,
}

impl StoreConfig {
    /// Names the directory where programs of this user keep their state, if nothing else is named.
    ///
    /// # Errors
    /// The environment names none.
    pub fn keep_state(&mut self, environment: impl Fn(&str) -> Option<OsString>) -> Result<(), StoreError> {
        if self.path.is_some() || self.state.is_some() {
            return Ok(());
        }
        // As systemd says them: several are separated by colons, and ours is the first.
        let first = |paths: OsString| std::env::split_paths(&paths).next();
        let named = |name: &str| environment(name).and_then(first);
        // What is not absolute is to be ignored, says the specification of these directories.
        let absolute = |name: &str| {
            let path = environment(name).map(PathBuf::from);
            path.filter(|path| path.is_absolute())
        };
        let systemd = named("STATE_DIRECTORY").filter(|path| path.is_absolute());
        let xdg = || absolute("XDG_STATE_HOME").map(|state| state.join("mom"));
        let home = || absolute("HOME").map(|home| home.join(".local/state/mom"));
        self.state = Some(systemd.or_else(xdg).or_else(home).ok_or(StoreError::NoState)?);
        Ok(())
    }

    /// Resolves both paths relative to a folder.
    pub fn resolve(&mut self, folder: &Path) {
        for path in [&mut self.path, &mut self.state].into_iter().flatten() {
            *path = folder.join(&*path);
        }
    }
}
