//! W18, W19, W23: how many robots are commanded ten times a second over the radio model.

use std::fmt::Write as _;

use anyhow::Result;
use mom_plots::{Axis, Plot, Series};
use mom_radio::Loss;

use super::air::{Came, Hosts, Run, SECOND, Style};
use super::percent;
use super::trips::{PAPER, RATES, fitted};
use crate::{IMAGES, Section, Settings};

const FLEETS: [usize; 9] = [1, 2, 5, 10, 16, 20, 25, 30, 40];
/// s for each row.
const TIME: i64 = 60;
const STYLES: [Style; 2] = [Style::Serial, Style::Concurrent];

/// A fleet, at each rate in each style.
struct Row {
    robots: usize,
    came: Vec<Came>,
}

/// The rows without what the computers take, or with it.
struct Table {
    with_hosts: bool,
    rows: Vec<Row>,
}

pub(crate) fn run(settings: &Settings) -> Result<Section> {
    let (fleets, time) = match settings.quick {
        true => (&FLEETS[..4], 5),
        false => (&FLEETS[..], TIME),
    };
    let tables = [false, true].map(|with_hosts| {
        let hosts = RATES.map(|rate| match with_hosts {
            true => fitted(settings.seed, 200, rate),
            false => Hosts::default(),
        });
        let rows = fleets.iter().map(|&robots| Row {
            robots,
            came: all(settings.seed, robots, time, hosts),
        });
        Table {
            with_hosts,
            rows: rows.collect(),
        }
    });
    Ok(Section {
        markdown: markdown(&tables, time),
        plots: vec![("experiment-fleet-rates.svg", plot(&tables))],
    })
}

/// At 1 Mbit/s and 2 Mbit/s, each in both styles.
fn all(seed: u64, robots: usize, time: i64, hosts: [Hosts; 2]) -> Vec<Came> {
    let cases = STYLES.into_iter().flat_map(|style| {
        RATES
            .into_iter()
            .zip(hosts)
            .map(move |(rate, hosts)| (style, rate, hosts))
    });
    cases
        .map(|(style, rate, hosts)| {
            let run = Run {
                robots,
                rate,
                style,
                commands: true,
                nulls: true,
                hosts,
                file: false,
                loss: Loss::None,
                time: time * SECOND,
                seed,
            };
            run.simulate()
        })
        .collect()
}

/// Commands/s for each robot of a base station that waits for each reply, by the paper's mean.
fn limit(robots: usize) -> f64 {
    1000.0 / PAPER / robots as f64
}

fn markdown(tables: &[Table], time: i64) -> String {
    let mut text = format!(
        "The paper concludes from its mean of {PAPER} ms that the base station \"would, for instance, be able to command up to 10 mobile robots, communicating with each 10 times/s (allowing for a processing overhead in the control base station)\". \
         Here 1 to 40 robots are commanded so over [the radio model](radio.md), {time} s of virtual time each. A command is MOTOR with a NULL behind it in one packet; its reply tells that it is carried out. \
         It is *missed* if its reply is not there when the next one is due, 100 ms after it; a robot that has not answered gets no other. *Serial* is a base station that waits for each reply before it commands the next robot, \
         as the paper's arithmetic has it: 1/{PAPER} ms / N for each of N robots. *Concurrent* is one that has a connection for each robot and waits for none (W10), as ours is.\n\n\
         **Inputs:** as in [the section before](#round-trip-of-null-over-the-radio-model-w18-w23): random access, no loss, 10 m; NULL every 10 s beside it; concurrent commands are due at random phases, serial ones of one round at once.\n"
    );
    for table in tables {
        let title = match table.with_hosts {
            true => format!(
                "With what the computers take so that one robot's mean is {PAPER} ms; the base station's share is one message after the other"
            ),
            false => "The radio alone".to_owned(),
        };
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "\n{title}: commands/s of each robot, ms from due to reply (p50, p99), missed.\n\n\
             | robots | 1/{PAPER} ms / N | serial, 1 Mbit/s | serial, 2 Mbit/s | concurrent, 1 Mbit/s | concurrent, 2 Mbit/s |\n|---:|---:|---:|---:|---:|---:|\n"
        );
        for row in &table.rows {
            let cells: Vec<String> = row.came.iter().map(cell).collect();
            let _ = writeln!(
                text,
                "| {} | {:.1} | {} |",
                row.robots,
                limit(row.robots),
                cells.join(" | ")
            );
        }
    }
    text += &verdict(tables);
    text += "\nSo the paper's ten robots at ten commands a second are within what such a network and such computers do, also one after the other. Beyond that its serial arithmetic is a property of the waiting, not of the network: \
             what ends the concurrent base station is the air at 1 Mbit/s, and with these computers the base station's own processor at 2 Mbit/s.\n";
    let _ = writeln!(
        text,
        "\n![Commands missed by size of the fleet](images/{IMAGES}-fleet-rates.svg)"
    );
    text
}

