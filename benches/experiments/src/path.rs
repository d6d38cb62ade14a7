//! M52: what the path rule buys. The same moves over tables with blocks, once by the rule and once straight.

use std::fmt::Write as _;

use anyhow::{Result, bail, ensure};
use fastrand::Rng;
use mom_arm::blocks::Block;
use mom_arm::controller::{Controller, Instruction, Progress, Simulated};
use mom_arm::motion::{Leg, MAX_OPENING, Posture};
use mom_arm::{Pose, path, reach};
use mom_device::ErrorName;
use mom_plots::{Axis, Plot, Series, quantiles};

use super::hand::{clearance, clearance_along};
use super::{IMAGES, Section, Settings, quantile};

/// How many moves.
const MOVES: usize = 10_000;
/// Blocks on each table.
const BLOCKS: usize = 6;
/// mm from the table's middle within which blocks lie and the hand goes.
const FIELD: f64 = 200.0;
/// mm above the table, between the fingertips: the ends of a move.
const HEIGHTS: [f64; 2] = [5.0, 150.0];
/// mm that the hand is away from every block at both ends.
const CLEAR: f64 = 5.0;
/// mm and degrees that a block has moved when it is said to be pushed.
const MOVED: f64 = 0.1;
/// mm of clearance above which nothing is simulated: more than the error of the clearance, so that nothing can be touched.
const SURELY_FREE: f64 = 6.0;
/// Of the ways that are surely free one in so many is simulated all the same, as a check of the clearance.
const CHECKED: usize = 20;
/// µs within which everything has fallen.
const SETTLED: i64 = 3_000_000;
/// mm of clearance at which the plot ends.
const WIDEST: f64 = 150.0;
/// How often a place is drawn before a table counts as too full.
const DRAWS: usize = 10_000;

/// mm of the higher end of a move, from which its row of the table is told.
const HIGHER: [[f64; 2]; 4] = [[5.0, 45.0], [45.0, 85.0], [85.0, 125.0], [125.0, 150.0]];

/// What became of a move.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Outcome {
    Free,
    /// A block was moved and the move went on.
    Pushed,
    /// The motors were overloaded and the move ended.
    Overload,
}

/// One way from one pose to another, as it went.
#[derive(Clone, Copy, Debug)]
struct Way {
    outcome: Outcome,
    /// mm between hand and blocks at the nearest; 0 where they would touch.
    clearance: f64,
    /// mm.
    length: f64,
    /// s at full speed.
    time: f64,
}

/// A move: its ends, and its two ways.
#[derive(Clone, Debug)]
struct Moved {
    /// mm, the height of its upper end.
    higher: f64,
    /// mm of clearance at the ends, which no way can exceed.
    ends: f64,
    rule: Way,
    straight: Way,
}

pub(super) fn run(settings: &Settings) -> Result<Section> {
    let mut random = Rng::with_seed(settings.seed);
    let moves = if settings.quick { MOVES / 50 } else { MOVES };
    let (mut moved, mut refused) = (Vec::with_capacity(moves), Refused::default());
    while moved.len() < moves {
        let blocks = table(&mut random)?;
        let [from, to] = ends(&mut random, &blocks)?;
        // The joints must allow both ways, or there is nothing to compare.
        let by_rule = path::check(&from, &to).is_ok();
        let straight = reach::check_leg(&from, &to).is_ok();
        refused.rule += usize::from(!by_rule);
        refused.straight += usize::from(!straight);
        if by_rule && straight {
            let check = moved.len() % CHECKED == 0;
            moved.push(Moved {
                higher: from.z.max(to.z),
                ends: clearance(&from, &blocks).min(clearance(&to, &blocks)),
                rule: go(&from, &path::legs(&from, &to), &blocks, check)?,
                straight: go(&from, &[to], &blocks, check)?,
            });
        }
    }
    Ok(Section {
        markdown: markdown(&moved, refused),
        plots: vec![("experiment-path.svg", plot(&moved))],
    })
}

