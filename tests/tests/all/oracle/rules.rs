//! The oracle: what a body may not do, as a function of what was seen.
//!
//! Times of words are those of their arrival in the test, so what a word promises held no later than that; times of
//! bodies are those of their traces. So each bound is counted from a time at or after the one that it is about, and a
//! body that is late by a bound is late indeed.

use std::fmt;

use super::body::{Look, Motion, looks, motions};
use super::log::{Hindered, Log, Micros, Sample, Seen};

/// A device hears at the latest so long after it was last heard of that its link is lost: three of its signs of life.
pub(super) const GONE: Micros = 1_500_000;
/// One way to and fro between device and hub, over the slowest network of a trial.
pub(super) const ROUND_TRIP: Micros = 300_000;
/// What a busy machine may add to any time, beside what it adds to this process.
const SLACK: Micros = 150_000;
/// It has stayed within its tolerance for so long before a new owner's first motion: 300 ms, of which the 30 may be
/// missing in which that is seen.
const RESTS: Micros = 270_000;
/// Trials in which this process itself stood still for longer are not judged.
pub(super) const MOST_PAUSE: Micros = 400_000;

/// What is declared of a device.
#[derive(Debug, Clone)]
pub(super) struct Spec {
    pub(super) name: &'static str,
    /// How far each number of its place may change in 30 ms at rest, and which of them goes on at 360°.
    pub(super) least: Vec<f64>,
    pub(super) turns: Option<usize>,
    /// By how much each may differ while it rests by its word.
    pub(super) tolerance: Vec<f64>,
    /// Within which it stands once it has been stopped.
    pub(super) stopping: Micros,
    /// How long what moves it goes on by itself when a program stands still, from when that had its last turn.
    pub(super) hold: Micros,
    /// Whether it also swings, to and fro by one call.
    pub(super) swings: bool,
}

/// What a body may not do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) enum Rule {
    BeginsAfterStopped,
    RollsOnAfterStopped,
    BeginsAfterStop,
    RollsOnAfterStop,
    OldOwner,
    FirstMotionAtRest,
    MovesAtRest,
    WrongPlace,
    Unguarded,
    LinkLost,
    ProgramStandsStill,
    Deadline,
    /// It is not at rest, by its word, for long after all is well.
    DoesNotComeToRest,
}

/// One thing that a body did and may not do.
#[derive(Debug, Clone)]
pub(super) struct Violation {
    pub(super) rule: Rule,
    pub(super) at: Micros,
    pub(super) words: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?} at {}: {}", self.rule, self.at, self.words)
    }
}

/// What keeps the device from its hub.
fn is_hubs(what: Hindered) -> bool {
    matches!(what, Hindered::Link | Hindered::Program(0))
}

/// What keeps the device's program from what it moves.
fn is_robots(what: Hindered) -> bool {
    matches!(what, Hindered::Wire | Hindered::Program(1..))
}

/// One body of a trial.
struct Body<'a> {
    spec: &'a Spec,
    log: &'a Log,
    samples: &'a [Sample],
    looks: Vec<Look>,
    motions: Vec<Motion>,
    slack: Micros,
}

/// Everything that the bodies of a trial did and may not do.
pub(super) fn judge(log: &Log, spec: &Spec) -> Vec<Violation> {
    let mut found = Vec::new();
    for samples in &log.bodies {
        let looks = looks(samples, &spec.least, spec.turns);
        let motions = motions(&looks, spec.least[0]);
        let slack = SLACK + 2 * log.pause;
        let body = Body {
            spec,
            log,
            samples,
            looks,
            motions,
            slack,
        };
        body.stops(&mut found);
        body.words_of_stops(&mut found);
        body.owners(&mut found);
        body.guards(&mut found);
        body.rests(&mut found);
        body.hindered(&mut found);
        body.deadlines(&mut found);
    }
    found.sort_by_key(|violation| (violation.at, violation.rule));
    found
}

/// How many motions there were.
pub(super) fn count(log: &Log, spec: &Spec) -> usize {
    let of = |samples: &Vec<Sample>| {
        let looks = looks(samples, &spec.least, spec.turns);
        motions(&looks, spec.least[0]).len()
    };
    log.bodies.iter().map(of).sum()
}

