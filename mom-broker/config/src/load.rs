//! From files to a configuration.

use std::collections::BTreeMap;
use std::path::Path;

use mom_hub::ContextSpec;
use mom_journal::{AuditConfig, RecordConfig};
use mom_login::{LoginConfig, UserEntry};
use mom_proto::{HARD_DEPTH, Limits, Value};
use mom_store::StoreConfig;
use serde::Deserialize;
use tracing_subscriber::EnvFilter;

use super::faults::Reading;
use super::source::SourceText;
use super::{
    Config, ConfigError, ConfigErrors, ListenConfig, ReloadOn, TlsConfig, WebConfig, config_schema, shape,
    users,
};

const LAB: &str = include_str!("../../../config/lab.toml");
const TWO_ARMS: &str = include_str!("../../../config/two-arms.toml");
const FLEET: &str = include_str!("../../../config/fleet.toml");
/// What nobody guesses.
const SHORTEST_TOKEN: usize = 16;

const LAB_USERS: &str = include_str!("../../../config/lab-users.toml");

#[derive(Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
struct ConfigDocument {
    listen: Vec<ListenConfig>,
    tls: TlsConfig,
    web: WebConfig,
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
            tls,
            web,
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
            tls,
            web,
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
    /// All that is wrong, with file, line and key.
    pub fn load(path: &Path) -> Result<Config, ConfigErrors> {
        let folder = path.parent().unwrap_or(Path::new("."));
        let mut config = Reading::new(read(path)?, |name| read(&folder.join(name))).finish()?;
        config.store.resolve(folder);
        Ok(config)
    }

    /// The demonstration lab that is built in, with its users; for loopback only, its passwords are public.
    ///
    /// # Panics
    /// Never: a test reads the same files.
    pub fn lab() -> Config {
        built_in("config/lab.toml", LAB)
    }

    /// The lab with two arms that share a table (M40), which is built in as well.
    ///
    /// # Panics
    /// Never: a test reads the same files.
    pub fn two_arms() -> Config {
        built_in("config/two-arms.toml", TWO_ARMS)
    }

    /// A fleet of robots behind a gateway, which is built in as well.
    ///
    /// # Panics
    /// Never: a test reads the same files.
    pub fn fleet() -> Config {
        built_in("config/fleet.toml", FLEET)
    }

    /// Reads what is left of the files.
    ///
    /// # Errors
    /// What is wrong, as far as it was read.
    pub(crate) fn read_once<F>(reading: &mut Reading<F>) -> Result<Config, Vec<ConfigError>>
    where
        F: Fn(&str) -> Result<SourceText, ConfigError>,
    {
        let source = &reading.config;
        let schema = config_schema();
        let faults = shape::faults(&schema, source);
        if !faults.is_empty() {
            return Err(faults);
        }
        let mut file: ConfigDocument = source
            .read()
            .map_err(|error| vec![shape::in_words(&schema, error)])?;
        let mut faults = check(&file, source);
        let folder = Path::new(&source.name).parent().unwrap_or(Path::new("."));
        file.tls.resolve(folder);
        file.audit.resolve(folder);
        file.record.resolve(folder);
        let unread = |keys: &[&str], error: ConfigError| ConfigError {
            busy: error.busy,
            ..source.error(keys, error.to_string())
        };
        if let Some(jwt) = &mut file.login.jwt {
            let text = |name: &str| (reading.beside)(name).map(|file| file.text);
            let read = jwt
                .key
                .read(|name| text(name).map_err(|error| unread(&["login", "jwt", "key"], error)));
            faults.extend(read.err());
        }
        if let Some(token) = &mut file.web.metrics_token {
            let keys = &["web", "metrics-token"];
            let read = token.read(|name| match (reading.beside)(name) {
                Ok(file) if file.text.trim().len() < SHORTEST_TOKEN => {
                    let text = format!("{name}: a token has {SHORTEST_TOKEN} characters at least");
                    Err(source.error(keys, text))
                }
                Ok(file) => Ok(file.text),
                Err(error) => Err(unread(keys, error)),
            });
            faults.extend(read.err());
        }
        if let (Some(name), None) = (&file.users, &reading.users) {
            match (reading.beside)(name) {
                Ok(users) => reading.users = Some(reading.open(users)),
                Err(error) => faults.push(unread(&["users"], error)),
            }
        }
        let users_source = reading.users.clone().filter(|_| file.users.is_some());
        let users = match &users_source {
            Some(users) => users::parse(users, file.login.guests),
            None => Ok(Vec::new()),
        };
        let users = users.unwrap_or_else(|more| {
            faults.extend(more);
            Vec::new()
        });
        let config = file.into_config(users, (reading.config.clone(), users_source));
        faults.extend(config.faults());
        match faults.is_empty() {
            true => Ok(config),
            false => Err(faults),
        }
    }
}

