//! One after the other.

use mom_proto::Verb;

use super::{Ask, GRAB, check, of};

/// Bob owns the token since 0 with a lease to 100 s, and alice asks.
const HELD: Ask<'_> = Ask {
    level: 9,
    owner: Some(("bob", 1, false)),
    lease_end: Some(100_000_000),
    now: 5_000_000,
    ..GRAB
};

#[test]
#[rustfmt::skip]
fn whoever_comes_later_waits() {
    let line = "queue: queue: held at 100000000 expected 100000000";
    let own = Ask { owner: Some(("alice", 1, true)), ..HELD };
    let endless = Ask { lease_end: None, ..HELD };
    check(
        of("queue").with("lease", 100_000),
        &[
            ("free", GRAB, "allow"),
            // The hub asks for each that waits at its turn.
            ("free, with others behind", Ask { waiting: 3, ..GRAB }, "allow"),
            ("one's own", own, "allow"),
            ("one's own, with others behind", Ask { waiting: 3, ..own }, "allow"),
            ("no level is high enough", HELD, line),
            ("nor a place further back another answer", Ask { waiting: 3, ..HELD }, line),
            ("a lease that is over", Ask { now: 100_000_000, ..HELD }, "allow"),
            ("a lease without end", endless, "queue: queue: held"),
            (
                "to hold with others is not a grab",
                Ask { verb: Verb::Inhibit, ..HELD },
                "queue: held at 100000000",
            ),
            ("also after the lease", Ask { verb: Verb::Inhibit, now: 100_000_000, ..HELD }, "queue: held at 100000000"),
            ("but of what is free", Ask { verb: Verb::Inhibit, ..GRAB }, "allow"),
            ("other verbs are not its business", Ask { verb: Verb::Break, ..HELD }, "allow"),
        ],
    );
}

#[test]
#[rustfmt::skip]
fn it_says_when_the_owner_is_done_at_the_latest() {
    let endless = Ask { lease_end: None, ..HELD };
    let held = "queue: queue: held at 100000000";
    check(
        of("queue").with("lease", 100_000).with("hold", 60_000).with("notice", 20_000),
        &[
            ("the longest hold", HELD, &format!("{held} expected 60000000")),
            ("not before the notice", Ask { now: 50_000_000, ..HELD }, &format!("{held} expected 70000000")),
            ("or the lease's end", Ask { now: 99_000_000, ..HELD }, &format!("{held} expected 100000000")),
            (
                "a hold counts from its begin",
                Ask { since: 1_000_000, ..HELD },
                &format!("{held} expected 61000000"),
            ),
            ("also without a lease", endless, "queue: queue: held expected 60000000"),
        ],
    );
}
