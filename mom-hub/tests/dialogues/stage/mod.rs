//! A small stage for table tests: peers say lines, and what each hears comes back as lines.
//!
//! `say("alice", "token grab /lab/key wait=1000")` gives `["alice< queued place=1"]`. Of what is heard only what tells
//! the tale is shown: the word, and some of the content. Fences are shown without their epoch.

use std::collections::BTreeMap;

use mom_hub::{
    Configuration, ContextSpec, Effect, Hub, Input, PeerId, Receivers, Record, Settings, StopRecord, Ticket,
    User,
};
use mom_managers::Registry;
use mom_proto::{Family, Map, Parcel, Path, STOP, Value, from_value};

/// The epoch of the fences, unless said otherwise.
pub(crate) const EPOCH: u64 = 1;

/// µs in a ms.
pub(crate) const MS: u64 = 1000;

/// Content that is shown, in this order.
const SHOWN: [&str; 12] = [
    "what", "owner", "peer", "by", "to", "from", "reason", "place", "allow", "fence", "commands", "rule",
];

/// A hub, its peers and its store.
pub(crate) struct Stage {
    pub(crate) hub: Hub,
    pub(crate) now: u64,
    id: u64,
    peers: BTreeMap<String, PeerId>,
    last_peer: u64,
    /// What was given to the store, and is not answered if it is awaited.
    pub(crate) stored: Vec<(Record, Option<Ticket>)>,
    /// What is to be kept of stops, in the same way.
    pub(crate) kept: Vec<(StopRecord, Option<Ticket>)>,
    pub(crate) effects: Vec<Effect>,
}

/// A context, as the configuration has it.
pub(crate) fn context(path: &str, kind: &str) -> Map {
    Map::new().with("path", path).with("kind", kind)
}

/// A session `/lab` with a token `/lab/key` and a channel `/lab/arm` whose commands it guards.
pub(crate) fn lab(token: Map) -> Vec<Map> {
    let guard = Map::new()
        .with("token", "/lab/key")
        .with("names", vec!["command".into()]);
    let mut key = context("/lab/key", "token");
    for (name, value) in token {
        key.set(&name, value);
    }
    vec![
        context("/lab", "session").with("presence", "none"),
        key,
        context("/lab/arm", "channel")
            .with("guard", guard)
            .with("devices", "several")
            .with("presence", "none"),
    ]
}

/// A manager of the papers' kind for the token.
pub(crate) fn level_or_lease(lease: i64, expiry: &str) -> Map {
    let manager = Map::new()
        .with("kind", "level-or-lease")
        .with("lease", lease)
        .with("expiry", expiry);
    Map::new().with("manager", manager)
}

pub(crate) fn user(name: &str, level: i32) -> User {
    User {
        name: name.to_owned(),
        level,
        groups: Vec::new(),
        details: Map::new(),
    }
}

fn specs(contexts: Vec<Map>) -> Vec<ContextSpec> {
    let specs = contexts.into_iter();
    specs
        .map(|spec| from_value(spec.into()).expect("a context"))
        .collect()
}

impl Stage {
    pub(crate) fn new(contexts: Vec<Map>) -> Stage {
        Stage::with(contexts, Registry::builtin(), Settings::default())
    }

    /// A stage whose changes of owner wait for [`Stage::stored`].
    pub(crate) fn durable(contexts: Vec<Map>) -> Stage {
        let settings = Settings {
            durable: true,
            ..Settings::default()
        };
        Stage::with(contexts, Registry::builtin(), settings)
    }

    pub(crate) fn with(contexts: Vec<Map>, registry: Registry, settings: Settings) -> Stage {
        let settings = Settings {
            epoch: settings.epoch.max(EPOCH),
            ..settings
        };
        let hub = Hub::new(settings, registry, &"open".into(), &specs(contexts)).expect("a hub");
        Stage {
            hub,
            now: 0,
            id: 0,
            peers: BTreeMap::new(),
            last_peer: 0,
            stored: Vec::new(),
            kept: Vec::new(),
            effects: Vec::new(),
        }
    }

    /// A peer comes, and goes to the lab and its arm as far as they are there.
    pub(crate) fn enter(&mut self, name: &str, level: i32) {
        self.arrive(name, level);
        self.say(name, "context join /lab");
        self.say(name, "context join /lab/arm");
    }

    /// A user logs in, on a new connection.
    pub(crate) fn arrive(&mut self, name: &str, level: i32) {
        self.last_peer += 1;
        self.login(PeerId(self.last_peer), user(name, level));
    }

    /// One more program of a user, by a name of its own.
    pub(crate) fn enter_for(&mut self, of: &str, nickname: &str) {
        self.last_peer += 1;
        self.id += 1;
        let peer = PeerId(self.last_peer);
        self.peers.insert(nickname.to_owned(), peer);
        self.give(Input::Login {
            peer,
            user: user(of, 1),
            nickname: Some(nickname.to_owned()),
            id: Some(self.id),
        });
        self.say(nickname, "context join /lab");
    }

