//! Some short lives of each kind, in each CI; `cargo xtask simulate` has more of them, and longer ones.

use std::time::Duration;

use mom_simulation::run::{Plan, run};
use mom_simulation::world::Panics;

const PLAN: Plan = Plan {
    seed: 0,
    time: Duration::from_secs(60),
    devices: 2,
    operators: 3,
    fault_each: Some(Duration::from_secs(5)),
};

/// One test, as it listens to the panics of the whole program.
#[test]
fn no_promise_is_broken_in_some_short_lives() {
    let panics = Panics::listen();
    let calm = Plan {
        fault_each: None,
        ..PLAN
    };
    let outcome = run(calm, &panics).expect("a world");
    assert!(outcome.broken.is_empty(), "{:#?}", outcome.broken);
    let count = |what: &str| outcome.counts.get(what).copied().unwrap_or_default();
    assert!(
        count("began") > 30 && count("obeyed") > 2 && count("unstops") > 2 && count("served") == 6,
        "too little was done: {:?}",
        outcome.counts
    );
    for seed in 1..=4 {
        let outcome = run(Plan { seed, ..PLAN }, &panics).expect("a world");
        assert!(
            outcome.broken.is_empty(),
            "{:#?}\nmore of it: cargo xtask simulate --seed {seed} --lives 1 --seconds 60 --fault-each 5 --facts",
            outcome.broken
        );
    }
}