/// A configuration of the demonstration, with its users.
fn built_in(name: &str, text: &str) -> Config {
    let users = SourceText::new("config/lab-users.toml", LAB_USERS);
    let reading = Reading::new(SourceText::new(name, text), |_: &str| Ok(users.clone()));
    reading.finish().expect("what is built in is tested")
}

impl ConfigDocument {
    fn into_config(self, users: Vec<UserEntry>, sources: (SourceText, Option<SourceText>)) -> Config {
        Config {
            listen: self.listen,
            tls: self.tls,
            web: self.web,
            connections: self.connections,
            connections_before_login: self.connections_before_login,
            connections_per_address: self.connections_per_address,
            connections_per_user: self.connections_per_user,
            memory: self.memory,
            log: self.log,
            reload: self.reload,
            limits: self.limits,
            login: self.login,
            store: self.store,
            audit: self.audit,
            record: self.record,
            root: self.root,
            managers: self.managers,
            contexts: self.contexts,
            users,
            source: Some(sources.0),
            users_source: sources.1,
        }
    }
}

fn read(path: &Path) -> Result<SourceText, ConfigError> {
    let name = path.display().to_string();
    match std::fs::read_to_string(path) {
        Ok(text) => Ok(SourceText::new(name, text)),
        Err(error) => Err(ConfigError {
            busy: matches!(error.raw_os_error(), Some(libc::EMFILE | libc::ENFILE)),
            ..ConfigError::of_file(&name, format!("cannot be read: {error}"))
        }),
    }
}

/// Checks what a schema cannot say.
fn check(file: &ConfigDocument, source: &SourceText) -> Vec<ConfigError> {
    let mut found = Vec::new();
    let mut wrong = |keys: &[&str], text: String| found.push(source.error(keys, text));
    if let Err(error) = EnvFilter::try_new(&file.log) {
        let text = format!(
            "{:?} is not a filter, such as info or mom_broker=debug: {error}",
            file.log
        );
        wrong(&["log"], text);
    }
    if file.listen.is_empty() {
        let text = "a broker needs an address to listen at, such as 127.0.0.1:7666";
        wrong(&["listen"], text.to_owned());
    }
    for (index, listen) in file.listen.iter().enumerate() {
        for (key, text) in listen.faults(file.tls.certificate.is_some()) {
            wrong(&["listen", &index.to_string(), key], text);
        }
    }
    if file.tls.certificate.is_some() != file.tls.key.is_some() {
        let text = "TLS needs both certificate and key, each the name of a file in PEM";
        wrong(&["tls"], text.to_owned());
    }
    if file.limits.depth > HARD_DEPTH {
        wrong(
            &["limits", "depth"],
            format!("depth must be a number from 1 to {HARD_DEPTH}"),
        );
    }
    let longest = Limits::default();
    for (value, most, key) in [
        (file.limits.path, longest.path, "path"),
        (file.limits.path_levels, longest.path_levels, "path-levels"),
    ] {
        if value > most {
            wrong(
                &["limits", key],
                format!("{key} is at most {most}: no path is longer"),
            );
        }
    }
    if file.limits.gone <= file.limits.heartbeat {
        let text = "`gone` must exceed `heartbeat`, or idle peers are dropped";
        let named = ["gone", "heartbeat"]
            .into_iter()
            .find(|key| source.has(&["limits", key]));
        wrong(&["limits", named.unwrap_or("gone")], text.to_owned());
    }
    for (key, path) in [("path", &file.store.path), ("state", &file.store.state)] {
        if path.as_ref().is_some_and(|path| path.as_os_str().is_empty()) {
            let text = format!("{key} is a directory such as \"state\", relative to this file");
            wrong(&["store", key], text);
        }
    }
    found
}

/// What the parser says of a text by itself, without the schema.
#[cfg(test)]
pub(crate) fn parser_error(text: &str) -> Option<String> {
    let file: ConfigDocument = match toml::from_str(text) {
        Ok(file) => file,
        Err(error) => return Some(error.message().to_owned()),
    };
    let config = file.into_config(Vec::new(), (SourceText::default(), None));
    config.faults().first().map(|error| error.text.clone())
}
