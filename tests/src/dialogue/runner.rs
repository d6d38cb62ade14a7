//! Runs a dialogue against a broker.

use std::collections::{BTreeMap, BTreeSet};

use mom_broker::{Broker, Clock, Config};
use mom_proto::{Family, Map, Parcel, Path, Time, Value};

use super::carrier::Carrier;
use super::hear::{Expected, Pattern};
use super::notation::Field;
use super::peer::{Heard, Peer};
use super::say::{Request, login_parcel};
use super::script::{Configuration, Connect, Line, Script, Step};
use super::{Error, root, show};
use crate::tls;

/// When every dialogue begins: 2026-11-21T10:00:00Z, in Unix seconds; also the epoch of its fences.
const BEGINNING: u64 = 1_795_255_200;

/// Runs a script from its first line to its last, and to the end of what is heard.
pub(crate) async fn run(script: &Script, carrier: Carrier) -> Result<(), Error> {
    let mut config = load(&script.config)?;
    config.listen = vec!["127.0.0.1:0".into()];
    config.tls = tls::of_hub();
    let clock = Clock::manual(beginning());
    let broker = Broker::start_at(config, clock.clone())
        .await
        .map_err(|error| Error::Broker(error.to_string()))?;
    let mut runner = Runner {
        broker,
        clock,
        carrier,
        peers: BTreeMap::new(),
        linked: 0,
        ignored: BTreeSet::new(),
        transcript: Vec::new(),
    };
    let result = runner.all(&script.steps).await;
    let Runner { broker, peers, .. } = runner;
    drop(peers);
    broker.stop().await;
    result
}

fn beginning() -> Time {
    i64::try_from(BEGINNING * 1_000_000)
        .ok()
        .and_then(Time::from_micros)
        .unwrap_or_default()
}

fn load(configuration: &Configuration) -> Result<Config, Error> {
    let failed = |error: &dyn std::fmt::Display| Error::Broker(error.to_string());
    let text = match configuration {
        Configuration::File(file) => return Config::load(&root().join(file)).map_err(|error| failed(&error)),
        Configuration::Text(text) => text,
    };
    let folder = tempfile::tempdir().map_err(|error| failed(&error))?;
    let path = folder.path().join("dialogue.toml");
    let users = root().join("config/lab-users.toml");
    std::fs::copy(users, folder.path().join("lab-users.toml")).map_err(|error| failed(&error))?;
    let text = format!("users = \"lab-users.toml\"\n{text}");
    std::fs::write(&path, text).map_err(|error| failed(&error))?;
    Config::load(&path).map_err(|error| failed(&error))
}

struct Runner {
    broker: Broker,
    clock: Clock,
    carrier: Carrier,
    peers: BTreeMap<String, Peer>,
    linked: usize,
    ignored: BTreeSet<String>,
    transcript: Vec<String>,
}

impl Runner {
    async fn all(&mut self, steps: &[Line]) -> Result<(), Error> {
        for line in steps {
            let result = self.step(&line.step).await;
            result.map_err(|text| self.otherwise(line.number, line.text.clone(), text))?;
            self.broker.check();
        }
        let last = steps.last().map_or(0, |line| line.number);
        for who in self.peers.keys().cloned().collect::<Vec<_>>() {
            let result = self.end(&who).await;
            result.map_err(|text| self.otherwise(last, format!("{who}, at the end"), text))?;
        }
        Ok(())
    }

    async fn step(&mut self, step: &Step) -> Result<(), String> {
        match step {
            Step::Connect(connect) => self.connect(connect).await,
            Step::Link(names) => {
                for name in names {
                    self.link(name).await?;
                }
                Ok(())
            }
            Step::Joins { who, paths } => self.joins(who, paths).await,
            Step::Ignore(kinds) => {
                self.ignored = kinds.iter().cloned().collect();
                Ok(())
            }
            Step::Clock(by) => {
                self.transcript.push(format!("clock +{by:?}"));
                self.clock.advance(*by);
                Ok(())
            }
            Step::Gone { who } => {
                self.transcript.push(format!("{who} gone"));
                self.peers.remove(who).map(drop).ok_or_else(|| unknown(who))
            }
            Step::Says { who, request } => self.say(who, request).await,
            Step::Hears { who, expected } => match &**expected {
                Expected::Parcel(pattern) => self.hear(who, pattern).await,
                Expected::Nothing => self.nothing(who).await,
                Expected::Closed => self.closed(who).await,
            },
        }
    }

