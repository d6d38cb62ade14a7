//! The motion oracle: devices of lab, fleet and CUBO in worlds that freeze, cut, slow, stop, kill and hand over, by
//! seeds, and what their bodies do.
//!
//! `MOM_ORACLE_TRIALS` says how many trials there are of each device, `MOM_ORACLE_SEED` which is the first (or the only one, with
//! `MOM_ORACLE_TRIALS=1`), `MOM_ORACLE_DEVICE` which device alone.

mod body;
mod log;
mod plan;
mod planted;
mod rules;
mod rules_tests;
mod trial;
mod world;

use std::collections::BTreeMap;

use log::Seen;
use planted::Plant;
use tokio::task::JoinSet;
use trial::{Outcome, Trials};
use world::Kind;

/// Trials of each device in a normal run.
const TRIALS: u64 = 20;
/// Worlds of each device at once.
const SIDE_BY_SIDE: u64 = 4;
/// Trials that are judged in each of two worlds, one of each plot, within two rounds of which each fault has to be found.
const FOUND_WITHIN: u64 = 7;

fn asked(name: &str) -> Option<u64> {
    std::env::var(name).ok().and_then(|text| text.parse().ok())
}

/// What came of all trials of one kind of device.
#[derive(Debug, Default)]
struct Count {
    trials: u64,
    /// Those that are not judged, and why.
    unjudged: Vec<String>,
    /// What happened: motions, stops, grants, guards, what was hindered.
    happened: [usize; 5],
    stories: Vec<String>,
    rules: BTreeMap<String, u64>,
}

impl Count {
    fn add(&mut self, kind: Kind, outcome: &Outcome) {
        self.trials += 1;
        if let Some(why) = &outcome.unjudged {
            self.unjudged.push(format!("{}: {why}", outcome.seed));
            return;
        }
        let seen = |of: fn(&Seen) -> bool| outcome.log.seen.iter().filter(|(_, seen)| of(seen)).count();
        let happened = [
            rules::count(&outcome.log, &kind.spec()),
            seen(|seen| matches!(seen, Seen::Stop { .. })),
            seen(|seen| matches!(seen, Seen::Grant { .. })),
            seen(|seen| *seen == Seen::Guarded),
            seen(|seen| matches!(seen, Seen::Hinder { begins: true, .. })),
        ];
        self.happen(happened);
        for violation in &outcome.violations {
            *self.rules.entry(format!("{:?}", violation.rule)).or_default() += 1;
        }
        if !outcome.violations.is_empty() {
            self.stories.push(outcome.story(kind));
        }
    }
}

impl Count {
    fn happen(&mut self, happened: [usize; 5]) {
        for (sum, more) in self.happened.iter_mut().zip(happened) {
            *sum += more;
        }
    }
}

async fn try_all(kind: Kind, first: u64, trials: u64) -> Count {
    let mut count = Count::default();
    let mut world = Trials::of(kind, first).await;
    for seed in first..first + trials {
        let outcome = world.run(seed).await;
        count.add(kind, &outcome);
    }
    count
}

/// No body does what it may not, whatever happens to its programs and networks.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_body_moves_that_may_not() {
    let first = asked("MOM_ORACLE_SEED").unwrap_or(1);
    let trials = asked("MOM_ORACLE_TRIALS").unwrap_or(TRIALS);
    let only = std::env::var("MOM_ORACLE_DEVICE").ok();
    let mut worlds = JoinSet::new();
    for kind in Kind::ALL {
        if only.as_ref().is_some_and(|only| *only != kind.spec().name) {
            continue;
        }
        let side_by_side = asked("MOM_ORACLE_WORLDS").unwrap_or(SIDE_BY_SIDE).min(trials);
        for world in 0..side_by_side {
            let from = first + trials * world / side_by_side;
            let to = first + trials * (world + 1) / side_by_side;
            worlds.spawn(async move { (kind, try_all(kind, from, to - from).await) });
        }
    }
    let mut all: BTreeMap<&str, Count> = BTreeMap::new();
    while let Some(ended) = worlds.join_next().await {
        let (kind, count) = ended.expect("a world");
        let sum = all.entry(kind.spec().name).or_default();
        sum.trials += count.trials;
        sum.unjudged.extend(count.unjudged);
        sum.happen(count.happened);
        sum.stories.extend(count.stories);
        for (rule, times) in count.rules {
            *sum.rules.entry(rule).or_default() += times;
        }
    }
    for (name, count) in &all {
        eprintln!(
            "{name}: {} trials, not judged {:?}; {:?} motions, stops, grants, guards, hindrances; {} with violations {:?}",
            count.trials,
            count.unjudged,
            count.happened,
            count.stories.len(),
            count.rules
        );
    }
    let stories: Vec<&String> = all.values().flat_map(|count| &count.stories).collect();
    for story in &stories {
        eprintln!("{story}\n");
    }
    assert!(stories.is_empty(), "{} trials with violations", stories.len());
    let (trials, unjudged) = all.values().fold((0, 0), |(trials, unjudged), count| {
        (trials + count.trials, unjudged + count.unjudged.len() as u64)
    });
    assert!(
        unjudged * 5 <= trials,
        "{unjudged} of {trials} trials could not be judged"
    );
}

/// In which trial of a world the fault is found, by the rule that it breaks; of a device without one, any that it is said to have.
async fn finds(plant: Plant, first: u64) -> Option<(u64, String)> {
    let kind = Kind::Planted(plant);
    let mut world = Trials::of(kind, first).await;
    let mut judged = 0;
    for seed in first..first + 3 * FOUND_WITHIN {
        let outcome = world.run(seed).await;
        judged += u64::from(outcome.unjudged.is_none());
        if outcome.unjudged.is_some() {
            continue;
        }
        // A busy machine may let a fault pass once.
        let rounds = if plant == Plant::Nothing { 1 } else { 2 };
        if judged > rounds * FOUND_WITHIN {
            break;
        }
        let breaks = |rule| plant == Plant::Nothing || plant.breaks().contains(&rule);
        if outcome.violations.iter().any(|found| breaks(found.rule)) {
            let found = match plant {
                Plant::Nothing => outcome.story(kind),
                _ => format!("{:?}", plant.breaks()),
            };
            return Some((judged, found));
        }
    }
    None
}

/// A device with one fault does in some trial what it may not; the same one without a fault does not.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn each_planted_fault_is_found_and_nothing_where_none_is() {
    let first = asked("MOM_ORACLE_SEED").unwrap_or(1);
    let mut worlds = JoinSet::new();
    let plants = || Plant::FAULTS.into_iter().chain([Plant::Nothing]);
    for plant in plants() {
        for first in [first, first + FOUND_WITHIN] {
            worlds.spawn(async move { (plant, finds(plant, first).await) });
        }
    }
    let mut found = Vec::new();
    while let Some(ended) = worlds.join_next().await {
        if let (plant, Some((trials, what))) = ended.expect("a world") {
            eprintln!("{plant:?}: in trial {trials}: {what}");
            found.push(plant);
        }
    }
    let wrong = plants().filter(|plant| found.contains(plant) == (*plant == Plant::Nothing));
    let wrong: Vec<Plant> = wrong.collect();
    assert!(wrong.is_empty(), "{wrong:?}");
}
