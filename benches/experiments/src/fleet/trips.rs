//! W18, W23: the round trip of NULL over the radio model, with the distribution that the paper lacks.

use std::fmt::Write as _;

use anyhow::Result;
use mom_plots::{Axis, Plot, Series, quantiles};
use mom_radio::{Loss, Micros};

use super::Times;
use super::air::{Hosts, MS, Run, SECOND, Style};
use crate::{IMAGES, Section, Settings};

/// ms, the paper's mean.
pub(super) const PAPER: f64 = 6.0;
/// Bit/s (W19).
pub(super) const RATES: [u32; 2] = [1_000_000, 2_000_000];
const FLEETS: [usize; 5] = [1, 5, 10, 20, 40];
/// NULLs of each row.
const NULLS: i64 = 2000;

/// Round trips of NULL.
struct Row {
    rate: u32,
    robots: usize,
    commands: bool,
    hosts: bool,
    times: Times,
    busy: f64,
}

fn nulls(seed: u64, count: i64, rate: u32, robots: usize, commands: bool, hosts: Hosts) -> (Times, f64) {
    let run = Run {
        robots,
        rate,
        style: Style::Concurrent,
        commands,
        nulls: true,
        hosts,
        file: false,
        loss: Loss::None,
        time: count * 10 * SECOND / robots as i64,
        seed,
    };
    let came = run.simulate();
    (came.nulls, came.busy)
}

/// What computers take so that the mean round trip of one robot is the paper's: the robot half of it.
pub(super) fn fitted(seed: u64, count: i64, rate: u32) -> Hosts {
    let mut hosts = Hosts::default();
    // While the robot computes, acknowledgement and backoff pass, so what is missing is not what there was to begin with.
    for _ in 0..4 {
        let (alone, _) = nulls(seed, count, rate, 1, false, hosts);
        let half = ((PAPER - alone.mean()) * MS as f64 / 2.0) as Micros;
        hosts = Hosts {
            robot: (hosts.robot + half).max(0),
            base: (hosts.base + half).max(0),
        };
    }
    hosts
}

pub(crate) fn run(settings: &Settings) -> Result<Section> {
    let count = if settings.quick { 100 } else { NULLS };
    let fleets = if settings.quick { &FLEETS[..3] } else { &FLEETS[..] };
    let mut rows = Vec::new();
    for rate in RATES {
        let hosts = fitted(settings.seed, count, rate);
        for (hosts, with) in [(Hosts::default(), false), (hosts, true)] {
            for robots in fleets {
                let idle = (*robots == 1).then_some(false);
                for commands in idle.into_iter().chain([true]) {
                    let (times, busy) = nulls(settings.seed, count, rate, *robots, commands, hosts);
                    rows.push(Row {
                        rate,
                        robots: *robots,
                        commands,
                        hosts: with,
                        times,
                        busy,
                    });
                }
            }
        }
    }
    let fitted = RATES.map(|rate| fitted(settings.seed, count, rate).robot as f64 / MS as f64);
    Ok(Section {
        markdown: markdown(&rows, fitted),
        plots: vec![("experiment-fleet-trips.svg", plot(&rows))],
    })
}

fn markdown(rows: &[Row], fitted: [f64; 2]) -> String {
    let [one, two] = fitted;
    let mut text = format!(
        "The paper: the \"measured average round trip time for a message to be sent from the control base station, to a mobile robot and then echoed back\" is {PAPER} ms; it gives no distribution, and neither rate nor number of robots. \
         Here a NULL goes to each robot every 10 s (W8) over [the radio model](radio.md), in virtual time: a model's figures, not a network's. Rows with commands have each robot commanded 10 times a second beside it: MOTOR, and a NULL that confirms it, \
         by the concurrent base station of [the next section](#ten-robots-with-ten-commands-a-second-w18-w19-w23).\n\n\
         **Inputs:** W19's rates; random access, no loss, all robots 10 m away; NULLs and commands begin at random phases. *Computers* is what both ends take beside the radio, which the paper does not split: \
         chosen so that the mean of one robot at rest is the paper's {PAPER} ms, half of it in the robot ({one:.2} ms at 1 Mbit/s, {two:.2} ms at 2 Mbit/s), a quarter in the base station before the command goes and a quarter after the reply.\n\n\
         | round trip of NULL, ms | robots | commands | mean | p50 | p90 | p99 | most | on the air |\n|---|---:|---|---:|---:|---:|---:|---:|---:|\n\
         | paper, 1 to 2 Mbit/s | | | {PAPER} | | | | | |\n"
    );
    for row in rows {
        let computers = if row.hosts { ", with computers" } else { "" };
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "| {} Mbit/s{computers} | {} | {} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.1} % |",
            row.rate / 1_000_000,
            row.robots,
            if row.commands { "10 a second" } else { "none" },
            row.times.mean(),
            row.times.at(0.5),
            row.times.at(0.9),
            row.times.at(0.99),
            row.times.at(1.0),
            100.0 * row.busy,
        );
    }
    let count = rows.first().map_or(0, |row| row.times.0.len());
    let alone = |rate| {
        let alone = |row: &&Row| row.rate == rate && row.robots == 1 && !row.commands && !row.hosts;
        rows.iter().find(alone).map_or(f64::NAN, |row| row.times.mean())
    };
    let _ = writeln!(
        text,
        "\nAbout {count} NULLs a row. The radio alone has a NULL back in {:.1} ms at 1 Mbit/s and {:.1} ms at 2 Mbit/s: the rest of the paper's {PAPER} ms is not the network of this model. \
         So the row that has the paper's mean has it because it was fitted; what it shows is the distribution, and how it grows with the fleet.\n\n![Round trips of NULL](images/{IMAGES}-fleet-trips.svg)",
        alone(RATES[0]),
        alone(RATES[1]),
    );
    text
}

fn plot(rows: &[Row]) -> String {
    let plot = Plot::new(
        "Round trip of NULL at 2 Mbit/s with the computers' time (W18, W23)",
        Axis::log("ms"),
        Axis::linear("share of the NULLs"),
    );
    let drawn = rows
        .iter()
        .filter(|row| row.hosts && row.commands && row.rate == RATES[1]);
    let plot = drawn.fold(plot, |plot, row| {
        let name = match row.robots {
            1 => "1 robot".to_owned(),
            robots => format!("{robots} robots"),
        };
        plot.with(Series::steps(name, quantiles(&row.times.0)))
    });
    plot.mark_x(PAPER, "paper's mean").to_svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn computers_make_up_for_the_rest_of_the_papers_mean() {
        for rate in RATES {
            let hosts = fitted(1, 100, rate);
            let (times, _) = nulls(2, 100, rate, 1, false, hosts);
            assert!((times.mean() - PAPER).abs() < 0.1, "{rate}: {}", times.mean());
            assert!(hosts.robot > 1000, "most of it is not the radio's: {hosts:?}");
        }
    }

    #[test]
    fn a_slower_network_takes_longer() {
        let [slow, fast] = RATES.map(|rate| nulls(1, 100, rate, 5, true, Hosts::default()).0);
        assert!(slow.at(0.5) > fast.at(0.5));
    }
}