    async fn link(&mut self, name: &str) -> Result<(), String> {
        let link = self.carrier.connect(&self.broker, self.linked).await?;
        self.linked += 1;
        match self.peers.insert(name.to_owned(), Peer::new(link)) {
            None => Ok(()),
            Some(_) => Err(format!("there is a peer {name} already")),
        }
    }

    async fn connect(&mut self, connect: &Connect) -> Result<(), String> {
        for user in &connect.users {
            let name = connect.name.as_ref().unwrap_or(user);
            self.link(name).await?;
            let mut content = Map::new()
                .with("name", user.as_str())
                .with("password", user.as_str());
            if let Some(nickname) = &connect.nickname {
                content.set("nickname", nickname.as_str());
            }
            let parcel = login_parcel(content);
            self.say(
                name,
                &Request {
                    parcel,
                    answered: true,
                },
            )
            .await?;
            let given = Field {
                key: "peer".to_owned(),
                part: false,
                value: Value::from(name.as_str()),
            };
            self.hear(name, &Pattern::ok(vec![given])).await?;
        }
        Ok(())
    }

    async fn joins(&mut self, who: &str, paths: &[String]) -> Result<(), String> {
        for path in paths {
            self.say(who, &Request::parse(&format!("join {path}"))?).await?;
            // Of the joining itself the peer hears as a member; that is not reported here.
            let own = self.ignored.insert("joined".to_owned());
            let result = self.hear(who, &Pattern::ok(Vec::new())).await;
            if own {
                self.ignored.remove("joined");
            }
            result?;
        }
        Ok(())
    }

    async fn say(&mut self, who: &str, request: &Request) -> Result<(), String> {
        self.transcript
            .push(format!("{who}: {}", show_request(&request.parcel)));
        self.peer(who)?.say(request, BEGINNING).await
    }

    async fn hear(&mut self, who: &str, pattern: &Pattern) -> Result<(), String> {
        loop {
            let parcel = match self.peer(who)?.hear().await? {
                Heard::Parcel(parcel) => parcel,
                Heard::Closed => return Err(format!("the link of {who} was closed")),
            };
            let heard = format!("{who}< {}", show::parcel(&parcel));
            let unlike = pattern.matches(&parcel);
            if unlike.is_err() && self.is_ignored(&parcel) {
                continue;
            }
            self.transcript.push(heard.clone());
            unlike.map_err(|why| format!("heard instead: {heard}\n{why}"))?;
            return self.peer(who)?.settle(&parcel);
        }
    }

    fn is_ignored(&self, parcel: &Parcel) -> bool {
        parcel.family == Family::Event && self.ignored.contains(parcel.name())
    }

    /// Two round trips, because what waited beside the first answer has left before the second.
    async fn nothing(&mut self, who: &str) -> Result<(), String> {
        for _ in 0..2 {
            let parcel = Parcel::new(Family::Time, "ping").context(Path::root());
            self.peer(who)?
                .say(
                    &Request {
                        parcel,
                        answered: true,
                    },
                    BEGINNING,
                )
                .await?;
            self.hear(who, &Pattern::pong()).await?;
            self.transcript.pop();
        }
        Ok(())
    }

    async fn closed(&mut self, who: &str) -> Result<(), String> {
        match self.peer(who)?.hear().await? {
            Heard::Closed => {
                self.transcript.push(format!("{who}< closed"));
                self.peers.remove(who);
                Ok(())
            }
            Heard::Parcel(parcel) => Err(format!("heard instead: {who}< {}", show::parcel(&parcel))),
        }
    }

    async fn end(&mut self, who: &str) -> Result<(), String> {
        self.nothing(who).await?;
        self.peer(who)?.all_answered()
    }

    fn peer(&mut self, who: &str) -> Result<&mut Peer, String> {
        self.peers.get_mut(who).ok_or_else(|| unknown(who))
    }

    fn otherwise(&self, line: usize, said: String, text: String) -> Error {
        let transcript = self
            .transcript
            .iter()
            .map(|line| format!("    {line}\n"))
            .collect();
        Error::Otherwise {
            line,
            said,
            text,
            transcript,
        }
    }
}

fn unknown(who: &str) -> String {
    format!("there is no peer {who}: connect {who}")
}

fn show_request(parcel: &Parcel) -> String {
    let path = parcel.context.as_ref().map(Path::as_str).unwrap_or_default();
    let content = match parcel.value() {
        Value::Null => String::new(),
        content => show::value(&content),
    };
    let family = parcel.family;
    format!("{family} {} {path} {content}", parcel.name())
        .trim_end()
        .to_owned()
}
