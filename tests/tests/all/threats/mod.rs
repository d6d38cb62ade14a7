//! Ways to hurt a hub, over real sockets, with a canary beside that must not notice.

mod arena;
mod doors;
mod flood;
mod framing;
mod identity;
mod leases;
mod lines;
mod load;
mod login;
mod look_alikes;
mod managing;
mod markup;
mod mime;
mod names;
mod owner_lost;
mod restart;
mod revocation;
mod secrets;
mod storm;
mod tokens;
mod wall_clock;

use std::io::Write as _;
use std::net::SocketAddr;

use bytes::Bytes;
use mom_broker::{Broker, Clock, Config};
use mom_proto::codec::Form;
use mom_proto::{Content, Family, Parcel, Value, WireError};
use mom_tests::audit::{AuditLog, Lines};
use mom_tests::bridge::Way;
use mom_tests::canary::Canary;
use mom_tests::raw::{Raw, at, message};
use mom_tests::{lab, tls};

/// The channel at which attacks aim; the witness listens there.
const CHAT: &str = "/chat";

/// A broker with its canary, and a witness in the channel at which attacks aim.
struct World {
    broker: Broker,
    canary: Canary,
    witness: Raw,
    attacks: u64,
    audit: AuditLog,
    /// Where attackers come in by another way than TCP alone, by their forms.
    entrances: Vec<(Form, SocketAddr)>,
    told: Told,
}

/// By which way attackers came, said when a test fails.
#[derive(Default)]
struct Told(Option<String>);

impl Drop for Told {
    fn drop(&mut self) {
        if let Some(way) = self.0.take()
            && std::thread::panicking()
        {
            let _ = writeln!(std::io::stderr(), "attackers came by {way}");
        }
    }
}

/// What becomes of the attacker's connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum After {
    Kept,
    Closed,
}

impl World {
    async fn start() -> World {
        World::start_with(|_| {}).await
    }

    async fn start_with(change: impl FnOnce(&mut Config)) -> World {
        World::start_at(Clock::system(), change).await
    }

    /// With a clock of the test's own.
    async fn start_at(clock: Clock, change: impl FnOnce(&mut Config)) -> World {
        let audit = AuditLog::new();
        let broker = lab::start_at(clock, |config| {
            config.audit.path = Some(audit.path());
            change(config);
        })
        .await;
        let address = broker.local_addr();
        let mut canary = Canary::start(address).await;
        canary.check().await;
        let mut witness = Raw::login(address, Form::Xml, "carol").await;
        witness.join(&[CHAT]).await;
        World {
            broker,
            canary,
            witness,
            attacks: 0,
            audit,
            entrances: Vec::new(),
            told: Told::default(),
        }
    }

    /// With attackers of this form that come this way.
    async fn start_by(way: Way, form: Form) -> World {
        World::start_by_with(way, form, |_| {}).await
    }

    async fn start_by_with(way: Way, form: Form, change: impl FnOnce(&mut Config)) -> World {
        let mut world = World::start_with(|config| {
            config.tls = tls::of_hub();
            change(config);
        })
        .await;
        let entrance = way.to(world.address(), form).await;
        world.entrances.push((form, entrance));
        world.told = Told(Some(format!("{way} in {}", form.word())));
        world
    }

    fn address(&self) -> SocketAddr {
        self.broker.local_addr()
    }

    /// Where attackers of this form come in.
    fn entrance(&self, form: Form) -> SocketAddr {
        let found = self.entrances.iter().find(|(of, _)| *of == form);
        found.map_or(self.address(), |(_, entrance)| *entrance)
    }

    /// A connection of an attacker that has not logged in.
    async fn stranger(&self, form: Form) -> Raw {
        Raw::connect(self.entrance(form), form).await
    }

    /// A peer that has logged in and sits in the channel of the witness.
    async fn attacker(&self, form: Form) -> Raw {
        let mut attacker = Raw::login(self.entrance(form), form, "bob").await;
        attacker.join(&[CHAT]).await;
        attacker
    }

    /// Lets an attacker that has logged in send these bytes, and checks the answer and all that must not happen.
    async fn attack(&mut self, what: &str, form: Form, bytes: &[u8], code: &str, after: After) -> WireError {
        let attacker = self.attacker(form).await;
        self.attack_from(attacker, what, bytes, code, after).await
    }