/// Draws that the joints do not allow.
#[derive(Clone, Copy, Debug, Default)]
struct Refused {
    rule: usize,
    straight: usize,
}

/// A table with blocks, about half of which lie on earlier ones, a little off its middle.
fn table(random: &mut Rng) -> Result<Vec<Block>> {
    let mut blocks: Vec<Block> = Vec::new();
    // The uppermost of each stack.
    let mut tops: Vec<usize> = Vec::new();
    for number in 0..BLOCKS {
        let yaw = between(random, -45.0, 45.0);
        let stacked = number > 0 && random.bool();
        let (x, y) = if stacked {
            let top = random.usize(..tops.len());
            let below = &blocks[tops[top]];
            tops[top] = number;
            (
                below.x + between(random, -8.0, 8.0),
                below.y + between(random, -8.0, 8.0),
            )
        } else {
            tops.push(number);
            // Seen from above no two stacks meet, whatever their yaw and their lean.
            let apart = |x: f64, y: f64| blocks.iter().all(|other| (other.x - x).hypot(other.y - y) > 80.0);
            let draws =
                std::iter::repeat_with(|| (between(random, -FIELD, FIELD), between(random, -FIELD, FIELD)));
            let Some(place) = draws.take(DRAWS).find(|(x, y)| apart(*x, *y)) else {
                bail!("no room for {BLOCKS} blocks on the table");
            };
            place
        };
        blocks.push(Block::new(&number.to_string(), [0; 3], x, y, yaw));
    }
    let machine = Simulated::new(0, blocks);
    ensure!(!machine.is_unsettled(), "a drawn stack does not stand");
    Ok(machine.reading().blocks)
}

/// Two poses, low over the table, beside or above the blocks.
fn ends(random: &mut Rng, blocks: &[Block]) -> Result<[Pose; 2]> {
    let mut end = || {
        let draws = std::iter::repeat_with(|| {
            let [low, high] = HEIGHTS;
            let (x, y) = (between(random, -FIELD, FIELD), between(random, -FIELD, FIELD));
            let z = between(random, low, high);
            Pose::new(x, y, z, between(random, -90.0, 90.0), 0.0)
        });
        draws.take(DRAWS).find(|pose| clearance(pose, blocks) >= CLEAR)
    };
    match (end(), end()) {
        (Some(from), Some(to)) => Ok([from, to]),
        _ => bail!("no room for the hand between {BLOCKS} blocks"),
    }
}

fn between(random: &mut Rng, low: f64, high: f64) -> f64 {
    low + random.f64() * (high - low)
}

/// Goes along these legs; `check` says that it is simulated even where nothing can be touched.
fn go(from: &Pose, legs: &[Pose], blocks: &[Block], check: bool) -> Result<Way> {
    let mut way = Way {
        outcome: Outcome::Free,
        clearance: clearance(from, blocks),
        length: 0.0,
        time: 0.0,
    };
    let open = |pose| Posture {
        pose,
        opening: MAX_OPENING,
    };
    let mut at = *from;
    for leg in legs {
        way.clearance = way.clearance.min(clearance_along(&at, leg, blocks));
        way.length += at.distance(leg);
        way.time += Leg::new(open(at), open(*leg)).duration() as f64 / 1e6;
        at = *leg;
    }
    if check || way.clearance < SURELY_FREE {
        way.outcome = simulate(from, legs, blocks)?;
        ensure!(
            way.clearance < SURELY_FREE || way.outcome == Outcome::Free,
            "the hand met a block from which it was thought to be {:.1} mm away",
            way.clearance
        );
    }
    Ok(way)
}

