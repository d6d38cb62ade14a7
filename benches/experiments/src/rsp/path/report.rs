//! What the drives came to.

use std::fmt::Write as _;

use mom_plots::{Axis, Plot, Series};

use super::super::world::ip_bytes;
use super::super::{Mean, PERIOD};
use super::follower::{Drove, Outcome};
use super::track::{LOOKAHEAD, SPEED, Track};
use super::{Arm, BASE, Cell, DATAGRAMS, LANES, OURS, PAPER, Row, SILENCE, STREAMS};
use crate::{IMAGES, Section};

type Value = fn(&Drove) -> f64;

pub(super) fn section(tracks: &[Track], tables: &[Vec<Row>], missing: Option<anyhow::Error>) -> Section {
    let mut text = head(tables);
    if let Some(missing) = missing {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "**Not all is here:** {missing:#}.\n");
    }
    for (track, rows) in tracks.iter().zip(tables) {
        let values: [(&str, usize, Value); 3] = [
            (
                "off the path, mm RMS, with the drives that were completed where not all were",
                1,
                |drove| drove.rms,
            ),
            ("off the path at the most, mm, mean over the drives", 0, |drove| {
                drove.worst
            }),
            ("age of the pose by which the middle steers, ms", 0, |drove| {
                drove.age
            }),
        ];
        for (number, (what, digits, value)) in values.into_iter().enumerate() {
            let _ = writeln!(
                text,
                "The {}, {:.1} m, {what}:\n",
                track.name,
                track.length() / 1000.0
            );
            text += &table(rows, value, digits, number == 0);
        }
        text += &shares(track, rows);
    }
    let mut plots = Vec::new();
    if let (Some(track), Some(rows)) = (tracks.first(), tables.first()) {
        text += &words();
        let _ = writeln!(
            text,
            "![Error against delay](images/{IMAGES}-rsp-path-delay.svg)\n\n![Error against loss](images/{IMAGES}-rsp-path-loss.svg)\n\n![Paths](images/{IMAGES}-rsp-path.svg)"
        );
        let delay = |row: &Row| {
            (row.name == "base" || row.name.starts_with("delay")).then_some(row.link.delay as f64)
        };
        let loss =
            |row: &Row| (row.name == "base" || row.name.starts_with("loss")).then_some(100.0 * row.link.loss);
        plots = vec![
            (
                "experiment-rsp-path-delay.svg",
                plot(rows, "ms of delay each way", delay),
            ),
            (
                "experiment-rsp-path-loss.svg",
                plot(rows, "% of the IP packets that are lost", loss),
            ),
            ("experiment-rsp-path.svg", traces(track, rows)),
        ];
    }
    Section {
        markdown: text,
        plots,
    }
}

fn head(tables: &[Vec<Row>]) -> String {
    let drives = |arm: Arm| {
        let cells = tables.iter().flatten().flat_map(|row| &row.cells);
        cells
            .filter(|cell| cell.arm == arm)
            .map(|cell| cell.drives.len())
            .max()
            .unwrap_or(0)
    };
    format!(
        "The paper's second experiment: the middle steers the robot along a path by the positions that come back; \"the path error of RSP was smaller\" than that of packets of fixed size over TCP, without a number. \
         Here a differential drive like CUBO, whose wheels follow with a time constant of 80 ms, drives at {SPEED} mm/s by pure pursuit ({LOOKAHEAD} mm ahead); the program knows nothing of the delay. Both ends are the real ones.\n\n\
         - *RSP*: what differs, over UDP, with running acknowledgement, watchdog and motion filter; *no motion filter*: the same, and the wheels take each value as it arrives.\n\
         - *Paper mode*: all elements that have a value in each packet, over UDP: 26 bytes down and 28 up, as only the wheels are written. *Variable, TCP*: the same packets.\n\
         - *Fixed size*: the same with all elements in each packet, 1992 bytes down and 688 up. The paper's rival is *fixed size, TCP*; which kind of TCP, it does not say, so there it is with Nagle's algorithm (the system's default) and without.\n\n\
         **Inputs:** the base: {} ms each way, jitter up to {:.0} % of that, {:.0} % of the IP packets lost each way, {} Mbit/s; one of these is another one in each row below. A link has a queue of 500 ms, keeps the order of packets, and carries a datagram of 1992 bytes as two IP packets. \
         At the beginning a robot is up to 20 mm and 5° off, which the seed draws. In own mode the middle gives a session up after {SILENCE} ms of silence instead of 500. A drive ends at the end of the path, 1 m off it, or after twice its time. Poses are true and in whole mm.\n\n\
         UDP is in virtual time, {} drives each. TCP is the kernel's (cubic), in real time through a packet relay of the same link model between two network namespaces, {} drives each, {LANES} robots at a time on a machine that is shared; *RSP, in real time* is RSP there, to compare. \
         Intervals are 95 %.\n\n",
        BASE.delay,
        100.0 * BASE.jitter,
        100.0 * BASE.loss,
        BASE.rate,
        drives(OURS),
        STREAMS.map(drives).into_iter().max().unwrap_or(0),
    )
}

