//! The controller with the simulated arm and drawn images, in virtual time.

use fastrand::Rng;
use mom_rehearsal::{Outcome, Start, Trouble};
use mom_servo::control::ALIGNED;
use proptest::prelude::*;
use proptest::test_runner::Config;

/// A start from this seed, ended within five minutes of its own time.
fn rehearse(seed: u64, degrees: f64, delay_ms: i64, jitter_ms: i64) -> Outcome {
    let mut start = Start::random(&mut Rng::with_seed(seed), degrees, delay_ms * 1000);
    start.jitter = jitter_ms * 1000;
    start.rehearse(300)
}

#[test]
fn without_a_delay_and_with_right_matrices() {
    let end = rehearse(1, 0.0, 0, 0);
    assert!(
        end.failure.is_none() && end.error < ALIGNED && end.turned < 4.0,
        "{end:?}"
    );
    assert!(end.seconds < 30.0 && end.progress.commands < 30, "{end:?}");
    assert!(
        end.progress
            .miss
            .is_some_and(|miss| (miss.level() - end.error).abs() < 2.0),
        "{end:?}"
    );
}

/// No command waits for the image of the one before: that would take some twenty times the delay.
#[test]
fn a_second_each_way_neither_oscillates_nor_doubles_the_commands() {
    let [near, far] = [0, 1000].map(|delay| rehearse(4, 2.0, delay, 0));
    assert!(far.failure.is_none() && far.error < ALIGNED, "{far:?}");
    assert!(
        far.progress.commands <= near.progress.commands + 8,
        "{near:?} {far:?}"
    );
    assert!(far.seconds < near.seconds + 25.0, "{near:?} {far:?}");
    let [delay, error] = far.progress.command_delay;
    assert!(
        (delay - 1_000_000).abs() < 60_000 && error < 20_000,
        "it is measured: {far:?}"
    );
}

/// mm by which the tip may be off the straight way of its phase, whatever delays: docs/lab.md.
const STRAY: f64 = 100.0;

/// Whatever comes late, in a bunch or not at all, it aligns the blocks, or ends and says why; never far off its way.
fn stays_on_its_way(seed: u64, delay_ms: i64, trouble: Trouble) -> Outcome {
    let mut start = Start::random(&mut Rng::with_seed(seed), 2.0, delay_ms * 1000);
    start.trouble = Trouble { seed, ..trouble };
    let end = start.rehearse(300);
    assert!(end.stray < STRAY && end.inside, "seed {seed}: {end:?}");
    match &end.failure {
        None => assert!(end.error < ALIGNED + 1.0, "seed {seed}: {end:?}"),
        Some(why) => assert!(
            why.len() > 10 && why != "it takes too long",
            "seed {seed}: {end:?}"
        ),
    }
    end
}

#[test]
fn images_that_are_lost_or_come_in_bunches_lead_nowhere_else() {
    let trouble = Trouble {
        dropped: 0.3,
        frozen: [4_000_000, 1_200_000],
        ..Trouble::default()
    };
    let end = stays_on_its_way(2, 300, trouble);
    assert!(end.failure.is_none(), "{end:?}");
}

/// The arm's program stands still for longer than a piece of a velocity may be late, as on a machine that does something else: nobody has
/// halted the arm, and it goes on from where it stands.
#[test]
fn an_arm_whose_program_stands_still_for_a_moment_is_driven_on() {
    let trouble = Trouble {
        stands: [5_000_000, 300_000],
        ..Trouble::default()
    };
    for seed in [1, 6] {
        let end = stays_on_its_way(seed, 20, trouble);
        assert!(end.failure.is_none(), "{end:?}");
    }
}

/// One that never takes a velocity up in time is given up.
#[test]
fn an_arm_whose_program_hardly_runs_is_given_up() {
    let trouble = Trouble {
        stands: [40_000, 400_000],
        ..Trouble::default()
    };
    let end = stays_on_its_way(1, 20, trouble);
    assert!(
        end.failure
            .as_deref()
            .is_some_and(|why| why.contains("stood still for")),
        "{end:?}"
    );
}

#[test]
fn blind_it_ends_within_two_seconds_of_the_limit_and_says_so() {
    let trouble = Trouble {
        blind: Some(5.0),
        ..Trouble::default()
    };
    let end = stays_on_its_way(1, 20, trouble);
    let why = end.failure.as_deref().unwrap_or_default();
    assert!(
        why.starts_with("sight: pictures of all cameras but one are ")
            && why.ends_with(" s old, 2.0 s is the limit"),
        "{end:?}"
    );
    assert!(end.unseen < 4.0, "2 s old, and at most 2 s later: {end:?}");
}

/// Commands that come late, each by another time, take the hand elsewhere than they should: the block may meet the table
/// before it is let go.
#[test]
fn commands_that_come_late_press_no_block_into_the_table() {
    for jitter in [300, 600] {
        let end = rehearse(5, 1.0, 20, jitter);
        assert!(
            end.failure.is_none() && end.error < ALIGNED,
            "{jitter} ms: {end:?}"
        );
    }
}

proptest! {
    #![proptest_config(Config { cases: 4, ..Config::default() })]

    #[test]
    fn it_is_never_far_off_its_way(
        seed in 0_u64..1_000_000,
        delay in 0_i64..500,
        dropped in 0.0..0.6_f64,
        often in 500_i64..5000,
        frozen in 0_i64..4000,
        stale in 0_i64..2000,
        wrong in 0_i64..300,
    ) {
        let trouble = Trouble {
            dropped,
            frozen: [often * 1000, frozen * 1000],
            stale: stale * 1000,
            wrong: wrong * 1000,
            ..Trouble::default()
        };
        stays_on_its_way(seed, delay, trouble);
    }

    #[test]
    fn it_converges_or_says_why_not(seed in 0_u64..1_000_000, degrees in 0.0..3.0_f64, delay in 0_i64..1000, jitter in 0_i64..500) {
        let end = rehearse(seed, degrees, delay, jitter);
        prop_assert!(end.inside, "{end:?}");
        match &end.failure {
            None => prop_assert!(end.error < ALIGNED + 1.0 && end.turned < 6.0, "{end:?}"),
            Some(why) => prop_assert!(why.len() > 10 && why != "it takes too long", "{end:?}"),
        }
    }
}
