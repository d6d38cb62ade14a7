//! W9, W23: what a robot does whose link is cut while it drives, and what loss does to its commands, over the radio model.

use std::fmt::Write as _;

use anyhow::Result;
use fastrand::Rng;
use mom_base_station::circuit::Options;
use mom_linuxbot::Rules;
use mom_plots::{Axis, Plot, Series, quantiles};
use mom_radio::Micros;

use super::air::{MS, SECOND};
use super::drive::{Drive, Drove};
use super::{Times, percent};
use crate::{IMAGES, Section, Settings};

const RUNS: usize = 100;
/// s after the cut for which a robot is watched.
const WATCHED: i64 = 60;
/// s for which each robot drives over a link with loss.
const DRIVEN: i64 = 60;

/// A robot's rules and how often its base station asks it.
struct Case {
    name: &'static str,
    rules: fn() -> Rules,
    null_period: i64,
}

const CASES: [Case; 3] = [
    Case {
        name: "paper",
        rules: || Rules::PAPER,
        null_period: 10,
    },
    Case {
        name: "watchdog 500 ms",
        rules: Rules::default,
        null_period: 10,
    },
    Case {
        name: "watchdog 500 ms, NULL every 1 s",
        rules: Rules::default,
        null_period: 1,
    },
];

/// Share of attempts that are lost, and how often the radio tries.
const LOSSES: [(f64, u32); 6] = [(0.0, 7), (0.05, 7), (0.1, 7), (0.2, 7), (0.02, 1), (0.05, 1)];
/// ms for which a link is cut that comes back.
const OUTAGES: [i64; 5] = [300, 1000, 2000, 5000, 20_000];

fn drive(case: &Case, seed: u64) -> Drive {
    let circuit = Options {
        null_period: case.null_period * SECOND,
        ..Options::default()
    };
    Drive::new((case.rules)(), circuit, seed)
}

/// The link is cut for good, at a random time.
fn cut(case: &Case, settings: &Settings, runs: usize) -> Vec<Drove> {
    let mut random = Rng::with_seed(settings.seed);
    let each = (0..runs).map(|_| {
        let at = random.i64(5 * SECOND..15 * SECOND);
        let drive = Drive {
            cut: Some(at),
            time: at + WATCHED * SECOND,
            ..drive(case, random.u64(..))
        };
        drive.simulate()
    });
    each.collect()
}

/// The link is cut, and comes back.
fn outage(case: &Case, settings: &Settings, runs: usize, gone: Micros) -> Vec<Drove> {
    let mut random = Rng::with_seed(settings.seed);
    let each = (0..runs).map(|_| {
        let at = random.i64(5 * SECOND..15 * SECOND);
        let drive = Drive {
            cut: Some(at),
            back: Some(at + gone),
            time: at + gone + 30 * SECOND,
            ..drive(case, random.u64(..))
        };
        drive.simulate()
    });
    each.collect()
}

fn lossy(case: &Case, settings: &Settings, runs: usize, (loss, attempts): (f64, u32)) -> Vec<Drove> {
    let mut random = Rng::with_seed(settings.seed);
    let each = (0..runs).map(|_| {
        let drive = Drive {
            loss,
            attempts,
            time: DRIVEN * SECOND,
            ..drive(case, random.u64(..))
        };
        drive.simulate()
    });
    each.collect()
}

pub(crate) fn run(settings: &Settings) -> Result<Section> {
    let runs = if settings.quick { 5 } else { RUNS };
    let (losses, outages) = match settings.quick {
        true => (&LOSSES[..2], &OUTAGES[..2]),
        false => (&LOSSES[..], &OUTAGES[..]),
    };
    let cuts: Vec<Vec<Drove>> = CASES.iter().map(|case| cut(case, settings, runs)).collect();
    let [paper, guarded, asked] = &CASES;
    let mut text = timeline(&cuts, runs);
    text += "\nA link that comes back: what the base station said meanwhile waits in TCP, and the wire tells no times (W2), so the robot carries it out then. *Late* is a MOTOR that is executed more than 500 ms after it was sent; \
             *stops undone* are those of them that moved a robot again which its watchdog had stopped.\n\n\
             | cut for | robot | MOTOR late, of all runs | stops undone | oldest, s | back under command, s (p50, most) |\n|---:|---|---:|---:|---:|---:|\n";
    for gone in outages {
        for case in [paper, guarded, asked] {
            text += &outage_row(*gone, case, &outage(case, settings, runs, gone * MS));
        }
    }
    text += &format!(
        "\nLoss without a cut, {runs} drives of {DRIVEN} s each, 10 commands/s, watchdog of 500 ms. *Missed* is a command that arrives more than 100 ms after it was sent, or never.\n\n\
         | attempts lost | attempts by the radio | missed | ms to arrive: p50 | p99 | most | late (500 ms) | stops by the watchdog | undone by a late one |\n|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n"
    );
    for loss in losses {
        text += &loss_row(*loss, &lossy(guarded, settings, runs, *loss));
    }
    text += &words();
    Ok(Section {
        markdown: text,
        plots: vec![("experiment-fleet-lost.svg", plot(&cuts))],
    })
}

