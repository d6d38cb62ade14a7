//! A run of messages is the same messages one by one: two switchboards hear the same bytes, and one of them never makes
//! runs. Each receiver gets the same parcels, the sender the same refusals, and both count the same.

use std::cell::Cell;
use std::sync::Arc;
use std::time::Duration;

use mom_hub::{ContextSpec, Hub, Input, PeerClock, PeerId, Settings, User};
use mom_journal::{AuditConfig, ConfigFile, RecordConfig, Tap};
use mom_managers::Registry;
use mom_net::{Accepted, Address, Door, Reader, Takes, Transceiver, Writer};
use mom_proto::codec::{Form, Frame};
use mom_proto::{
    ClockOffset, ContextNumber, Delivery, Family, Limit, Limits, Map, Parcel, Path, Time, Value, from_value,
};
use mom_system::Clock;
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use tokio::net::TcpListener;
use tokio::task::JoinHandle;

use super::{Handled, Keeping, Switchboard, Touched, flush};
use crate::traffic::channel::Sender;
use crate::traffic::encodings::Bounds;
use crate::traffic::outbox::Outbox;

const ARM: &str = "/lab/arm";

/// Sequences of steps that are tried.
const CASES: u32 = 96;

/// Who is there: the first sends, all may hear.
const PEERS: [&str; 4] = ["alice", "bob", "carol", "dave"];

/// A start, in µs since 1970.
const START: i64 = 1_000_000_000_000_000;

/// What a group of messages has in common.
#[derive(Clone, Debug)]
struct Alike {
    name: &'static str,
    size: usize,
    priority: Option<i32>,
    delivery: Option<Delivery>,
    echo: Option<bool>,
    expires: Option<u64>,
    receipt: bool,
    /// The fence that the sender names.
    fence: Option<u64>,
    address: Option<Vec<&'static str>>,
}

#[derive(Clone, Debug)]
enum Step {
    /// Messages of the first peer that arrive together; of each how old it is, in ms, and none without a timestamp.
    /// Whether they leave before the next step.
    Say(Vec<(Alike, Vec<Option<i64>>)>, bool),
    /// A peer asks for something about a context.
    Ask(usize, Family, &'static str, &'static str),
    /// Time passes, in ms.
    Wait(u64),
    /// From now on the sender's clock is known to this error in µs, or not known.
    Clock(Option<u64>),
}

/// A switchboard with its hub and its peers.
struct World {
    board: Switchboard,
    clock: Clock,
    /// Whether it makes runs.
    runs: bool,
    peers: Vec<Present>,
    /// The sender's link: its own end, and what the hub reads of it.
    writer: Option<Writer>,
    _said: Reader,
    heard: Reader,
    known: Option<u64>,
    ids: u64,
    /// Outboxes that nobody has flushed yet.
    touched: Touched,
    refused: Vec<(u64, String)>,
    made: usize,
}

/// A peer that is there.
struct Present {
    id: PeerId,
    outbox: Arc<Outbox>,
    /// Reads until the end, so that the link is never full.
    heard: JoinHandle<Vec<String>>,
    /// Kept, or the link would be closed.
    _ends: (Reader, Writer),
}

fn path(text: &str) -> Path {
    Path::parse(text).expect("a path")
}

/// Steps are refused when they are not fresh, states by their rate, and commands need the token.
fn contexts() -> Vec<ContextSpec> {
    let words = |words: &[&str]| words.iter().map(|word| Value::from(*word)).collect::<Vec<_>>();
    let context = |path: &str, kind: &str| Map::new().with("path", path).with("kind", kind);
    let fresh = Map::new()
        .with("allow", words(&["send"]))
        .with("messages", words(&["step"]))
        .with("max-age", 200);
    let secret = Map::new()
        .with("deny", words(&["send"]))
        .with("messages", words(&["secret"]));
    let all = Map::new().with("allow", words(&["*"]));
    let rules: Vec<Value> = [fresh, secret, all].map(Value::from).to_vec();
    let roles = Map::new().with("kind", "roles").with("rules", rules);
    let limit = Map::new()
        .with("verbs", words(&["send"]))
        .with("parcels", 40)
        .with("bytes", 6000)
        .with("bytes-burst", 20_000);
    let quota = Map::new()
        .with("kind", "quota")
        .with("limits", vec![Value::from(limit)]);
    let chain = Map::new()
        .with("kind", "chain")
        .with("of", vec![Value::from(roles), Value::from(quota)]);
    let guard = Map::new()
        .with("token", "/lab/key")
        .with("names", words(&["command"]));
    let all = [
        context("/lab", "session").with("presence", "none"),
        context("/lab/key", "token").with("manager", Map::new().with("kind", "level-or-lease")),
        context(ARM, "channel")
            .with("guard", guard)
            .with("manager", chain)
            .with("presence", "none"),
    ];
    all.into_iter()
        .map(|spec| from_value(spec.into()).expect("a context"))
        .collect()
}