/// The mean of a value of a cell's drives, those that began.
fn mean(cell: &Cell, value: Value) -> Mean {
    let values = cell.drives.iter().map(value).filter(|value| value.is_finite());
    Mean::of(&values.collect::<Vec<f64>>())
}

/// A row for each link, a column for each arm.
fn table(rows: &[Row], value: Value, digits: usize, counted: bool) -> String {
    let Some(base) = rows.first() else {
        return String::new();
    };
    let arms: Vec<Arm> = base.cells.iter().map(|cell| cell.arm).collect();
    let names: Vec<&str> = arms.iter().map(|arm| arm.name).collect();
    let mut text = format!(
        "| | {} |\n|---|{}\n",
        names.join(" | "),
        "---:|".repeat(arms.len())
    );
    for row in rows {
        // Writing to a String cannot fail.
        let _ = write!(text, "| {} |", row.name);
        for arm in &arms {
            let Some(cell) = row.cells.iter().find(|cell| cell.arm == *arm) else {
                text += " |";
                continue;
            };
            let done = cell
                .drives
                .iter()
                .filter(|drove| drove.outcome == Outcome::Done)
                .count();
            let _ = write!(text, " {:.digits$}", mean(cell, value));
            if counted && done < cell.drives.len() {
                let _ = write!(text, " ({done} of {})", cell.drives.len());
            }
            text += " |";
        }
        text += "\n";
    }
    text + "\n"
}

/// What comes of size and what of transport: differences between arms that differ in one thing.
fn shares(track: &Track, rows: &[Row]) -> String {
    let [variable, _, fixed, fixed_nagle] = STREAMS;
    let [_, unfiltered, _, datagram] = DATAGRAMS;
    let pairs = [
        ("size, over UDP", datagram, PAPER),
        ("size, over TCP", fixed, variable),
        ("TCP instead of UDP, variable size", variable, PAPER),
        ("TCP instead of UDP, fixed size", fixed, datagram),
        ("Nagle, fixed size", fixed_nagle, fixed),
        ("paper's rival against RSP", fixed_nagle, OURS),
        ("own mode instead of paper mode", OURS, PAPER),
        ("motion filter", OURS, unfiltered),
    ];
    let names = pairs.map(|(name, ..)| name).join(" | ");
    let mut text = format!(
        "What comes of the size and what of the transport: differences of the RMS error on the {}, mm, between two arms that differ in this alone, drive by drive of the same seed (more is worse; bold is what differs from 0 beyond its interval):\n\n| | {names} |\n|---|{}\n",
        track.name,
        "---:|".repeat(pairs.len())
    );
    for row in rows {
        let drives = |arm: Arm| {
            row.cells
                .iter()
                .find(|cell| cell.arm == arm)
                .map(|cell| &cell.drives)
        };
        let cells = pairs.map(|(_, with, without)| {
            let (Some(with), Some(without)) = (drives(with), drives(without)) else {
                return String::new();
            };
            // The same seed begins at the same place.
            let differences = with
                .iter()
                .zip(without)
                .map(|(with, without)| with.rms - without.rms);
            let difference = Mean::of(&differences.collect::<Vec<f64>>());
            if difference.mean.abs() > difference.half {
                format!("**{difference:+.1}**")
            } else {
                format!("{difference:+.1}")
            }
        });
        // Writing to a String cannot fail.
        let _ = writeln!(text, "| {} | {} |", row.name, cells.join(" | "));
    }
    text + "\n"
}

