//! Another configuration while the broker runs: all of it or nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::Arc;

use mom_config::{Config, ConfigError, ConfigErrors};
use mom_hub::{Configuration, Input, PeerId, User};
use mom_proto::{Limits, Map, Value};

use crate::Broker;
use crate::broker::open_tls;
use crate::traffic::switchboard::{Touched, flush};

/// What another configuration changed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReloadReport {
    /// Users, by name.
    pub users: Changes,
    /// Managers that have names.
    pub managers: Changes,
    /// Contexts of the configuration, by path.
    pub contexts: Changes,
    /// Other keys with another value that holds from now on, such as `limits.gone`.
    pub keys: Vec<String>,
    /// Keys with another value that holds only after the next start; until then the old one does.
    pub needs_restart: Vec<String>,
    /// How many of the peers that are logged in are of users that were changed or removed.
    pub peers: usize,
}

/// What became of things that have names.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Changes {
    /// Those that are new.
    pub added: Vec<String>,
    /// Those that are no more.
    pub removed: Vec<String>,
    /// Those that are not as they were.
    pub changed: Vec<String>,
}

impl Broker {
    /// Goes by another configuration from now on, but for what cannot change while it runs, which the report names.
    ///
    /// Connected peers stay so, unless their user was removed; `limits` hold for connections that come after.
    ///
    /// # Errors
    /// The configuration is wrong; nothing was changed.
    pub fn reload(&self, config: Config) -> Result<ReloadReport, ConfigErrors> {
        let mut running = self.running.lock();
        let (config, needs_restart) = keep_fixed(&running, config);
        running.check_replacement(&config)?;
        config.check()?;
        let tls = open_tls(&config)?;
        let mut report = ReloadReport::of(&running, &config, needs_restart);
        let mut touched = Touched::new();
        let configure = |users: Vec<(PeerId, Option<User>)>| {
            report.peers = users.len();
            let configuration = configuration(&config, users);
            let input = Input::Configure(Box::new(configuration));
            self.services.board.tap.configuring(config.file());
            self.services.board.decide(input, &mut touched);
        };
        let (users, login) = (config.users.clone(), config.login.clone());
        self.services
            .logins
            .replace(users, login, configure)
            .map_err(ConfigError::from)?;
        *self.tls.write() = tls;
        self.web.replace(&config.web);
        *self.services.next_limits.write() = Arc::new(config.limits.clone());
        flush(&mut touched);
        *running = config;
        tracing::info!("configuration: {report}");
        for key in &report.needs_restart {
            tracing::warn!(key, "this changes only when the broker is started again");
        }
        Ok(report)
    }
}

/// A configuration with what cannot change while the broker runs taken from the one that runs, and the keys that
/// were different there.
fn keep_fixed(running: &Config, mut config: Config) -> (Config, Vec<String>) {
    let mut different = Vec::new();
    keep(&running.listen, &mut config.listen, "listen", &mut different);
    keep(
        &running.connections,
        &mut config.connections,
        "connections",
        &mut different,
    );
    keep(
        &running.connections_before_login,
        &mut config.connections_before_login,
        "connections-before-login",
        &mut different,
    );
    keep(
        &running.connections_per_address,
        &mut config.connections_per_address,
        "connections-per-address",
        &mut different,
    );
    keep(
        &running.connections_per_user,
        &mut config.connections_per_user,
        "connections-per-user",
        &mut different,
    );
    // Every peer that is connected was promised that nothing longer or deeper will reach it.
    let (limits, new) = (&running.limits, &mut config.limits);
    keep(&limits.parcel, &mut new.parcel, "limits.parcel", &mut different);
    keep(&limits.depth, &mut new.depth, "limits.depth", &mut different);
    // Files that are open.
    keep(&running.store, &mut config.store, "store", &mut different);
    keep(&running.audit, &mut config.audit, "audit", &mut different);
    keep(&running.record, &mut config.record, "record", &mut different);
    (config, different)
}

