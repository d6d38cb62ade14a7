//! From files to a configuration.

use std::collections::BTreeMap;
use std::path::Path;

use mom_hub::ContextSpec;
use mom_journal::{AuditConfig, RecordConfig};
use mom_login::LoginConfig;
use mom_proto::{HARD_DEPTH, Limits, Value};
use mom_store::StoreConfig;
use serde::Deserialize;
use tracing_subscriber::EnvFilter;

use super::locate::SourceText;
use super::{Config, ConfigError, ReloadOn, users};

const LAB: &str = include_str!("../../../config/lab.toml");
const LAB_USERS: &str = include_str!("../../../config/lab-users.toml");

#[derive(Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
struct ConfigDocument {
    listen: Vec<String>,
    connections: usize,
    connections_before_login: Option<usize>,
    connections_per_address: Option<usize>,
    connections_per_user: Option<usize>,
    memory: Option<usize>,
    log: String,
    reload: ReloadOn,
    users: Option<String>,
    root: Value,
    limits: Limits,
    login: LoginConfig,
    store: StoreConfig,
    audit: AuditConfig,
    record: RecordConfig,
    managers: BTreeMap<String, Value>,
    contexts: Vec<ContextSpec>,
}

impl Default for ConfigDocument {
    fn default() -> ConfigDocument {
        let Config {
            listen,
            connections,
            connections_before_login,
            connections_per_address,
            connections_per_user,
            memory,
            log,
            reload,
            limits,
            login,
            store,
            audit,
            record,
            root,
            managers,
            contexts,
            ..
        } = Config::default();
        ConfigDocument {
            listen,
            connections,
            connections_before_login,
            connections_per_address,
            connections_per_user,
            memory,
            log,
            reload,
            users: None,
            root,
            limits,
            login,
            store,
            audit,
            record,
            managers,
            contexts,
        }
    }
}

impl Config {
    /// Reads a configuration file and the users file that it names, which lies relative to it, as does the store.
    ///
    /// # Errors
    /// What is wrong, with file, line and key.
    pub fn load(path: &Path) -> Result<Config, ConfigError> {
        let folder = path.parent().unwrap_or(Path::new("."));
        let mut config = Config::parse(read(path)?, |name| read(&folder.join(name)))?;
        config.store.resolve(folder);
        Ok(config)
    }

    /// The demonstration lab that is built in, with its users; for loopback only, its passwords are public.
    ///
    /// # Panics
    /// Never: a test reads the same files.
    pub fn lab() -> Config {
        let source = |name: &str, text: &str| SourceText {
            name: name.to_owned(),
            text: text.to_owned(),
        };
        let users = source("config/lab-users.toml", LAB_USERS);
        Config::parse(source("config/lab.toml", LAB), |_| Ok(users.clone()))
            .expect("the built-in lab is tested")
    }

    fn parse(
        source: SourceText,
        beside: impl Fn(&str) -> Result<SourceText, ConfigError>,
    ) -> Result<Config, ConfigError> {
        let mut file: ConfigDocument = toml::from_str(&source.text).map_err(|error| source.syntax(&error))?;
        check(&file, &source)?;
        let folder = Path::new(&source.name).parent().unwrap_or(Path::new("."));
        file.audit.resolve(folder);
        file.record.resolve(folder);
        let unread = |keys: &[&str], error: ConfigError| ConfigError {
            busy: error.busy,
            ..source.error(keys, error.to_string())
        };
        let users_source = file.users.as_deref().map(&beside).transpose();
        let users_source = users_source.map_err(|error| unread(&["users"], error))?;
        let users = match &users_source {
            Some(users) => users::parse(users, file.login.guests)?,
            None => Vec::new(),
        };
        if let Some(jwt) = &mut file.login.jwt {
            let text = |name: &str| beside(name).map(|file| file.text);
            jwt.key
                .read(|name| text(name).map_err(|error| unread(&["login", "jwt", "key"], error)))?;
        }
        let config = Config {
            listen: file.listen,
            connections: file.connections,
            connections_before_login: file.connections_before_login,
            connections_per_address: file.connections_per_address,
            connections_per_user: file.connections_per_user,
            memory: file.memory,
            log: file.log,
            reload: file.reload,
            limits: file.limits,
            login: file.login,
            store: file.store,
            audit: file.audit,
            record: file.record,
            root: file.root,
            managers: file.managers,
            contexts: file.contexts,
            users,
            source: Some(source),
            users_source,
        };
        config.check()?;
        Ok(config)
    }
}

