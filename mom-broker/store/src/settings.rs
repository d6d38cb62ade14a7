//! The table `[store]` of the configuration.

use std::path::PathBuf;

use serde::Deserialize;

/// What outlives the broker: who owns which token, and the fences.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct StoreConfig {
    /// A directory of this broker's own; it is made if it is not there. None = nothing outlives it.
    pub path: Option<PathBuf>,
}
