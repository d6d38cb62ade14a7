//! Random steps, and the inputs that they become.

use std::collections::BTreeMap;
use std::sync::Arc;

use mom_hub::{Input, PeerId};
use mom_proto::{Family, Map, Parcel, Path, Value};
use proptest::prelude::*;
use proptest::sample::select;

use crate::lab::{EPOCH, PATHS, USERS, user};

/// Connections at a time; each that ends is followed by one of a new number.
const SEATS: usize = 5;

/// A step: time that passes, then something that one connection does.
#[derive(Clone, Debug)]
pub(crate) struct Step {
    wait: u64,
    seat: usize,
    /// Who logs in if this connection has to before it can do something.
    user: usize,
    act: Act,
}

#[derive(Clone, Debug)]
enum Act {
    Login {
        nickname: Option<&'static str>,
    },
    /// Something before a login, or again.
    Stranger,
    Gone,
    Ask {
        family: Family,
        verb: &'static str,
        path: &'static str,
    },
    Create {
        path: &'static str,
        spec: Map,
    },
    Send(Message),
    Tick,
}

#[derive(Clone, Debug)]
struct Message {
    path: &'static str,
    name: &'static str,
    to: Option<Vec<&'static str>>,
    fence: Option<u64>,
    echo: Option<bool>,
    receipt: bool,
}

/// Any step.
fn step() -> impl Strategy<Value = Step> {
    // µs: nothing, less than a lease, exactly one, more.
    let wait = prop_oneof![
        40 => Just(0),
        20 => Just(1),
        10 => Just(1_000_000),
        4 => Just(2_000_000),
        2 => Just(5_000_000),
        1 => 0_u64..100_000_000,
        1 => Just(180_000_000),
    ];
    (wait, 0..SEATS, 0..USERS.len(), act()).prop_map(|(wait, seat, user, act)| Step {
        wait,
        seat,
        user,
        act,
    })
}

/// Any log: half of them begin where everybody is everywhere, so that there is more to go wrong.
pub(crate) fn steps(most: usize) -> impl Strategy<Value = Vec<Step>> {
    let begin = prop_oneof![Just(Vec::new()), Just(everybody())];
    (begin, proptest::collection::vec(step(), 1..=most)).prop_map(|(begin, rest)| [begin, rest].concat())
}

fn everybody() -> Vec<Step> {
    const CARVED: [(&str, &str); 3] = [("/a", "session"), ("/a/token", "token"), ("/a/arm", "channel")];
    let at_once = |seat, act| Step {
        wait: 0,
        seat,
        user: seat,
        act,
    };
    let ask = |family, verb, path| Act::Ask { family, verb, path };
    let mut steps = Vec::new();
    for seat in 0..SEATS {
        steps.push(at_once(seat, Act::Login { nickname: None }));
        for path in [
            "/lab",
            "/lab/arm",
            "/lab/talk",
            "/yard",
            "/yard/work",
            "/yard/press",
            "/a",
        ] {
            steps.push(at_once(seat, ask(Family::Context, "join", path)));
        }
    }
    steps.push(at_once(0, ask(Family::Context, "leave", "/lab/talk")));
    for (path, kind) in CARVED {
        let mut spec = Map::new().with("kind", kind);
        match kind {
            "channel" => spec.set(
                "guard",
                Map::new()
                    .with("token", "/a/token")
                    .with("names", vec!["say".into()]),
            ),
            "token" => spec.set("manager", "level-or-lease"),
            _ => {}
        }
        steps.push(at_once(0, Act::Create { path, spec }));
        steps.extend([0, 1, 3].map(|seat| at_once(seat, ask(Family::Context, "join", path))));
    }
    steps
}

fn act() -> impl Strategy<Value = Act> {
    let path = || select(&PATHS[..]);
    let ask = |family, verbs: &'static [&'static str]| {
        (select(verbs), path()).prop_map(move |(verb, path)| Act::Ask { family, verb, path })
    };
    let nickname = prop_oneof![3 => Just(None), 1 => Just(Some("ally"))];
    // Most of what there is lies in these.
    let inner = select(vec![
        "/lab",
        "/yard",
        "/a",
        "/lab/arm",
        "/yard/work",
        "/yard/press",
        "/a/arm",
        "/lab/talk",
    ]);
    let enter = inner.prop_map(|path| Act::Ask {
        family: Family::Context,
        verb: "join",
        path,
    });
    let tokens = select(vec!["/lab/token", "/yard/key", "/yard/eager", "/a/token"]);
    let grab = tokens.prop_map(|path| Act::Ask {
        family: Family::Token,
        verb: "grab",
        path,
    });
    prop_oneof![
        2 => nickname.prop_map(|nickname| Act::Login { nickname }),
        2 => Just(Act::Gone),
        1 => Just(Act::Stranger),
        30 => enter,
        4 => ask(Family::Context, &["join"]),
        5 => ask(Family::Context, &["leave", "delete", "lookup", "list", "info", "members", "grib"]),
        16 => grab,
        8 => ask(Family::Token, &["grab", "renew", "release", "info"]),
        1 => ask(Family::Login, &["logout"]),
        2 => Just(Act::Ask { family: Family::Context, verb: "delete", path: "/a/token" }),
        4 => Just(Act::Create { path: "/a/token", spec: Map::new().with("kind", "token") }),
        10 => (path(), spec()).prop_map(|(path, spec)| Act::Create { path, spec }),
        30 => message().prop_map(Act::Send),
        4 => Just(Act::Tick),
    ]
}

