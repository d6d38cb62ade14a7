//! The configuration: what the file may say, and its defaults.

mod error;
mod load;
mod locate;
mod users;

use std::collections::BTreeMap;
use std::path::PathBuf;

use mom_hub::ContextSpec;
use mom_managers::Registry;
use mom_proto::{Limits, Value};
use serde::Deserialize;

pub use error::ConfigError;
pub use users::UserEntry;

use locate::Source;

/// All that a broker can be told.
///
/// ```
/// use mom_broker::Config;
/// let config = Config::default();
/// assert_eq!(config.listen, ["127.0.0.1:7666"]);
/// assert!(config.users.is_empty(), "closed by default");
/// ```
#[derive(Clone, Debug)]
pub struct Config {
    /// The addresses to listen at.
    pub listen: Vec<String>,
    /// Connections at once.
    pub connections: usize,
    /// What to log, in the words of `tracing`'s filters.
    pub log: String,
    /// What the hub takes.
    pub limits: Limits,
    /// How logins are checked.
    pub login: LoginConfig,
    /// What outlives the broker.
    pub store: StoreConfig,
    /// The manager of the root.
    pub root: Value,
    /// The managers that have names.
    pub managers: BTreeMap<String, Value>,
    /// The contexts that are always there.
    pub contexts: Vec<ContextSpec>,
    /// The users.
    pub users: Vec<UserEntry>,
    source: Option<Source>,
}

/// How logins are checked.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct LoginConfig {
    /// Passwords hashed at once.
    pub hashers: usize,
    /// Logins that may wait for that; more are told to try later.
    pub waiting: usize,
    /// Failed logins after which a connection is closed.
    pub attempts: u32,
}

/// What outlives the broker: who owns which token, and the fences.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct StoreConfig {
    /// A directory of this broker's own; it is made if it is not there. None = nothing outlives it.
    pub path: Option<PathBuf>,
}

impl Default for LoginConfig {
    fn default() -> LoginConfig {
        LoginConfig {
            hashers: 2,
            waiting: 64,
            attempts: 3,
        }
    }
}

impl Default for Config {
    fn default() -> Config {
        Config {
            listen: vec!["127.0.0.1:7666".to_owned()],
            connections: 10_000,
            log: "info".to_owned(),
            limits: Limits::default(),
            login: LoginConfig::default(),
            store: StoreConfig::default(),
            root: Value::from("closed"),
            managers: BTreeMap::new(),
            contexts: Vec::new(),
            users: Vec::new(),
            source: None,
        }
    }
}

impl Config {
    /// The managers that contexts can name.
    pub(crate) fn registry(&self) -> Registry {
        let mut registry = Registry::builtin();
        for (name, spec) in &self.managers {
            registry.define(name, spec.clone());
        }
        registry
    }
}
