//! The matrix with the least sum of squared distances in the image (Levenberg and Marquardt).
//!
//! The linear estimate makes the residuals of its equations small, which no one sees; this makes those in the image
//! small, for the middle of the marker's outline. The library for it wants another version of nalgebra than
//! the rest of this workspace, and the method is short for so few unknowns.

use mom_vision::projection::{ball, homogeneous};
use nalgebra::{Matrix3x4, SMatrix, SVector};

use crate::dlt::{Normalised, facing};
use crate::{CalibrationError, Observation, Projection};

type Unknowns = SVector<f64, 12>;
type Normal = SMatrix<f64, 12, 12>;

/// The most steps; it takes 3 to 10.
const STEPS: usize = 60;
/// A step that gains a smaller part of the sum than this is the last.
const GAIN: f64 = 1e-12;

/// Refines a matrix by these observations of a ball with this radius in mm.
///
/// # Errors
///
/// [`CalibrationError::NoCamera`] if what fits best has the ball behind it.
pub fn refine(
    start: &Projection,
    observations: &[Observation],
    radius: f64,
) -> Result<Projection, CalibrationError> {
    let normalised = Normalised::new(observations);
    let radius = radius * normalised.world_scale;
    let begin = normalised.of_pixels(&Matrix3x4::from_row_slice(&start.numbers()));
    let mut best = unknowns(&begin).normalize();
    let mut cost = cost(&normalised, &best, radius);
    let mut damping = 1e-3;
    for _ in 0..STEPS {
        let (normal, gradient) = linearised(&normalised, &best, radius);
        let mut gained = 0.0;
        // More damping makes shorter steps, down the slope, until one of them gains.
        while damping < 1e12 {
            let tried = step(&normal, &gradient, damping).map(|step| (best - step).normalize());
            let there = tried.map(|tried| (tried, self::cost(&normalised, &tried, radius)));
            if let Some((tried, less)) = there.filter(|(_, there)| *there < cost) {
                gained = (cost - less) / cost;
                (best, cost, damping) = (tried, less, damping * 0.1);
                break;
            }
            damping *= 10.0;
        }
        if gained < GAIN {
            break;
        }
    }
    facing(normalised.to_pixels(&matrix(&best)), observations)
}

fn unknowns(matrix: &Matrix3x4<f64>) -> Unknowns {
    Unknowns::from_fn(|i, _| matrix[(i / 4, i % 4)])
}

fn matrix(unknowns: &Unknowns) -> Matrix3x4<f64> {
    Matrix3x4::from_fn(|row, column| unknowns[4 * row + column])
}

/// The sum of squared distances; not a number where there is no picture.
fn cost(normalised: &Normalised, unknowns: &Unknowns, radius: f64) -> f64 {
    let matrix = matrix(unknowns);
    let seen = normalised.world.iter().zip(&normalised.pixels);
    seen.map(|(world, [u, v])| {
        let [a, b] = ball(&matrix, &homogeneous(*world), radius).pixel();
        (a - u).powi(2) + (b - v).powi(2)
    })
    .sum()
}

/// `JᵀJ` and `Jᵀr` of the distances `r` and their derivatives `J`.
fn linearised(normalised: &Normalised, unknowns: &Unknowns, radius: f64) -> (Normal, Unknowns) {
    let matrix = matrix(unknowns);
    let square = radius * radius;
    let (mut normal, mut gradient) = (Normal::zeros(), Unknowns::zeros());
    for (world, pixel) in normalised.world.iter().zip(&normalised.pixels) {
        let point = homogeneous(*world);
        let outline = ball(&matrix, &point, radius);
        let seen = matrix * point;
        // Of an entry (row, 2) of the dual conic by a row of the matrix.
        let by = |value: f64, row: usize| {
            let mut along = point * value;
            for i in 0..3 {
                along[i] -= square * matrix[(row, i)];
            }
            along
        };
        for axis in 0..2 {
            let at = outline.middle[axis] / outline.scale;
            let mut slope = Unknowns::zeros();
            let own = by(seen.z, 2) / outline.scale;
            let last = (by(seen[axis], axis) - by(seen.z, 2) * (2.0 * at)) / outline.scale;
            slope.fixed_rows_mut::<4>(4 * axis).copy_from(&own);
            slope.fixed_rows_mut::<4>(8).copy_from(&last);
            normal += slope * slope.transpose();
            gradient += slope * (at - pixel[axis]);
        }
    }
    (normal, gradient)
}

/// The step against the gradient; none where the numbers are no good.
fn step(normal: &Normal, gradient: &Unknowns, damping: f64) -> Option<Unknowns> {
    let mut damped = *normal;
    // The scale of the matrix changes nothing, so that `normal` alone cannot be solved.
    let least = normal.diagonal().max() * 1e-9;
    for i in 0..12 {
        damped[(i, i)] += damping * normal[(i, i)].max(least);
    }
    Some(damped.cholesky()?.solve(gradient))
}
