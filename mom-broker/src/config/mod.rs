//! The configuration: what the file may say, and its defaults.

mod error;
mod load;
mod locate;
mod login;
mod users;

use std::collections::BTreeMap;

use mom_hub::ContextSpec;
use mom_managers::Registry;
use mom_proto::{Limits, Value};

pub use error::ConfigError;
pub use login::{FailureRate, JwtConfig, JwtKey, JwtUsers, LoginConfig, ThrottleConfig};
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

impl Default for Config {
    fn default() -> Config {
        Config {
            listen: vec!["127.0.0.1:7666".to_owned()],
            connections: 10_000,
            log: "info".to_owned(),
            limits: Limits::default(),
            login: LoginConfig::default(),
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
