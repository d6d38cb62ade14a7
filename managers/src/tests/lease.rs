//! The rule of M29, and first come, first served.

use mom_proto::Verb;

use super::{Ask, GRAB, ask, build, of, short};
use crate::{Expiry, Terms};

const LEASE: u64 = 180_000_000;

fn check(kind: &str, table: &[(&str, Ask<'_>, &str)]) {
    let mut manager = build(of(kind).with("lease", 180_000));
    for (why, question, expected) in table {
        assert_eq!(short(&ask(&mut *manager, question)), *expected, "{kind}: {why}");
    }
}

/// Bob at a level owns the token since 0, and alice asks at a level and time.
fn held(by: i32, level: i32, now: u64) -> Ask<'static> {
    Ask {
        level,
        owner: Some(("bob", by, false)),
        lease_end: Some(LEASE),
        now,
        ..GRAB
    }
}

fn own(now: u64) -> Ask<'static> {
    Ask {
        owner: Some(("alice", 1, true)),
        lease_end: Some(LEASE),
        now,
        ..GRAB
    }
}

#[test]
fn level_or_lease_is_m29() {
    let held_until_then = "level-or-lease: held at 180000000";
    check(
        "level-or-lease",
        &[
            ("free", GRAB, "allow"),
            ("an equal level waits", held(1, 1, 0), held_until_then),
            ("a lower level waits", held(5, 1, 0), held_until_then),
            ("a strictly higher level takes it", held(1, 2, 0), "displace"),
            ("also a negative one", held(-2, -1, 0), "displace"),
            (
                "up to the last microsecond",
                held(1, 1, LEASE - 1),
                held_until_then,
            ),
            ("the lease's end is late", held(1, 1, LEASE), "displace"),
            ("then also for a lower level", held(5, 1, LEASE), "displace"),
            ("asking for one's own", own(0), "displace"),
            ("also after the lease", own(LEASE), "displace"),
            (
                "without end",
                Ask {
                    lease_end: None,
                    ..held(1, 1, u64::MAX)
                },
                "level-or-lease: held",
            ),
            (
                "only grabs are its business",
                Ask {
                    verb: Verb::Renew,
                    ..held(1, 1, 0)
                },
                "allow",
            ),
            (
                "also sends",
                Ask {
                    verb: Verb::Send,
                    ..held(1, 1, 0)
                },
                "allow",
            ),
        ],
    );
}

#[test]
fn first_come_knows_no_level() {
    let held_until_then = "first-come: held at 180000000";
    check(
        "first-come",
        &[
            ("free", GRAB, "allow"),
            ("an equal level waits", held(1, 1, 0), held_until_then),
            ("a higher level waits", held(1, 9, 0), held_until_then),
            ("the lease's end is late", held(1, 1, LEASE), "allow"),
            ("asking for one's own", own(0), "allow"),
            (
                "without end",
                Ask {
                    lease_end: None,
                    ..held(1, 9, u64::MAX)
                },
                "first-come: held",
            ),
        ],
    );
}

#[test]
fn terms_are_those_of_the_file() {
    let terms = |lease: Option<u64>, expiry| Terms {
        lease,
        expiry,
        ..Terms::default()
    };
    for (spec, expected) in [
        (of("level-or-lease"), terms(Some(LEASE), Expiry::Lazy)),
        (
            of("level-or-lease").with("lease", 1).with("expiry", "eager"),
            terms(Some(1000), Expiry::Eager),
        ),
        (of("first-come"), terms(None, Expiry::Lazy)),
        (of("first-come").with("lease", 2), terms(Some(2000), Expiry::Lazy)),
        (of("open"), Terms::default()),
        (
            of("chain").with(
                "of",
                vec!["open".into(), of("first-come").with("lease", 3).into()],
            ),
            terms(Some(3000), Expiry::Lazy),
        ),
    ] {
        assert_eq!(build(spec.clone()).terms(), expected, "{spec:?}");
    }
}
