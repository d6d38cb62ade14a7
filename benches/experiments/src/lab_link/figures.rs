//! The table and the plot of the lab behind a narrow link.

use std::fmt::Write as _;

use mom_plots::{Axis, Plot, Series, quantiles};

use super::{Both, Seen, VIEWS, Way};
use crate::{IMAGES, quantile};

/// p50, p99 and the worst of times in s, in ms.
fn shown(times: &[f64]) -> String {
    let times = sorted(times);
    if times.is_empty() {
        return String::new();
    }
    let times = [0.5, 0.99, 1.0].map(|share| format!("{:.0}", 1000.0 * quantile(&times, share)));
    times.join(" / ")
}

fn sorted(times: &[f64]) -> Vec<f64> {
    let mut sorted = times.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted
}

/// So much later than without images is still as soon: two segments, a chunk, and a turn of this machine's scheduler.
const AS_SOON: f64 = 0.1;

/// Whether 99 of 100 times, in s, are as short with images as without.
fn is_kept(with: &[f64], without: &[f64]) -> bool {
    let [with, without] = [with, without].map(|times| quantile(&sorted(times), 0.99));
    with <= without + AS_SOON
}

/// The ages of the images of all cameras.
fn image_ages(seen: &Seen) -> Vec<f64> {
    seen.images.concat()
}

/// The least and the greatest of the cameras' images per second.
fn rates(images: [usize; 4], seconds: f64) -> String {
    let rates = images.map(|images| images as f64 / seconds);
    let least = rates.into_iter().reduce(f64::min).unwrap_or_default();
    let most = rates.into_iter().reduce(f64::max).unwrap_or_default();
    format!("{least:.1}–{most:.1}")
}

fn rows(ways: &[(Way, Both)]) -> impl Iterator<Item = (String, &Seen)> {
    ways.iter().flat_map(|(way, both)| {
        [
            (format!("{}, images", way.name), &both.with),
            (format!("{}, no images", way.name), &both.without),
        ]
    })
}

pub(super) fn markdown(ways: &[(Way, Both)]) -> String {
    let mut text = intro(ways);
    text += "| | images/s and camera, sent | seen | age of images, ms | states/s, sent | seen | age of states, ms | known state at its oldest, ms |\n\
             |---|---:|---:|---:|---:|---:|---:|---:|\n";
    for (name, seen) in rows(ways) {
        let images = match image_ages(seen).is_empty() {
            true => " | | |".to_owned(),
            false => format!(
                " {} | {} | {} |",
                rates(seen.images_sent, seen.seconds),
                rates(seen.images.each_ref().map(Vec::len), seen.seconds),
                shown(&image_ages(seen))
            ),
        };
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "| {name} |{images} {:.1} | {:.1} | {} | {} |",
            seen.states_sent as f64 / seen.seconds,
            seen.states.len() as f64 / seen.seconds,
            shown(&seen.states),
            shown(&seen.known)
        );
    }
    text += "\n| | stops | until the arm stands, ms | until the operator has heard so, ms |\n|---|---:|---:|---:|\n";
    for (name, seen) in rows(ways) {
        let _ = writeln!(
            text,
            "| {name} | {} | {} | {} |",
            seen.stood.len(),
            shown(&seen.stood),
            shown(&seen.heard)
        );
    }
    text += &judged(ways);
    let _ = writeln!(
        text,
        "\n![Ages behind a narrow link](images/{IMAGES}-lab-link.svg)"
    );
    text
}

/// Which bounds are kept, by the figures.
fn judged(ways: &[(Way, Both)]) -> String {
    let all = |pick: fn(&Seen) -> &[f64]| {
        ways.iter()
            .filter(|(way, _)| way.rate.is_some())
            .all(|(_, both)| is_kept(pick(&both.with), pick(&both.without)))
    };
    let said = |kept| if kept { "kept" } else { "not kept" };
    let (stood, known, heard) = (
        all(|seen| &seen.stood),
        all(|seen| &seen.known),
        all(|seen| &seen.heard),
    );
    let text = format!(
        "\nA bound is kept if with images p99 is at most {:.0} ms above p99 without. Over the narrow links: until the arm stands, {}; the known state at its oldest (how old the newest \
         state that the operator has had becomes before the next one comes), {}; until the operator has heard that the arm stands, {}. Images thin out to what the link carries: a newer one takes the place of \
         one that waits, so that what comes has waited for the images of the other cameras and no longer.",
        1000.0 * AS_SOON,
        said(stood),
        said(known),
        said(heard)
    );
    text + "\n"
}