impl Body<'_> {
    fn seen(&self) -> impl DoubleEndedIterator<Item = (Micros, &Seen)> {
        self.log.seen.iter().map(|(at, seen)| (*at, seen))
    }

    fn add(&self, found: &mut Vec<Violation>, rule: Rule, at: Micros, words: String) {
        found.push(Violation { rule, at, words });
    }

    /// When a stop is lifted.
    fn freed(&self, stop: u64) -> Micros {
        let lifts = |(at, seen): (Micros, &Seen)| match seen {
            Seen::Unstop { number } if *number >= stop => Some(at),
            _ => None,
        };
        self.seen().find_map(lifts).unwrap_or(Micros::MAX)
    }

    /// The first motion that certainly begins within these times.
    fn begins(&self, from: Micros, to: Micros) -> Option<&Motion> {
        let mut motions = self.motions.iter();
        motions.find(|motion| motion.since > from && motion.seen < to)
    }

    /// When it is first seen to move within these times.
    fn moves(&self, from: Micros, to: Micros) -> Option<Micros> {
        let mut looks = self.looks.iter();
        let moves = looks.find(|look| look.from > from && look.at < to && look.speed > 1.0);
        moves.map(|look| look.at)
    }

    /// When which of these was hindered.
    fn hindrances(&self, which: fn(Hindered) -> bool) -> Vec<(Hindered, Micros, Micros)> {
        let mut all = Vec::new();
        for (at, seen) in self.seen() {
            let Seen::Hinder { what, begins } = seen else {
                continue;
            };
            if !which(*what) {
                continue;
            }
            let is_open = all.iter().any(|(open, _, to)| open == what && *to == Micros::MAX);
            if *begins {
                // What is hindered twice is freed by the first who frees it.
                if !is_open {
                    all.push((*what, at, Micros::MAX));
                }
            } else if let Some(open) = all
                .iter_mut()
                .rev()
                .find(|(open, _, to)| open == what && *to == Micros::MAX)
            {
                open.2 = at;
            }
        }
        all
    }

    /// Whether any of these was hindered within these times, or so shortly before that it is felt.
    fn is_hindered(&self, which: fn(Hindered) -> bool, from: Micros, to: Micros) -> bool {
        let all = self.hindrances(which);
        all.iter()
            .any(|(_, begin, end)| *begin < to && end.saturating_add(ROUND_TRIP + self.slack) > from)
    }

    /// How long the body may go on when its program, or the way to it, is hindered.
    fn hold(&self, from: Micros, to: Micros) -> Micros {
        match self.is_hindered(is_robots, from, to) {
            true => self.spec.hold,
            false => 0,
        }
    }

    /// After the hub's receipt of a stop.
    fn stops(&self, found: &mut Vec<Violation>) {
        for (at, seen) in self.seen() {
            let Seen::Stop { number } = seen else { continue };
            let free = self.freed(*number);
            let bound = at + GONE + ROUND_TRIP + self.slack;
            if let Some(motion) = self.begins(bound, free) {
                let late = (motion.since - at) / 1000;
                let words = format!("a motion begins {late} ms after the hub took stop {number}");
                self.add(found, Rule::BeginsAfterStop, motion.since, words);
            }
            let bound = bound + self.spec.stopping + self.hold(at, bound + self.spec.stopping);
            if let Some(moves) = self.moves(bound, free) {
                let late = (moves - at) / 1000;
                let words = format!("it moves {late} ms after the hub took stop {number}");
                self.add(found, Rule::RollsOnAfterStop, moves, words);
            }
        }
    }

    /// After the device's own word that it is stopped, by a stop that holds.
    fn words_of_stops(&self, found: &mut Vec<Violation>) {
        let mut known: Option<u64> = None;
        for (at, seen) in self.seen() {
            let Seen::State {
                stopped: true, stop, ..
            } = seen
            else {
                continue;
            };
            let free = self.freed(*stop);
            let ours = self
                .seen()
                .any(|(_, seen)| matches!(seen, Seen::Stop { number } if number == stop));
            if !ours || free <= at || known == Some(*stop) {
                continue;
            }
            known = Some(*stop);
            let most = at + self.spec.stopping;
            let hold = self.hold(at - GONE, most);
            // A gesture is one motion, to and fro, until its robot has heard of the stop or has rested by itself.
            let swings = if self.spec.swings { self.spec.hold } else { 0 };
            if let Some(motion) = self.begins(at + swings + self.slack, free) {
                let late = (motion.since - at) / 1000;
                let words = format!("a motion begins {late} ms after the device said that stop {stop} holds");
                self.add(found, Rule::BeginsAfterStopped, motion.since, words);
            }
            if let Some(moves) = self.moves(most + hold + self.slack, free) {
                let late = (moves - at) / 1000;
                let words = format!("it moves {late} ms after the device said that stop {stop} holds");
                self.add(found, Rule::RollsOnAfterStopped, moves, words);
            }
        }
    }

    /// Which way the body moves by commands of this owner, if it has sent any before.
    fn way_of(&self, owner: &str, before: Micros) -> Option<f64> {
        let of = |(at, seen): (Micros, &Seen)| match seen {
            Seen::Command { owner: who, ways, .. } if who == owner && at < before => Some(*ways),
            _ => None,
        };
        self.seen().rev().find_map(of)
    }

    /// When a peer sends what no fence guards, after this time.
    fn unfenced(&self, after: Micros) -> Micros {
        let is = |(at, seen): (Micros, &Seen)| {
            let is = matches!(seen, Seen::Command { fenced: false, .. });
            (is && at > after).then_some(at)
        };
        self.seen().find_map(is).unwrap_or(Micros::MAX)
    }

    /// What was sent without a fence, after a guard has appeared.
    fn guards(&self, found: &mut Vec<Violation>) {
        for (at, _) in self.seen().filter(|(_, seen)| **seen == Seen::Guarded) {
            // What was sent under a fence may have come behind the guard.
            let mut sent = self.seen().filter(|(time, _)| *time > at - GONE && *time <= at);
            if sent.any(|(_, seen)| matches!(seen, Seen::Command { fenced: true, .. })) {
                continue;
            }
            let hindered = self.is_hindered(|_| true, at - GONE, at + self.spec.stopping);
            let bound = at + if hindered { GONE } else { 0 } + ROUND_TRIP + self.slack;
            let rests = bound + self.spec.stopping + self.hold(at - GONE, bound + self.spec.stopping);
            let until = self.disturbed(at);
            let begins = self.begins(bound, until).map(|motion| motion.since);
            if let Some(moves) = self.moves(rests, until).into_iter().chain(begins).min() {
                let words = format!("it moves {} ms after a guard appeared", (moves - at) / 1000);
                self.add(found, Rule::Unguarded, moves, words);
            }
        }
    }

    /// What changes hands.
    fn owners(&self, found: &mut Vec<Violation>) {
        let mut grants: Vec<(Micros, &str, u64)> = self
            .seen()
            .filter_map(|(at, seen)| match seen {
                Seen::Grant { owner, fence } => Some((at, owner.as_str(), *fence)),
                _ => None,
            })
            .collect();
        // A grant is answered, and told to all.
        grants.dedup_by_key(|(.., fence)| *fence);
        for (index, (at, owner, fence)) in grants.iter().enumerate() {
            let next = grants.get(index + 1).map_or(Micros::MAX, |(at, ..)| *at);
            let next = next.min(self.unfenced(*at));
            let before = grants.get(..index).and_then(<[_]>::last);
            let Some((_, old, _)) = before.filter(|(_, old, _)| old != owner) else {
                continue;
            };
            let Some(theirs) = self.way_of(old, *at) else {
                continue;
            };
            if self.way_of(owner, Micros::MAX) == Some(theirs) {
                continue;
            }
            for motion in &self.motions {
                let is_theirs = motion.way * theirs > 3.0 * self.spec.least[0];
                // Who owns it next may have been told sooner than this test.
                if motion.since <= *at || motion.seen >= next.saturating_sub(SLACK) || !is_theirs {
                    continue;
                }
                let hindered = self.is_hindered(|_| true, *at - GONE, motion.since);
                let grace = if hindered { GONE } else { 0 };
                if motion.since > at + grace + ROUND_TRIP + self.slack {
                    let late = (motion.since - at) / 1000;
                    let words = format!(
                        "a motion {old}'s way begins {late} ms after {owner} was granted fence {fence}"
                    );
                    self.add(found, Rule::OldOwner, motion.since, words);
                }
            }
            let new = self.motions.iter().enumerate().find(|(_, motion)| {
                motion.until > *at && motion.since < next && motion.way * theirs < -3.0 * self.spec.least[0]
            });
            if let Some((place, motion)) = new
                && let Some(last) = place.checked_sub(1).and_then(|last| self.motions.get(last))
                && last.way * theirs > 0.0
                && last.until > *at - 100_000
                && let Some((index, far)) = self.strays(motion.since - RESTS, motion.since)
            {
                let rested = (motion.since - last.until) / 1000;
                let words = format!(
                    "{owner}'s first motion begins {rested} ms after {old}'s, and number {index} of its place has changed by {far:.1} just before"
                );
                self.add(found, Rule::FirstMotionAtRest, motion.since, words);
            }
        }
    }

    /// How many commands may be under way at this time.
    fn under_way(&self, at: Micros) -> usize {
        let mut open: Vec<&str> = Vec::new();
        for (_, seen) in self.seen().take_while(|(time, _)| *time <= at) {
            match seen {
                Seen::Command { owner, .. } => open.push(owner),
                // Of none that was sent in this trial, if there is none of its owner.
                Seen::Ended { owner } => {
                    if let Some(place) = open.iter().position(|other| other == owner) {
                        open.remove(place);
                    }
                }
                _ => {}
            }
        }
        open.len()
    }

    /// When something new may begin after this time.
    fn disturbed(&self, after: Micros) -> Micros {
        let disturbs = |(at, seen): (Micros, &Seen)| {
            let disturbs = matches!(seen, Seen::Command { .. } | Seen::Unstop { .. });
            (at > after && disturbs).then_some(at)
        };
        self.seen().find_map(disturbs).unwrap_or(Micros::MAX)
    }

    /// Which number of its place differs by more than its tolerance, and by how much.
    fn off(&self, from: &Sample, to: &Sample) -> Option<(usize, f64)> {
        let far = |index: usize| {
            let change = (to.place[index] - from.place[index]).abs();
            match self.spec.turns == Some(index) {
                true => change.min(360.0 - change),
                false => change,
            }
        };
        let all = (0..self.spec.tolerance.len()).map(|index| (index, far(index)));
        all.into_iter()
            .find(|(index, far)| *far > self.spec.tolerance[*index])
    }

    /// The same of where it was within these times.
    fn strays(&self, from: Micros, to: Micros) -> Option<(usize, f64)> {
        let mut within = self
            .samples
            .iter()
            .filter(|sample| sample.at >= from && sample.at <= to);
        let first = within.next()?;
        within.find_map(|sample| self.off(first, sample))
    }

    /// While it rests by its word.
    fn rests(&self, found: &mut Vec<Violation>) {
        let mut judged = 0;
        for (at, seen) in self.seen() {
            let Seen::State {
                stopped,
                stop,
                moving: false,
                rests: true,
                at: told,
            } = seen
            else {
                continue;
            };
            let holds = *stopped && self.freed(*stop) > at && *stop > 0;
            if at < judged || !(holds || self.under_way(at) == 0) {
                continue;
            }
            let until = self.disturbed(at);
            let within = |sample: &&Sample| sample.at >= at && sample.at < until;
            // It is the word of an earlier body where this one was not there yet.
            if self.samples.first().is_none_or(|first| first.at > at) {
                continue;
            }
            let Some(first) = self.samples.iter().find(within) else {
                continue;
            };
            judged = until;
            for sample in self.samples.iter().filter(within) {
                if let Some((index, far)) = self.off(first, sample) {
                    let late = (sample.at - at) / 1000;
                    let words = format!(
                        "number {index} of its place is off by {far:.1} within {late} ms of its word that it rests"
                    );
                    self.add(found, Rule::MovesAtRest, sample.at, words);
                    break;
                }
            }
            if let Some(told) = told
                && (told - first.place[0]).abs() > self.spec.tolerance[0] + 1.0
            {
                let words = format!("it says that it rests at {told}, and is at {}", first.place[0]);
                self.add(found, Rule::WrongPlace, first.at, words);
            }
        }
    }

    /// While its link or its program is hindered.
    fn hindered(&self, found: &mut Vec<Violation>) {
        for (_, begin, end) in self.hindrances(is_hubs) {
            let bound = begin + GONE + ROUND_TRIP + self.slack;
            let hold = self.hold(begin, end.min(bound + self.spec.stopping));
            let moves = self.moves(bound + self.spec.stopping + hold, end);
            let begins = self.begins(bound, end).map(|motion| motion.since);
            if let Some(at) = moves.into_iter().chain(begins).min() {
                let words = format!("it moves {} ms after its link was lost", (at - begin) / 1000);
                self.add(found, Rule::LinkLost, at, words);
            }
        }
        for (_, begin, end) in self.hindrances(|what| matches!(what, Hindered::Program(1..))) {
            let bound = begin + self.spec.hold + self.spec.stopping + self.slack;
            if let Some(at) = self.moves(bound, end) {
                let words = format!(
                    "it moves {} ms after its program stood still",
                    (at - begin) / 1000
                );
                self.add(found, Rule::ProgramStandsStill, at, words);
            }
        }
    }

    /// Beyond the time that the last statement takes.
    fn deadlines(&self, found: &mut Vec<Violation>) {
        for (at, seen) in self.seen() {
            let Seen::Last { owner, lasts } = seen else {
                continue;
            };
            let way = self.way_of(owner, at);
            let most = at + lasts + self.spec.hold + self.spec.stopping + self.slack;
            let others = self.seen().any(|(time, seen)| {
                time > at - GONE
                    && time < most + GONE
                    && matches!(seen, Seen::Command { .. })
                    && time != at
                    && time > at
            });
            if others || self.under_way(at) > 1 {
                continue;
            }
            if let Some(moves) = self.moves(most, self.disturbed(at)) {
                let words = format!(
                    "it moves {} ms after it began what takes {} ms ({way:?})",
                    (moves - at) / 1000,
                    lasts / 1000
                );
                self.add(found, Rule::Deadline, moves, words);
            }
        }
    }
}
