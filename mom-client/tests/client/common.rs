//! A hub that does what the test says, parcel by parcel.

use std::time::Duration;

use mom_client::{Builder, Client, Event, Events, Family, Map, Parcel, Path, Value, WireError};
use mom_net::Transceiver;
use mom_proto::Limits;
use mom_proto::codec::Frame;
use tokio::net::TcpListener;
use tokio::sync::mpsc;

/// Where peers come in.
pub(crate) enum Hub {
    Local(mpsc::UnboundedReceiver<Transceiver>),
    Tcp(TcpListener),
}

/// The hub's end of one connection.
pub(crate) struct Peer {
    transceiver: Transceiver,
}

pub(crate) fn path(text: &str) -> Path {
    Path::parse(text).unwrap()
}

/// A hub in this process, and a client's builder for it.
pub(crate) fn local() -> (Hub, Builder) {
    let (sender, receiver) = mpsc::unbounded_channel();
    let builder = Client::builder_local(move || {
        let (here, there) = mom_net::pair();
        // A hub that is gone closes at once.
        drop(sender.send(there));
        here
    });
    (Hub::Local(receiver), builder.user("alice").password("secret"))
}

/// A hub behind a socket, and a client's builder that speaks this scheme to it.
pub(crate) async fn tcp(scheme: &str) -> (Hub, Builder) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = format!("{scheme}://{}", listener.local_addr().unwrap());
    (
        Hub::Tcp(listener),
        Client::builder(address).user("alice").password("secret"),
    )
}

/// A client that has logged in as `ally`, and the hub's end of its connection.
pub(crate) async fn logged_in(hub: &mut Hub, builder: Builder) -> (Client, Peer) {
    logged_in_with(hub, builder, Map::new()).await
}

pub(crate) async fn logged_in_with(hub: &mut Hub, builder: Builder, limits: Map) -> (Client, Peer) {
    let (client, peer) = tokio::join!(builder.connect(), async {
        let mut peer = hub.accept().await;
        peer.log_in("ally", limits).await;
        peer
    });
    (client.unwrap(), peer)
}

impl Hub {
    pub(crate) async fn accept(&mut self) -> Peer {
        let transceiver = match self {
            Hub::Local(receiver) => receiver.recv().await.unwrap(),
            Hub::Tcp(listener) => {
                let (stream, _) = listener.accept().await.unwrap();
                // The test waits for as long as it takes.
                let never = std::future::pending();
                let (takes, limits) = (mom_net::Takes::default(), Limits::default());
                let accepted =
                    mom_net::accept(stream, None, takes, &limits, never, |error| error.to_parcel(None)).await;
                match accepted.unwrap() {
                    mom_net::Accepted::Peer(peer) => peer,
                    mom_net::Accepted::Http(_) => panic!("HTTP where a peer was expected"),
                }
            }
        };
        Peer { transceiver }
    }
}

impl Peer {
    /// The next parcel, or nothing once the client hung up.
    pub(crate) async fn hear_any(&mut self) -> Option<Parcel> {
        match self.transceiver.reader.next().await {
            Ok(Some(Frame::Parcel(parcel))) => Some(*parcel),
            Ok(Some(malformed)) => panic!("{malformed:?}"),
            Ok(None) | Err(_) => None,
        }
    }

    /// The next parcel that is not a ping; pings are answered.
    pub(crate) async fn hear(&mut self) -> Parcel {
        loop {
            let parcel = self.hear_any().await.expect("the client hung up");
            if !parcel.is(Family::Time, "ping") {
                return parcel;
            }
            let mut pong = Parcel::new(Family::Time, "pong");
            pong.reference = parcel.id;
            self.say(pong).await;
        }
    }

    /// The next parcel, which must be `family name path`.
    pub(crate) async fn expect(&mut self, what: &str) -> Parcel {
        let parcel = self.hear().await;
        assert_eq!(words(&parcel), what);
        parcel
    }

    pub(crate) async fn say(&mut self, parcel: Parcel) {
        self.transceiver.writer.send(parcel).await.unwrap();
    }

    pub(crate) async fn ok(&mut self, request: &Parcel, content: Map) {
        let mut reply = Parcel::new(Family::Reply, "ok").content(content);
        reply.reference = request.id;
        reply.context = request.context.clone();
        self.say(reply).await;
    }

    pub(crate) async fn refuse(&mut self, request: &Parcel, error: &WireError) {
        self.say(error.to_parcel(request.id)).await;
    }

    pub(crate) async fn event(&mut self, name: &str, context: &str, content: Map) {
        self.say(
            Parcel::new(Family::Event, name)
                .context(path(context))
                .content(content),
        )
        .await;
    }

    pub(crate) async fn message(&mut self, name: &str, context: &str, content: impl Into<Value>) {
        let content: Value = content.into();
        self.say(
            Parcel::new(Family::Message, name)
                .context(path(context))
                .content(content),
        )
        .await;
    }

    pub(crate) async fn log_in(&mut self, name: &str, limits: Map) -> Parcel {
        let login = self.expect("login login /").await;
        let welcome = Map::new()
            .with("peer", name)
            .with("user", "alice")
            .with("level", 1)
            .with("limits", limits);
        self.ok(&login, welcome).await;
        login
    }

    /// Answers the joins of a context and of all above it.
    pub(crate) async fn joined(&mut self, to: &str, kind: &str, more: Map) {
        let target = path(to);
        let mut above = Vec::new();
        let mut next = target.parent();
        while let Some(parent) = next.filter(|parent| !parent.is_root()) {
            next = parent.parent();
            above.push(parent);
        }
        for parent in above.iter().rev() {
            self.join_one(parent.as_str(), "session", Map::new()).await;
        }
        self.join_one(to, kind, more).await;
    }

    pub(crate) async fn join_one(&mut self, to: &str, kind: &str, more: Map) {
        let join = self.expect(&format!("context join {to}")).await;
        let mut content = Map::new().with("path", to).with("kind", kind).with("number", 7);
        for (key, value) in more {
            content.set(&key, value);
        }
        self.ok(&join, content).await;
    }

    /// Answers a grab.
    pub(crate) async fn granted(&mut self, token: &str, fence: i64, lease: i64) {
        let grab = self.expect(&format!("token grab {token}")).await;
        self.ok(&grab, Map::new().with("fence", fence).with("lease", lease))
            .await;
    }

    /// Ends the connection.
    pub(crate) fn hang_up(self) {}
}

/// `family name path`.
pub(crate) fn words(parcel: &Parcel) -> String {
    let context = parcel
        .context
        .as_ref()
        .map(|path| format!(" {path}"))
        .unwrap_or_default();
    format!("{} {}{context}", parcel.family, parcel.name())
}

/// The next event, which must come.
pub(crate) async fn next(events: &mut Events) -> Event {
    tokio::time::timeout(Duration::from_secs(60), events.next())
        .await
        .expect("no event came")
        .expect("the subscription ended")
}
