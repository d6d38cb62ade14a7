//! What connections do, by kind.

use mom_proto::{Family, Map, Value};
use proptest::prelude::*;
use proptest::sample::select;

use crate::lab::PATHS;
use crate::steps::{Act, Message, SEATS, Who, guard};

const TOKENS: [&str; 8] = [
    "/lab/token",
    "/yard/key",
    "/yard/eager",
    "/yard/dead",
    "/yard/turns",
    "/yard/moody",
    "/yard/chaired",
    "/a/token",
];

fn path() -> impl Strategy<Value = &'static str> {
    select(&PATHS[..])
}

fn token() -> impl Strategy<Value = &'static str> {
    select(&TOKENS[..])
}

fn who() -> impl Strategy<Value = Who> {
    // The last is nobody.
    (0..=SEATS).prop_map(Who)
}

/// Losses of connections, with little time to come back, or much.
pub(crate) fn lose() -> impl Strategy<Value = Act> {
    let grace = select(vec![
        1,
        1_000_000,
        30_000_000,
        300_000_000,
        300_000_000,
        300_000_000,
    ]);
    grace.prop_map(|grace| Act::Lost { grace })
}

/// Joins: most of what there is lies in these.
pub(crate) fn enter() -> impl Strategy<Value = Act> {
    let inner = select(vec![
        "/lab",
        "/yard",
        "/a",
        "/lab/arm",
        "/yard/work",
        "/yard/press",
        "/yard/belt",
        "/yard/gate",
        "/yard/bay",
        "/yard/dock",
        "/yard/mill",
        "/yard/tap",
        "/a/arm",
        "/a/own",
        "/lab/talk",
    ]);
    prop_oneof![6 => inner, 1 => path()].prop_map(|path| Act::Ask {
        family: Family::Context,
        verb: "join",
        path,
    })
}

/// Leaving, deleting, looking.
pub(crate) fn look_around() -> impl Strategy<Value = Act> {
    let verbs = select(vec![
        "leave", "leave", "delete", "lookup", "list", "info", "members", "stats", "audit", "explain",
        "what-if", "grib",
    ]);
    (verbs, path()).prop_map(|(verb, path)| Act::Ask {
        family: Family::Context,
        verb,
        path,
    })
}

/// Grabs that wait, for a while or for ever, and that do not.
pub(crate) fn grab() -> impl Strategy<Value = Act> {
    let wait = prop_oneof![
        3 => Just(None),
        2 => select(vec![1, 1000, 2000, 60_000]).prop_map(|ms: i64| Some(Value::from(ms))),
        2 => Just(Some(Value::from("unlimited"))),
    ];
    (token(), wait).prop_map(|(path, wait)| Act::Tell {
        family: Family::Token,
        verb: "grab",
        path,
        content: wait.map_or_else(Map::new, |wait| Map::new().with("wait", wait)),
        peer: None,
    })
}

/// Renewing, giving back, looking; also where there is no token.
pub(crate) fn keep() -> impl Strategy<Value = Act> {
    let verbs = select(vec!["renew", "renew", "release", "release", "info", "grab"]);
    let path = prop_oneof![4 => token(), 1 => path()];
    (verbs, path).prop_map(|(verb, path)| Act::Ask {
        family: Family::Token,
        verb,
        path,
    })
}

/// Offers and requests.
pub(crate) fn hand_over() -> impl Strategy<Value = Act> {
    let within = || select(vec![None, None, Some(1), Some(1000), Some(2000)]);
    let time = select(vec![None, None, None, Some(1000), Some(3000)]);
    let commands = select(vec![None, None, None, None, Some(1), Some(2)]);
    let give = (token(), who(), within(), time, commands).prop_map(|(path, who, within, time, commands)| {
        let mut content = Map::new();
        for (key, value) in [("within", within), ("for", time), ("commands", commands)] {
            if let Some(value) = value {
                content.set(key, value);
            }
        }
        Act::Tell {
            family: Family::Token,
            verb: "give",
            path,
            content,
            peer: Some(("to", who)),
        }
    });
    let request = (token(), within()).prop_map(|(path, within)| Act::Tell {
        family: Family::Token,
        verb: "request",
        path,
        content: within.map_or_else(Map::new, |within| Map::new().with("within", within)),
        peer: None,
    });
    prop_oneof![3 => give, 2 => request]
}

/// Answers to offers and requests.
pub(crate) fn answer() -> impl Strategy<Value = Act> {
    let verb = select(vec!["accept", "accept", "decline"]);
    let rightly = prop::bool::weighted(0.9);
    let seen =
        (verb, any::<bool>(), 0..4_usize, rightly).prop_map(|(verb, offer, pick, rightly)| Act::Answer {
            verb,
            offer,
            pick,
            rightly,
        });
    let blind = (
        select(vec!["accept", "decline"]),
        token(),
        prop::option::of(who()),
    )
        .prop_map(|(verb, path, who)| Act::Tell {
            family: Family::Token,
            verb,
            path,
            content: Map::new(),
            peer: who.map(|who| ("peer", who)),
        });
    prop_oneof![5 => seen, 1 => blind]
}

