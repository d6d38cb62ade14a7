//! How often and how much.

use std::sync::Arc;

use mom_proto::{Map, Value, Verb};
use proptest::prelude::*;

use super::{Ask, GRAB, ask, build, of, short, text, words};
use crate::bucket::{Over, RateCounts};
use crate::{Bucket, GivenAnswer, Rate, Scope, Standing};

fn quota(limits: Vec<Map>) -> Map {
    let limits: Vec<Value> = limits.into_iter().map(Value::from).collect();
    of("quota").with("limits", limits)
}

fn limit(verbs: &[&str]) -> Map {
    Map::new().with("verbs", words(verbs))
}

fn bucket(per_second: u64, burst: u64) -> Bucket {
    Bucket { per_second, burst }
}

const SEND: Ask<'_> = Ask {
    verb: Verb::Send,
    message: Some("say"),
    ..GRAB
};

#[test]
#[rustfmt::skip]
fn messages_pass_at_a_rate_that_the_broker_counts() {
    let staff = Map::new().with("min-level", 5).with("parcels", 100).with("burst", 200).with("bytes", 4096);
    let all = Map::new().with("parcels", 10).with("bytes", 1000).with("bytes-burst", 5000);
    let cut = Map::new().with("users", words(&["mallory"])).with("bytes", 1);
    let mut manager = build(quota(vec![cut, staff, all]));
    for (user, level, parcels, bytes) in [
        ("carol", 5, bucket(100, 200), bucket(4096, 4096)),
        ("alice", 4, bucket(10, 10), bucket(1000, 5000)),
        // The first limit that fits, whatever comes after.
        ("mallory", 9, Bucket::UNLIMITED, bucket(1, 1)),
    ] {
        let verdict = ask(&mut *manager, &Ask { user, level, ..SEND });
        let rate = Some(Rate { parcels, bytes });
        let standing = Standing::Stands { scope: Scope::AnyName, until: None, rate, max_age: None };
        assert_eq!((short(&verdict).as_str(), verdict.standing), ("allow", standing), "{user}");
    }
    for (verb, message) in [(Verb::Stop, "stop"), (Verb::Unstop, "unstop")] {
        let verdict = ask(&mut *manager, &Ask { verb, message: Some(message), ..SEND });
        assert_eq!(verdict.standing.rate(), None, "{verb} is never limited");
    }
}

#[test]
fn a_message_that_no_limit_is_about_has_none() {
    let mut manager = build(quota(vec![Map::new().with("min-level", 5).with("parcels", 1)]));
    let verdict = ask(&mut *manager, &SEND);
    assert_eq!(verdict.standing, crate::Verdict::allow_always().standing);
}

#[test]
#[rustfmt::skip]
fn other_verbs_are_counted_by_peer_and_limit() {
    let mut manager = build(quota(vec![
        limit(&["grab"]).with("parcels", 2),
        limit(&["*"]).with("parcels", 1).with("bytes", 10),
    ]));
    let info = Ask { verb: Verb::Info, ..GRAB };
    let done = [GivenAnswer { label: "x".into(), by: None, allow: false, stands: false, text: String::new() }];
    for (why, question, expected) in [
        ("a full bucket", GRAB, "allow"),
        ("has two", GRAB, "allow"),
        ("and no third", GRAB, "quota/limit 1: over-quota at 500000"),
        ("what is refused costs nothing", GRAB, "quota/limit 1: over-quota at 500000"),
        ("the same request again is counted already", Ask { answers: &done, ..GRAB }, "allow"),
        ("another peer has its own", Ask { user: "bob", ..GRAB }, "allow"),
        ("another limit too", info, "allow"),
        ("which is over as well", info, "quota/limit 2: over-quota at 1000000"),
        (
            "with other verbs of that limit",
            Ask { verb: Verb::Members, ..GRAB },
            "quota/limit 2: over-quota at 1000000",
        ),
        ("one µs too early", Ask { now: 499_999, ..GRAB }, "quota/limit 1: over-quota at 500000"),
        ("in time", Ask { now: 500_000, ..GRAB }, "allow"),
        ("once", Ask { now: 500_000, ..GRAB }, "quota/limit 1: over-quota at 1000000"),
        ("all of it", Ask { now: 1_000_000, size: 10, ..info }, "allow"),
        (
            "nothing is left of the bytes",
            Ask { now: 2_000_000, size: 11, ..info },
            "quota/limit 2: over-quota",
        ),
        ("or of the parcels", Ask { now: 2_000_000, size: 10, ..info }, "allow"),
        ("giving up is free", Ask { verb: Verb::Release, now: 2_000_000, ..GRAB }, "allow"),
        ("a stop is free", Ask { verb: Verb::Stop, now: 2_000_000, ..GRAB }, "allow"),
    ] {
        assert_eq!(short(&ask(&mut *manager, &question)), expected, "{why}");
    }
}

