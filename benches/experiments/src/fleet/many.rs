//! W18, W23: 10 to 1000 robots with ten commands a second each, over real sockets.

use std::fmt::Write as _;
use std::time::Duration;

use anyhow::Result;
use mom_plots::{Axis, Plot, Series};

use super::percent;
use super::sockets::{Measured, measure};
use crate::{IMAGES, Section, Settings};

const FLEETS: [u16; 5] = [10, 41, 100, 300, 1000];
/// For each size.
const TIME: Duration = Duration::from_secs(8);

pub(crate) fn run(settings: &Settings) -> Result<Section> {
    let (fleets, time) = match settings.quick {
        true => (&FLEETS[..2], Duration::from_secs(1)),
        false => (&FLEETS[..], TIME),
    };
    let mut rows = Vec::new();
    for robots in fleets {
        rows.push(measure(*robots, time, settings.seed)?);
    }
    Ok(Section {
        markdown: markdown(&rows, time),
        plots: vec![("experiment-fleet-many.svg", plot(&rows))],
    })
}

fn markdown(rows: &[Measured], time: Duration) -> String {
    let mut text = format!(
        "Beyond the 40 robots that a network of 2 Mbit/s could carry: how far the programs themselves go. The base station's library (`mom_base_station::Station`) commands simulated robots, each a server of its own (`mom_linuxbot::serve`), \
         over TCP on loopback: real sockets, real time, {} s for each size. All robots are on one thread, the base station with its connections on another. A command is MOTOR and a NULL behind it; the reply confirms it.\n\n\
         **Inputs:** ten commands a second for each robot at random phases; the watchdog of 500 ms; robots spin on the spot, so that no wall comes. *Due to reply* counts from the time at which a command was due, so that a base station that is behind hides nothing; \
         the timer that wakes it counts in ms. *Round trip* is from writing the NULL to reading its reply. *Missed* has no reply 100 ms after it was due. The machine is shared with other work.\n\n\
         | robots | commands/s of each | of all | missed | due to reply, ms: p50 | p99 | most | round trip, ms: p50 | p99 | processor of a robot: base station | robot server |\n|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n",
        time.as_secs()
    );
    for row in rows {
        let cpu =
            |cpu: Option<f64>| cpu.map_or_else(|| "not told".to_owned(), |cpu| format!("{cpu:.2} ms/s"));
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "| {} | {:.2} | {:.0} | {} of {} ({:.2} %) | {:.2} | {:.2} | {:.1} | {:.2} | {:.2} | {} | {} |",
            row.robots,
            row.rate,
            row.rate * f64::from(row.robots),
            row.missed,
            row.due,
            percent(row.missed, row.due),
            row.took.at(0.5),
            row.took.at(0.99),
            row.took.at(1.0),
            row.trips.at(0.5),
            row.trips.at(0.99),
            cpu(row.base_cpu),
            cpu(row.robot_cpu),
        );
    }
    let _ = writeln!(
        text,
        "\nA processor core has 1000 ms/s. What the kernel does for loopback counts to the writer.\n\n![Commands over loopback](images/{IMAGES}-fleet-many.svg)"
    );
    text
}

fn plot(rows: &[Measured]) -> String {
    let values = |value: &dyn Fn(&Measured) -> f64| -> Vec<(f64, f64)> {
        let each = rows.iter().map(|row| (f64::from(row.robots), value(row)));
        each.collect()
    };
    Plot::new(
        "Ten commands/s for each robot, over loopback",
        Axis::log("robots"),
        Axis::log("ms from due to reply"),
    )
    .with(Series::line("p50", values(&|row| row.took.at(0.5))))
    .with(Series::line("p99", values(&|row| row.took.at(0.99))))
    .with(Series::line("most", values(&|row| row.took.at(1.0))))
    .mark_y(100.0, "missed")
    .to_svg()
}
