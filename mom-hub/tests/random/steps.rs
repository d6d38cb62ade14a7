//! Random steps: what passes in a log, before it is known who is who.

use std::fmt;

use mom_proto::{Family, Map, Value};
use proptest::prelude::*;
use proptest::sample::select;

use crate::acts;
use crate::lab::{USERS, VARIANTS};

/// Connections at a time; each that ends is followed by one of a new number.
pub(crate) const SEATS: usize = 5;

/// A step: time that passes, then something that one connection does.
#[derive(Clone, Debug)]
pub(crate) struct Step {
    pub(crate) wait: u64,
    pub(crate) seat: usize,
    /// Who logs in if this connection has to before it can do something.
    pub(crate) user: usize,
    pub(crate) act: Act,
    /// Whether the owner does it, where it is for the owner to do.
    pub(crate) by_owner: bool,
    /// When the store answers what this step gives it, and how.
    pub(crate) disk: Disk,
    /// Whether the outboxes are written, and the robots read.
    pub(crate) link: (bool, bool),
}

/// A store at work: after so many steps, well or not.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Disk {
    pub(crate) after: usize,
    pub(crate) ok: bool,
}

/// A peer by what is known only in the run: who sits there, or nobody.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Who(pub(crate) usize);

#[derive(Clone, Debug)]
pub(crate) enum Act {
    Login {
        nickname: Option<&'static str>,
    },
    /// Something before a login, or again.
    Stranger,
    Gone,
    /// The connection is lost, and may come back for so long, µs.
    Lost {
        grace: u64,
    },
    /// A lost peer comes back, or none does.
    Resumed,
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
    /// What was said last, once more, by the same.
    Again,
    /// A request with content; the peer named in it, under this key.
    Tell {
        family: Family,
        verb: &'static str,
        path: &'static str,
        content: Map,
        peer: Option<(&'static str, Who)>,
    },
    /// The answer to an offer or a request that was seen, by whom it is for or by this seat.
    Answer {
        verb: &'static str,
        offer: bool,
        pick: usize,
        rightly: bool,
    },
    /// The answer to a question that was seen.
    Verdict {
        pick: usize,
        rightly: bool,
        number: Option<i64>,
        allow: bool,
        stands: bool,
    },
    Configure(usize),
    Tick,
}

#[derive(Clone, Debug)]
pub(crate) struct Message {
    pub(crate) path: &'static str,
    pub(crate) name: &'static str,
    pub(crate) to: Option<Vec<&'static str>>,
    pub(crate) fence: Option<u64>,
    pub(crate) echo: Option<bool>,
    pub(crate) receipt: bool,
}

impl Message {
    fn to_all(path: &'static str, name: &'static str) -> Message {
        Message {
            path,
            name,
            to: None,
            fence: None,
            echo: None,
            receipt: false,
        }
    }
}

/// Any step.
fn step() -> impl Strategy<Value = Step> {
    // µs: nothing, less than a lease, exactly one, more.
    let wait = prop_oneof![
        50 => Just(0),
        15 => Just(1),
        4 => Just(499_999),
        10 => Just(1_000_000),
        4 => Just(2_000_000),
        2 => Just(5_000_000),
        1 => 0_u64..100_000_000,
        1 => Just(180_000_000),
    ];
    let disk = (
        prop_oneof![3 => Just(0), 2 => 1..6_usize],
        prop::bool::weighted(0.85),
    );
    // Often not, so that commands are under way when something changes.
    let link = (prop::bool::weighted(0.5), prop::bool::weighted(0.7));
    let by_owner = prop::bool::weighted(0.7);
    (wait, 0..SEATS, 0..USERS.len(), act(), by_owner, disk, link).prop_map(
        |(wait, seat, user, act, by_owner, (after, ok), link)| Step {
            wait,
            seat,
            user,
            act,
            by_owner,
            disk: Disk { after, ok },
            link,
        },
    )
}

/// What single steps seldom come to: a peer drives, and who has asked for the token is lost before the owner says yes; or
/// the driver is lost while its messages wait for an answer; or who lent the token is lost before it comes back.
fn scene() -> impl Strategy<Value = Vec<Step>> {
    let places = select(vec![
        ("/yard/dead", "/yard/belt", "command"),
        ("/yard/eager", "/yard/press", "say"),
        ("/yard/eager", "/yard/dock", "command"),
        ("/yard/eager", "/yard/dock", "say"),
    ]);
    let steps = (step(), step(), step(), step(), step(), step());
    (places, 0..3, acts::lose(), steps).prop_map(|((token, path, name), which, lost, steps)| {
        let steps = <[Step; 6]>::from(steps);
        let (driver, other) = (steps[0].seat, steps[1].seat);
        let tell = |verb, content, peer| Act::Tell {
            family: Family::Token,
            verb,
            path: token,
            content,
            peer,
        };
        let ask = |verb| tell(verb, Map::new(), None);
        let send = |name| Act::Send(Message::to_all(path, name));
        let accept = |offer| Act::Answer {
            verb: "accept",
            offer,
            pick: 0,
            rightly: true,
        };
        let release = Act::Ask {
            family: Family::Token,
            verb: "release",
            path: token,
        };
        let lend = tell("give", Map::new().with("for", 60_000), Some(("to", Who(other))));
        // Who does it, and whether that is the owner, or who has just asked.
        let (own, others, owners) = ((driver, false), (other, false), (driver, true));
        let acts = match which {
            0 => [
                (own, ask("grab")),
                (own, send(name)),
                (others, ask("request")),
                (own, send(name)),
                (owners, lost),
                (owners, accept(false)),
            ],
            1 => [
                (own, ask("grab")),
                (own, send(name)),
                (own, send("say")),
                (own, send("say")),
                (own, send(name)),
                (owners, lost),
            ],
            _ => [
                (own, ask("grab")),
                (own, lend),
                (others, accept(true)),
                (others, send(name)),
                (own, lost),
                (others, release),
            ],
        };
        let scene = steps.into_iter().zip(acts);
        let scene = scene.map(|(step, ((seat, by_owner), act))| Step {
            wait: 0,
            seat,
            act,
            by_owner,
            ..step
        });
        scene.collect()
    })
}

/// A log. Most begin where everybody is everywhere, so that there is more to go wrong.
#[derive(Clone)]
pub(crate) struct Script {
    crowded: bool,
    pub(crate) steps: Vec<Step>,
}

impl Script {
    /// What passes before it, where everybody is everywhere.
    pub(crate) fn before(&self) -> Vec<Step> {
        match self.crowded {
            true => everybody(),
            false => Vec::new(),
        }
    }
}

/// As few words as can be, because a person has to read the shortest log that fails.
impl fmt::Debug for Script {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "crowded: {}", self.crowded)?;
        for step in &self.steps {
            let Step {
                wait,
                seat,
                user,
                act,
                by_owner,
                disk,
                link,
            } = step;
            let who = if *by_owner { "owner or seat" } else { "seat" };
            writeln!(
                out,
                "+{wait} {who} {seat} (user {user}): {act:?}; {disk:?}, link {link:?}"
            )?;
        }
        Ok(())
    }
}

