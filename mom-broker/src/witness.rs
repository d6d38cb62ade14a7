//! Stands between the broker and its hub, and writes down what goes in and what comes out.

use std::path::Path;
use std::sync::Arc;

use mom_hub::{Audit, Effect, Hub, Input, PeerId, Route, Settings};
use mom_proto::{Code, Family, Value, Verb, WireError};
use parking_lot::Mutex;

use crate::audit::{AuditLog, Fact};
use crate::broker::BrokerError;
use crate::clock::Clock;
use crate::config::Config;
use crate::record::Recorder;

/// The audit log and the recording of a broker.
#[derive(Debug)]
pub(crate) struct Witness {
    pub(crate) audit: AuditLog,
    recorder: Option<Recorder>,
    clock: Clock,
    /// Which configuration the hub goes by, or is about to.
    origin: Mutex<Origin>,
}

/// The name and the hash of a configuration's file.
#[derive(Clone, Debug)]
struct Origin {
    file: Option<String>,
    hash: Option<String>,
}

impl Origin {
    fn of(config: &Config) -> Origin {
        Origin {
            file: config.file_name(),
            hash: config.text_hash(),
        }
    }

    fn tell(&self, fact: &mut Fact) {
        let keys = [("config", &self.file), ("sha256", &self.hash)];
        let known = keys
            .into_iter()
            .filter_map(|(key, text)| Some((key, text.clone()?)));
        fact.more.extend(known);
    }
}

impl Witness {
    /// Opens what the configuration wishes, for a hub that starts with these settings.
    ///
    /// # Errors
    /// A file that cannot be written: a broker that shall be audited does not run without.
    pub(crate) fn start(config: &Config, settings: &Settings, clock: &Clock) -> Result<Witness, BrokerError> {
        let failed = |what, path: &Option<std::path::PathBuf>| {
            let path = path.as_deref().unwrap_or(Path::new("")).display().to_string();
            move |error| BrokerError::Write { what, path, error }
        };
        let audit = AuditLog::start(&config.audit, clock.clone());
        let recorder = Recorder::start(&config.record, settings, config);
        let witness = Witness {
            audit: audit.map_err(failed("audit log", &config.audit.path))?,
            recorder: recorder.map_err(failed("recording", &config.record.path))?,
            clock: clock.clone(),
            origin: Mutex::new(Origin::of(config)),
        };
        let mut started = Fact::of(clock.wall(), "started");
        started
            .more
            .push(("version", env!("CARGO_PKG_VERSION").to_owned()));
        witness.origin.lock().tell(&mut started);
        witness.audit.note(started);
        Ok(witness)
    }

    /// Says which configuration the next [`Input::Configure`] brings.
    pub(crate) fn configuring(&self, config: &Config) {
        *self.origin.lock() = Origin::of(config);
    }

    /// Gives the hub an input and writes down what it decides.
    pub(crate) fn handle(&self, hub: &mut Hub, input: Input, effects: &mut Vec<Effect>) {
        let now = self.clock.now();
        let peer = match &input {
            Input::Login { peer, .. } | Input::Request { peer, .. } | Input::Gone { peer } => Some(*peer),
            Input::Stored { .. } | Input::Configure(_) | Input::Tick => None,
        };
        if let Input::Login { peer, user, .. } = &input {
            self.audit.is_user(*peer, &user.name);
        }
        let configured = matches!(input, Input::Configure(_)).then(|| self.origin.lock().clone());
        let mut noted = self
            .recorder
            .as_ref()
            .and_then(|recorder| recorder.note(&input, hub));
        hub.handle(now, input, effects);
        if let Some(Origin { file, hash }) = configured.clone() {
            Recorder::name_configuration(&mut noted, file, hash);
        }
        if let (Some(recorder), Some(noted)) = (&self.recorder, noted) {
            recorder.decided(now, noted, effects, hub.deadline());
        }
        let at = self.clock.wall_at(now);
        let complete = |fact: &mut Fact| {
            if let (Some(origin), "configured") = (&configured, fact.audit.what) {
                origin.tell(fact);
            }
        };
        self.audit.take(at, peer, effects, complete);
    }

