//! M55: how well a camera is calibrated, by the number of poses and the noise of the measured marker.

use std::fmt::Write as _;

use anyhow::{Context as _, Result};
use fastrand::Rng;
use mom_calibrate::experiment::LAB_X;
use mom_calibrate::poses::spread;
use mom_calibrate::{MARKER, Observation, Projection, RADIUS, calibrate};
use mom_plots::{Axis, Plot, Series};

use super::{IMAGES, Section, Settings, quantile};

/// How many poses; the paper had 20.
const POSES: [usize; 10] = [6, 7, 8, 10, 12, 15, 20, 30, 40, 50];
/// Deviations of a measured place, pixels in either direction.
const NOISE: [f64; 5] = [0.0, 0.25, 0.5, 1.0, 2.0];
/// Calibrations of each kind.
const RUNS: usize = 200;
/// The workspace of M50, mm, in which the fresh points are.
const SPACE: [(f64, f64); 3] = [(-300.0, 300.0), (-300.0, 300.0), (0.0, 450.0)];
/// How many fresh points.
const POINTS: usize = 200;
/// One calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Run {
    /// The fit's own RMS at the poses it was made from, pixels.
    fit: f64,
    /// The RMS at points that it has not seen, pixels.
    fresh: f64,
}

/// The calibrations of one number of poses and one noise.
#[derive(Clone, Debug, PartialEq)]
struct Cell {
    fit: f64,
    fresh: f64,
    /// What nineteen in twenty do not exceed.
    worst: f64,
    /// Runs that gave no matrix.
    refused: usize,
}

pub(super) fn run(settings: &Settings) -> Result<Section> {
    let runs = if settings.quick { 3 } else { RUNS };
    let mut random = Rng::with_seed(settings.seed);
    let camera = Projection::new(LAB_X).context("the lab's camera has no depth")?;
    let cells = POSES.map(|poses| NOISE.map(|noise| cell(&camera, poses, noise, runs, &mut random)));
    Ok(Section {
        markdown: markdown(&cells, scale(&camera), runs),
        plots: vec![("experiment-calibration.svg", plot(&cells))],
    })
}

fn cell(camera: &Projection, poses: usize, noise: f64, runs: usize, random: &mut Rng) -> Cell {
    let results: Vec<Run> = (0..runs)
        .filter_map(|_| once(camera, poses, noise, random))
        .collect();
    let of = |value: fn(&Run) -> f64, share: f64| {
        let mut values: Vec<f64> = results.iter().map(value).collect();
        values.sort_by(f64::total_cmp);
        quantile(&values, share)
    };
    Cell {
        fit: of(|run| run.fit, 0.5),
        fresh: of(|run| run.fresh, 0.5),
        worst: of(|run| run.fresh, 0.95),
        refused: runs - results.len(),
    }
}

/// Calibrates once; none if the observations give no matrix.
fn once(camera: &Projection, poses: usize, noise: f64, random: &mut Rng) -> Option<Run> {
    // Seed 0 would be the same poses each time.
    let poses = spread(poses, random.u64(1..));
    let observations = poses.iter().filter_map(|pose| {
        let world = pose.place(MARKER);
        let [u, v] = camera.project_ball(world, RADIUS)?;
        let [a, b] = normal(random);
        Some(Observation {
            world,
            pixel: [u + noise * a, v + noise * b],
        })
    });
    let observations: Vec<Observation> = observations.collect();
    let measured = calibrate(&observations, RADIUS).ok()?;
    let points = (0..POINTS).map(|_| SPACE.map(|(low, high)| low + random.f64() * (high - low)));
    let points: Vec<[f64; 3]> = points.collect();
    Some(Run {
        fit: measured.rms,
        fresh: apart(camera, &measured.projection, &points),
    })
}

/// The root of the mean squared distance of points in two cameras' images, pixels.
fn apart(one: &Projection, other: &Projection, points: &[[f64; 3]]) -> f64 {
    let seen = points
        .iter()
        .filter_map(|point| Some((one.project(*point)?, other.project(*point)?)));
    let squares: Vec<f64> = seen
        .map(|(a, b)| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2))
        .collect();
    (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
}