    /// The same, from a connection of the caller's.
    async fn attack_from(
        &mut self,
        mut attacker: Raw,
        what: &str,
        bytes: &[u8],
        code: &str,
        after: After,
    ) -> WireError {
        let (one, other) = bytes.split_at(bytes.len() / 2);
        attacker.send(one).await;
        self.canary.check().await;
        attacker.send(other).await;
        let error = attacker.next_error().await;
        assert_eq!(error.code.word(), code, "{what}: {error}");
        assert_eq!(
            error.code.closes(),
            after == After::Closed,
            "{what}: the code says so"
        );
        match after {
            After::Kept => attacker.check_alive().await,
            After::Closed => attacker.check_closed().await,
        }
        self.check_nothing_arrived(what).await;
        error
    }

    /// Lets an attacker send content that cannot be written in the witness's form: both are told that it was dropped,
    /// and why.
    async fn attack_content(&mut self, what: &str, content: Vec<u8>) {
        let mut attacker = self.attacker(Form::Binary).await;
        let (bytes, before) = (chat_binary(content), attacker.name().to_owned());
        attacker.send(&bytes).await;
        let expected = ["bad-content", "carol", &before].map(Value::from);
        for heard in [&mut attacker, &mut self.witness] {
            let told = heard.next_of(Family::Event, "dropped").await.value();
            let told = ["reason", "receiver", "sender"].map(|name| told.get(name).cloned());
            assert_eq!(told, expected.clone().map(Some), "{what}");
        }
        attacker.check_alive().await;
        self.check_nothing_arrived(what).await;
    }

    /// Checks that the witness has heard nothing of an attacker, and that the canary lives.
    async fn check_nothing_arrived(&mut self, what: &str) {
        self.attacks += 1;
        let marker = format!("after attack {}", self.attacks);
        let id = self.witness.post(message("chat", CHAT, marker.as_str())).await;
        loop {
            let heard = self.witness.next().await.expect("the witness is connected");
            if heard.family == Family::Message {
                let told = (heard.sender.as_deref(), heard.id, heard.value());
                assert_eq!(
                    told,
                    (Some("carol"), Some(id), Value::from(marker.as_str())),
                    "{what}"
                );
                break;
            }
            assert_ne!(heard.family, Family::Error, "{what}: {heard:?}");
        }
        self.canary.check().await;
    }

    /// The same hub still serves newcomers, and the canary has lost nothing. Gives what was written down.
    async fn end(self) -> Lines {
        let mut newcomer = Raw::login(self.address(), Form::Binary, "bob").await;
        newcomer.join(&[CHAT]).await;
        newcomer.check_alive().await;
        assert!(self.canary.stop().await > 0);
        self.broker.stop().await;
        let lines = self.audit.lines();
        let robot = ("context", "/robot/token");
        assert_eq!(
            lines.count(&[("what", "granted"), robot]),
            1,
            "the canary's grant"
        );
        assert_eq!(
            lines.count(&[("what", "lost"), robot]),
            1,
            "its end, and no other"
        );
        lines
    }
}

/// An XML entity around this body.
fn entity(body: impl AsRef<[u8]>) -> Vec<u8> {
    let body = body.as_ref();
    let head = format!(
        "Content-Type: application/xml\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    [head.as_bytes(), body].concat()
}

/// The XML of a message to the witness with these further slots.
fn chat_xml(slots: &str) -> String {
    format!(
        "<parcel><family>message</family><name>chat</name><id>7</id><context>{CHAT}</context>{slots}</parcel>"
    )
}

/// The line of JSON of a message to the witness with these further members.
fn chat_json(members: impl AsRef<[u8]>) -> Vec<u8> {
    let head = format!("{{\"family\":\"message\",\"name\":\"chat\",\"id\":7,\"context\":\"{CHAT}\",");
    [head.as_bytes(), members.as_ref(), b"}\n"].concat()
}

/// A binary message to the witness with this content, which need not be any.
fn chat_binary(content: Vec<u8>) -> Vec<u8> {
    let mut parcel = Parcel::new(Family::Message, "chat").context(at(CHAT)).id(7);
    parcel.content = Some(Content::Encoded(Bytes::from(content)));
    let encoded = Form::Binary
        .encode(&parcel)
        .expect("encoded content is not looked at");
    encoded.to_vec()
}

/// A binary frame around these bytes.
fn frame(bytes: &[u8]) -> Vec<u8> {
    let length = u32::try_from(bytes.len()).expect("a frame below 4 GiB");
    [&length.to_be_bytes()[..], bytes].concat()
}
