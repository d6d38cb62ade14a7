//! S12: what the motion filter does with gaps and bursts, and what becomes of motion without one.

use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::time::Duration;

use anyhow::{Result, anyhow};
use fastrand::Rng;
use mom_plots::{Axis, Plot, Series};
use mom_rsp::middle::{Middle, Settings as Ends, State};
use mom_rsp::robot::{self, Body};
use mom_rsp::{Direction, Header, Item, Items, Type};
use mom_tests::network::Shape;

use super::probe::{HOLD, LIMITED, LINE, PROBE, Probe, RATE, STEPS};
use super::world::{End, Scene, World, middle};
use super::{MS, Mean, PERIOD, SECOND};
use crate::{IMAGES, Section, Settings};

/// What the robot shall do: to and fro by so much, so often a second.
const MOST: f64 = 600.0;
const TURNS: f64 = 0.5;
/// ms without packets, once each second.
const GAPS: [u64; 4] = [0, 100, 200, 400];
const SEEDS: u64 = 10;
/// s of each run.
const TIME: u64 = 30;
/// µs between two measurements.
const TICK: u64 = 5 * MS;

/// The ways to use what arrives, as they are measured.
const WAYS: [&str; 7] = [
    "hold",
    "interpolation",
    "limit",
    "as it comes",
    "one each T",
    "sum",
    "steps, one each T",
];
const AS_IT_COMES: usize = 3;
const QUEUE: usize = 4;
const SUM: usize = 5;
const STEP_QUEUE: usize = 6;

/// What becomes of the packets of a gap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Gap {
    Lost,
    /// They arrive at its end, all at once.
    Burst,
}

/// The program that moves the robot, the robot, and who compares.
struct Mover {
    random: Rng,
    gap: Gap,
    /// When the session began, and gaps after that, from and to.
    begin: Option<u64>,
    gaps: Vec<(u64, u64)>,
    held: Vec<Vec<u8>>,
    /// The total that was written in steps.
    written: i16,
    is_prepared: bool,
    tick: u64,
    outputs: [f64; WAYS.len()],
    /// Values and steps that wait until the one before was carried out, where there is no filter; and when that is.
    queue: VecDeque<[f64; 2]>,
    turn: u64,
    samples: f64,
    squares: [f64; WAYS.len()],
    /// A tick ago, and the most change in one.
    before: Option<[f64; WAYS.len()]>,
    jumps: [f64; WAYS.len()],
    /// s, what it shall do, what it does.
    trace: Vec<(f64, f64, [f64; WAYS.len()])>,
}

/// What the robot shall do at this time.
fn wanted(since: u64) -> f64 {
    // At the end it stands, so that what is missing can be seen.
    let seconds = since.min(TIME * SECOND) as f64 / SECOND as f64;
    MOST * (TAU * TURNS * seconds).sin()
}

impl Mover {
    fn new(gap: Gap, ms: u64, seed: u64) -> Mover {
        let mut random = Rng::with_seed(seed);
        let gaps = (1..TIME).filter(|_| ms > 0).map(|second| {
            let from = second * SECOND + random.u64(0..500) * MS;
            (from, from + ms * MS)
        });
        Mover {
            gaps: gaps.collect(),
            random,
            gap,
            begin: None,
            held: Vec::new(),
            written: 0,
            is_prepared: false,
            tick: 0,
            outputs: [0.0; WAYS.len()],
            queue: VecDeque::new(),
            turn: 0,
            samples: 0.0,
            squares: [0.0; WAYS.len()],
            before: None,
            jumps: [0.0; WAYS.len()],
            trace: Vec::new(),
        }
    }

    fn since(&self, now: u64) -> Option<u64> {
        now.checked_sub(self.begin?)
    }

    /// The end of the gap that this is in.
    fn gap_end(&self, now: u64) -> Option<u64> {
        let since = self.since(now)?;
        let within = self
            .gaps
            .iter()
            .find(|(from, to)| (*from..*to).contains(&since))?;
        Some(now - since + within.1)
    }