/// Has the simulated controller go along these legs.
fn simulate(from: &Pose, legs: &[Pose], blocks: &[Block]) -> Result<Outcome> {
    let mut machine = Simulated::new(0, blocks.iter().cloned());
    // In no time: the hand is there, whatever lies between.
    machine.begin(&Instruction::Glide(*from, 0), 0)?;
    machine.advance(0);
    let mut now = 0;
    for leg in legs {
        machine.begin(&Instruction::Move(*leg), now)?;
        match machine.advance(i64::MAX / 2) {
            Progress::Done(at) => now = at,
            Progress::Failed(_, error) if error.name() == ErrorName::TorqueOverload => {
                return Ok(Outcome::Overload);
            }
            other => bail!("the controller neither arrives nor meets anything: {other:?}"),
        }
    }
    machine.advance(now + SETTLED);
    let blocks_after = machine.reading().blocks;
    let pushed = blocks.iter().zip(&blocks_after).any(|(before, after)| {
        let way = (after.x - before.x).hypot(after.y - before.y);
        way.hypot(after.z - before.z) > MOVED || (after.yaw - before.yaw).abs() > MOVED
    });
    Ok(if pushed { Outcome::Pushed } else { Outcome::Free })
}

/// What many ways came to.
#[derive(Debug, PartialEq)]
struct Sum {
    moves: usize,
    pushed: usize,
    overload: usize,
}

impl Sum {
    fn of<'a>(ways: impl Iterator<Item = &'a Way>) -> Sum {
        let mut sum = Sum {
            moves: 0,
            pushed: 0,
            overload: 0,
        };
        for way in ways {
            sum.moves += 1;
            sum.pushed += usize::from(way.outcome == Outcome::Pushed);
            sum.overload += usize::from(way.outcome == Outcome::Overload);
        }
        sum
    }

    fn share(&self, count: usize) -> String {
        format!("{:.1} %", 100.0 * count as f64 / self.moves.max(1) as f64)
    }
}

fn markdown(moved: &[Moved], refused: Refused) -> String {
    let [low, high] = HEIGHTS;
    let mut text = format!(
        "The paper added the rule at the suggestion of a user: across first on the way down, up first on the way up, which \"reduces the chance of accidental \
         collisions\". It gives no figure. Here {} moves, each over a table of its own with {BLOCKS} blocks, are made twice by the simulated controller: by the \
         rule, and straight. A move touches if it displaces a block or ends with an overload of the motors. Where the clearance, computed from the sizes of hand and blocks, is never below {SURELY_FREE} mm, nothing can be touched; of such ways one in {CHECKED} is simulated all the same, and none of those touched.\n\n\
         **Inputs:** blocks of 40 mm within {FIELD} mm of the table's middle, each with an even chance on an earlier one; both ends of a move anywhere \
         over that field, the tips {low} to {high} mm above the table, spin up to 90 degrees to either side, not tilted, jaws open and empty, and at least {CLEAR} mm \
         from every block; 150 mm/s, 90 degrees/s, a halt at each leg's end. Draws that the joints do not allow are drawn again: \
         {} by the rule, {} straight.\n\n",
        moved.len(),
        refused.rule,
        refused.straight,
    );
    text += "| upper end of the move | moves | rule: touched | overloaded | straight: touched | overloaded |\n|---|---:|---:|---:|---:|---:|\n";
    let all = (format!("all, {low} to {high} mm"), [low, f64::INFINITY]);
    let rows = HIGHER.map(|[low, high]| (format!("{low} to {high} mm"), [low, high]));
    for (name, [low, high]) in rows.into_iter().chain([all]) {
        let within = || {
            moved
                .iter()
                .filter(move |moved| moved.higher >= low && moved.higher < high)
        };
        let (rule, straight) = (
            Sum::of(within().map(|moved| &moved.rule)),
            Sum::of(within().map(|moved| &moved.straight)),
        );
        let columns = [&rule, &straight].map(|sum| {
            let touched = sum.pushed + sum.overload;
            format!(" {} | {} |", sum.share(touched), sum.share(sum.overload))
        });
        // Writing to a String cannot fail.
        let _ = writeln!(text, "| {name} | {} |{}", rule.moves, columns.concat());
    }
    text += "\n| | rule | straight |\n|---|---:|---:|\n";
    let row = |name: &str, value: fn(&Way) -> f64, digits: usize| {
        let mean = |way: fn(&Moved) -> &Way| {
            moved.iter().map(|moved| value(way(moved))).sum::<f64>() / moved.len().max(1) as f64
        };
        let [rule, straight] = [mean(|moved| &moved.rule), mean(|moved| &moved.straight)];
        format!("| {name} | {rule:.digits$} | {straight:.digits$} |\n")
    };
    text += &row("length, mean, mm", |way| way.length, 0);
    text += &row("time, mean, s", |way| way.time, 2);
    for share in [0.1, 0.25, 0.5] {
        let of = |way: fn(&Moved) -> &Way| quantile(&sorted(moved, |moved| way(moved).clearance), share);
        let (rule, straight) = (of(|moved| &moved.rule), of(|moved| &moved.straight));
        let _ = writeln!(
            text,
            "| smallest clearance (to about 2 mm) of which {:.0} % of the moves have less, mm | {rule:.1} | {straight:.1} |",
            share * 100.0
        );
    }
    text += &verdict(moved);
    let _ = writeln!(text, "\n![Smallest clearance](images/{IMAGES}-path.svg)");
    text
}