/// Both ends of a link over loopback, as a peer of the binary form has it: the hub's end first.
async fn link() -> (Transceiver, Transceiver) {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let port = listener.local_addr().expect("bound").port();
    let limits = Limits::default();
    let address = Address {
        tls: false,
        form: Form::Binary,
        door: Door::Stream,
        host: "127.0.0.1".to_owned(),
        port,
        path: None,
        pin: None,
        any: false,
        port_named: true,
    };
    let near = async {
        let (stream, _) = listener.accept().await.expect("a connection");
        let never = std::future::pending();
        let takes = Takes::default();
        let accepted =
            mom_net::accept(stream, None, takes, &limits, never, |error| error.to_parcel(None)).await;
        match accepted.expect("binary") {
            Accepted::Peer(transceiver) => transceiver,
            Accepted::Http(_) => panic!("no HTTP"),
        }
    };
    let far = async {
        mom_net::connect(&address, &limits, None)
            .await
            .expect("it listens")
    };
    tokio::join!(near, far)
}

impl World {
    async fn new(runs: bool) -> World {
        let clock = Clock::manual(Time::from_micros(START).expect("a time"));
        let settings = Settings {
            anchor: clock.anchor(),
            epoch: 1,
            ..Settings::default()
        };
        let hub =
            Hub::new(settings.clone(), Registry::builtin(), &"open".into(), &contexts()).expect("a hub");
        let bounds = Bounds {
            depth: 32,
            parcel: Limit::At(1 << 20),
        };
        let journal = (&AuditConfig::default(), &RecordConfig::default());
        let tap = Tap::start(journal, ConfigFile::default(), &settings, &clock).expect("it writes nothing");
        let (near, said) = link().await;
        let mut world = World {
            board: Switchboard::new(hub, clock.clone(), bounds, Keeping::default(), tap),
            clock,
            runs,
            peers: Vec::new(),
            writer: Some(said.writer),
            _said: said.reader,
            heard: near.reader,
            known: None,
            ids: 1000,
            touched: Touched::new(),
            refused: Vec::new(),
            made: 0,
        };
        for (level, name) in PEERS.into_iter().enumerate() {
            world.enter(name, i32::try_from(level).expect("few")).await;
        }
        world
    }

    async fn enter(&mut self, name: &str, level: i32) {
        let id = self.board.next_peer();
        let (near, far) = link().await;
        let outbox = Arc::new(Outbox::new(id, self.clock.clone(), near.writer, 1 << 20));
        self.board.add_outbox(&outbox);
        let Transceiver {
            mut reader, writer, ..
        } = far;
        let heard = tokio::spawn(async move {
            let mut heard = Vec::new();
            while let Some(frame) = reader.next().await.expect("a link") {
                heard.push(format!("{frame:?}"));
            }
            heard
        });
        self.peers.push(Present {
            id,
            outbox,
            heard,
            _ends: (near.reader, writer),
        });
        let user = User {
            name: name.to_owned(),
            level,
            groups: Vec::new(),
            details: Map::new(),
        };
        let mut touched = Touched::new();
        let login = Input::Login {
            peer: id,
            user,
            nickname: None,
            id: None,
        };
        self.board.decide(login, &mut touched);
        flush(&mut touched);
        for context in ["/lab", ARM] {
            self.ask(self.peers.len() - 1, Family::Context, "join", context);
        }
    }

    /// The number of the channel.
    fn number(&self) -> ContextNumber {
        *self.board.by_path.get(&path(ARM)).expect("it is there")
    }

