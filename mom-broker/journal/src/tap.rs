//! The tap between the broker and its hub: writes inputs and effects to the audit log and the recording.

use std::sync::Arc;

use mom_hub::{Audit, Effect, Hub, Input, PeerId, Route, Settings};
use mom_proto::{Code, Family, Value, Verb, WireError};
use mom_system::Clock;
use parking_lot::Mutex;

use crate::audit::{AuditConfig, AuditLog, Fact};
use crate::record::{RecordConfig, Recorder};
use crate::{ConfigFile, FoldedLines, WriteError};

/// The audit log and the recording of a broker, and what of its log is counted.
#[derive(Debug)]
pub struct Tap {
    /// The audit log, for facts that the hub does not know.
    pub audit: AuditLog,
    /// What is counted in the log instead of written line by line.
    pub lines: FoldedLines,
    recorder: Option<Recorder>,
    clock: Clock,
    /// The hub's configuration, or the one about to be applied.
    config: Mutex<ConfigFile>,
}

impl Tap {
    /// Opens what is configured, for a hub that starts with these settings.
    ///
    /// # Errors
    /// A file that cannot be written: a broker with an audit log does not run without it.
    pub fn start(
        (audit, record): (&AuditConfig, &RecordConfig),
        config: ConfigFile,
        settings: &Settings,
        clock: &Clock,
    ) -> Result<Tap, WriteError> {
        let log = AuditLog::start(audit, clock.clone());
        let recorder = Recorder::start(record, settings, &config);
        let tap = Tap {
            audit: log.map_err(WriteError::of("audit log", audit.path.as_deref()))?,
            lines: FoldedLines::default(),
            recorder: recorder.map_err(WriteError::of("recording", record.path.as_deref()))?,
            clock: clock.clone(),
            config: Mutex::new(config),
        };
        let mut started = Fact::of(clock.civil(), "started");
        started
            .more
            .push(("version", env!("CARGO_PKG_VERSION").to_owned()));
        name_config(&mut started, &tap.config.lock());
        tap.audit.note(started);
        Ok(tap)
    }

    /// Says which configuration the next [`Input::Configure`] brings.
    pub fn configuring(&self, config: ConfigFile) {
        *self.config.lock() = config;
    }

    /// Gives the hub an input and writes down its decision.
    pub fn handle(&self, hub: &mut Hub, input: Input, effects: &mut Vec<Effect>) {
        let now = self.clock.now();
        let peer = match &input {
            Input::Login { peer, .. }
            | Input::Request { peer, .. }
            | Input::Gone { peer }
            | Input::Lost { peer, .. }
            | Input::Resumed { peer } => Some(*peer),
            Input::Stored { .. } | Input::Configure(_) | Input::Tick | Input::Wall { .. } => None,
        };
        if let Input::Login { peer, user, .. } = &input {
            self.audit.is_user(*peer, &user.name);
        }
        let configured = matches!(input, Input::Configure(_)).then(|| self.config.lock().clone());
        let mut noted = self
            .recorder
            .as_ref()
            .and_then(|recorder| recorder.note(&input, hub));
        hub.handle(now, input, effects);
        if let Some(config) = &configured {
            Recorder::name_configuration(&mut noted, config);
        }
        if let (Some(recorder), Some(noted)) = (&self.recorder, noted) {
            recorder.decided(now, noted, effects, hub.deadline());
        }
        let at = self.clock.civil();
        let complete = |fact: &mut Fact| {
            if let (Some(config), "configured") = (&configured, fact.audit.what) {
                name_config(fact, config);
            }
        };
        self.audit.take(at, peer, effects, complete);
    }

    /// Notes a message that was refused without the hub.
    pub fn refused(
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
            // A peer that is not a member there still has a name.
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
        self.audit.refused(Fact::new(self.clock.civil(), audit));
    }

