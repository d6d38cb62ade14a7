//! Random logs of inputs: whatever happens in whatever order, the hub keeps its promises (design §4).
//!
//! `MOM_CASES` sets the number of logs, `MOM_STEPS` their length. The nightly form, over 10⁶ inputs:
//!
//! ```sh
//! MOM_CASES=5000 MOM_STEPS=200 cargo test -p mom-hub --release --test random -- --nocapture
//! ```
#![expect(clippy::unwrap_used, reason = "a test that fails panics")]

mod acts;
mod answers;
mod disk;
mod follow;
mod handover;
mod kinds;
mod lab;
mod log;
mod look;
mod observer;
mod owners;
mod queues;
mod robots;
mod run;
mod seen;
mod steps;
mod tree;

use mom_hub::Effect;
use proptest::prelude::*;
use proptest::test_runner::TestCaseResult;

use crate::observer::Past;
use crate::run::Run;
use crate::seen::Seen;
use crate::steps::script;

fn number(key: &str, default: u32) -> u32 {
    let asked = std::env::var(key).ok();
    asked.and_then(|asked| asked.parse().ok()).unwrap_or(default)
}

fn cases() -> u32 {
    number("MOM_CASES", 60)
}

fn length() -> usize {
    usize::try_from(number("MOM_STEPS", 200)).unwrap()
}

/// Runs a log on a new hub with nothing in between; gives the effects of each input.
fn replay(past: &Past) -> Vec<Vec<Effect>> {
    let mut hub = past.start.hub();
    let inputs = past.inputs.iter().cloned();
    let effects = inputs.map(|(now, input)| {
        let mut effects = Vec::new();
        hub.handle(now, input, &mut effects);
        effects
    });
    effects.collect()
}

/// Neither looking at the hub between the steps nor ticks of its own change what it does; and the same log gives
/// the same effects.
fn check_replay(past: &Past) -> TestCaseResult {
    prop_assert_eq!(&replay(past), &past.effects);
    prop_assert_eq!(&replay(past), &past.effects);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn promises_hold_after_every_input(script in script(length()), gated: bool) {
        let mut run = Run::new(false, gated);
        run.play(&script);
        check_replay(&run.end())?;
    }

    #[test]
    fn promises_hold_while_records_are_stored(script in script(length()), gated: bool) {
        let mut run = Run::new(true, gated);
        run.play(&script);
        check_replay(&run.end())?;
    }

    #[test]
    fn promises_hold_over_a_restart(
        script in script(length()),
        later in script(length() / 2),
        luck: u64,
        gated: bool,
    ) {
        let mut run = Run::new(true, gated);
        run.play(&script);
        check_replay(&run.restart(luck))?;
        run.play(&later);
        check_replay(&run.end())?;
    }
}

/// The random logs reach what they are to test: grants, losses of every reason, refusals, both send paths.
#[test]
fn random_logs_reach_everything() -> TestCaseResult {
    use proptest::strategy::ValueTree;
    use proptest::test_runner::TestRunner;

    let mut runner = TestRunner::deterministic();
    let mut seen = Seen::default();
    for number in 0..LOGS {
        let mut draw = || -> Result<_, TestCaseError> {
            let tree = script(200).new_tree(&mut runner).map_err(TestCaseError::fail)?;
            Ok(tree.current())
        };
        let mut run = Run::new(number % 2 == 0, number % 4 < 2);
        run.play(&draw()?);
        if number % 2 == 0 {
            run.restart(number);
            run.play(&draw()?);
        }
        seen.add(&run.observer.seen);
        run.end();
    }
    let missing: Vec<&&str> = REACHED.iter().filter(|what| seen.count(what) == 0).collect();
    prop_assert!(missing.is_empty(), "never seen: {:?}\n{:?}", missing, seen);
    Ok(())
}

/// Logs in which all that follows is reached. The longer nightly form reaches more: what a gate stops, what has a rate.
const LOGS: u64 = 150;

const REACHED: &[&str] = &[
    "reason released",
    "reason expired",
    "reason preempted",
    "reason disconnected",
    "reason deleted",
    "reason broken",
    "reason revoked",
    "reason given",
    "reason returned",
    "lease over",
    "turn over",
    "not alive",
    "grabbed",
    "requested",
    "offer",
    "queued",
    "waits before others",
    "waits behind others",
    "inhibited",
    "uninhibited",
    "invited",
    "expelled",
    "consult",
    "expired",
    "bad-slot",
    "lapsed timed-out",
    "lapsed declined",
    "lapsed lost",
    "lapsed left",
    "halt",
    "lift",
    "joined",
    "left",
    "created",
    "count",
    "held",
    "timed-out",
    "withdrawn",
    "declined",
    "storage-failed",
    "try-later",
    "denied",
    "not-owner",
    "not-member",
    "no-offer",
    "too-late",
    "older-fence",
    "bad-fence",
    "unknown-peer",
    "unknown-path",
    "unknown-verb",
    "not-logged-in",
    "exists",
    "wrong-kind",
    "permanent",
    "full",
    "revoked",
    "answered later",
    "stored",
    "closed",
    "kept after a restart",
    "passed by its route",
    "refused by its route",
    "passed by the hub",
    "stopped",
    "command sent",
    "command obeyed",
];