    fn ask(&mut self, peer: usize, family: Family, name: &str, context: &str) {
        self.ids += 1;
        let parcel = Box::new(Parcel::new(family, name).context(path(context)).id(self.ids));
        let mut touched = Touched::new();
        let input = Input::Request {
            peer: self.peers[peer].id,
            parcel,
            clock: None,
        };
        self.board.decide(input, &mut touched);
        flush(&mut touched);
    }

    /// What the first peer says arrives, and is sent as its connection sends it.
    async fn say(&mut self, groups: &[(Alike, Vec<Option<i64>>)], leaves: bool) {
        let number = self.number();
        let mut said = Vec::new();
        for (alike, ages) in groups {
            for age in ages {
                self.ids += 1;
                said.push(alike.parcel(self.ids, *age, self.clock.wall(), number));
            }
        }
        said.push(Parcel::new(Family::Time, "ping").id(1));
        // Beside the reading: the link may hold less than all of it.
        let mut writer = self.writer.take().expect("nobody else writes");
        let write = async move {
            for parcel in said {
                writer.send(parcel).await.expect("a link");
            }
            writer
        };
        let (writer, ()) = tokio::join!(write, self.hear());
        self.writer = Some(writer);
        if leaves {
            self.leave().await;
        }
    }

    /// Sends what arrives, up to a ping.
    async fn hear(&mut self) {
        let mut touched = Touched::new();
        let limits = Limits::default();
        let known = self.known;
        let clock = move |_| {
            known.map(|error| PeerClock {
                offset: ClockOffset { micros: 0, error },
                future: 100_000,
            })
        };
        let sender = Sender {
            peer: self.peers[0].id,
            clock: &clock,
            late: false,
            read: None,
        };
        loop {
            if self.runs && self.board.run(&sender, &mut self.heard, &mut touched) {
                self.made += 1;
                continue;
            }
            let parcel = match self.heard.try_next().expect("a link") {
                Some(Frame::Parcel(parcel)) => parcel,
                Some(Frame::Malformed { error, .. }) => panic!("{error}"),
                None => {
                    assert!(
                        self.heard.arrive().await.expect("a link"),
                        "the ping is on its way"
                    );
                    continue;
                }
            };
            if parcel.family == Family::Time {
                break;
            }
            let id = parcel.id.expect("numbered");
            match self.board.message(&sender, &limits, parcel, &mut touched) {
                Ok(Handled::Done) => {}
                Ok(Handled::Waits(_)) => panic!("nobody waits here"),
                Err(error) => self.refused.push((id, error.to_string())),
            }
        }
        self.touched.append(&mut touched);
    }

    /// Lets all that waits leave.
    async fn leave(&mut self) {
        flush(&mut self.touched);
        for peer in &self.peers {
            while peer.outbox.queued() > 0 {
                peer.outbox.flush();
                tokio::task::yield_now().await;
            }
        }
    }

    async fn step(&mut self, step: &Step) {
        match step {
            Step::Say(groups, leaves) => self.say(groups, *leaves).await,
            Step::Ask(peer, family, verb, context) => self.ask(*peer, *family, verb, context),
            Step::Wait(millis) => {
                self.clock.advance(Duration::from_millis(*millis));
                let mut touched = Touched::new();
                self.board.decide(Input::Tick, &mut touched);
                flush(&mut touched);
            }
            Step::Clock(known) => self.known = *known,
        }
        self.board.check();
    }

    /// All that was heard, by each peer, and what the sender was refused.
    async fn end(mut self) -> (Vec<Vec<String>>, Vec<(u64, String)>, usize) {
        self.leave().await;
        self.ask(0, Family::Context, "stats", ARM);
        let mut heard = Vec::new();
        for peer in self.peers {
            peer.outbox.close(None, None, true);
            peer.outbox.run().await;
            heard.push(peer.heard.await.expect("it reads"));
        }
        (heard, self.refused, self.made)
    }
}

impl Alike {
    fn parcel(&self, id: u64, age: Option<i64>, now: Time, number: ContextNumber) -> Parcel {
        let content = vec![7; self.size];
        let mut parcel = Parcel::new(Family::Message, self.name).id(id);
        if self.size > 0 {
            parcel = parcel.content(Value::Binary(content.into()));
        }
        parcel.number = Some(number);
        parcel.timestamp = age.and_then(|age| Time::from_micros(now.micros() - age * 1000));
        (parcel.priority, parcel.delivery, parcel.echo) = (self.priority, self.delivery, self.echo);
        (parcel.expires, parcel.fence) = (self.expires, self.fence);
        parcel.receipt = self.receipt.then_some(true);
        let address = self.address.as_ref();
        parcel.address = address.map(|names| names.iter().map(|name| (*name).into()).collect());
        parcel
    }
}