    /// Notes a message that was refused without the hub.
    pub(crate) fn refused(
        &self,
        (peer, name): (PeerId, Option<Arc<str>>),
        route: &Route,
        message: &Arc<str>,
        error: &WireError,
    ) {
        let word = |key: &str| error.get(key).and_then(Value::as_str).map(Arc::from);
        let facts = route.member(peer).map(|member| &member.facts);
        let verb = Verb::of(Family::Message, message).ok();
        let audit = Audit {
            peer: name,
            // Whoever is no member there is still somebody.
            user: facts
                .map(|facts| Arc::clone(&facts.user))
                .or_else(|| self.audit.user(peer)),
            level: facts.map(|facts| facts.level),
            verb,
            context: Some(route.path.clone()),
            message: (verb == Some(Verb::Send)).then(|| Arc::clone(message)),
            rule: word("rule"),
            code: Some(error.code.clone()),
            by: word("owner"),
            ..Audit::new("refused")
        };
        self.audit.refused(Fact::new(self.clock.wall(), audit));
    }

    /// Notes a login that was refused. `user` is the one that it claimed to be, if there is such a user.
    pub(crate) fn login_refused(
        &self,
        peer: PeerId,
        name: Option<Arc<str>>,
        user: Option<Arc<str>>,
        code: &Code,
    ) {
        // No text: it may quote what was typed. No name but a known one: people type passwords there.
        let audit = Audit {
            peer: name,
            user: Some(user.unwrap_or_else(|| "unknown".into())),
            verb: Some(Verb::Login),
            code: Some(code.clone()),
            ..Audit::new("refused")
        };
        let fact = Fact::new(self.clock.wall(), audit);
        self.audit.login(peer, fact);
    }

    /// The last words, and that they are written.
    pub(crate) async fn stop(&self) {
        self.audit.note(Fact::of(self.clock.wall(), "stopped"));
        self.audit.flush().await;
        if let Some(recorder) = &self.recorder {
            recorder.end().await;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use mom_hub::Configuration;
    use tempfile::TempDir;

    use super::*;

    #[tokio::test]
    async fn another_configuration_is_named() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("lab.toml");
        let text =
            "root = \"open\"\naudit = { path = \"audit.jsonl\" }\nrecord = { path = \"control.jsonl\" }\n";
        fs::write(&path, text).unwrap();
        let config = Config::load(&path).unwrap();
        let settings = Settings::default();
        let mut hub = config.make_hub(settings.clone()).unwrap();
        let clock = Clock::manual(mom_proto::Time::default());
        let witness = Witness::start(&config, &settings, &clock).unwrap();
        fs::write(&path, text.replace("open", "closed")).unwrap();
        let changed = Config::load(&path).unwrap();
        witness.configuring(&changed);
        let configuration = Configuration {
            registry: changed.registry(),
            root: changed.root.clone(),
            contexts: Vec::new(),
            limits: changed.limits.clone(),
            users: Vec::new(),
        };
        let input = Input::Configure(Box::new(configuration));
        witness.handle(&mut hub, input, &mut Vec::new());
        witness.stop().await;
        let hashes = [config.text_hash().unwrap(), changed.text_hash().unwrap()];
        assert_ne!(hashes[0], hashes[1]);
        let audit = fs::read_to_string(folder.path().join("audit.jsonl")).unwrap();
        let lines: Vec<&str> = audit.lines().collect();
        let named = |hash: &String| format!("\"config\":\"lab.toml\",\"sha256\":\"{hash}\"}}");
        for (line, what, hash) in [
            (lines[0], "started", &hashes[0]),
            (lines[1], "configured", &hashes[1]),
        ] {
            assert!(line.contains(what) && line.ends_with(&named(hash)), "{line}");
        }
        let control = fs::read_to_string(folder.path().join("control.jsonl")).unwrap();
        let told = format!("{{\"configure\":[\"lab.toml\",\"{}\"]}}", hashes[1]);
        assert!(control.contains(&told), "{control}");
    }
}