    /// Notes a refused login. `user` is the claimed user, if there is one of that name.
    pub fn login_refused(&self, peer: PeerId, name: Option<Arc<str>>, user: Option<Arc<str>>, code: &Code) {
        // No text, because it may quote what was typed, and only known names, because people type passwords there.
        let audit = Audit {
            peer: name,
            user: Some(user.unwrap_or_else(|| "unknown".into())),
            verb: Some(Verb::Login),
            code: Some(code.clone()),
            ..Audit::new("refused")
        };
        let fact = Fact::new(self.clock.civil(), audit);
        self.audit.login(peer, fact);
    }

    /// Notes that a connection has asked for the link of a peer, or of nobody, and could not prove its secret.
    pub fn resume_refused(&self, by: PeerId, name: Option<Arc<str>>, user: Option<Arc<str>>) {
        let audit = Audit {
            peer: name,
            user: Some(user.unwrap_or_else(|| "unknown".into())),
            verb: Some(Verb::Resume),
            code: Some(Code::NOT_RESUMED),
            ..Audit::new("refused")
        };
        let fact = Fact::new(self.clock.civil(), audit);
        self.audit.login(by, fact);
    }

    /// The recording, with all that was noted so far; none if nothing is recorded.
    pub async fn recording(&self) -> Option<&std::path::Path> {
        match &self.recorder {
            Some(recorder) => Some(recorder.written().await),
            None => None,
        }
    }

    /// Whether there is a recording.
    pub fn records(&self) -> bool {
        self.recorder.is_some()
    }

    /// Writes `stopped` and waits until all is written.
    pub async fn stop(&self) {
        self.lines.report(self.clock.now(), true);
        self.audit.note(Fact::of(self.clock.civil(), "stopped"));
        self.audit.flush().await;
        if let Some(recorder) = &self.recorder {
            recorder.end().await;
        }
    }
}

/// Adds the configuration to a fact.
fn name_config(fact: &mut Fact, config: &ConfigFile) {
    let keys = [("config", &config.name), ("sha256", &config.sha256)];
    let known = keys
        .into_iter()
        .filter_map(|(key, text)| Some((key, text.clone()?)));
    fact.more.extend(known);
}

#[cfg(test)]
mod tests {
    use std::fs;

    use mom_hub::Configuration;
    use mom_managers::Registry;
    use mom_proto::Limits;
    use tempfile::TempDir;

    use super::*;

    #[tokio::test]
    async fn another_configuration_is_named() {
        let folder = TempDir::new().unwrap();
        let path = |name: &str| Some(folder.path().join(name));
        let audit = AuditConfig {
            path: path("audit.jsonl"),
            ..AuditConfig::default()
        };
        let record = RecordConfig {
            path: path("control.jsonl"),
            ..RecordConfig::default()
        };
        let file = |sha256: &str| ConfigFile {
            name: Some("lab.toml".to_owned()),
            sha256: Some(sha256.to_owned()),
        };
        let settings = Settings::default();
        let mut hub = Hub::new(settings.clone(), Registry::builtin(), &"open".into(), &[]).unwrap();
        let clock = Clock::manual(mom_proto::Time::default());
        let tap = Tap::start((&audit, &record), file("01"), &settings, &clock).unwrap();
        tap.configuring(file("02"));
        let configuration = Configuration {
            registry: Registry::builtin(),
            root: "closed".into(),
            contexts: Vec::new(),
            limits: Limits::default(),
            users: Vec::new(),
        };
        let input = Input::Configure(Box::new(configuration));
        tap.handle(&mut hub, input, &mut Vec::new());
        tap.stop().await;
        let audit = fs::read_to_string(folder.path().join("audit.jsonl")).unwrap();
        let lines: Vec<&str> = audit.lines().collect();
        let named = |hash: &str| format!("\"config\":\"lab.toml\",\"sha256\":\"{hash}\"}}");
        for (line, what, hash) in [(lines[0], "started", "01"), (lines[1], "configured", "02")] {
            assert!(line.contains(what) && line.ends_with(&named(hash)), "{line}");
        }
        let control = fs::read_to_string(folder.path().join("control.jsonl")).unwrap();
        let told = "{\"configure\":[\"lab.toml\",\"02\"]}";
        assert!(control.contains(told), "{control}");
    }
}