/// What is read from it. The rate that TCP gets where packets are lost is Mathis's: 1.22 segments in a round trip, over the root of the
/// loss.
fn words() -> String {
    let rate = |delay: u64| 1.22 * 1448.0 * 8.0 / (2.0 * delay as f64 * 1000.0 * BASE.loss.sqrt());
    let needed = |datagram: usize| ip_bytes(datagram) as f64 * 8.0 / PERIOD as f64;
    format!(
        "- *Size alone*, over UDP, is of no account but where it fills the link: a fixed size needs {:.2} Mbit/s, and at 0.8 the queue of 500 ms is full all the time. That it is lost twice as often, as two IP packets, is not to be seen: the next one comes after 20 ms.\n\
         - *Transport alone*: without loss TCP follows the path as UDP does, at any of the sizes, and a long delay is as bad for both. With loss small packets over TCP wait for what was lost, which makes poses older, and is seen from 100 ms each way on.\n\
         - *Both together* are what the paper saw. Where packets are lost TCP gets about 1.22 segments in a round trip over the root of the loss, {:.1} Mbit/s at the base and {:.1} with {} ms each way. A fixed size needs more than that, so what is sent waits ever longer, and the robot leaves the path; packets of 26 bytes need {:.3} Mbit/s. \
         The rival here skips nothing: what the system does not take yet waits in its program. One that skipped would still have the system's own buffers before it.\n\
         - *Nagle* keeps small packets until the last one is acknowledged, so poses are older by up to a round trip; beside a flow that does not fit it makes no difference.\n\
         - *Own mode and paper mode* are alike here: of a motion that is new in each packet both send the same. The motion filter costs little: its outputs follow the packets. Up to 100 ms each way what is measured is how pure pursuit cuts corners, and a little more delay even helps.\n\n",
        needed(1992),
        rate(BASE.delay),
        rate(2 * BASE.delay),
        2 * BASE.delay,
        needed(26),
    )
}

fn plot(rows: &[Row], label: &str, factor: impl Fn(&Row) -> Option<f64>) -> String {
    let plot = Plot::new(
        "Following the square (S28, figure 11)",
        Axis::linear(label),
        Axis::log("mm RMS off the path"),
    );
    let [_, unfiltered, ..] = DATAGRAMS;
    // As many as there are colours.
    let arms = rows.first().map(|row| row.cells.iter().map(|cell| cell.arm));
    let arms = arms.into_iter().flatten().filter(|arm| *arm != unfiltered);
    let with = |plot: Plot, arm: Arm| {
        let mut line: Vec<(f64, f64)> = rows
            .iter()
            .filter_map(|row| {
                let cell = row.cells.iter().find(|cell| cell.arm == arm)?;
                Some((factor(row)?, mean(cell, |drove| drove.rms).mean))
            })
            .collect();
        line.sort_by(|one, other| one.0.total_cmp(&other.0));
        // One point is not a line.
        if line.len() > 1 {
            plot.with(Series::line(arm.name, line))
        } else {
            plot
        }
    };
    arms.fold(plot, with).to_svg()
}

/// Where the robots of the first seed went, over the link with a long delay.
fn traces(track: &Track, rows: &[Row]) -> String {
    let row = rows.iter().find(|row| row.link.delay == 200).or(rows.first());
    let delay = row.map_or(0, |row| row.link.delay);
    let plot = Plot::new(
        format!(
            "The square with {delay} ms each way (S28, figure 11); T = {} ms",
            PERIOD / 1000
        ),
        Axis::linear("x, m").from_to(1.5, 4.5),
        Axis::linear("y, m").from_to(1.5, 4.5),
    );
    let [.., rival] = STREAMS;
    let of = |arm: Arm| row?.cells.iter().find(|cell| cell.arm == arm)?.drives.first();
    let lines = [OURS, PAPER, rival].map(|arm| (arm.name, of(arm)));
    let plot = plot.with(Series::line("path", track.line()));
    let with = |plot: Plot, (name, drove): (&'static str, Option<&Drove>)| match drove {
        Some(drove) => plot.with(Series::line(name, drove.trace.clone())),
        None => plot,
    };
    lines.into_iter().fold(plot, with).to_svg()
}
