//! A device of its own beside that of the canary: what is done to its token the canary must not notice.

use std::net::SocketAddr;

use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel, Value};
use mom_tests::canary::fence_of;
use mom_tests::raw::{Raw, at, message};

pub(super) const ARENA: &str = "/arena";
pub(super) const TOKEN: &str = "/arena/token";
pub(super) const ARM: &str = "/arena/arm";

/// Makes the arena: a session that is open to all, a token with these terms, and a channel whose `command` needs it.
pub(super) async fn make(address: SocketAddr, token: Map) -> Raw {
    let mut host = Raw::login(address, Form::Xml, "carol").await;
    let guard = Map::new()
        .with("token", TOKEN)
        .with("names", vec!["command".into()]);
    let level_or_lease = Map::new().with("kind", "level-or-lease");
    let mut token = token.with("kind", "token");
    if token.get("manager").is_none() {
        token.set("manager", level_or_lease);
    }
    create(
        &mut host,
        ARENA,
        Map::new().with("kind", "session").with("manager", "open"),
    )
    .await;
    host.join(&[ARENA]).await;
    create(&mut host, TOKEN, token).await;
    create(
        &mut host,
        ARM,
        Map::new().with("kind", "channel").with("guard", guard),
    )
    .await;
    host
}

pub(super) async fn create(host: &mut Raw, path: &str, spec: Map) {
    let create = Parcel::new(Family::Context, "create")
        .context(at(path))
        .content(spec);
    host.ask(create)
        .await
        .unwrap_or_else(|error| panic!("{path}: {error}"));
}

/// A peer that is where the token is, but not in the channel.
pub(super) async fn enter(address: SocketAddr, form: Form, user: &str) -> Raw {
    let mut peer = Raw::login(address, form, user).await;
    peer.join(&[ARENA]).await;
    peer
}

/// A peer that can drive the robot: commands are sent by members.
pub(super) async fn driver(address: SocketAddr, form: Form, user: &str) -> Raw {
    let mut peer = enter(address, form, user).await;
    peer.join(&[ARM]).await;
    peer
}

/// A peer under a nickname.
pub(super) async fn nicknamed(address: SocketAddr, user: &str, nickname: &str) -> Raw {
    let mut peer = Raw::connect(address, Form::Xml).await;
    let content = Map::new().with("name", user).with("password", user);
    let login = Parcel::new(Family::Login, "login").content(content.with("nickname", nickname));
    peer.ask(login).await.expect("a user of the lab");
    peer.join(&[ARENA]).await;
    peer
}

/// A request about the token.
pub(super) fn about(verb: &str) -> Parcel {
    Parcel::new(Family::Token, verb).context(at(TOKEN))
}

/// Grabs the token; gives its fence.
pub(super) async fn grab(peer: &mut Raw) -> u64 {
    let granted = peer.ask(about("grab")).await;
    fence_of(&granted.unwrap_or_else(|error| panic!("{error}")).value())
}

/// A command for the robot.
pub(super) fn command(text: &str, fence: Option<u64>) -> Parcel {
    let mut command = message("command", ARM, text);
    command.fence = fence;
    command
}

/// The device: it listens, and answers to heartbeats.
pub(super) struct Robot {
    raw: Raw,
}

impl Robot {
    pub(super) async fn enter(address: SocketAddr, form: Form) -> Robot {
        Robot {
            raw: driver(address, form, "camera").await,
        }
    }

    /// What it hears next: `command TEXT FENCE`, `halt`, `stop`, `grabbed OWNER FENCE`, `released OWNER REASON FENCE`.
    pub(super) async fn hears(&mut self) -> String {
        self.hears_or_ends().await.expect("the robot is connected")
    }

    /// The same; none at the end of its link.
    pub(super) async fn hears_or_ends(&mut self) -> Option<String> {
        loop {
            let parcel = self.raw.next().await?;
            let word = |key: &str| match parcel.value().get(key) {
                Some(Value::String(word)) => word.clone(),
                Some(Value::Int(number)) => number.to_string(),
                other => panic!("{key} is {other:?} in {parcel:?}"),
            };
            match (parcel.family, parcel.name()) {
                (Family::Time, "ping") => {
                    let mut pong = Parcel::new(Family::Time, "pong");
                    pong.reference = parcel.id;
                    self.raw.send_parcel(&pong).await;
                }
                (Family::Message, "command") => {
                    let fence = parcel.fence.unwrap_or_default();
                    let Value::String(text) = parcel.value() else {
                        panic!("{parcel:?}");
                    };
                    return Some(format!("command {text} {fence}"));
                }
                (Family::Message, name) => return Some(name.to_owned()),
                (Family::Event, "grabbed") => {
                    return Some(format!("grabbed {} {}", word("owner"), word("fence")));
                }
                (Family::Event, "released") => {
                    let end = format!("{} {} {}", word("owner"), word("reason"), word("fence"));
                    return Some(format!("released {end}"));
                }
                _ => {}
            }
        }
    }

    /// Checks that it hears this next.
    pub(super) async fn expect(&mut self, wanted: &str) {
        assert_eq!(self.hears().await, wanted);
    }

    /// Checks that it hears of nothing else up to now.
    pub(super) async fn expect_nothing(&mut self) {
        let id = self.raw.post(Parcel::new(Family::Time, "ping")).await;
        loop {
            let parcel = self.raw.next().await.expect("the robot is connected");
            if parcel.reference == Some(id) {
                return;
            }
            let news = matches!(parcel.name(), "grabbed" | "released") || parcel.family == Family::Message;
            assert!(!news, "{parcel:?}");
        }
    }
}
