//! M41: how well the visual-servoing agent puts one block beside another, by the delay.

use std::fmt::Write as _;

use anyhow::Result;
use fastrand::Rng;
use mom_plots::{Axis, Plot, Series};
use mom_rehearsal::{Outcome, Start};

use super::{IMAGES, Section, Settings, quantile};

/// ms on the way of commands, and of images: each.
const DELAYS: [i64; 3] = [0, 300, 1000];
/// Starts for each delay.
const STARTS: usize = 100;
/// Degrees by which a camera's matrix is wrong, at most.
const WRONG: f64 = 2.0;
/// s of its own time after which a start is given up.
const LIMIT: i64 = 300;
/// Draws of a bootstrap.
const DRAWS: usize = 1000;

/// The starts with one delay.
struct Row {
    delay: i64,
    outcomes: Vec<Outcome>,
}

pub(super) fn run(settings: &Settings) -> Result<Section> {
    let starts = if settings.quick { 1 } else { STARTS };
    let delays = if settings.quick {
        &DELAYS[1..2]
    } else {
        &DELAYS[..]
    };
    // The same starts for each delay.
    let rows = delays.iter().map(|&delay| Row {
        delay,
        outcomes: rehearse(settings.seed, starts, delay),
    });
    let rows: Vec<Row> = rows.collect();
    let mut random = Rng::with_seed(settings.seed);
    Ok(Section {
        markdown: markdown(&rows, starts, &mut random),
        plots: vec![("experiment-servo.svg", plot(&rows))],
    })
}

/// Half of them on a thread of their own.
fn rehearse(seed: u64, starts: usize, delay: i64) -> Vec<Outcome> {
    let mut random = Rng::with_seed(seed);
    let starts = (0..starts).map(|_| Start::random(&mut random, WRONG, delay * 1000));
    let starts: Vec<Start> = starts.collect();
    let (one, other) = starts.split_at(starts.len() / 2);
    let all = |starts: &[Start]| {
        starts
            .iter()
            .map(|start| start.rehearse(LIMIT))
            .collect::<Vec<Outcome>>()
    };
    std::thread::scope(|scope| {
        let beside = scope.spawn(|| all(one));
        let mut outcomes = all(other);
        // A thread that broke down gives no outcomes, and the table says how many there are.
        outcomes.extend(beside.join().unwrap_or_default());
        outcomes
    })
}

/// A value at a share of the sorted ones, and what 95 % of bootstrap draws have there.
fn interval(values: &[f64], share: f64, random: &mut Rng) -> [f64; 3] {
    let at = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        quantile(&values, share)
    };
    if values.is_empty() {
        return [f64::NAN; 3];
    }
    let draw = |random: &mut Rng| {
        (0..values.len())
            .map(|_| values[random.usize(0..values.len())])
            .collect()
    };
    let mut draws: Vec<f64> = (0..DRAWS).map(|_| at(draw(random))).collect();
    draws.sort_by(f64::total_cmp);
    [
        at(values.to_vec()),
        quantile(&draws, 0.025),
        quantile(&draws, 0.975),
    ]
}

impl Row {
    fn aligned(&self) -> Vec<&Outcome> {
        self.outcomes
            .iter()
            .filter(|outcome| outcome.failure.is_none())
            .collect()
    }

    fn of(&self, value: fn(&Outcome) -> f64) -> Vec<f64> {
        self.aligned().into_iter().map(value).collect()
    }
}