/// s, of those that there are.
fn times(drove: &[Drove], value: fn(&Drove) -> Option<Micros>) -> Times {
    let seconds = drove
        .iter()
        .filter_map(value)
        .map(|time| time as f64 / SECOND as f64);
    Times::new(seconds.collect())
}

fn timeline(cuts: &[Vec<Drove>], runs: usize) -> String {
    let mut text = format!(
        "A robot drives a circle at 250 mm/s by 10 commands/s, and its link is cut at a random time: {runs} runs for each row, watched for {WATCHED} s after the cut. The paper's robot drives on when its base station is lost (W9); ours has a watchdog. \
         Robot, base station and wire are the programs' own (`mom_linuxbot::Robot`, `mom_base_station::Circuit`, `mom_brs`); between them is [the radio model](radio.md) with TCP, all in virtual time.\n\n\
         **Inputs:** 2 Mbit/s, no other stations, no loss but the cut; the simulated robot's wheels follow their motors with a time constant of 100 ms, and it stands below 0.5 mm/s; what computers take is left out.\n\n\
         | s after the cut | motors off: p50 | most | stands: p50 | most | mm until it stands: p50 | most | the base station knows: p50 | most |\n|---|---:|---:|---:|---:|---:|---:|---:|---:|\n"
    );
    for (case, drove) in CASES.iter().zip(cuts) {
        let off = times(drove, |one| one.off);
        let stands = times(drove, |one| one.stands);
        let known = times(drove, |one| one.known);
        let way: Vec<f64> = drove
            .iter()
            .filter_map(|one| one.stands.and(Some(one.way)))
            .collect();
        let way = Times::new(way);
        let cells = |times: &Times, digits: usize| match times.0.len() {
            0 => "never | never".to_owned(),
            _ => format!("{:.digits$} | {:.digits$}", times.at(0.5), times.at(1.0)),
        };
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {} |",
            case.name,
            cells(&off, 3),
            cells(&stands, 3),
            cells(&way, 0),
            cells(&known, 1)
        );
    }
    let driven: Vec<f64> = cuts.first().into_iter().flatten().map(|one| one.way).collect();
    let _ = writeln!(
        text,
        "\nThe paper's robots drove {:.1} m and more in the {WATCHED} s, and none stood. The watchdog counts from the last frame that came, up to 100 ms before the cut, so motors may be off sooner than 500 ms after it. \
         A base station knows of a silent robot by NULLs alone: three periods after the first that has no reply, which is 30 to 40 s after the cut at W8's period; how old a state is, it can say at once.",
        driven.iter().copied().fold(f64::INFINITY, f64::min) / 1000.0
    );
    text
}

fn outage_row(gone: i64, case: &Case, drove: &[Drove]) -> String {
    let late: u64 = drove.iter().map(|one| one.late).sum();
    let after: u64 = drove.iter().map(|one| one.after_stop).sum();
    let oldest = drove.iter().map(|one| one.oldest).max().unwrap_or(0);
    let again = times(drove, |one| one.again);
    format!(
        "| {:.1} s | {} | {late} | {after} | {:.2} | {:.2}, {:.2} |\n",
        gone as f64 / 1000.0,
        case.name,
        oldest as f64 / SECOND as f64,
        again.at(0.5),
        again.at(1.0)
    )
}

