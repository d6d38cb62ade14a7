//! Random logs of inputs: whatever happens in whatever order, the hub keeps its promises (design §4).
//!
//! `MOM_CASES` sets the number of logs, 256 without it.
#![expect(clippy::unwrap_used, reason = "a test that fails panics")]

mod lab;
mod observer;
mod steps;

use mom_hub::{Effect, Hub};
use proptest::prelude::*;
use proptest::test_runner::TestCaseResult;

use crate::observer::Observer;
use crate::steps::{Log, Step, steps};

const STEPS: usize = 200;

fn cases() -> u32 {
    let asked = std::env::var("MOM_CASES").ok();
    asked.and_then(|cases| cases.parse().ok()).unwrap_or(256)
}

/// Runs a log on a new hub with nothing in between; gives the effects of each step.
fn replay(steps: &[Step]) -> Vec<Vec<Effect>> {
    let mut hub: Hub = lab::hub();
    let mut log = Log::default();
    let handle = |step| {
        let (now, input) = log.next(step);
        let mut effects = Vec::new();
        hub.handle(now, input, &mut effects);
        effects
    };
    steps.iter().map(handle).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn promises_hold_after_every_input(steps in steps(STEPS)) {
        let mut observer = Observer::new(lab::hub());
        let mut log = Log::default();
        for step in &steps {
            let (now, input) = log.next(step);
            observer.take(now, &input);
        }
        // Neither looking at the hub between the steps nor ticks of its own change what it does; and the same
        // log gives the same effects.
        prop_assert_eq!(&replay(&steps), &observer.effects);
        prop_assert_eq!(&replay(&steps), &observer.effects);
    }
}

/// The random logs reach what they are to test: grants, losses of every reason, refusals, both send paths.
#[test]
fn random_logs_reach_everything() -> TestCaseResult {
    use proptest::strategy::ValueTree;
    use proptest::test_runner::TestRunner;

    let mut runner = TestRunner::deterministic();
    let mut seen = observer::Seen::default();
    for _ in 0..60 {
        let steps = steps(STEPS)
            .new_tree(&mut runner)
            .map_err(TestCaseError::fail)?
            .current();
        let mut observer = Observer::new(lab::hub());
        let mut log = Log::default();
        for step in &steps {
            let (now, input) = log.next(step);
            observer.take(now, &input);
        }
        seen.add(&observer.seen);
    }
    for what in [
        "released",
        "expired",
        "preempted",
        "disconnected",
        "deleted",
        "grabbed",
        "halt",
        "lift",
        "joined",
        "left",
        "created",
        "count",
        "held",
        "denied",
        "not-owner",
        "not-member",
        "older-fence",
        "bad-fence",
        "unknown-peer",
        "unknown-path",
        "not-logged-in",
        "exists",
        "wrong-kind",
        "permanent",
        "full",
        "passed by its route",
        "refused by its route",
        "passed by the hub",
    ] {
        prop_assert!(seen.count(what) > 0, "never seen: {}\n{:?}", what, seen);
    }
    Ok(())
}