fn message() -> impl Strategy<Value = Message> {
    const CHANNELS: [&str; 7] = [
        "/lab/arm",
        "/lab/arm",
        "/lab/talk",
        "/yard/work",
        "/yard/press",
        "/a/arm",
        "/a/b",
    ];
    const NAMES: [&str; 6] = ["alice", "alice~2", "bob", "carol", "ally", "nobody"];
    let to = prop_oneof![
        3 => Just(None),
        1 => proptest::collection::vec(select(&NAMES[..]), 1..3).prop_map(Some),
    ];
    let fence = prop_oneof![3 => Just(None), 2 => (0_u64..4).prop_map(Some)];
    let names = ["command", "command", "say", "say", "stop", "unstop", "halt"];
    let echo = prop_oneof![Just(None), Just(Some(false))];
    (
        select(&CHANNELS[..]),
        select(names.to_vec()),
        to,
        fence,
        echo,
        any::<bool>(),
    )
        .prop_map(|(path, name, to, fence, echo, receipt)| Message {
            path,
            name,
            to,
            fence,
            echo,
            receipt,
        })
}

fn spec() -> impl Strategy<Value = Map> {
    let kind = select(vec!["session", "session", "channel", "token", "castle"]);
    let manager = prop_oneof![
        6 => Just(None),
        1 => select(vec!["open", "closed", "first-come", "level-or-lease", "lab", "nobody"])
            .prop_map(|name| Some(Value::from(name))),
        1 => Just(Some(Value::Map(Map::new().with("kind", "level-or-lease").with("lease", 1000).with("expiry", "eager")))),
    ];
    let guard = prop_oneof![1 => Just(None), 1 => select(&PATHS[..]).prop_map(Some)];
    let presence = select(vec![None, None, Some("counts"), Some("none")]);
    (
        kind,
        manager,
        guard,
        presence,
        any::<bool>(),
        prop_oneof![3 => Just(None), 1 => Just(Some(1000))],
    )
        .prop_map(|(kind, manager, guard, presence, transient, lease)| {
            let mut spec = Map::new().with("kind", kind).with("transient", transient);
            if let Some(manager) = manager {
                spec.set("manager", manager);
            }
            if let Some(token) = guard.filter(|_| kind == "channel") {
                spec.set(
                    "guard",
                    Map::new()
                        .with("token", token)
                        .with("names", vec!["command".into()]),
                );
            }
            if let Some(presence) = presence {
                spec.set("presence", presence);
            }
            if let Some(lease) = lease.filter(|_| kind == "token") {
                spec.set("lease", lease);
            }
            spec
        })
}

/// Turns steps into inputs: time that only goes forth, ids that rise, connections that are new after each end.
#[derive(Debug, Default)]
pub(crate) struct Log {
    now: u64,
    id: u64,
    /// Of each seat how often its connection has ended, and whether the present one has logged in.
    seats: BTreeMap<usize, (u64, bool)>,
}

impl Log {
    pub(crate) fn next(&mut self, step: &Step) -> (u64, Input) {
        self.now += step.wait;
        self.id += 1;
        let (ended, logged_in) = self.seats.entry(step.seat).or_default();
        let peer = PeerId(1 + step.seat as u64 + *ended * SEATS as u64);
        let login = |nickname: Option<&str>| Input::Login {
            peer,
            user: user(step.user),
            nickname: nickname.map(str::to_owned),
            id: Some(self.id),
        };
        let request = |parcel: Parcel| Input::Request {
            peer,
            parcel: Box::new(parcel.id(self.id)),
        };
        let input = match &step.act {
            Act::Login { nickname } => {
                *logged_in = true;
                login(*nickname)
            }
            Act::Gone => {
                (*ended, *logged_in) = (*ended + 1, false);
                Input::Gone { peer }
            }
            Act::Stranger => request(Parcel::new(Family::Token, "grab").context(at("/lab/token"))),
            _ if !*logged_in => {
                *logged_in = true;
                login(None)
            }
            Act::Ask { family, verb, path } => request(Parcel::new(*family, *verb).context(at(path))),
            Act::Create { path, spec } => request(
                Parcel::new(Family::Context, "create")
                    .context(at(path))
                    .content(spec.clone()),
            ),
            Act::Send(message) => request(message.parcel()),
            Act::Tick => Input::Tick,
        };
        (self.now, input)
    }
}

impl Message {
    fn parcel(&self) -> Parcel {
        let mut parcel = Parcel::new(Family::Message, self.name).context(at(self.path));
        parcel.address = self
            .to
            .as_ref()
            .map(|to| to.iter().map(|name| Arc::from(*name)).collect());
        parcel.fence = self.fence.map(|number| (EPOCH << 20) + number);
        parcel.echo = self.echo;
        parcel.receipt = self.receipt.then_some(true);
        parcel
    }
}

/// A path that is one.
pub(crate) fn at(path: &str) -> Path {
    Path::parse(path).unwrap()
}
