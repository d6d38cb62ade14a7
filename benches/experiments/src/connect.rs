//! M59: how long it takes to connect, through each door.

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use anyhow::Result;
use mom_client::{Address, Probe};
use mom_plots::{Axis, Plot, Series, quantiles};
use tokio::time::timeout;

use super::links::{Far, LINKS, LinkKind, Trouble, inputs, over_all};
use super::{IMAGES, Section, Settings, quantile};

/// The doors, with the names that a plot has for them. A tunnel without TLS is for loopback only.
const DOORS: [(&str, &str); 7] = [
    ("bin", "binary"),
    ("tcp", "XML"),
    ("bins", "binary, TLS"),
    ("tcps", "XML, TLS"),
    ("ws", "WebSocket"),
    ("wss", "WebSocket, TLS"),
    ("https", "tunnel, TLS"),
];

/// Packets are late and lost as on the way to a user far away.
const TROUBLE: Trouble = Trouble {
    jitter: 100,
    loss: 0.02,
};
/// Nobody waits longer; such a connection counts as one of that length.
const PATIENCE: Duration = Duration::from_secs(30);

/// The times of one connection in s: until it is open, and until the hub has answered.
type Times = (f64, f64);

/// Times by link, by door.
type ByLink = Vec<Vec<Vec<Times>>>;

pub(super) fn run(settings: &Settings) -> Result<Section> {
    let rounds = if settings.quick { 2 } else { 25 };
    let known = |(scheme, _): &(&str, &str)| format!("{scheme}://lab").parse::<Address>().is_ok();
    let doors: Vec<(&str, &str)> = DOORS.into_iter().filter(known).collect();
    let times = over_all(TROUBLE, settings, |far, _| connect_all(far, &doors, rounds))?;
    Ok(Section {
        markdown: markdown(&doors, &times, rounds),
        plots: vec![("experiment-connect.svg", plot(&doors, &times))],
    })
}

/// One connection through each door in each round, so that all doors have the same chances.
fn connect_all(far: &Far, doors: &[(&str, &str)], rounds: usize) -> Result<Vec<Vec<Times>>> {
    let mut times = vec![Vec::new(); doors.len()];
    far.afar(async {
        for _ in 0..rounds {
            for (at, (scheme, _)) in doors.iter().enumerate() {
                times[at].push(connect(&far.address(scheme).parse()?).await?);
            }
        }
        Ok(())
    })?;
    Ok(times)
}

async fn connect(address: &Address) -> Result<Times> {
    let start = Instant::now();
    let mut open = None;
    let connected = timeout(PATIENCE, async {
        let mut probe = Probe::connect(address, None).await?;
        open = Some(start.elapsed());
        probe.ping(0).await
    });
    if let Ok(answered) = connected.await {
        answered?;
    }
    let all = start.elapsed();
    Ok((open.unwrap_or(all).as_secs_f64(), all.as_secs_f64()))
}

/// The sorted times of a door over all links.
fn pooled(times: &ByLink, door: usize, pick: fn(&Times) -> f64) -> Vec<f64> {
    let mut pooled: Vec<f64> = times
        .iter()
        .flat_map(|link| link[door].iter().map(pick))
        .collect();
    pooled.sort_by(f64::total_cmp);
    pooled
}

fn markdown(doors: &[(&str, &str)], times: &ByLink, rounds: usize) -> String {
    let mut text = format!(
        "A client connects {rounds} times through each door over each link. The paper measured until a socket was open; *open* is that, with TLS \
         where the door has it, and *answer* the time until the hub's first words have come as well. Users are drawn from the four links \
         in equal shares.\n\n{}\n\n",
        inputs(TROUBLE)
    );
    let links = LINKS.map(|link: LinkKind| format!(" {} |", link.name)).concat();
    text += &format!(
        "| s | open, median | third quartile | answer, median | third quartile | median by link:{links}\n"
    );
    text += &format!("|---|---:|---:|---:|---:|{}\n", "---:|".repeat(LINKS.len()));
    text += &format!("| paper | 0.6 | 1.4 | | |{}\n", " |".repeat(LINKS.len()));
    for (door, (_, name)) in doors.iter().enumerate() {
        let (open, answer) = (
            pooled(times, door, |times| times.0),
            pooled(times, door, |times| times.1),
        );
        let by_link = times.iter().map(|link| {
            let mut times: Vec<f64> = link[door].iter().map(|times| times.1).collect();
            times.sort_by(f64::total_cmp);
            format!(" {:.2} |", quantile(&times, 0.5))
        });
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "| {name} | {:.2} | {:.2} | {:.2} | {:.2} |{}",
            quantile(&open, 0.5),
            quantile(&open, 0.75),
            quantile(&answer, 0.5),
            quantile(&answer, 0.75),
            by_link.collect::<String>()
        );
    }
    let _ = writeln!(text, "\n![Connect times](images/{IMAGES}-connect.svg)");
    text
}

fn plot(doors: &[(&str, &str)], times: &ByLink) -> String {
    let plot = Plot::new(
        "Until the hub has answered, over all links, by door (M59)",
        Axis::log("s"),
        Axis::linear("share of the connections").from_to(0.0, 1.0),
    );
    let plot = doors.iter().enumerate().fold(plot, |plot, (door, (_, name))| {
        plot.with(Series::steps(
            *name,
            quantiles(&pooled(times, door, |times| times.1)),
        ))
    });
    plot.mark_x(0.6, "median of the paper: 0.6 s")
        .mark_x(1.4, "third quartile of the paper: 1.4 s")
        .mark_y(0.5, "")
        .mark_y(0.75, "")
        .to_svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_beside_the_paper() {
        let doors = [("bin", "binary"), ("bins", "binary, TLS")];
        let link = vec![vec![(0.3, 0.6), (0.4, 0.8)], vec![(0.9, 1.2), (1.0, 1.4)]];
        let times = vec![link; LINKS.len()];
        let text = markdown(&doors, &times, 2);
        assert!(text.contains("| paper | 0.6 | 1.4 |"), "{text}");
        assert!(
            text.contains("| binary, TLS | 0.90 | 1.00 | 1.20 | 1.40 | 1.20 |"),
            "{text}"
        );
        let plot = plot(&doors, &times);
        assert!(
            plot.contains("median of the paper") && plot.contains(">binary, TLS<"),
            "{plot}"
        );
    }
}