fn read(path: &Path) -> Result<SourceText, ConfigError> {
    let name = path.display().to_string();
    match std::fs::read_to_string(path) {
        Ok(text) => Ok(SourceText { name, text }),
        Err(error) => Err(ConfigError {
            busy: matches!(error.raw_os_error(), Some(libc::EMFILE | libc::ENFILE)),
            ..ConfigError::of_file(&name, format!("cannot be read: {error}"))
        }),
    }
}

fn check(file: &ConfigDocument, source: &SourceText) -> Result<(), ConfigError> {
    let optional = [
        ("connections-before-login", file.connections_before_login),
        ("connections-per-address", file.connections_per_address),
        ("connections-per-user", file.connections_per_user),
        ("memory", file.memory),
    ];
    let optional = optional.map(|(key, number)| (key, number.map_or(1, |number| number as u64), key));
    let at_least_one = [
        ("connections", file.connections as u64, "connections"),
        ("limits", file.limits.heartbeat, "heartbeat"),
        ("limits", file.limits.gone, "gone"),
        ("limits", file.limits.login_time, "login-time"),
        ("limits", file.limits.future, "future"),
        ("limits", file.limits.outbox as u64, "outbox"),
        ("limits", file.limits.burst as u64, "burst"),
        ("limits", file.limits.send_wait, "send-wait"),
        ("limits", file.limits.stalled, "stalled"),
        ("limits", file.limits.before_login as u64, "before-login"),
        ("limits", file.limits.attributes as u64, "attributes"),
        ("limits", file.limits.attribute_size as u64, "attribute-size"),
        ("limits", file.limits.path as u64, "path"),
        ("limits", file.limits.path_levels as u64, "path-levels"),
        ("limits", file.limits.header as u64, "header"),
        ("limits", file.limits.parts as u64, "parts"),
    ];
    for (table, value, key) in optional.into_iter().chain(at_least_one) {
        if value == 0 {
            let keys = if table == key { vec![key] } else { vec![table, key] };
            return Err(source.error(&keys, format!("{key} is a number from 1")));
        }
    }
    if let Err(error) = EnvFilter::try_new(&file.log) {
        let text = format!(
            "{:?} is no filter, such as info or mom_broker=debug: {error}",
            file.log
        );
        return Err(source.error(&["log"], text));
    }
    if file.listen.is_empty() {
        return Err(source.error(
            &["listen"],
            "a broker needs an address to listen at, such as 127.0.0.1:7666".into(),
        ));
    }
    if !(1..=HARD_DEPTH).contains(&file.limits.depth) {
        return Err(source.error(
            &["limits", "depth"],
            format!("depth is a number from 1 to {HARD_DEPTH}"),
        ));
    }
    let longest = Limits::default();
    for (value, most, key) in [
        (file.limits.path, longest.path, "path"),
        (file.limits.path_levels, longest.path_levels, "path-levels"),
    ] {
        if value > most {
            return Err(source.error(
                &["limits", key],
                format!("{key} is at most {most}: no path is longer"),
            ));
        }
    }
    if file.limits.gone <= file.limits.heartbeat {
        let text = "gone has to be longer than heartbeat, or every quiet peer is lost";
        return Err(source.error(&["limits", "gone"], text.to_owned()));
    }
    check_files(file, source)
}

/// Checks what is written: the store, the audit log, the recording.
fn check_files(file: &ConfigDocument, source: &SourceText) -> Result<(), ConfigError> {
    for (table, size, least) in [
        ("audit", file.audit.size, AuditConfig::LEAST),
        ("record", file.record.size, RecordConfig::LEAST),
    ] {
        if size < least {
            let text = format!("size is a number of bytes from {least}");
            return Err(source.error(&[table, "size"], text));
        }
    }
    for (key, path) in [("path", &file.store.path), ("state", &file.store.state)] {
        if path.as_ref().is_some_and(|path| path.as_os_str().is_empty()) {
            let text = format!("{key} is a directory such as \"state\", relative to this file");
            return Err(source.error(&["store", key], text));
        }
    }
    Ok(())
}
