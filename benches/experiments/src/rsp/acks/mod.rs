//! S19 to S22, figure 7: what is acknowledged, against loss, and in paper mode.

mod caller;
mod chart;

use std::fmt::Write as _;
use std::time::Duration;

use anyhow::{Result, ensure};
use mom_plots::{Axis, Plot, Series};
use mom_rsp::middle::Settings as Ends;
use mom_rsp::{Kind, robot};
use mom_tests::network::Shape;

use super::probe::{COMMAND, EVENT, MEMORY_COMMAND, MEMORY_EVENT, PROBE, Probe};
use super::world::{World, middle};
use super::{MS, Mean, SECOND};
use crate::{IMAGES, Section, Settings, quantile};
use caller::{Caller, Told};

/// The kinds that are acknowledged, with the places of their elements.
const KINDS: [(u8, &str); 4] = [
    (COMMAND, "command"),
    (MEMORY_COMMAND, "memory command"),
    (EVENT, "event"),
    (MEMORY_EVENT, "memory event"),
];
const LOSSES: [f64; 7] = [0.0, 0.01, 0.05, 0.1, 0.15, 0.2, 0.3];
const SEEDS: u64 = 10;
/// Ids of each kind in each run: each number comes again.
const IDS: usize = 600;
/// ms from one end to the other.
const DELAY: u64 = 20;

type Scene = World<Probe, Caller>;

/// Both ends over a link that loses this share.
fn world(kind: u8, ids: usize, paper: bool, loss: f64, seed: u64) -> Result<Scene> {
    let shape = Shape {
        loss,
        ..Shape::mbit(10.0, Duration::from_millis(DELAY))
    };
    let ends = Ends {
        paper,
        ..Ends::default()
    };
    let end = Probe::new(&PROBE, robot::Settings::default())
        .map_err(|fault| anyhow::anyhow!("the robot's end: {fault}"))?;
    let caller = Caller::new(kind, ids, paper, seed);
    Ok(World::new(middle(&PROBE, ends, seed)?, end, caller, shape, seed))
}

/// What became of one kind at one loss, over all seeds.
#[derive(Debug, Default)]
struct Row {
    ids: usize,
    /// Ids that were carried out so often: never, once, more often.
    times: [usize; 3],
    /// Ids that were not acknowledged by themselves: % of each seed, all, and those of them that were not carried out either.
    failed: Vec<f64>,
    given_up: usize,
    unheard: usize,
    /// ms to the acknowledgement, sorted.
    took: Vec<f64>,
    /// Bytes of map and payload for each id, of each seed.
    bytes: Vec<f64>,
}

fn row(kind: u8, ids: usize, paper: bool, loss: f64, seeds: std::ops::Range<u64>) -> Result<Row> {
    let mut row = Row::default();
    for seed in seeds {
        let mut world = world(kind, ids, paper, loss, seed)?;
        let latest = world.now + (ids as u64 + 30) * 20 * SECOND;
        while !world.scene.is_done() && world.step(latest) {}
        ensure!(world.scene.is_done(), "a call has no end");
        // What still repeats is heard, so that what would be carried out twice is.
        world.run_until(world.now + SECOND);
        let calls = world.scene.calls();
        row.ids += calls.len();
        for call in calls {
            row.times[call.executed.min(2)] += 1;
            row.unheard += usize::from(call.failed && call.executed_by_itself == 0);
            row.took.extend(call.took.map(|took| took as f64 / MS as f64));
        }
        let failed = calls.iter().filter(|call| call.failed).count();
        row.given_up += failed;
        row.failed.push(100.0 * failed as f64 / calls.len() as f64);
        row.bytes.push(world.scene.bytes as f64 / calls.len() as f64);
    }
    row.took.sort_by(f64::total_cmp);
    Ok(row)
}

/// All losses of one kind, in own mode and in paper mode.
struct Rows {
    name: &'static str,
    is_memory: bool,
    rows: Vec<(f64, Row, Row)>,
}

pub(crate) fn run(settings: &Settings) -> Result<Section> {
    let (losses, seeds, ids) = match settings.quick {
        true => (&LOSSES[5..6], 2, 40),
        false => (&LOSSES[..], SEEDS, IDS),
    };
    let mut all = Vec::new();
    for (kind, name) in KINDS {
        let mut rows = Vec::new();
        for loss in losses {
            let row = |paper| row(kind, ids, paper, *loss, settings.seed..settings.seed + seeds);
            rows.push((*loss, row(false)?, row(true)?));
        }
        let is_memory = PROBE
            .elements()
            .get(usize::from(kind))
            .is_some_and(|element| matches!(element.kind, Kind::MemoryCommand | Kind::MemoryEvent));
        all.push(Rows {
            name,
            is_memory,
            rows,
        });
    }
    let mut charts = Vec::new();
    for (kind, name) in KINDS {
        for paper in [false, true] {
            // The others are the same in paper mode.
            if !paper || matches!(kind, MEMORY_COMMAND | MEMORY_EVENT) {
                let title = if paper {
                    format!("{name}, paper mode")
                } else {
                    name.to_owned()
                };
                charts.push((title, told(kind, paper, settings.seed)?));
            }
        }
    }
    Ok(Section {
        markdown: markdown(&all, ids, seeds),
        plots: vec![
            ("experiment-rsp-acks-charts.svg", chart::draw(&charts)),
            (
                "experiment-rsp-acks-time.svg",
                plot(&all, "ms to the acknowledgement, p99", |row| {
                    quantile(&row.took, 0.99)
                }),
            ),
            (
                "experiment-rsp-acks-bytes.svg",
                plot(&all, "bytes for each id", |row| Mean::of(&row.bytes).mean),
            ),
        ],
    })
}

