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
mod events;
mod follow;
mod handover;
mod kinds;
mod lab;
mod links;
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

use std::sync::atomic::{AtomicUsize, Ordering};

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

/// Logs of each test in the form of every day.
const SHORT: u32 = 60;

fn cases() -> u32 {
    number("MOM_CASES", SHORT)
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

/// Equal inputs give equal effects: once more, and without looking at the hub or ticks between the steps.
fn check_replay(past: &Past) -> TestCaseResult {
    prop_assert_eq!(&replay(past), &past.effects);
    report(past.inputs.len());
    Ok(())
}

/// Says how far the long form is: it runs for minutes.
#[expect(clippy::print_stderr, reason = "for who waits for it")]
fn report(inputs: usize) {
    static LOGS: AtomicUsize = AtomicUsize::new(0);
    static INPUTS: AtomicUsize = AtomicUsize::new(0);
    let inputs = inputs + INPUTS.fetch_add(inputs, Ordering::Relaxed);
    let logs = 1 + LOGS.fetch_add(1, Ordering::Relaxed);
    if cases() > SHORT && logs.is_multiple_of(500) {
        eprintln!("{logs} lives of hubs, {inputs} inputs");
    }
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

/// Logs in which all that follows is reached.
const LOGS: u64 = 400;

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
    "lapsed withdrawn",
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
    "passed with a rate",
    "stopped",
    "command sent",
    "command obeyed",
    "stopped by the broker's gate",
    "stopped by the robot's gate",
    "lost",
    "resumed",
    "halted at a loss",
    "stopped after a loss",
    "held by a lost owner",
    "refused at a loss",
    "asked anew at a loss",
    "expired while lost",
    "preempted while lost",
    "disconnected while lost",
    "granted while lost",
    "handed to who is lost",
    "closed while lost",
    "gone while lost",
    "not resumed in time",
    "gone like others",
    "lost twice",
    "lost by nobody",
    "resumed without a loss",
];
