//! The whole configuration, as data.

use std::collections::BTreeMap;

use mom_hub::ContextSpec;
use mom_journal::{AuditConfig, RecordConfig};
use mom_login::{LoginConfig, UserEntry};
use mom_managers::Registry;
use mom_proto::{Limits, Value};
use mom_store::StoreConfig;
use serde::Deserialize;

use crate::listen::ListenConfig;
use crate::source::SourceText;
use crate::tls::TlsConfig;
use crate::web::WebConfig;

/// The whole configuration of a broker.
///
/// ```
/// use mom_config::Config;
/// let config = Config::default();
/// assert_eq!(config.listen, ["127.0.0.1:7666".into()]);
/// assert!(config.users.is_empty(), "closed by default");
/// ```
#[derive(Clone, Debug)]
pub struct Config {
    /// The listeners.
    pub listen: Vec<ListenConfig>,
    /// The certificate for connections with TLS.
    pub tls: TlsConfig,
    /// Connections at once.
    pub connections: usize,
    /// Of them, those that have not logged in; none = a quarter.
    pub connections_before_login: Option<usize>,
    /// Of these, those from one address; none = a quarter.
    pub connections_per_address: Option<usize>,
    /// Connections of one user; none = a quarter of all.
    pub connections_per_user: Option<usize>,
    /// What HTTP may ask.
    pub web: WebConfig,
    /// Bytes that may wait or be kept in the whole hub; none = a quarter of the machine's memory.
    pub memory: Option<usize>,
    /// What to log, in the words of `tracing`'s filters.
    pub log: String,
    /// When the file is read again.
    pub reload: ReloadOn,
    /// The hub's limits.
    pub limits: Limits,
    /// How logins are checked.
    pub login: LoginConfig,
    /// What outlives the broker.
    pub store: StoreConfig,
    /// Where the audit log goes.
    pub audit: AuditConfig,
    /// Where the hub's inputs are recorded.
    pub record: RecordConfig,
    /// The manager of the root.
    pub root: Value,
    /// The named managers.
    pub managers: BTreeMap<String, Value>,
    /// The permanent contexts.
    pub contexts: Vec<ContextSpec>,
    /// The users.
    pub users: Vec<UserEntry>,
    pub(crate) source: Option<SourceText>,
    pub(crate) users_source: Option<SourceText>,
}

/// When the configuration file is read again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReloadOn {
    /// When it or the users file has changed, and at SIGHUP.
    #[default]
    Change,
    /// At SIGHUP only.
    Signal,
}

/// How many connections there may be, and whose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConnectionCaps {
    /// All.
    pub all: usize,
    /// Those that have not logged in.
    pub before_login: usize,
    /// Those from one address that have not logged in.
    pub per_address: usize,
    /// Those of one user.
    pub per_user: usize,
}

/// A quarter, but of a few all of them: a small hub is for few people, who would only hinder themselves.
fn quarter(of: usize) -> usize {
    (of / 4).max(of.min(16))
}

impl Default for Config {
    fn default() -> Config {
        Config {
            listen: vec!["127.0.0.1:7666".into()],
            tls: TlsConfig::default(),
            web: WebConfig::default(),
            connections: 10_000,
            connections_before_login: None,
            connections_per_address: None,
            connections_per_user: None,
            memory: None,
            log: "info".to_owned(),
            reload: ReloadOn::default(),
            limits: Limits::default(),
            login: LoginConfig::default(),
            store: StoreConfig::default(),
            audit: AuditConfig::default(),
            record: RecordConfig::default(),
            root: Value::from("closed"),
            managers: BTreeMap::new(),
            contexts: Vec::new(),
            users: Vec::new(),
            source: None,
            users_source: None,
        }
    }
}

impl Config {
    /// How many connections there may be, and whose.
    pub fn connection_caps(&self) -> ConnectionCaps {
        let all = self.connections;
        let before_login = self
            .connections_before_login
            .unwrap_or_else(|| quarter(all))
            .min(all);
        let per_address = self
            .connections_per_address
            .unwrap_or_else(|| quarter(before_login));
        let per_user = self.connections_per_user.unwrap_or_else(|| quarter(all));
        ConnectionCaps {
            all,
            before_login,
            per_address: per_address.min(before_login),
            per_user: per_user.min(all),
        }
    }

    /// The bytes that may wait or be kept in the whole hub.
    pub fn memory_bound(&self) -> usize {
        let quarter = || mom_system::machine_memory().map_or(usize::MAX, |all| all / 4);
        self.memory.unwrap_or_else(quarter)
    }

    /// The managers that contexts can name.
    pub fn registry(&self) -> Registry {
        let mut registry = Registry::builtin();
        for (name, spec) in &self.managers {
            registry.define(name, spec.clone());
        }
        registry
    }
}