    /// A login on a connection, which may be another user's so far.
    pub(crate) fn login(&mut self, peer: PeerId, user: User) -> Vec<String> {
        self.id += 1;
        let name = user.name.clone();
        let (nickname, id) = (None, Some(self.id));
        let login = Input::Login {
            peer,
            user,
            nickname,
            id,
        };
        self.peers.retain(|_, known| *known != peer);
        self.peers.insert(name, peer);
        self.last_peer = self.last_peer.max(peer.0);
        self.give(login)
    }

    pub(crate) fn peer(&self, name: &str) -> PeerId {
        self.peers[name]
    }

    /// A peer says a line: family, name, path, and `key=value` of its content, or `@fence=…`, `@stop=…`, `@to=…` of the
    /// parcel; `number=…` is the key `stop` with an epoch.
    pub(crate) fn say(&mut self, name: &str, line: &str) -> Vec<String> {
        let input = self.request(name, line);
        self.give(input)
    }

    /// The same with one value more in its content.
    pub(crate) fn say_with(&mut self, name: &str, line: &str, key: &str, value: Value) -> Vec<String> {
        let Input::Request {
            peer,
            mut parcel,
            clock,
        } = self.request(name, line)
        else {
            unreachable!("a line is a request")
        };
        let mut content = parcel.value().as_map().cloned().unwrap_or_default();
        content.set(key, value);
        *parcel = parcel.content(content);
        self.give(Input::Request { peer, parcel, clock })
    }

    /// What [`Stage::say`] would give the hub.
    pub(crate) fn request(&mut self, name: &str, line: &str) -> Input {
        self.id += 1;
        let mut words = line.split(' ');
        let mut word = || words.next().expect("family, name, path");
        let family = Family::from_word(word()).expect("a family");
        let (verb, path) = (word(), word());
        let mut parcel = Parcel::new(family, verb)
            .context(Path::parse(path).expect("a path"))
            .id(self.id);
        let mut content = Map::new();
        for pair in words {
            let (key, value) = pair.split_once('=').expect("key=value");
            let value = match value {
                "true" | "false" => Value::from(value == "true"),
                _ => value
                    .parse::<i64>()
                    .map_or_else(|_| Value::from(value), Value::from),
            };
            match key {
                "@fence" => {
                    let number = value.as_int().and_then(|number| u64::try_from(number).ok());
                    parcel.fence = number.map(|number| (EPOCH << 20) + number);
                }
                "@stop" => {
                    let number = value.as_int().map(|number| (EPOCH.cast_signed() << 20) + number);
                    parcel.extra.set(STOP, number.expect("a number"));
                }
                "@to" => {
                    let names = value.as_str().expect("names").split(',');
                    parcel.address = Some(names.map(Into::into).collect());
                }
                "number" => {
                    let number = value.as_int().expect("a number");
                    content.set(STOP, (EPOCH.cast_signed() << 20) + number);
                }
                key => content.set(key, value),
            }
        }
        if !content.is_empty() {
            parcel = parcel.content(content);
        }
        let peer = self.peers[name];
        Input::Request {
            peer,
            parcel: Box::new(parcel),
            clock: None,
        }
    }

    pub(crate) fn gone(&mut self, name: &str) -> Vec<String> {
        let peer = self.peers[name];
        let heard = self.give(Input::Gone { peer });
        self.peers.remove(name);
        heard
    }

    /// A peer loses its connection, and may come back for so many ms.
    pub(crate) fn lost(&mut self, name: &str, grace: u64) -> Vec<String> {
        let peer = self.peers[name];
        let grace = grace * MS;
        self.give(Input::Lost { peer, grace })
    }

    pub(crate) fn resumed(&mut self, name: &str) -> Vec<String> {
        let peer = self.peers[name];
        self.give(Input::Resumed { peer })
    }

    /// Time goes on to this many ms.
    pub(crate) fn at(&mut self, ms: u64) -> Vec<String> {
        self.at_micros(ms * MS)
    }

    pub(crate) fn at_micros(&mut self, micros: u64) -> Vec<String> {
        self.now = micros;
        self.give(Input::Tick)
    }

    pub(crate) fn configure(
        &mut self,
        contexts: Vec<Map>,
        users: Vec<(PeerId, Option<User>)>,
    ) -> Vec<String> {
        self.configure_with(Registry::builtin(), contexts, users)
    }