    fn write(&mut self, now: u64, middle: &mut Middle<'_>) -> Result<(), mom_rsp::Refused> {
        let value = wanted(self.since(now).unwrap_or_default()).round() as i16;
        for element in [HOLD, LINE, LIMITED] {
            middle.write(element, &value.to_be_bytes())?;
        }
        middle.write(STEPS, &(value - self.written).to_be_bytes())?;
        self.written = value;
        Ok(())
    }

    fn measure(&mut self, now: u64) {
        let Some(since) = self.since(now).filter(|since| *since >= SECOND / 2) else {
            return;
        };
        let wanted = wanted(since);
        self.samples += 1.0;
        for (square, output) in self.squares.iter_mut().zip(self.outputs) {
            *square += (output - wanted).powi(2);
        }
        let before = self.before.replace(self.outputs).unwrap_or(self.outputs);
        for ((jump, before), output) in self.jumps.iter_mut().zip(before).zip(self.outputs) {
            *jump = jump.max((output - before).abs());
        }
        self.trace
            .push((since as f64 / SECOND as f64, wanted, self.outputs));
    }
}

impl Body for Mover {
    fn random(&mut self, bytes: &mut [u8]) {
        self.random.fill(bytes);
    }

    fn effector(&mut self, element: u8, value: &[u8]) {
        let value = number(value);
        let [hold, line, limited, .., sum, _] = &mut self.outputs;
        match element {
            HOLD => *hold = value,
            LINE => *line = value,
            LIMITED => *limited = value,
            STEPS => *sum += value,
            _ => {}
        }
    }

    fn command(&mut self, _: u8, _: &[u8]) {}
}

fn number(bytes: &[u8]) -> f64 {
    bytes
        .try_into()
        .map_or(f64::NAN, |bytes| f64::from(i16::from_be_bytes(bytes)))
}

impl Scene for Mover {
    fn at_middle(&mut self, now: u64, middle: &mut Middle<'_>) {
        while middle.next_notice().is_some() {}
        let is_due = middle.wake().is_some_and(|wake| wake <= now);
        if middle.state() == State::Up && is_due && !self.is_prepared {
            self.begin = self.begin.or(Some(now));
            self.is_prepared = true;
            let written = self.write(now, middle);
            debug_assert!(written.is_ok(), "{written:?}");
        }
    }

    fn at_robot(&mut self, now: u64, _: &mut impl End) {
        if now >= self.turn
            && let Some([value, step]) = self.queue.pop_front()
        {
            self.turn = now + PERIOD;
            self.outputs[QUEUE] = value;
            self.outputs[STEP_QUEUE] += step;
        }
        if now >= self.tick {
            self.tick = now + TICK;
            self.measure(now);
        }
    }

    fn leaves_middle(&mut self, now: u64, datagram: &[u8]) -> bool {
        self.is_prepared = false;
        let is_gap = self.gap_end(now).is_some();
        if is_gap && self.gap == Gap::Burst {
            self.held.push(datagram.to_vec());
        }
        !is_gap
    }

    fn late(&mut self, now: u64) -> Vec<Vec<u8>> {
        match self.gap_end(now) {
            None => std::mem::take(&mut self.held),
            Some(_) => Vec::new(),
        }
    }

    fn reaches_robot(&mut self, _: u64, datagram: &[u8]) {
        if !Header::decode(datagram).is_ok_and(|header| header.kind == Type::Data) {
            return;
        }
        let items = Items::parse(
            &PROBE,
            Direction::Down,
            datagram.get(Header::LEN..).unwrap_or_default(),
        );
        let mut heard = [self.queue.back().map_or(self.outputs[QUEUE], |last| last[0]), 0.0];
        for (element, item) in items.into_iter().flatten() {
            match (element, item) {
                (HOLD, Item::Value(value)) => {
                    self.outputs[AS_IT_COMES] = number(value);
                    heard[0] = number(value);
                }
                (STEPS, Item::Value(value)) => heard[1] = number(value),
                _ => {}
            }
        }
        self.queue.push_back(heard);
    }

    fn wake(&self) -> Option<u64> {
        let turn = (!self.queue.is_empty()).then_some(self.turn);
        Some(turn.map_or(self.tick, |turn| turn.min(self.tick)))
    }
}