#[test]
#[rustfmt::skip]
fn a_refusal_says_how_much_one_may() {
    let mut manager =
        build(quota(vec![limit(&["create"]).with("parcels", 1).with("bytes", 10).with("bytes-burst", 20)]));
    let create = Ask { verb: Verb::Create, path: "/x", ..GRAB };
    assert!(ask(&mut *manager, &create).is_allow());
    let verdict = ask(&mut *manager, &create);
    assert_eq!(text(&verdict), "alice may create /x no more than 1 times a second and 10 bytes a second");
    let verdict = ask(&mut *manager, &Ask { size: 21, ..create });
    assert_eq!(text(&verdict), "alice may create /x with 20 bytes at once at most");
}

#[test]
fn peers_with_full_buckets_are_forgotten_and_a_full_table_denies() {
    let rate = Rate {
        parcels: bucket(1, 2),
        bytes: Bucket::UNLIMITED,
    };
    let mut counts = RateCounts::new(rate, 2);
    let [alice, bob, carol]: [Arc<str>; 3] = ["alice", "bob", "carol"].map(Into::into);
    for (peer, now, expected) in [
        (&alice, 0, Ok(())),
        (&alice, 0, Ok(())),
        (&bob, 10, Ok(())),
        (&carol, 20, Err(Over::Crowded(1_000_010))),
        // Who is counted already is not shut out.
        (&bob, 20, Ok(())),
        (&carol, 1_000_010, Err(Over::Crowded(2_000_000))),
        (&carol, 1_999_999, Err(Over::Crowded(2_000_000))),
        (&carol, 2_000_000, Ok(())),
        (&alice, 2_000_000, Err(Over::Crowded(2_000_010))),
        (&alice, 2_000_010, Ok(())),
    ] {
        assert_eq!(counts.take(peer, 0, now), expected, "{peer} at {now}");
    }
}

#[test]
fn the_highest_rates_and_times_do_not_overflow() {
    let most = crate::bucket::HIGHEST;
    let mut counts = RateCounts::new(
        Rate {
            parcels: bucket(1, most),
            bytes: bucket(most, 1),
        },
        1,
    );
    let peer: Arc<str> = "alice".into();
    assert_eq!(counts.take(&peer, usize::MAX, 0), Err(Over::Never));
    assert_eq!(counts.take(&peer, 1, 0), Ok(()));
    assert_eq!(counts.take(&peer, 1, 0), Err(Over::Until(1)));
    assert_eq!(counts.take(&peer, 1, u64::MAX), Ok(()));
    assert_eq!(counts.take(&peer, 1, u64::MAX), Err(Over::Until(u64::MAX)));
}

proptest! {
    /// No span of time lets more through than its rate and one burst, and what is refused passes at the time that
    /// the refusal names, but not before.
    #[test]
    fn a_bucket_is_exact(
        (rate, burst) in (1_u64..50, 1_u64..20),
        steps in prop::collection::vec((0_u64..300_000, 1_usize..25), 1..60),
    ) {
        let peer: Arc<str> = "alice".into();
        let mut counts = RateCounts::new(Rate { parcels: Bucket::UNLIMITED, bytes: bucket(rate, burst) }, 1);
        let mut passed: Vec<(u64, u64)> = Vec::new();
        let mut now = 0;
        for (pause, size) in steps {
            now += pause;
            match counts.take(&peer, size, now) {
                Ok(()) => passed.push((now, size as u64)),
                Err(Over::Never) => prop_assert!(size as u64 > burst),
                Err(Over::Crowded(_)) => prop_assert!(false, "one peer has room"),
                Err(Over::Until(time)) => {
                    prop_assert!(time > now);
                    prop_assert_eq!(counts.take(&peer, size, time - 1), Err(Over::Until(time)));
                    prop_assert_eq!(counts.take(&peer, size, time), Ok(()));
                    passed.push((time, size as u64));
                    now = time;
                }
            }
        }
        for (first, (begin, _)) in passed.iter().enumerate() {
            let mut sum = 0;
            for (end, size) in &passed[first..] {
                sum += size * 1_000_000;
                prop_assert!(sum <= burst * 1_000_000 + (end - begin) * rate, "{:?}", passed);
            }
        }
    }
}