    pub(crate) fn configure_with(
        &mut self,
        registry: Registry,
        contexts: Vec<Map>,
        users: Vec<(PeerId, Option<User>)>,
    ) -> Vec<String> {
        self.give(Input::Configure(Box::new(Configuration {
            registry,
            root: "open".into(),
            contexts: specs(contexts),
            limits: mom_proto::Limits::default(),
            users,
        })))
    }

    /// The store answers the oldest awaited record.
    pub(crate) fn answer(&mut self, ok: bool) -> Vec<String> {
        let awaited = self.stored.iter_mut().find_map(|(_, ticket)| ticket.take());
        let ticket = awaited.expect("something is being stored");
        self.give(Input::Stored { ticket, ok })
    }

    /// The oldest awaited record of stops is kept, or will never be.
    pub(crate) fn answer_kept(&mut self, ok: bool) -> Vec<String> {
        let awaited = self.kept.iter_mut().find_map(|(_, ticket)| ticket.take());
        let ticket = awaited.expect("something is being kept");
        self.give(Input::Stored { ticket, ok })
    }

    /// Gives the hub an input; what is heard.
    pub(crate) fn give(&mut self, input: Input) -> Vec<String> {
        let mut effects = Vec::new();
        self.hub.handle(self.now, input, &mut effects);
        self.hub.check();
        let mut heard = Vec::new();
        for effect in &effects {
            match effect {
                Effect::Deliver { to, parcel } => {
                    heard.extend(to.iter().map(|to| self.line(*to, parcel)));
                }
                Effect::Reply { to, parcel } => heard.push(self.line(*to, parcel)),
                Effect::Send {
                    parcel,
                    receivers,
                    route,
                    ..
                } => {
                    let places: Vec<usize> = match receivers {
                        Receivers::All => (0..route.members.len()).collect(),
                        Receivers::AllBut(own) => (0..route.members.len()).filter(|at| at != own).collect(),
                        Receivers::These(places) => places.clone(),
                    };
                    let peers = places.into_iter().map(|place| route.members[place].peer);
                    heard.extend(peers.map(|peer| self.line(peer, parcel)));
                }
                Effect::Store { record, ticket } => self.stored.push((record.clone(), *ticket)),
                Effect::Keep { record, ticket } => self.kept.push((record.clone(), *ticket)),
                Effect::Close { peer, .. } => heard.push(format!("{} closed", self.name(*peer))),
                _ => {}
            }
        }
        self.effects = effects;
        heard
    }

    /// What the last input leaves in the audit log, a line for each fact; fences without their epoch.
    pub(crate) fn facts(&self) -> Vec<String> {
        let facts = self.effects.iter().filter_map(|effect| match effect {
            Effect::Audit(fact) => Some(fact.to_map()),
            _ => None,
        });
        let pair = |(key, value): (&str, &Value)| match value {
            Value::Int(number) if ["fence", "stop"].contains(&key) => {
                format!("{key}={}", number & ((1 << 20) - 1))
            }
            Value::Int(number) => format!("{key}={number}"),
            Value::String(text) => format!("{key}={text}"),
            other => format!("{key}={other:?}"),
        };
        facts
            .map(|fact| fact.iter().map(pair).collect::<Vec<_>>().join(" "))
            .collect()
    }

    fn name(&self, peer: PeerId) -> &str {
        let known = self.peers.iter().find(|(_, known)| **known == peer);
        known.map_or("somebody", |(name, _)| name)
    }

    fn line(&self, to: PeerId, parcel: &Parcel) -> String {
        let mut line = format!("{}< {}", self.name(to), parcel.name());
        let content = parcel.value();
        if parcel.family == Family::Message {
            line += &format!(" of {}", parcel.sender.as_deref().unwrap_or_default());
        }
        if let Some(Value::Int(stop)) = parcel.extra.get(STOP) {
            line += &format!(" stop={}", stop & ((1 << 20) - 1));
        }
        let fence = parcel.fence.map(|fence| fence.cast_signed());
        for key in SHOWN {
            let value = match (key, content.get(key)) {
                ("fence", None) => fence.map(Value::from),
                // The owner in a refusal says the same as its rule, and less.
                ("owner" | "place", Some(_)) if parcel.family == Family::Error => None,
                (_, value) => value.cloned(),
            };
            match value {
                None => {}
                Some(Value::Int(fence)) if key == "fence" => {
                    line += &format!(" fence={}", fence & ((1 << 20) - 1));
                }
                Some(Value::Int(number)) => line += &format!(" {key}={number}"),
                Some(Value::String(text)) => line += &format!(" {key}={text}"),
                Some(other) => line += &format!(" {key}={other:?}"),
            }
        }
        line
    }
}

/// Only what these hear.
pub(crate) fn of(lines: &[String], names: &[&str]) -> Vec<String> {
    let mine = |line: &&String| names.iter().any(|name| line.starts_with(&format!("{name}<")));
    lines.iter().filter(mine).cloned().collect()
}