/// Mostly plain: what is not goes one by one in any case.
fn alike() -> impl Strategy<Value = Alike> {
    let names = prop_oneof![
        4 => Just("state"),
        4 => Just("chat"),
        4 => Just("command"),
        4 => Just("step"),
        1 => Just("secret"),
        1 => Just("stop"),
        1 => Just("halt"),
    ];
    let sizes = prop_oneof![3 => 0..400_usize, 1 => Just(9000_usize)];
    let seldom = |weight| proptest::bool::weighted(weight);
    let delivery = prop_oneof![
        6 => Just(None),
        2 => Just(Some(Delivery::Reliable)),
        1 => Just(Some(Delivery::Latest)),
    ];
    let address = prop_oneof![
        8 => Just(None),
        1 => Just(Some(vec!["bob"])),
        1 => Just(Some(vec!["carol", "nobody"])),
    ];
    let fence = prop_oneof![8 => Just(None), 1 => Just(Some((1 << 20) + 1)), 1 => Just(Some(1))];
    let echo = prop_oneof![3 => Just(None), 1 => Just(Some(false))];
    let priority = prop_oneof![6 => Just(None), 1 => Just(Some(5)), 1 => Just(Some(1000))];
    let all = (
        names,
        sizes,
        priority,
        delivery,
        echo,
        seldom(0.1),
        seldom(0.1),
        fence,
        address,
    );
    all.prop_map(
        |(name, size, priority, delivery, echo, expires, receipt, fence, address)| Alike {
            name,
            size,
            priority,
            delivery,
            echo,
            expires: expires.then_some(150),
            receipt,
            fence,
            address,
        },
    )
}

fn step() -> impl Strategy<Value = Step> {
    // Ages around what is fresh, what is over, and what lies in the future.
    let age =
        prop_oneof![1 => Just(None), 8 => (0..260_i64).prop_map(Some), 1 => (-300..0_i64).prop_map(Some)];
    let group = (alike(), vec(age, 1..12));
    let control = prop_oneof![
        Just((Family::Token, "grab", "/lab/key")),
        Just((Family::Token, "release", "/lab/key")),
        Just((Family::Context, "leave", ARM)),
        Just((Family::Context, "join", ARM)),
    ];
    prop_oneof![
        6 => (vec(group, 1..5), any::<bool>()).prop_map(|(groups, leaves)| Step::Say(groups, leaves)),
        3 => (0..PEERS.len(), control).prop_map(|(peer, (family, verb, context))| {
            Step::Ask(peer, family, verb, context)
        }),
        1 => Just(Step::Ask(0, Family::Token, "grab", "/lab/key")),
        1 => Just(Step::Ask(0, Family::Context, "join", ARM)),
        2 => (0..900_u64).prop_map(Step::Wait),
        2 => proptest::option::weighted(0.8, 0..30_000_u64).prop_map(Step::Clock),
    ]
}

#[test]
fn a_run_is_the_same_messages_one_by_one() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime.expect("a runtime");
    let made = Cell::new(0);
    let mut runner = TestRunner::new(Config {
        cases: CASES,
        failure_persistence: None,
        max_shrink_iters: 200,
        ..Config::default()
    });
    let passed = runner.run(&vec(step(), 1..16), |steps| {
        let (by_runs, one_by_one) = runtime.block_on(async {
            let (mut one, mut other) = (World::new(true).await, World::new(false).await);
            for step in &steps {
                one.step(step).await;
                other.step(step).await;
            }
            (one.end().await, other.end().await)
        });
        prop_assert_eq!(&by_runs.0, &one_by_one.0, "heard");
        prop_assert_eq!(&by_runs.1, &one_by_one.1, "refused");
        prop_assert_eq!(one_by_one.2, 0);
        made.set(made.get() + by_runs.2);
        Ok(())
    });
    if let Err(error) = passed {
        panic!("{error}");
    }
    assert!(
        made.get() > CASES as usize / 2,
        "only {} runs were made",
        made.get()
    );
}
