//! The oracle on bodies and words that are made up: what it finds, and what it lets pass.

use super::log::{Hindered, Log, Micros, Sample, Seen};
use super::rules::{GONE, Rule, Spec, judge};

const MS: Micros = 1_000;

fn spec() -> Spec {
    Spec {
        name: "made up",
        least: vec![0.15, 0.3],
        turns: Some(1),
        tolerance: vec![2.0, 2.0],
        stopping: 200 * MS,
        hold: 500 * MS,
        swings: false,
    }
}

/// A body that has these speeds, mm/s, each until that many ms.
fn body(parts: &[(i64, f64)]) -> Vec<Sample> {
    let (mut x, mut at) = (0.0, 0);
    let mut samples = Vec::new();
    for (until, speed) in parts {
        while at < until * MS {
            samples.push(Sample {
                at,
                place: vec![x, 0.0],
            });
            x += speed * 0.01;
            at += 10 * MS;
        }
    }
    samples
}

fn found(parts: &[(i64, f64)], seen: &[(i64, Seen)]) -> Vec<Rule> {
    let log = Log {
        bodies: vec![body(parts)],
        seen: seen.iter().map(|(ms, seen)| (ms * MS, seen.clone())).collect(),
        pause: 0,
    };
    let mut rules: Vec<Rule> = judge(&log, &spec()).iter().map(|found| found.rule).collect();
    rules.dedup();
    rules
}

fn state(stop: u64, stopped: bool, moving: bool, at: f64) -> Seen {
    let at = Some(at);
    Seen::State {
        stopped,
        stop,
        moving,
        rests: !moving,
        at,
    }
}

fn command(owner: &str, ways: f64) -> Seen {
    Seen::Command {
        owner: owner.to_owned(),
        ways,
        fenced: true,
    }
}

fn grant(owner: &str, fence: u64) -> Seen {
    Seen::Grant {
        owner: owner.to_owned(),
        fence,
    }
}

const STOP: Seen = Seen::Stop { number: 7 };
const UNSTOP: Seen = Seen::Unstop { number: 7 };

#[test]
fn what_stands_when_it_is_stopped_and_moves_when_it_is_let_go_is_right() {
    let parts = [(1000, 300.0), (2900, 0.0), (3500, -300.0), (4000, 0.0)];
    let seen = [
        (1000, STOP),
        (1010, state(7, true, true, 300.0)),
        (1400, state(7, true, false, 300.0)),
        // So shortly before it moves that it may have begun before, by the samples alone.
        (2890, UNSTOP),
        (2895, command("alice", -1.0)),
    ];
    assert_eq!(found(&parts, &seen), []);
}

#[test]
fn what_begins_after_its_word_is_found_and_so_is_what_rolls_on() {
    let begins = [(1000, 300.0), (1500, 0.0), (1600, 300.0), (5000, 0.0)];
    let seen = [(1000, STOP), (1010, state(7, true, true, 300.0))];
    assert_eq!(
        found(&begins, &seen),
        [Rule::BeginsAfterStopped, Rule::RollsOnAfterStopped]
    );
    let rolls = [(1700, 300.0), (5000, 0.0)];
    assert_eq!(found(&rolls, &seen), [Rule::RollsOnAfterStopped]);
    // It becomes faster again before it stands.
    let pushed = [(1000, 300.0), (1150, 100.0), (1340, 300.0), (5000, 0.0)];
    assert_eq!(found(&pushed, &seen), []);
    let late = [(1000, 300.0), (1180, 100.0), (1300, 300.0), (5000, 0.0)];
    assert_eq!(found(&late, &seen), [Rule::BeginsAfterStopped]);
}

#[test]
fn after_the_hubs_receipt_a_device_that_is_out_of_reach_has_until_it_is_gone() {
    let seen = [(1000, STOP)];
    let gone = GONE / MS;
    assert_eq!(found(&[(1000 + gone + 300, 300.0), (6000, 0.0)], &seen), []);
    let begins = [(1000 + gone + 600, 0.0), (4000, 300.0), (6000, 0.0)];
    let both = [Rule::BeginsAfterStop, Rule::RollsOnAfterStop];
    assert_eq!(found(&begins, &seen), both);
    assert_eq!(found(&[(6000, 300.0)], &seen), [Rule::RollsOnAfterStop]);
}

