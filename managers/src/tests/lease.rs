//! The rule of M29, and first come, first served.

use mom_proto::Verb;
use proptest::prelude::*;

use super::{Ask, GRAB, ask, build, of, short, text};
use crate::{Answer, Expiry, Standing, Terms};

const LEASE: u64 = 180_000_000;

fn check(kind: &str, table: &[(&str, Ask<'_>, &str)]) {
    super::check(of(kind).with("lease", 180_000), table);
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

fn inhibit(question: Ask<'_>) -> Ask<'_> {
    Ask {
        verb: Verb::Inhibit,
        ..question
    }
}

#[test]
#[rustfmt::skip]
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
            ("up to the last microsecond", held(1, 1, LEASE - 1), held_until_then),
            ("the lease's end is late", held(1, 1, LEASE), "displace"),
            ("then also for a lower level", held(5, 1, LEASE), "displace"),
            ("asking for one's own", own(0), "allow"),
            ("also after the lease", own(LEASE), "allow"),
            ("holding with others is not a grab", inhibit(held(1, 2, 0)), held_until_then),
            ("also after the lease", inhibit(held(1, 2, LEASE)), held_until_then),
            ("but of what is free", inhibit(GRAB), "allow"),
            ("or of one's own", inhibit(own(0)), "allow"),
            ("without end", Ask { lease_end: None, ..held(1, 1, u64::MAX) }, "level-or-lease: held"),
            ("only grabs are its business", Ask { verb: Verb::Renew, ..held(1, 1, 0) }, "allow"),
            ("also sends", Ask { verb: Verb::Send, ..held(1, 1, 0) }, "allow"),
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
                "holding with others is not a grab",
                inhibit(held(1, 9, 0)),
                held_until_then,
            ),
            ("but of what is free", inhibit(GRAB), "allow"),
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
fn an_equal_level_takes_it_where_the_file_says_so() {
    let held_until_then = "level-or-lease: held at 180000000";
    super::check(
        of("level-or-lease").with("equal", true),
        &[
            ("an equal level takes it", held(1, 1, 0), "displace"),
            ("a higher one too", held(1, 2, 0), "displace"),
            ("a lower one waits", held(2, 1, 0), held_until_then),
            (
                "holding with others is not a grab",
                inhibit(held(1, 1, 0)),
                held_until_then,
            ),
        ],
    );
}

#[test]
#[rustfmt::skip]
fn a_line_forms_where_the_file_says_so() {
    let line = "queue: level-or-lease: held at 180000000";
    let bounded = of("level-or-lease").with("hold", 60_000).with("notice", 5_000);
    for (spec, question, expected) in [
        (of("level-or-lease").with("queue", true), held(1, 1, 0), format!("{line} expected 180000000")),
        (bounded.clone(), held(1, 1, 0), format!("{line} expected 60000000")),
        (bounded.clone(), held(1, 1, 70_000_000), format!("{line} expected 75000000")),
        (bounded.clone(), held(1, 2, 0), "displace".to_owned()),
        (bounded.clone(), held(1, 1, LEASE), "displace".to_owned()),
        (bounded.with("queue", false), held(1, 1, 0), "level-or-lease: held at 180000000".to_owned()),
    ] {
        assert_eq!(short(&ask(&mut *build(spec.clone()), &question)), expected, "{spec:?}");
    }
}

#[test]
fn a_refusal_says_who_holds_it() {
    for kind in ["level-or-lease", "first-come", "queue"] {
        let mut manager = build(kind);
        for question in [held(1, 1, 0), inhibit(held(1, 1, 0))] {
            let verdict = ask(&mut *manager, &question);
            assert_eq!(text(&verdict), "/robot/token is held by bob", "{kind}");
            assert_eq!(verdict.rule.as_deref(), Some(kind));
        }
    }
}

proptest! {
    /// Threat 24: an equal level cannot preempt while the lease lasts, unless the file says so.
    #[test]
    fn nobody_is_displaced_by_an_equal(
        kind in prop::sample::select(vec!["level-or-lease", "queue", "first-come", "open", "closed"]),
        equal in any::<bool>(),
        levels in (-3..4, -3..4),
        lease_end in prop::option::of(0_u64..100),
        now in 0_u64..100,
        waiting in 0_usize..3,
    ) {
        let (by, level) = levels;
        let spec = of(kind);
        let level_or_lease = kind == "level-or-lease";
        let spec = if level_or_lease { spec.with("equal", equal).with("queue", waiting > 1) } else { spec };
        let question = Ask { lease_end, waiting, ..held(by, level, now) };
        let verdict = ask(&mut *build(spec), &question);
        let lasts = lease_end.is_none_or(|end| now < end);
        let outranks = level_or_lease && (level > by || equal && level == by);
        let displaced = matches!(verdict.answer, Answer::Allow(grant) if grant.displace);
        prop_assert_eq!(displaced, level_or_lease && (!lasts || outranks));
        prop_assert_eq!(verdict.is_allow() && lasts, lasts && (kind == "open" || outranks));
    }
}

#[test]
#[rustfmt::skip]
fn terms_are_those_of_the_file() {
    let terms = |lease: Option<u64>, expiry| Terms { lease, expiry, ..Terms::default() };
    let noticed = |lease, expiry| Terms { notice: 10_000_000, ..terms(lease, expiry) };
    let levels = |lease, expiry| Terms { by_level: true, ..noticed(lease, expiry) };
    for (spec, expected) in [
        (of("level-or-lease"), levels(Some(LEASE), Expiry::Lazy)),
        (of("level-or-lease").with("lease", 1).with("expiry", "eager"), levels(Some(1000), Expiry::Eager)),
        (
            of("level-or-lease").with("deadman", 5).with("hold", 6),
            Terms { deadman: Some(5000), hold: Some(6000), ..levels(Some(LEASE), Expiry::Lazy) },
        ),
        (
            of("queue").with("lease", 9).with("deadman", 5).with("hold", 6).with("notice", 0),
            Terms { deadman: Some(5000), hold: Some(6000), notice: 0, ..terms(Some(9000), Expiry::Lazy) },
        ),
        (of("queue").with("expiry", "eager"), noticed(None, Expiry::Eager)),
        (of("first-come"), terms(None, Expiry::Lazy)),
        (of("first-come").with("lease", 2), terms(Some(2000), Expiry::Lazy)),
        (of("open"), Terms::default()),
        (
            of("chain").with("of", vec!["open".into(), of("first-come").with("lease", 3).into()]),
            terms(Some(3000), Expiry::Lazy),
        ),
    ] {
        assert_eq!(build(spec.clone()).terms(), expected, "{spec:?}");
    }
}

#[test]
fn a_grab_is_asked_about_each_time() {
    for kind in ["level-or-lease", "first-come"] {
        let mut manager = build(of(kind).with("lease", 180_000));
        for verb in [Verb::Grab, Verb::Inhibit] {
            let verdict = ask(&mut *manager, &Ask { verb, ..GRAB });
            assert_eq!(verdict.standing, Standing::Once, "{kind}: {verb} of a free token");
        }
        let verdict = ask(
            &mut *manager,
            &Ask {
                verb: Verb::Renew,
                ..GRAB
            },
        );
        assert_ne!(verdict.standing, Standing::Once, "{kind}: a renewal");
    }
}

#[test]
fn a_lease_ends_as_the_file_says() {
    for kind in ["level-or-lease", "first-come"] {
        for (word, expiry) in [("lazy", Expiry::Lazy), ("eager", Expiry::Eager)] {
            let terms = build(of(kind).with("lease", 180_000).with("expiry", word)).terms();
            assert_eq!((terms.lease, terms.expiry), (Some(LEASE), expiry), "{kind}");
        }
    }
}