fn verdict(moved: &[Moved]) -> String {
    let touched = |way: &Way| way.outcome != Outcome::Free;
    let count = |wanted: fn(bool, bool) -> bool| {
        let of = |moved: &&Moved| wanted(touched(&moved.rule), touched(&moved.straight));
        moved.iter().filter(of).count()
    };
    let saved = count(|rule, straight| !rule && straight);
    let spoilt = count(|rule, straight| rule && !straight);
    let both = count(|rule, straight| rule && straight);
    let low = moved.iter().filter(|moved| moved.higher < HIGHER[1][0]).count();
    format!(
        "\nThe rule keeps {saved} of {} moves from touching that would touch straight, and has {spoilt} touch that would not; {both} touch either way. \
         It buys height, and no more of it than the upper end of the move has: where both ends are lower than {:.0} mm ({low} moves), the hand goes across beside the blocks' sides on both ways. \
         It does not look where blocks are, and with jaws across its way the hand may pass with a block between them unharmed, which is luck on both ways. Who wants to be sure of no touch \
         writes a waypoint above the highest stack. Not measured: a block in the jaws, which hangs lower than the tips; the arm behind the palm, which meets nothing in the simulation.\n",
        moved.len(),
        HIGHER[1][0],
    )
}

fn sorted(moved: &[Moved], value: impl Fn(&Moved) -> f64) -> Vec<f64> {
    let mut values: Vec<f64> = moved.iter().map(value).collect();
    values.sort_by(f64::total_cmp);
    values
}

fn plot(moved: &[Moved]) -> String {
    let curve = |value: fn(&Moved) -> f64| {
        let mut curve = thinned(quantiles(&sorted(moved, value)));
        curve.retain(|(clearance, _)| *clearance <= WIDEST);
        curve
    };
    Plot::new(
        "Smallest clearance between hand and blocks on a move (M52)",
        Axis::linear("mm; 0: the hand touches").from_to(0.0, WIDEST),
        Axis::linear("share of the moves").from_to(0.0, 1.0),
    )
    .with(Series::steps("by the rule", curve(|moved| moved.rule.clearance)))
    .with(Series::steps("straight", curve(|moved| moved.straight.clearance)))
    .with(Series::steps(
        "at the ends: more no way can have",
        curve(|moved| moved.ends),
    ))
    .to_svg()
}