/// Holding together, and breaking.
pub(crate) fn share() -> impl Strategy<Value = Act> {
    let verb = select(vec!["inhibit", "inhibit", "uninhibit", "uninhibit", "break"]);
    (verb, token()).prop_map(|(verb, path)| Act::Ask {
        family: Family::Token,
        verb,
        path,
    })
}

/// Verdicts, of who was asked or not, with a number that was seen or not.
pub(crate) fn verdict() -> impl Strategy<Value = Act> {
    let number = prop_oneof![9 => Just(None), 1 => (0..20_i64).prop_map(Some)];
    let rightly = prop::bool::weighted(0.9);
    (0..4_usize, rightly, number, any::<bool>(), any::<bool>()).prop_map(
        |(pick, rightly, number, allow, stands)| Act::Verdict {
            pick,
            rightly,
            number,
            allow,
            stands,
        },
    )
}

/// Invitations, and putting out; out of the root rarely.
pub(crate) fn show_out() -> impl Strategy<Value = Act> {
    let place = prop_oneof![
        6 => select(vec!["/lab", "/yard", "/a", "/lab/arm", "/yard/work", "/a/own"]),
        1 => Just("/"),
    ];
    let time = select(vec![None, Some(0), Some(1), Some(1000)]);
    (select(vec!["invite", "expel"]), place, who(), time).prop_map(|(verb, path, who, time)| {
        let content = match time.filter(|_| verb == "expel") {
            Some(time) => Map::new().with("for", time),
            None => Map::new(),
        };
        Act::Tell {
            family: Family::Context,
            verb,
            path,
            content,
            peer: Some(("peer", who)),
        }
    })
}

pub(crate) fn message() -> impl Strategy<Value = Message> {
    const CHANNELS: [&str; 13] = [
        "/lab/arm",
        "/lab/arm",
        "/lab/talk",
        "/yard/work",
        "/yard/press",
        "/yard/belt",
        "/yard/gate",
        "/yard/bay",
        "/yard/dock",
        "/yard/mill",
        "/yard/tap",
        "/yard/tap",
        "/a/arm",
    ];
    const NAMES: [&str; 6] = ["alice", "alice~2", "bob", "carol", "ally", "nobody"];
    let to = prop_oneof![
        4 => Just(None),
        1 => prop::collection::vec(select(&NAMES[..]), 1..3).prop_map(Some),
    ];
    let path = prop_oneof![12 => select(&CHANNELS[..]), 1 => Just("/a/own"), 1 => Just("/a/b")];
    let fence = prop_oneof![6 => Just(None), 1 => (0_u64..4).prop_map(Some)];
    let names = select(vec![
        "command", "command", "command", "say", "say", "stop", "unstop", "halt",
    ]);
    let echo = prop_oneof![Just(None), Just(Some(false))];
    (path, names, to, fence, echo, any::<bool>()).prop_map(|(path, name, to, fence, echo, receipt)| Message {
        path,
        name,
        to,
        fence,
        echo,
        receipt,
    })
}

/// Things that are made, rightly or not.
pub(crate) fn create() -> impl Strategy<Value = Act> {
    let kind = select(vec!["session", "session", "channel", "token", "castle"]);
    let eager = Map::new()
        .with("kind", "level-or-lease")
        .with("lease", 1000)
        .with("expiry", "eager");
    let words = select(vec![
        "open",
        "closed",
        "first-come",
        "level-or-lease",
        "lab",
        "nobody",
        "own",
        "moody",
        "turns",
    ]);
    let manager = prop_oneof![
        6 => Just(None),
        2 => words.prop_map(|name| Some(Value::from(name))),
        1 => Just(Some(Value::Map(eager))),
    ];
    let guarded = prop_oneof![1 => Just(None), 1 => path().prop_map(Some)];
    let presence = select(vec![None, None, Some("counts"), Some("none")]);
    let lease = prop_oneof![3 => Just(None), 1 => Just(Some(1000))];
    let spec = (kind, manager, guarded, presence, any::<bool>(), lease).prop_map(
        |(kind, manager, guarded, presence, transient, lease)| {
            let mut spec = Map::new().with("kind", kind).with("transient", transient);
            if let Some(manager) = manager {
                spec.set("manager", manager);
            }
            if let Some(token) = guarded.filter(|_| kind == "channel") {
                spec.set("guard", guard(token, "command"));
            }
            if let Some(presence) = presence {
                spec.set("presence", presence);
            }
            if let Some(lease) = lease.filter(|_| kind == "token") {
                spec.set("lease", lease);
            }
            spec
        },
    );
    (path(), spec).prop_map(|(path, spec)| Act::Create { path, spec })
}