/// Two independent normal numbers of deviation 1 (Box and Muller).
fn normal(random: &mut Rng) -> [f64; 2] {
    let radius = (-2.0 * (1.0 - random.f64()).ln()).sqrt();
    let (sin, cos) = (std::f64::consts::TAU * random.f64()).sin_cos();
    [radius * cos, radius * sin]
}

/// mm that a pixel is wide at the middle of the table.
fn scale(camera: &Projection) -> f64 {
    let at = |y: f64| camera.project([0.0, y, 0.0]);
    let pixels = at(-1.0)
        .zip(at(1.0))
        .map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
    pixels.map_or(f64::NAN, |pixels| 2.0 / pixels)
}

type Cells = [[Cell; NOISE.len()]; POSES.len()];

fn markdown(cells: &Cells, scale: f64, runs: usize) -> String {
    let mut text = format!(
        "The paper: \"recording the position of the robot in camera images for 20 different robot poses, the camera matrix is then obtained by a least squares fit\". It gives no error. \
         Here a camera whose matrix is known (the lab's x, 640×480; a pixel is {scale:.1} mm wide at the middle of the table) is calibrated {runs} times for each number of poses and each noise, by the code of `mom calibrate`. \
         The first number is the median of the fit's own RMS, which a calibration can tell; the second, *fresh*, is the RMS at {POINTS} points all over the workspace that the fit has not seen, \
         which only the true matrix can tell; the third is what 95 % of the calibrations do not exceed of it.\n\n\
         **Inputs:** the noise, normal, in both directions of the image; poses of `mom calibrate`, shifted at random; they keep 130 mm above the table, so that fresh points near the table are beyond what was measured; the pose and the marker's place in the hand known exactly, no lens distortion, no marker that is found wrongly.\n\n\
         | poses; fit / fresh / 95 %, pixels |"
    );
    let noisy = |column: &usize| NOISE[*column] > 0.0;
    let columns: Vec<usize> = (0..NOISE.len()).filter(noisy).collect();
    for column in &columns {
        // Writing to a String cannot fail.
        let _ = write!(text, " noise {} |", NOISE[*column]);
    }
    text += "\n|---:|";
    text += &"---:|".repeat(columns.len());
    text.push('\n');
    for (poses, row) in POSES.iter().zip(cells) {
        let _ = write!(text, "| {poses} |");
        for cell in columns.iter().map(|column| &row[*column]) {
            let _ = write!(
                text,
                " {} |",
                [cell.fit, cell.fresh, cell.worst].map(show).join(" / ")
            );
        }
        text.push('\n');
    }
    let exact = cells
        .iter()
        .flatten()
        .zip(NOISE.iter().cycle())
        .filter(|(_, noise)| **noise == 0.0);
    let exact = exact.map(|(cell, _)| cell.worst).fold(0.0, f64::max);
    let _ = writeln!(
        text,
        "\nWithout noise 95 % of the calibrations are exact to {exact:.0e} pixels, with any of these numbers of poses."
    );
    text += &verdict(cells, scale, runs * POSES.len() * NOISE.len());
    let _ = writeln!(text, "\n![Calibration](images/{IMAGES}-calibration.svg)");
    text
}

fn verdict(cells: &Cells, scale: f64, all: usize) -> String {
    let at = |poses: usize, noise: f64| {
        let row = POSES.iter().position(|known| *known == poses)?;
        let column = NOISE.iter().position(|known| *known == noise)?;
        cells.get(row)?.get(column)
    };
    let fresh = |poses: usize| at(poses, 1.0).map_or(f64::NAN, |cell| cell.fresh);
    let fit = |poses: usize| at(poses, 1.0).map_or(f64::NAN, |cell| cell.fit);
    let refused: usize = cells.iter().flatten().map(|cell| cell.refused).sum();
    format!(
        "\nThe fit's own RMS is not a measure of accuracy: with few poses it is small because 11 numbers are fitted to 2 equations a pose, and rises with more poses towards the noise (√2 of the deviation), while the error at fresh points falls. \
         With a noise of 1 pixel and 6, 20 and 50 poses the fit says {:.2}, {:.2} and {:.2} pixels, and fresh points are off by {:.2}, {:.2} and {:.2} ({:.1}, {:.1} and {:.1} mm). \
         So the paper's 20 poses are enough where the marker is found to a fraction of a pixel; beyond them the error falls with about the root of their number. \
         {refused} of the {all} calibrations gave no matrix, with the reason. What is not in these figures: errors of the arm's poses and of the lens, which no number of poses takes away.\n",
        fit(6),
        fit(20),
        fit(50),
        fresh(6),
        fresh(20),
        fresh(50),
        fresh(6) * scale,
        fresh(20) * scale,
        fresh(50) * scale,
    )
}