fn keep<T: PartialEq + Clone>(running: &T, new: &mut T, key: &str, different: &mut Vec<String>) {
    if new != running {
        new.clone_from(running);
        different.push(key.to_owned());
    }
}

/// What the hub is told.
fn configuration(config: &Config, users: Vec<(PeerId, Option<User>)>) -> Configuration {
    Configuration {
        registry: config.registry(),
        root: config.root.clone(),
        contexts: config.contexts.clone(),
        limits: config.limits.clone(),
        users,
    }
}

impl ReloadReport {
    fn of(running: &Config, config: &Config, needs_restart: Vec<String>) -> ReloadReport {
        let users = |config: &Config| by_name(&config.users, |user| user.name.clone());
        let contexts =
            |config: &Config| by_name(&config.contexts, |spec| spec.path.clone().unwrap_or_default());
        let mut keys = Vec::new();
        let mut note = |same: bool, key: &str| {
            if !same {
                keys.push(key.to_owned());
            }
        };
        note(running.log == config.log, "log");
        note(running.tls == config.tls, "tls");
        note(running.web == config.web, "web");
        note(running.reload == config.reload, "reload");
        note(running.root == config.root, "root");
        note(running.login == config.login, "login");
        keys.extend(changed_limits(&running.limits, &config.limits));
        ReloadReport {
            users: Changes::between(&users(running), &users(config)),
            managers: Changes::between(&running.managers, &config.managers),
            contexts: Changes::between(&contexts(running), &contexts(config)),
            keys,
            needs_restart,
            peers: 0,
        }
    }

    /// Whether nothing is another than it was.
    pub fn is_empty(&self) -> bool {
        let lists = [&self.users, &self.managers, &self.contexts];
        lists.iter().all(|changes| changes.is_empty())
            && self.keys.is_empty()
            && self.needs_restart.is_empty()
    }
}

fn by_name<T: Clone>(list: &[T], name: impl Fn(&T) -> String) -> BTreeMap<String, T> {
    list.iter().map(|entry| (name(entry), entry.clone())).collect()
}

fn changed_limits(before: &Limits, now: &Limits) -> Vec<String> {
    let map = |limits: &Limits| match mom_proto::to_value(limits) {
        Ok(Value::Map(map)) => map,
        // A number that no wire takes: above what an int holds.
        _ => Map::new(),
    };
    let (before, now) = (map(before), map(now));
    let changed = now.iter().filter(|(key, value)| before.get(key) != Some(*value));
    changed.map(|(key, _)| format!("limits.{key}")).collect()
}

impl Changes {
    fn between<T: PartialEq>(before: &BTreeMap<String, T>, now: &BTreeMap<String, T>) -> Changes {
        let names = |map: &BTreeMap<String, T>| map.keys().cloned().collect::<BTreeSet<_>>();
        let (old, new) = (names(before), names(now));
        let differs = |name: &&String| before.get(*name) != now.get(*name);
        Changes {
            added: new.difference(&old).cloned().collect(),
            removed: old.difference(&new).cloned().collect(),
            changed: new.intersection(&old).filter(differs).cloned().collect(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.added.is_empty() && self.removed.is_empty() && self.changed.is_empty()
    }
}

impl fmt::Display for ReloadReport {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_empty() {
            return formatter.write_str("nothing changed");
        }
        let mut parts = Vec::new();
        for (what, changes) in [
            ("users", &self.users),
            ("managers", &self.managers),
            ("contexts", &self.contexts),
        ] {
            for (how, names) in [
                ("new", &changes.added),
                ("removed", &changes.removed),
                ("changed", &changes.changed),
            ] {
                if !names.is_empty() {
                    parts.push(format!("{how} {what} {}", names.join(", ")));
                }
            }
        }
        if !self.keys.is_empty() {
            parts.push(format!("changed {}", self.keys.join(", ")));
        }
        if !self.needs_restart.is_empty() {
            parts.push(format!("not before a restart {}", self.needs_restart.join(", ")));
        }
        formatter.write_str(&parts.join("; "))
    }
}
