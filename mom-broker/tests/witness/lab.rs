//! A small lab with two drivers, and peers that talk to it over real sockets.

use std::fs;
use std::path::{Path as FilePath, PathBuf};
use std::sync::OnceLock;
use std::time::Duration;

use mom_broker::{Broker, Clock, Config, hash};
use mom_net::{Address, Transceiver};
use mom_proto::codec::Frame;
use mom_proto::{Family, Limits, Map, Parcel, Path, Value, Verb};
use serde_json::Value as Json;
use tempfile::TempDir;

/// How long anything may take before a test gives up.
const PATIENCE: Duration = Duration::from_secs(60);

/// Who may do what; the first rule is what the tests change.
pub(crate) const RULES: &str = r#"
[[managers.lab.rules]]
name = "alice drives"
users = ["alice"]
allow = ["grab", "renew"]

[[managers.lab.rules]]
name = "carol may all"
groups = ["boss"]
allow = ["*"]

[[managers.lab.rules]]
name = "nobody shouts"
messages = ["shout"]
deny = ["send"]

[[managers.lab.rules]]
name = "all look and talk"
allow = ["join", "lookup", "list", "info", "members", "send", "stop"]
"#;

const CONTEXTS: &str = r#"
[managers.drive]
kind = "chain"
of = ["lab", { kind = "level-or-lease", lease = 180000 }]

[[contexts]]
path = "/chat"
kind = "channel"

[[contexts]]
path = "/robot"
kind = "session"

[[contexts]]
path = "/robot/token"
kind = "token"
manager = "drive"

[[contexts]]
path = "/robot/door"
kind = "token"
manager = { kind = "chain", of = ["lab", { kind = "moderated", chairs = { groups = ["boss"] }, within = 60000 }] }

[[contexts]]
path = "/robot/arm"
kind = "channel"
guard = { token = "/robot/token", names = ["command"] }
"#;

/// A folder with a configuration in it.
pub(crate) struct Lab {
    folder: TempDir,
}

impl Lab {
    /// The lab with these lines before everything else.
    pub(crate) fn new(first: &str) -> Lab {
        Lab::with(first, RULES)
    }

    /// The same with these rules.
    pub(crate) fn with(first: &str, rules: &str) -> Lab {
        let lab = Lab {
            folder: TempDir::new().expect("a folder"),
        };
        lab.write("lab.toml", &format!("{first}\n{}", Lab::body(rules)));
        let user = |(name, level, groups): (&str, i32, &str)| {
            let hash = password_hash();
            format!(
                "[[users]]\nname = \"{name}\"\npassword = \"{hash}\"\nlevel = {level}\ngroups = [{groups}]\n"
            )
        };
        let users = [("alice", 1, ""), ("bob", 1, ""), ("carol", 5, "\"boss\"")];
        lab.write("users.toml", &users.map(user).concat());
        lab
    }

    /// The configuration with these rules, without its first lines.
    pub(crate) fn body(rules: &str) -> String {
        let head = "root = \"lab\"\nusers = \"users.toml\"\nlisten = [\"127.0.0.1:0\"]\n";
        format!("{head}[managers.lab]\nkind = \"roles\"\n{rules}{CONTEXTS}")
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn write(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).expect("written");
    }

    pub(crate) fn read(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).expect("readable")
    }

    /// The lines of a file as JSON.
    pub(crate) fn lines(&self, name: &str) -> Vec<Json> {
        let text = self.read(name);
        text.lines()
            .map(|line| serde_json::from_str(line).expect("JSON"))
            .collect()
    }

    pub(crate) fn config(&self) -> Config {
        Config::load(&self.path("lab.toml")).expect("right")
    }

    /// A broker of the lab by a clock that stands, at ten o'clock.
    pub(crate) async fn start(&self) -> (Broker, Clock) {
        let clock = Clock::manual("2026-11-21T10:00:00Z".parse().expect("a time"));
        let broker = Broker::start_at(self.config(), clock.clone()).await;
        (broker.expect("it starts"), clock)
    }

    pub(crate) fn folder(&self) -> &FilePath {
        self.folder.path()
    }
}

/// The password of all users.
pub(crate) const PASSWORD: &str = "correct-horse-Zq7";