fn markdown(rows: &[Row], starts: usize, random: &mut Rng) -> String {
    let mut text = format!(
        "The paper: \"the visual servo agent would then keep moving the robot and analysing new images until the desired state was reached, at which point it would return robot control to the user\". \
         It built none and measures none. Here the controller of `mom-servo` puts the red block beside the green one from {starts} random starts for each delay, in virtual time, with the simulated arm and \
         the pictures that the lab's cameras x, y and top draw (640×480, JPEG quality 80, two a second each). The error is the distance of the red block's middle from its place, in truth. The intervals are 95 % of a bootstrap.\n\n\
         **Inputs:** three blocks at random places at least 120 mm apart, turned at random; a random side, a gap of 10 to 40 mm, a random pose of the hand; each camera's matrix wrong by a rotation of up to {WRONG} degrees about a random axis \
         (one degree shifts the picture of camera top by 52 mm on the table); the delay is that of commands, and again that of images, so the loop is twice as slow. Clocks without error, nothing lost, no jitter.\n\n\
         | delay each way | aligned | error, mm: median | 90 % | max | s: median | 90 % | commands: median | max | put down more than once |\n|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n"
    );
    for row in rows {
        let errors = row.of(|outcome| outcome.error);
        let mut cell = |share: f64| {
            let [value, low, high] = interval(&errors, share, random);
            format!("{value:.2} ({low:.2}–{high:.2})")
        };
        let (median, most) = (cell(0.5), cell(0.9));
        let at = |value: fn(&Outcome) -> f64, share: f64| {
            let mut values = row.of(value);
            values.sort_by(f64::total_cmp);
            quantile(&values, share)
        };
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "| {} ms | {} of {} | {median} | {most} | {:.2} | {:.0} | {:.0} | {:.0} | {:.0} | {} |",
            row.delay,
            errors.len(),
            row.outcomes.len(),
            at(|outcome| outcome.error, 1.0),
            at(|outcome| outcome.seconds, 0.5),
            at(|outcome| outcome.seconds, 0.9),
            at(|outcome| outcome.progress.commands.into(), 0.5),
            at(|outcome| outcome.progress.commands.into(), 1.0),
            row.aligned()
                .iter()
                .filter(|outcome| outcome.progress.attempts > 1)
                .count(),
        );
    }
    text += &failures(rows);
    let _ = writeln!(text, "\n![Alignment error](images/{IMAGES}-servo.svg)");
    text
}

/// Every failure, with its reason.
fn failures(rows: &[Row]) -> String {
    let failed = rows.iter().flat_map(|row| {
        row.outcomes
            .iter()
            .filter_map(|outcome| Some(format!("- {} ms: {}\n", row.delay, outcome.failure.as_deref()?)))
    });
    let failed: Vec<String> = failed.collect();
    let outside = rows
        .iter()
        .flat_map(|row| &row.outcomes)
        .filter(|outcome| !outcome.inside)
        .count();
    let word = "*Aligned* is the agent's word, by its images; what they were wrong by, an error may be beyond its tolerance of 3 mm.";
    let mut text = match failed.is_empty() {
        true => format!("\n{word} None failed. "),
        false => format!(
            "\n{word} Those that failed, and what it said:\n\n{}\n",
            failed.concat()
        ),
    };
    let _ = writeln!(text, "The hand left the workspace in {outside} of them.");
    text
}

fn plot(rows: &[Row]) -> String {
    let plot = Plot::new(
        "Alignment error of the servo agent (M41)",
        Axis::linear("mm"),
        Axis::linear("share of the starts"),
    );
    let plot = rows.iter().fold(plot, |plot, row| {
        let mut errors = row.of(|outcome| outcome.error);
        errors.sort_by(f64::total_cmp);
        let count = row.outcomes.len().max(1) as f64;
        let steps = errors
            .iter()
            .enumerate()
            .map(|(i, error)| (*error, (i + 1) as f64 / count));
        plot.with(Series::steps(
            format!("{} ms each way", row.delay),
            steps.collect(),
        ))
    });
    plot.mark_x(mom_servo::control::ALIGNED, "tolerance").to_svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_hold_their_value() {
        let values: Vec<f64> = (1..=100).map(f64::from).collect();
        let [median, low, high] = interval(&values, 0.5, &mut Rng::with_seed(1));
        assert!(
            low < median && median < high && high - low < 40.0,
            "{low} {median} {high}"
        );
        assert_eq!(median, 50.0);
        assert!(interval(&[], 0.5, &mut Rng::with_seed(1))[0].is_nan());
    }

    #[test]
    fn one_start_is_told_as_a_row() {
        let outcomes = rehearse(1, 1, 0);
        assert_eq!(outcomes.len(), 1);
        let rows = [Row { delay: 0, outcomes }];
        let text = markdown(&rows, 1, &mut Rng::with_seed(1));
        assert!(
            text.contains("| 0 ms | 1 of 1 | ") && text.contains("None failed."),
            "{text}"
        );
        assert!(plot(&rows).starts_with("<svg"));
    }
}