fn intro(ways: &[(Way, Both)]) -> String {
    let links = ways.iter().filter(|(way, _)| way.rate.is_some());
    let links = links.map(|(way, _)| format!("{} one way", way.name));
    let (bytes, images) = ways.iter().fold((0, 0), |(bytes, images), (_, both)| {
        let sent: usize = both.with.images_sent.iter().sum();
        (bytes + both.with.image_bytes, images + sent)
    });
    let seconds = ways.first().map_or(0.0, |(_, both)| both.with.seconds);
    format!(
        "The demonstration lab (`config/lab.toml`) with its arm and its {} cameras, each a process beside the broker. Alice has the arm move all the time. An operator at the other \
         end of a link has joined the arm and all cameras by one connection (TLS), and does nothing against the flood. For {seconds:.0} s its images and states are counted and their age taken at \
         arrival; then it sends stops, each while the arm moves, and the arm is let go again. Then the same by an operator who has not joined the cameras. \
         Ages and times are p50 / p99 / the worst, and the link's own delay is part of them.\n\n\
         **Inputs:** the links, both ways alike: {}; nothing lost, a queue of 4 s at the bottleneck, emulated by a packet relay between two network namespaces. \
         The cameras' own settings (at most 10 images a second, class `latest`; here {:.0} kB each).\n\n",
        VIEWS.len(),
        links.collect::<Vec<_>>().join(", "),
        bytes as f64 / 1000.0 / images.max(1) as f64
    )
}

pub(super) fn plot(ways: &[(Way, Both)]) -> String {
    let plot = Plot::new(
        "How old the known state becomes, and images are, at the operator",
        Axis::log("ms"),
        Axis::linear("share of them").from_to(0.0, 1.0),
    );
    let curve = |ages: &[f64]| quantiles(&sorted(&ages.iter().map(|age| 1000.0 * age).collect::<Vec<_>>()));
    let plot = ways.iter().fold(plot, |plot, (way, both)| {
        let (known, images) = (curve(&both.with.known), curve(&image_ages(&both.with)));
        plot.with(Series::steps(format!("known state, {}", way.name), known))
            .with(Series::steps(format!("images, {}", way.name), images))
    });
    plot.to_svg()
}

#[cfg(test)]
mod tests {
    use super::super::WAYS;
    use super::*;

    fn seen(ages: &[f64]) -> Seen {
        Seen {
            seconds: 10.0,
            images: std::array::from_fn(|_| ages.to_vec()),
            states: vec![0.2; 100],
            known: vec![0.3; 99],
            images_sent: [40, 50, 60, 50],
            image_bytes: 200 * 25_000,
            states_sent: 200,
            stood: vec![0.4, 0.3],
            heard: vec![0.7, 0.6],
        }
    }

    #[test]
    fn a_bound_is_judged_by_the_figures() {
        assert!(is_kept(&[0.5, 0.3], &[0.41]) && !is_kept(&[0.3, 0.52], &[0.41]));
        let mut late = seen(&[0.5]);
        late.known.push(1.5);
        late.known.push(1.5);
        let both = Both {
            with: late,
            without: seen(&[]),
        };
        let text = judged(&[(WAYS[2], both)]);
        assert!(
            text.contains(
                "before the next one comes), not kept; until the operator has heard that the arm stands, kept"
            ),
            "{text}"
        );
    }

    #[test]
    fn the_table_puts_what_was_seen_beside_what_was_sent() {
        let both = Both {
            with: seen(&[0.5, 0.7]),
            without: seen(&[]),
        };
        let ways = [(WAYS[1], both)];
        let text = markdown(&ways);
        assert!(
            text.contains("| 1 Mbit/s, 150 ms, images | 4.0–6.0 | 0.2–0.2 | 500 / 700 / 700 | 20.0 | 10.0 | 200 / 200 / 200 | 300 / 300 / 300 |"),
            "{text}"
        );
        assert!(
            text.contains("| 1 Mbit/s, 150 ms, no images | | | | 20.0 | 10.0 |"),
            "{text}"
        );
        assert!(
            text.contains("| 2 | 300 / 400 / 400 | 600 / 700 / 700 |"),
            "{text}"
        );
        assert!(text.contains("here 25 kB each"), "{text}");
        assert!(!text.contains("not kept"), "{text}");
        assert!(plot(&ways).contains("known state, 1 Mbit/s, 150 ms"));
    }
}