/// Some hundred points of a curve: more make the file large, and are not seen.
fn thinned(curve: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let step = (curve.len() / 200).max(1);
    let last = curve.len().saturating_sub(1);
    // Of equal values the last tells the share.
    let zeros = curve.iter().rposition(|(value, _)| *value <= 0.0);
    let kept = curve
        .into_iter()
        .enumerate()
        .filter(|(at, _)| at % step == 0 || *at == last || Some(*at) == zeros);
    kept.map(|(_, point)| point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block_at(x: f64) -> Vec<Block> {
        vec![Block::new("one", [0; 3], x, 0.0, 0.0)]
    }

    #[test]
    fn the_rule_passes_above_what_a_straight_move_meets() {
        let (from, to) = (
            Pose::new(-150.0, 0.0, 120.0, 0.0, 0.0),
            Pose::new(150.0, 0.0, 10.0, 0.0, 0.0),
        );
        let blocks = block_at(60.0);
        let rule = go(&from, &path::legs(&from, &to), &blocks, true).unwrap();
        let straight = go(&from, &[to], &blocks, true).unwrap();
        assert_eq!(
            (rule.outcome, straight.clearance),
            (Outcome::Free, 0.0),
            "{rule:?} {straight:?}"
        );
        assert_ne!(straight.outcome, Outcome::Free);
        assert!((rule.length - 410.0).abs() < 1e-9 && straight.length < 320.0);
        assert!(
            (rule.time - 410.0 / 150.0).abs() < 1e-3,
            "two legs of 150 mm/s: {rule:?}"
        );
        // Low at both ends the two ways are one.
        let low = Pose { z: 10.0, ..from };
        let pushed = go(&low, &path::legs(&low, &to), &blocks, true).unwrap();
        assert_eq!((pushed.outcome, pushed.clearance), (Outcome::Pushed, 0.0));
        // With the jaw line across its way the block passes between the jaws.
        let across = [low, to].map(|pose| Pose { spin: 90.0, ..pose });
        let between = go(&across[0], &[across[1]], &blocks, true).unwrap();
        assert_eq!((between.outcome, between.clearance), (Outcome::Free, 20.0));
    }

    #[test]
    fn draws_stand_and_are_clear() {
        let mut random = Rng::with_seed(3);
        let mut stacked = false;
        for _ in 0..20 {
            let blocks = table(&mut random).unwrap();
            assert_eq!(blocks.len(), BLOCKS);
            stacked |= blocks.iter().any(|block| block.z > 50.0);
            for end in ends(&mut random, &blocks).unwrap() {
                assert!(clearance(&end, &blocks) >= CLEAR);
            }
        }
        assert!(stacked);
    }

    #[test]
    fn shares_and_what_the_rule_saves() {
        let way = |outcome| Way {
            outcome,
            clearance: 10.0,
            length: 300.0,
            time: 2.0,
        };
        let moved = |rule, straight| Moved {
            higher: 100.0,
            ends: 12.0,
            rule: way(rule),
            straight: way(straight),
        };
        let all = [
            moved(Outcome::Free, Outcome::Pushed),
            moved(Outcome::Free, Outcome::Overload),
            moved(Outcome::Pushed, Outcome::Free),
            moved(Outcome::Free, Outcome::Free),
        ];
        let text = markdown(&all, Refused::default());
        assert!(
            text.contains("| 85 to 125 mm | 4 | 25.0 % | 0.0 % | 50.0 % | 25.0 % |"),
            "{text}"
        );
        assert!(text.contains("| length, mean, mm | 300 | 300 |"), "{text}");
        assert!(
            text.contains("keeps 2 of 4 moves") && text.contains("has 1 touch"),
            "{text}"
        );
        assert!(plot(&all).contains("by the rule"));
    }

    #[test]
    fn a_thinned_curve_keeps_its_ends_and_the_share_at_zero() {
        let values: Vec<f64> = (0..1000).map(|at| f64::from(at - 505).max(0.0)).collect();
        let thin = thinned(quantiles(&values));
        assert!(thin.len() < 400);
        assert!(thin.contains(&(0.0, 0.506)) && thin.last() == Some(&(494.0, 1.0)));
    }
}