fn cell(came: &Came) -> String {
    format!(
        "{:.2}/s, {:.1}, {:.1} ms, {}",
        came.rate,
        came.commands.at(0.5),
        came.commands.at(0.99),
        match came.missed {
            0 => "0".to_owned(),
            missed => format!("{:.2} %", percent(missed, came.due)),
        }
    )
}

/// The largest fleet that misses nothing, in each case.
fn verdict(tables: &[Table]) -> String {
    let mut text = "\n".to_owned();
    for table in tables {
        let largest = |case: usize| {
            let fine = table
                .rows
                .iter()
                .take_while(|row| row.came.get(case).is_some_and(|came| came.missed == 0));
            fine.last().map_or(0, |row| row.robots)
        };
        let ten = |row: &&Row| row.robots == 10;
        let ten = table.rows.iter().find(ten).map_or_else(String::new, |row| {
            let missed: Vec<String> = row.came.iter().map(|came| came.missed.to_string()).collect();
            let due = row.came.first().map_or(0, |came| came.due);
            format!(
                " The paper's ten robots miss {} (in the order of the columns) of {due} commands.",
                missed.join(", ")
            )
        });
        let _ = writeln!(
            text,
            "- {}: the largest of these fleets up to which nothing is missed has {} and {} robots in serial, {} and {} concurrently (1 and 2 Mbit/s).{ten}",
            if table.with_hosts {
                "With computers"
            } else {
                "Radio alone"
            },
            largest(0),
            largest(1),
            largest(2),
            largest(3),
        );
    }
    text
}

fn plot(tables: &[Table]) -> String {
    let mut plot = Plot::new(
        "Commands/s of each robot (W18), computers included",
        Axis::linear("robots"),
        Axis::linear("commands/s of each").from_to(0.0, 10.5),
    );
    let names = [
        "serial, 1 Mbit/s",
        "serial, 2 Mbit/s",
        "concurrent, 1 Mbit/s",
        "concurrent, 2 Mbit/s",
    ];
    let rows = || {
        tables
            .iter()
            .filter(|table| table.with_hosts)
            .flat_map(|table| &table.rows)
    };
    for (case, name) in names.into_iter().enumerate() {
        let values = rows().filter_map(|row| Some((row.robots as f64, row.came.get(case)?.rate)));
        plot = plot.with(Series::line(name, values.collect()));
    }
    let limits = rows().map(|row| (row.robots as f64, limit(row.robots).min(10.0)));
    plot.with(Series::points(format!("1/{PAPER} ms / N"), limits.collect()))
        .mark_x(10.0, "paper's claim")
        .to_svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_robot_misses_nothing_and_ten_have_their_rate() {
        for robots in [1, 10] {
            for came in all(3, robots, 10, [Hosts::default(); 2]) {
                assert_eq!(came.missed, 0, "{robots}");
                assert!((came.rate - 10.0).abs() < 0.2, "{}", came.rate);
            }
        }
    }

    #[test]
    fn the_serial_limit_is_the_papers() {
        assert!((limit(10) - 16.667).abs() < 0.001);
        let hosts = RATES.map(|rate| fitted(1, 100, rate));
        let came = all(1, 25, 10, hosts);
        // A command is longer than a NULL, so somewhat below the limit.
        let serial = came[1].rate;
        assert!(
            serial < limit(25) && serial > 0.9 * limit(25),
            "{serial} {}",
            limit(25)
        );
        assert!(came[3].rate > serial);
    }
}