fn run_one(paper: bool, gap: Gap, ms: u64, seed: u64) -> Result<Mover> {
    let ends = Ends {
        paper,
        ..Ends::default()
    };
    let end = Probe::new(&PROBE, robot::Settings::default())
        .map_err(|fault| anyhow!("the robot's end: {fault}"))?;
    let shape = Shape::mbit(10.0, Duration::from_millis(20));
    let mover = Mover::new(gap, ms, seed);
    let mut world = World::new(middle(&PROBE, ends, seed)?, end, mover, shape, seed);
    // A second at rest at the end.
    world.run_until(world.now + (TIME + 1) * SECOND);
    Ok(world.scene)
}

/// All seeds of one gap: in own mode, and in paper mode.
struct Row {
    ms: u64,
    gap: Gap,
    ours: Vec<Mover>,
    paper: Vec<Mover>,
}

impl Row {
    fn new(ms: u64, gap: Gap, seeds: std::ops::Range<u64>) -> Result<Row> {
        let all = |paper| -> Result<Vec<Mover>> {
            seeds.clone().map(|seed| run_one(paper, gap, ms, seed)).collect()
        };
        Ok(Row {
            ms,
            gap,
            ours: all(false)?,
            paper: all(true)?,
        })
    }

    fn name(&self) -> String {
        match (self.ms, self.gap) {
            (0, _) => "none".to_owned(),
            (ms, Gap::Lost) => format!("{ms} ms, lost"),
            (ms, Gap::Burst) => format!("{ms} ms, then a burst"),
        }
    }
}

fn rms(movers: &[Mover], way: usize) -> Mean {
    let each = movers
        .iter()
        .map(|mover| (mover.squares[way] / mover.samples).sqrt());
    Mean::of(&each.collect::<Vec<f64>>())
}

fn jump(movers: &[Mover], way: usize) -> f64 {
    movers.iter().map(|mover| mover.jumps[way]).fold(0.0, f64::max)
}

/// How far from its total a sum is in the end.
fn missing(movers: &[Mover], way: usize) -> Mean {
    let each = movers
        .iter()
        .map(|mover| (mover.outputs[way] - f64::from(mover.written)).abs());
    Mean::of(&each.collect::<Vec<f64>>())
}

pub(crate) fn run(settings: &Settings) -> Result<Section> {
    let (gaps, seeds) = if settings.quick {
        (&GAPS[..2], 2)
    } else {
        (&GAPS[..], SEEDS)
    };
    let mut rows = Vec::new();
    for ms in gaps {
        for gap in [Gap::Lost, Gap::Burst] {
            if *ms > 0 || gap == Gap::Lost {
                rows.push(Row::new(*ms, gap, settings.seed..settings.seed + seeds)?);
            }
        }
    }
    Ok(Section {
        markdown: markdown(&rows),
        plots: vec![("experiment-rsp-filter.svg", plot(&rows))],
    })
}

