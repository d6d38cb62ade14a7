//! M60: the round trip of a message against its size, on links of several rates.

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use mom_client::{Client, Event};
use mom_plots::{Axis, Plot, Series};
use tokio::time::timeout;

use super::links::{Far, LINKS, LinkKind, Trouble, inputs, over_all};
use super::{IMAGES, Section, Settings};

/// The channel of the broker under measurement.
const CHANNEL: &str = "/bench";
/// The paper's sizes.
const LARGEST: usize = 10_000;
/// Sizes on each link, besides the fixed ones.
const DRAWN: usize = 16;
/// Sizes that are always there: where the curve is said to be flat, and where it bends.
const FIXED: [usize; 10] = [1, 10, 30, 100, 200, 500, 1000, 1500, 3000, LARGEST];
/// Nothing is lost here: a retransmission would be measured instead of the size.
const TROUBLE: Trouble = Trouble { jitter: 0, loss: 0.0 };
/// A message that takes longer is lost.
const PATIENCE: Duration = Duration::from_secs(60);

/// The mean round trip of each size in s, by size.
type Curve = Vec<(usize, f64)>;

pub(super) fn run(settings: &Settings) -> Result<Section> {
    let sizes = sizes(settings);
    let messages = |kind: LinkKind| match (settings.quick, kind.rate < 1e6) {
        (true, _) => 1,
        // A minute for each of the large ones would be too long.
        (false, true) => 5,
        (false, false) => 20,
    };
    let curves = over_all(TROUBLE, settings, |far, kind| {
        measure(far, &sizes, messages(kind))
    })?;
    Ok(Section {
        markdown: markdown(&curves, LINKS.map(messages)),
        plots: vec![("experiment-round-trip.svg", plot(&curves))],
    })
}

/// The sizes to be measured, sorted.
fn sizes(settings: &Settings) -> Vec<usize> {
    if settings.quick {
        return vec![1, 1000, 3000];
    }
    let mut random = fastrand::Rng::with_seed(settings.seed);
    let drawn = (0..DRAWN).map(|_| random.usize(1..=LARGEST));
    let mut sizes: Vec<usize> = drawn.chain(FIXED).collect();
    sizes.sort_unstable();
    sizes.dedup();
    sizes
}

fn measure(far: &Far, sizes: &[usize], messages: usize) -> Result<Curve> {
    far.afar(async {
        let client = Client::builder(far.address("bin")).guest().no_reconnect();
        let client = client.request_timeout(PATIENCE).connect().await?;
        let channel = client.channel(CHANNEL).await?;
        let mut events = channel.events();
        let mut curve = Curve::new();
        for size in sizes {
            let text = "x".repeat(*size);
            let mut sum = 0.0;
            for _ in 0..messages {
                let start = Instant::now();
                channel.send("state", text.as_str()).await?;
                let echo = async {
                    while let Some(event) = events.next().await {
                        if matches!(event, Event::Message(_)) {
                            return Ok(());
                        }
                    }
                    Err(anyhow::anyhow!("the link ended"))
                };
                timeout(PATIENCE, echo).await.context("a message is lost")??;
                sum += start.elapsed().as_secs_f64();
            }
            curve.push((*size, sum / messages as f64));
        }
        client.close().await;
        Ok(curve)
    })
}

/// The time of the size next to this one.
fn near(curve: &Curve, size: usize) -> f64 {
    let nearest = curve.iter().min_by_key(|(known, _)| known.abs_diff(size));
    nearest.map_or(f64::NAN, |(_, time)| *time)
}

/// The greatest size up to which a round trip takes at most a quarter more than that of one byte.
fn flat_to(curve: &Curve) -> usize {
    let most = near(curve, 1) * 1.25;
    let flat = curve.iter().take_while(|(_, time)| *time <= most).last();
    flat.map_or(0, |(size, _)| *size)
}

fn markdown(curves: &[Curve], messages: [usize; 4]) -> String {
    let mut text = format!(
        "A client that is logged in sends text of one size to a channel and waits until it is back, one message at a time, with the size in both \
         directions as in the paper; each point is the mean of {} messages on the four links (the paper: 50). Sizes are drawn evenly from 1 to \
         {LARGEST} B, with some fixed ones among them.\n\n{}\n\n",
        messages.map(|messages| messages.to_string()).join(", "),
        inputs(TROUBLE)
    );
    text += "| link | 1 B | 1000 B | 3000 B | 10 000 B | at most a quarter more than 1 B, up to |\n|---|---:|---:|---:|---:|---:|\n";
    text += "| paper, all users | | | | | about 1000 B |\n";
    for (kind, curve) in LINKS.iter().zip(curves) {
        let times = [1, 1000, 3000, LARGEST].map(|size| format!(" {:.0} ms |", near(curve, size) * 1000.0));
        // Writing to a String cannot fail.
        let _ = writeln!(text, "| {} |{} {} B |", kind.name, times.concat(), flat_to(curve));
    }
    text += "\nWhere the curve bends depends on the link: what a size adds is its time at the link's rate, there and back, beside the delay. The paper's users \
             together had their bend at 1000 B, between those of ISDN and of faster lines.\n";
    let _ = writeln!(text, "\n![Round trips](images/{IMAGES}-round-trip.svg)");
    text
}

fn plot(curves: &[Curve]) -> String {
    let plot = Plot::new(
        "Round trip of a message against its size (M60)",
        Axis::log("bytes of text, both ways"),
        Axis::log("s"),
    );
    let plot = LINKS.iter().zip(curves).fold(plot, |plot, (kind, curve)| {
        let points = curve.iter().map(|(size, time)| (*size as f64, *time));
        plot.with(Series::line(kind.name, points.collect()))
    });
    plot.mark_x(1000.0, "the paper: flat up to about 1000 B").to_svg()
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    #[test]
    fn a_curve_is_flat_until_it_bends() {
        let curve = vec![(1, 0.4), (100, 0.41), (1000, 0.48), (3000, 0.9), (10_000, 2.0)];
        assert_eq!(flat_to(&curve), 1000);
        let text = markdown(&vec![curve.clone(); 4], [5; 4]);
        assert!(
            text.contains("| 64 kbit/s | 400 ms | 480 ms | 900 ms | 2000 ms | 1000 B |"),
            "{text}"
        );
        assert!(plot(&vec![curve; 4]).contains("about 1000 B"));
    }

    #[test]
    fn the_same_seed_draws_the_same_sizes() {
        let settings = |seed| Settings {
            seed,
            quick: false,
            broker: PathBuf::new(),
        };
        assert_eq!(sizes(&settings(1)), sizes(&settings(1)));
        assert_ne!(sizes(&settings(1)), sizes(&settings(2)));
        let sizes = sizes(&settings(1));
        assert_eq!((sizes.first(), sizes.last()), (Some(&1), Some(&LARGEST)));
    }
}