/// What passes when the first packet with the call is lost, and the first with its acknowledgement.
fn told(kind: u8, paper: bool, seed: u64) -> Result<Told> {
    let mut world = world(kind, 1, paper, 0.0, seed)?;
    world.scene.script();
    world.run_until(world.now + 2 * SECOND);
    Ok(world.scene.told())
}

fn markdown(all: &[Rows], ids: usize, seeds: u64) -> String {
    let mut text = format!(
        "Commands, memory commands, events and memory events (S19 to S22), of each kind {ids} in each of {seeds} runs, one after the other, by both real ends over a link of {DELAY} ms each way that loses packets in both directions; T is 20 ms. \
         In paper mode the protocol is S19 to S22 to the letter: memory commands and memory events are sent once. There a memory event that is not acknowledged within 1 s counts as failed, and the program asks for it then.\n\n\
         **Inputs:** the loss, each packet by itself; pauses of up to 40 ms between two calls. *Time* is from the program's call (or the robot's event) until the acknowledgement is heard. *Bytes* are those in map and payload that this kind needs, call and acknowledgement, \
         without the header, as the packets leave anyway. Intervals are 95 % over the seeds.\n\n\
         | kind | loss | ids | carried out once | never | more often | ms to the acknowledgement: p50 | p99 | most | bytes for each id | paper mode: failed, % | of these not carried out | carried out twice |\n\
         |---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n"
    );
    for kind in all {
        for (loss, ours, paper) in &kind.rows {
            let [never, once, more] = ours.times;
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "| {} | {:.0} % | {} | {once} | {never} | {more} | {:.0} | {:.0} | {:.0} | {:.2} | {:.2} | {} of {} | {} |",
                kind.name,
                100.0 * loss,
                ours.ids,
                quantile(&ours.took, 0.5),
                quantile(&ours.took, 0.99),
                quantile(&ours.took, 1.0),
                Mean::of(&ours.bytes),
                Mean::of(&paper.failed),
                paper.unheard,
                paper.given_up,
                paper.times[2],
            );
        }
    }
    let wrong: usize = all
        .iter()
        .flat_map(|kind| &kind.rows)
        .map(|(_, ours, _)| ours.times[0] + ours.times[2])
        .sum();
    let _ = writeln!(
        text,
        "\nIn own mode {} was carried out another number of times than once. A memory kind buys few bytes with time: it waits max(4 T, 2 round trips) where a command is repeated each T. \
         To the letter of the paper a memory kind fails as often as a packet or its acknowledgement is lost, 1 − (1 − p)², and of those that fail nobody can tell whether they were carried out. \
         What is drawn below is what left and arrived when the first packet with the call is lost, and the first with its acknowledgement; the other packets of each T are grey.\n\n\
         ![Sequences](images/{IMAGES}-rsp-acks-charts.svg)\n\n![Time to the acknowledgement](images/{IMAGES}-rsp-acks-time.svg)\n\n![Bytes](images/{IMAGES}-rsp-acks-bytes.svg)",
        if wrong == 0 {
            "none".to_owned()
        } else {
            wrong.to_string()
        }
    );
    text
}

fn plot(all: &[Rows], label: &str, value: impl Fn(&Row) -> f64) -> String {
    let plot = Plot::new(
        "Acknowledged kinds against loss (S19 to S22)",
        Axis::linear("% of the packets that are lost"),
        Axis::linear(label),
    );
    let with = |plot: Plot, kind: &Rows| {
        let line = |of: fn(&(f64, Row, Row)) -> &Row| -> Vec<(f64, f64)> {
            kind.rows
                .iter()
                .map(|row| (100.0 * row.0, value(of(row))))
                .collect()
        };
        let plot = plot.with(Series::line(kind.name, line(|(_, ours, _)| ours)));
        match kind.is_memory {
            true => plot.with(Series::line(
                format!("{}, paper mode (what succeeds)", kind.name),
                line(|(_, _, paper)| paper),
            )),
            false => plot,
        }
    };
    all.iter().fold(plot, with).to_svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_id_is_carried_out_once_and_paper_mode_loses_some() {
        for (kind, name) in KINDS {
            let ours = row(kind, 60, false, 0.2, 1..2).unwrap();
            assert_eq!(ours.times, [0, 60, 0], "{name}");
            assert_eq!(ours.failed, [0.0], "{name}");
            let paper = row(kind, 60, true, 0.2, 1..2).unwrap();
            let is_memory = matches!(kind, MEMORY_COMMAND | MEMORY_EVENT);
            assert_eq!(paper.failed[0] > 10.0, is_memory, "{name}: {:?}", paper.failed);
        }
    }

    #[test]
    fn a_lost_call_and_a_lost_acknowledgement_are_seen_in_the_chart() {
        let told = told(COMMAND, false, 1).unwrap();
        let lost: Vec<&str> = told
            .arrows
            .iter()
            .filter(|arrow| arrow.lost)
            .map(|arrow| arrow.label.as_str())
            .take(2)
            .collect();
        assert_eq!(lost, ["call 1", "ACK 1"]);
        assert_eq!(told.executed.len(), 1);
        let drawn = chart::draw(&[("command".to_owned(), told)]);
        assert!(drawn.starts_with("<svg") && drawn.contains("call 1"), "{drawn}");
    }
}