fn show(pixels: f64) -> String {
    if pixels.is_nan() {
        return "none".to_owned();
    }
    format!("{pixels:.2}")
}

fn plot(cells: &Cells) -> String {
    let plot = Plot::new(
        "Error of a calibration, median (M55)",
        Axis::linear("poses").from_to(0.0, 50.0),
        Axis::log("pixels"),
    );
    let curve = |column: usize, of: fn(&Cell) -> f64| {
        let points = POSES.iter().zip(cells);
        points
            .map(|(poses, row)| (*poses as f64, of(&row[column])))
            .collect()
    };
    // Without noise there is only rounding.
    let noisy = NOISE.iter().enumerate().filter(|(_, noise)| **noise > 0.0);
    let plot = noisy.fold(plot, |plot, (column, noise)| {
        let name = format!("fresh points, noise {noise}");
        let plot = plot.with(Series::line(name, curve(column, |cell| cell.fresh)));
        match *noise == 1.0 {
            true => plot.with(Series::line(
                "the fit's own, noise 1",
                curve(column, |cell| cell.fit),
            )),
            false => plot,
        }
    });
    plot.mark_x(20.0, "the paper: 20 poses").to_svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Projection {
        Projection::new(LAB_X).unwrap()
    }

    #[test]
    fn without_noise_the_matrix_is_found() {
        let cell = cell(&camera(), 12, 0.0, 3, &mut Rng::with_seed(1));
        assert!(
            cell.fit < 1e-6 && cell.worst < 1e-6 && cell.refused == 0,
            "{cell:?}"
        );
    }

    #[test]
    fn the_fit_looks_better_than_it_is_and_more_poses_make_it_better() {
        let mut random = Rng::with_seed(1);
        let few = cell(&camera(), 8, 1.0, 9, &mut random);
        let many = cell(&camera(), 40, 1.0, 9, &mut random);
        assert!(few.fit < few.fresh && few.fit < many.fit, "{few:?} {many:?}");
        assert!(
            many.fresh < few.fresh / 1.5 && many.fresh < many.fit,
            "{few:?} {many:?}"
        );
        // √2 of the deviation, less what 11 of 80 numbers take.
        let expected = (2.0 * (1.0 - 11.0 / 80.0_f64)).sqrt();
        assert!((many.fit - expected).abs() < 0.2, "{many:?}");
    }

    #[test]
    fn distances_between_images() {
        let one = camera();
        let points = [[0.0, 0.0, 0.0], [100.0, 50.0, 200.0]];
        assert_eq!(apart(&one, &one, &points), 0.0);
        // All of the image three pixels to the right and four down.
        let mut numbers = LAB_X;
        for column in 0..4 {
            numbers[column] += 3.0 * numbers[8 + column];
            numbers[4 + column] += 4.0 * numbers[8 + column];
        }
        let moved = Projection::new(numbers).unwrap();
        assert!((apart(&one, &moved, &points) - 5.0).abs() < 1e-9);
        assert!((scale(&one) - 1752.29 / 832.0).abs() < 0.01, "{}", scale(&one));
    }

    #[test]
    fn numbers_of_the_table() {
        assert_eq!([1.234, f64::NAN].map(show), ["1.23", "none"]);
        let cell = Cell {
            fit: 1.0,
            fresh: 2.0,
            worst: 3.0,
            refused: 1,
        };
        let cells: Cells = std::array::from_fn(|_| std::array::from_fn(|_| cell.clone()));
        let text = markdown(&cells, 2.0, 40);
        assert!(text.contains("| 20 | 1.00 / 2.00 / 3.00 | 1.00"), "{text}");
        assert!(
            text.contains("(4.0, 4.0 and 4.0 mm)") && text.contains("50 of the 2000 calibrations"),
            "{text}"
        );
        assert!(plot(&cells).contains("the paper: 20 poses"));
    }
}