/// Any log.
pub(crate) fn script(most: usize) -> impl Strategy<Value = Script> {
    let some = prop_oneof![
        60 => step().prop_map(|step| vec![step]),
        1 => scene(),
    ];
    let steps = prop::collection::vec(some, 1..=most);
    (prop::bool::weighted(0.75), steps).prop_map(move |(crowded, steps)| {
        let mut steps = steps.concat();
        steps.truncate(most);
        Script { crowded, steps }
    })
}

fn everybody() -> Vec<Step> {
    let at_once = |seat, act| Step {
        wait: 0,
        seat,
        user: seat,
        act,
        by_owner: false,
        disk: Disk { after: 0, ok: true },
        link: (true, true),
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
            "/yard/belt",
            "/yard/gate",
            "/yard/bay",
            "/yard/dock",
            "/yard/mill",
            "/a",
        ] {
            steps.push(at_once(seat, ask(Family::Context, "join", path)));
        }
    }
    steps.push(at_once(0, ask(Family::Context, "leave", "/lab/talk")));
    for (path, kind) in [
        ("/a", "session"),
        ("/a/token", "token"),
        ("/a/arm", "channel"),
        ("/a/own", "channel"),
    ] {
        let mut spec = Map::new().with("kind", kind);
        match path {
            "/a/arm" => spec.set("guard", guard("/a/token", "say")),
            "/a/token" => spec.set("manager", "level-or-lease"),
            "/a/own" => spec.set("manager", "own"),
            _ => {}
        }
        steps.push(at_once(0, Act::Create { path, spec }));
        steps.extend([0, 1, 3].map(|seat| at_once(seat, ask(Family::Context, "join", path))));
    }
    steps
}

pub(crate) fn guard(token: &str, name: &str) -> Map {
    Map::new()
        .with("token", token)
        .with("names", vec![Value::from(name)])
}

fn act() -> impl Strategy<Value = Act> {
    let nickname = prop_oneof![3 => Just(None), 1 => Just(Some("ally"))];
    let create_token = Act::Create {
        path: "/a/token",
        spec: Map::new().with("kind", "token"),
    };
    let delete_token = Act::Ask {
        family: Family::Context,
        verb: "delete",
        path: "/a/token",
    };
    prop_oneof![
        2 => nickname.prop_map(|nickname| Act::Login { nickname }),
        2 => Just(Act::Gone),
        5 => acts::lose(),
        5 => Just(Act::Resumed),
        1 => Just(Act::Stranger),
        22 => acts::enter(),
        9 => acts::look_around(),
        1 => Just(Act::Ask { family: Family::Login, verb: "logout", path: "/" }),
        45 => acts::grab(),
        8 => acts::keep(),
        40 => acts::hand_over(),
        25 => acts::answer(),
        6 => acts::share(),
        10 => acts::verdict(),
        4 => acts::show_out(),
        1 => (0..VARIANTS).prop_map(Act::Configure),
        1 => Just(delete_token),
        3 => Just(create_token),
        9 => acts::create(),
        45 => acts::message().prop_map(Act::Send),
        12 => Just(Act::Again),
        4 => Just(Act::Tick),
    ]
}