fn loss_row((loss, attempts): (f64, u32), drove: &[Drove]) -> String {
    let sum = |value: fn(&Drove) -> u64| drove.iter().map(value).sum::<u64>();
    let (sent, missed) = (sum(|one| one.sent), sum(|one| one.missed));
    let took = Times::new(drove.iter().flat_map(|one| one.took.iter().copied()).collect());
    format!(
        "| {:.0} % | {attempts} | {missed} of {sent} ({:.3} %) | {:.2} | {:.1} | {:.0} | {} | {} | {} |\n",
        100.0 * loss,
        percent(missed, sent),
        took.at(0.5),
        took.at(0.99),
        took.at(1.0),
        sum(|one| one.late),
        sum(|one| one.stops),
        sum(|one| one.after_stop),
    )
}

fn words() -> String {
    format!(
        "\nWhat guards against late commands, and what does not: the watchdog stops the motors, but does not know that a MOTOR which comes after it was said long before; nothing on the wire could tell. \
         So late commands are executed, each outage of a second and longer undoes the watchdog's stop once, and even one of 300 ms has some, as TCP's timer doubles until the link is found to be back. \
         What ends that is the base station's patience: one that has given a connection up sends nothing of it any more (NULL every 1 s, cut for 5 s and longer), and a robot drops with a connection what it has not read. \
         A gateway's commands are fewer (`motor` once, and its end), and it has a robot stand that says that it moves without an order, but they go the same way. \
         Seven attempts by the radio hide a loss of 20 % but for some ms; without them TCP's timer is what commands wait for, longer here than in reality, as the model's TCP knows no fast retransmission.\n\n![Time until the robot stands](images/{IMAGES}-fleet-lost.svg)\n"
    )
}

fn plot(cuts: &[Vec<Drove>]) -> String {
    let plot = Plot::new(
        "From the cut of the link (W9)",
        Axis::log("s after the cut"),
        Axis::linear("share of the runs"),
    );
    // The paper's robot never stands, and its base station knows when ours does.
    let [_, guarded, asked] = cuts else {
        return plot.to_svg();
    };
    let lines = [
        ("the robot stands", times(guarded, |one| one.stands)),
        (
            "the base station knows, NULL every 1 s",
            times(asked, |one| one.known),
        ),
        (
            "the base station knows, NULL every 10 s",
            times(guarded, |one| one.known),
        ),
    ];
    let plot = lines.into_iter().fold(plot, |plot, (name, times)| {
        plot.with(Series::steps(name, quantiles(&times.0)))
    });
    plot.mark_x(0.5, "watchdog").to_svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> Settings {
        Settings {
            seed: 1,
            quick: true,
            broker: std::path::PathBuf::new(),
        }
    }

    #[test]
    fn a_watchdog_has_it_stand_and_the_paper_does_not() {
        let [paper, guarded, asked] = CASES.each_ref().map(|case| cut(case, &settings(), 5));
        assert!(paper.iter().all(|one| one.off.is_none() && one.stands.is_none()));
        // The slower wheel runs out from 200 mm/s, the faster one from 300: 100 ms × ln (300 / 0.5).
        let braking = (0.1 * 600f64.ln() * SECOND as f64) as Micros;
        for one in guarded.iter().chain(&asked) {
            let (off, stands) = (one.off.expect("off"), one.stands.expect("stands"));
            assert!((390 * MS..=500 * MS).contains(&off), "{one:?}");
            assert!(stands <= off + braking + 2 * MS, "{one:?}");
            assert!(one.known.is_some_and(|known| known > stands), "{one:?}");
        }
        assert!(asked.iter().all(|one| one.known < Some(5 * SECOND)));
    }

    #[test]
    fn nothing_is_missed_or_late_on_a_good_link() {
        for one in lossy(&CASES[1], &settings(), 3, (0.0, 7)) {
            assert_eq!((one.missed, one.late, one.after_stop, one.stops), (0, 0, 0, 0));
            assert!(one.sent > 590, "{one:?}");
        }
    }

    #[test]
    fn a_base_station_that_gave_up_sends_nothing_late() {
        let drove = outage(&CASES[2], &settings(), 5, 20 * SECOND);
        assert!(
            drove.iter().all(|one| one.late == 0 && one.again.is_some()),
            "{drove:?}"
        );
    }
}