fn password_hash() -> &'static str {
    static HASH: OnceLock<String> = OnceLock::new();
    HASH.get_or_init(|| hash(PASSWORD).expect("hashed"))
}

/// A peer that says one thing after another.
pub(crate) struct Peer {
    link: Transceiver,
    last: u64,
}

impl Peer {
    /// A peer in XML that has logged in.
    pub(crate) async fn xml(broker: &Broker, user: &str) -> Peer {
        let mut peer = Peer::connect(broker, "tcp").await;
        peer.login(user, PASSWORD).await;
        peer
    }

    /// A peer in binary that has logged in.
    pub(crate) async fn binary(broker: &Broker, user: &str) -> Peer {
        let mut peer = Peer::connect(broker, "bin").await;
        peer.login(user, PASSWORD).await;
        peer
    }

    pub(crate) async fn connect(broker: &Broker, scheme: &str) -> Peer {
        Peer::at(&broker.local_addr().to_string(), scheme).await
    }

    /// A peer of a broker that listens there.
    pub(crate) async fn at(address: &str, scheme: &str) -> Peer {
        let address: Address = format!("{scheme}://{address}").parse().expect("an address");
        let link = mom_net::connect(&address, &Limits::default(), None)
            .await
            .expect("it listens");
        Peer { link, last: 0 }
    }

    pub(crate) async fn login(&mut self, user: &str, password: impl Into<Value>) -> Parcel {
        let content = Map::new().with("name", user).with("password", password.into());
        self.ask(Parcel::new(Family::Login, "login").content(content))
            .await
    }

    /// Sends a request and gives its answer.
    pub(crate) async fn ask(&mut self, parcel: Parcel) -> Parcel {
        let id = self.say(parcel).await;
        self.answer_to(id).await
    }

    /// Sends a parcel without waiting for anything; gives its id.
    pub(crate) async fn say(&mut self, parcel: Parcel) -> u64 {
        self.last += 1;
        self.link
            .writer
            .send(parcel.id(self.last))
            .await
            .expect("it hears");
        self.last
    }

    /// The answer to the request with this id, however many events come before it.
    pub(crate) async fn answer_to(&mut self, id: u64) -> Parcel {
        self.hear(|parcel| {
            matches!(parcel.family, Family::Reply | Family::Error) && parcel.reference == Some(id)
        })
        .await
    }

    /// The next event of this name.
    pub(crate) async fn event(&mut self, name: &str) -> Parcel {
        self.hear(|parcel| parcel.is(Family::Event, name)).await
    }

    /// The next question, answered with yes; the word of the answer to that.
    pub(crate) async fn approve(&mut self) -> String {
        let asked = self.hear(|parcel| parcel.is(Family::Manager, "consult")).await;
        let number = asked.id.and_then(|id| i64::try_from(id).ok()).expect("a number");
        let verdict = Map::new().with("consult", number).with("allow", true);
        self.verb_with(Verb::Verdict, "/", verdict).await
    }

    async fn hear(&mut self, wanted: impl Fn(&Parcel) -> bool) -> Parcel {
        loop {
            let frame = tokio::time::timeout(PATIENCE, self.link.reader.next()).await;
            match frame.expect("in time").expect("a link") {
                Some(Frame::Parcel(parcel)) if wanted(&parcel) => return *parcel,
                Some(_) => {}
                None => panic!("the link ended"),
            }
        }
    }

    /// Asks for a verb at a path; the word of the answer.
    pub(crate) async fn verb(&mut self, verb: Verb, path: &str) -> String {
        self.verb_with(verb, path, Map::new()).await
    }

    pub(crate) async fn verb_with(&mut self, verb: Verb, path: &str, content: Map) -> String {
        let parcel = Parcel::new(verb.family(), verb.word()).context(at(path));
        let parcel = match content.is_empty() {
            true => parcel,
            false => parcel.content(content),
        };
        self.ask(parcel).await.name().to_owned()
    }

    /// Sends a message and waits until it has arrived; the word of the answer.
    pub(crate) async fn message(&mut self, name: &str, path: &str, content: &str) -> String {
        let mut parcel = Parcel::new(Family::Message, name)
            .context(at(path))
            .content(content);
        parcel.receipt = Some(true);
        self.ask(parcel).await.name().to_owned()
    }
}

pub(crate) fn at(path: &str) -> Path {
    Path::parse(path).expect("a path")
}