fn markdown(rows: &[Row]) -> String {
    let mut text = format!(
        "What arrives late or not at all is interpolated with the last value, and commands that come in bursts are corrected (S12, the paper's figure 5). Here the middle moves effectors to and fro, ±{MOST} units {TURNS} times a second, by a value each T = 20 ms, \
         over 20 ms each way; once a second nothing arrives for some time: the packets of that time are lost, or all arrive at its end. Both ends are the real ones, {} runs of {TIME} s each.\n\n\
         *With* the filter: hold (the newest value, one each T), interpolation (on a straight line through one T), limit ({RATE} units/s at most). *Without*: each packet *as it comes*, the last of a burst last; and *one each T*, \
         as a robot does that carries out one command after the other. The error is against what is wanted at that time, so the first row is what delay and periods cost anyway.\n\n\
         **Inputs:** the motion, the gaps and their times, which the seed draws. Intervals are 95 %.\n\n\
         | gap, once a second | with, RMS: hold | interpolation | limit | without: as it comes | one each T | most change at once: hold | interpolation | limit | as it comes | one each T |\n\
         |---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n",
        rows.first().map_or(0, |row| row.ours.len())
    );
    for row in rows {
        let errors: Vec<String> = (0..SUM)
            .map(|way| format!("{:.1}", rms(&row.ours, way)))
            .collect();
        let jumps: Vec<String> = (0..SUM)
            .map(|way| format!("{:.0}", jump(&row.ours, way)))
            .collect();
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "| {} | {} | {} |",
            row.name(),
            errors.join(" | "),
            jumps.join(" | ")
        );
    }
    text += "\nThe same motion in steps of an incremental effector. In own mode packets have the running total, and the filter's output is the difference; in paper mode they have the steps, of which the filter makes sums.\n\n\
         | gap, once a second | RMS: own mode | paper mode | paper mode, one each T | missing in the end: own mode | paper mode | paper mode, one each T |\n|---|---:|---:|---:|---:|---:|---:|\n";
    for row in rows {
        let _ = writeln!(
            text,
            "| {} | {:.1} | {:.1} | {:.1} | {:.1} | {:.1} | {:.1} |",
            row.name(),
            rms(&row.ours, SUM),
            rms(&row.paper, SUM),
            rms(&row.paper, STEP_QUEUE),
            missing(&row.ours, SUM),
            missing(&row.paper, SUM),
            missing(&row.paper, STEP_QUEUE),
        );
    }
    text += &format!(
        "\nFor absolute values the newest one is all there is to know, so \"as it comes\" is no worse than hold; what hurts is to carry out a burst one command after the other, which makes the delay of the worst gap the delay of all that follows. \
         \
         A limit bounds the change of an output ({:.0} in one T) for little more error. Interpolation does so little: on a line through one T, with one output each T, it is that T later and hardly smoother. For steps a sum keeps what came in a burst, but only totals keep what was lost.\n\n![Motion through gaps](images/{IMAGES}-rsp-filter.svg)\n",
        f64::from(RATE) * PERIOD as f64 / SECOND as f64
    );
    text
}

/// Two seconds with bursts after 200 ms, or the longest gap that there is.
fn plot(rows: &[Row]) -> String {
    let is_shown = |row: &&Row| row.gap == Gap::Burst && row.ms <= 200;
    let row = rows.iter().rev().find(is_shown);
    let shown = |(at, ..): &&(f64, f64, [f64; WAYS.len()])| (4.0..6.0).contains(at);
    let trace: Vec<_> = row
        .iter()
        .flat_map(|row| &row.ours)
        .next()
        .map_or_else(Vec::new, |mover| {
            mover.trace.iter().filter(shown).copied().collect()
        });
    let title = format!(
        "Bursts after {} ms without packets (S12, figure 5)",
        row.map_or(0, |row| row.ms)
    );
    let plot = Plot::new(title, Axis::linear("s"), Axis::linear("units")).with(Series::line(
        "wanted",
        trace.iter().map(|(at, wanted, _)| (*at, *wanted)).collect(),
    ));
    let with = |plot: Plot, way: usize| {
        let line = trace.iter().map(|(at, _, outputs)| (*at, outputs[way]));
        plot.with(Series::line(WAYS[way], line.collect()))
    };
    [0, 1, 2, QUEUE].into_iter().fold(plot, with).to_svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn totals_lose_nothing_and_steps_lose_what_is_lost() {
        let ours = run_one(false, Gap::Lost, 200, 3).unwrap();
        assert_eq!(missing(std::slice::from_ref(&ours), SUM).mean, 0.0);
        let paper = run_one(true, Gap::Lost, 200, 3).unwrap();
        assert!(missing(std::slice::from_ref(&paper), SUM).mean > 10.0);
        let burst = run_one(true, Gap::Burst, 200, 3).unwrap();
        assert_eq!(
            missing(std::slice::from_ref(&burst), SUM).mean,
            0.0,
            "a sum keeps a burst"
        );
    }

    #[test]
    fn a_queue_makes_the_worst_gap_the_delay_of_all() {
        let burst = run_one(false, Gap::Burst, 200, 3).unwrap();
        let [hold, queue] = [0, QUEUE].map(|way| rms(std::slice::from_ref(&burst), way).mean);
        assert!(queue > 1.5 * hold, "{queue} {hold}");
        assert!(jump(std::slice::from_ref(&burst), 2) <= f64::from(RATE) * 0.021);
    }
}