#[test]
fn an_old_owners_motion_and_a_new_ones_before_rest_are_found() {
    let seen = [
        (0, grant("alice", 1)),
        (10, command("alice", 1.0)),
        (2000, grant("bob", 2)),
        (2001, grant("bob", 2)),
        (2010, command("bob", -1.0)),
    ];
    let right = [(2000, 300.0), (2400, 0.0), (3000, -300.0), (4000, 0.0)];
    assert_eq!(found(&right, &seen), []);
    let at_once = [(2000, 300.0), (3000, -300.0), (4000, 0.0)];
    assert_eq!(found(&at_once, &seen), [Rule::FirstMotionAtRest]);
    let old = [(2000, 300.0), (2600, 0.0), (3000, 300.0), (4000, 0.0)];
    assert_eq!(found(&old, &seen), [Rule::OldOwner]);
}

#[test]
fn what_rests_by_its_word_stays_where_it_says_it_is() {
    let seen = [(1000, state(0, false, false, 0.0))];
    assert_eq!(found(&[(2000, 0.0)], &seen), []);
    assert_eq!(found(&[(1000, 0.0), (2000, 4.0)], &seen), [Rule::MovesAtRest]);
    assert_eq!(found(&[(900, 100.0), (2000, 0.0)], &seen), [Rule::WrongPlace]);
    // A command is under way, and may have begun meanwhile.
    let seen = [(900, command("alice", 1.0)), (1000, state(0, false, false, 0.0))];
    assert_eq!(found(&[(950, 0.0), (2000, 100.0)], &seen), []);
}

#[test]
fn what_has_lost_its_link_or_its_program_stands() {
    let hinder = |what, begins| Seen::Hinder { what, begins };
    let lost = [
        (1000, hinder(Hindered::Link, true)),
        (5000, hinder(Hindered::Link, false)),
    ];
    assert_eq!(found(&[(2800, 300.0), (6000, 0.0)], &lost), []);
    assert_eq!(found(&[(4000, 300.0), (6000, 0.0)], &lost), [Rule::LinkLost]);
    let frozen = [
        (1000, hinder(Hindered::Program(1), true)),
        (5000, hinder(Hindered::Program(1), false)),
    ];
    assert_eq!(found(&[(1500, 300.0), (6000, 0.0)], &frozen), []);
    assert_eq!(
        found(&[(3000, 300.0), (6000, 0.0)], &frozen),
        [Rule::ProgramStandsStill]
    );
}

#[test]
fn what_was_sent_without_a_fence_ends_where_a_guard_appears() {
    let unfenced = Seen::Command {
        owner: "bob".to_owned(),
        ways: 1.0,
        fenced: false,
    };
    let seen = [(900, unfenced), (2000, Seen::Guarded)];
    assert_eq!(found(&[(1000, 0.0), (2300, 300.0), (4000, 0.0)], &seen), []);
    for wrong in [
        vec![(1000, 0.0), (4000, 300.0)],
        vec![
            (1000, 0.0),
            (2000, 300.0),
            (2600, 0.0),
            (2700, 300.0),
            (4000, 0.0),
        ],
    ] {
        assert_eq!(found(&wrong, &seen), [Rule::Unguarded]);
    }
    // What has an owner may go on.
    let seen = [(1900, command("alice", 1.0)), (2000, Seen::Guarded)];
    assert_eq!(found(&[(1000, 0.0), (4000, 300.0)], &seen), []);
}

#[test]
fn what_goes_on_beyond_its_time_is_found() {
    let owner = "alice".to_owned();
    let lasts = 500 * MS;
    let seen = [(900, command("alice", 1.0)), (1000, Seen::Last { owner, lasts })];
    assert_eq!(found(&[(1000, 0.0), (1500, 300.0), (4000, 0.0)], &seen), []);
    assert_eq!(
        found(&[(1000, 0.0), (3500, 300.0), (4000, 0.0)], &seen),
        [Rule::Deadline]
    );
}
