//! From errors in images to millimetres: the control law.
//!
//! Each camera says in its own image how far a thing is from where it is to be. The millimetres are those whose pictures,
//! by the cameras' matrices, are nearest to all these errors (Gauss and Newton on the interaction matrices). A camera that is wrong by
//! a shift says no wrong thing: both places are in the same image.

use mom_vision::Projection;
use nalgebra::{Matrix3, Vector3};

/// Of a place in an image, pixels.
const NOISE: f64 = 0.3;

/// A thing in a camera's image, and where it is to be.
#[derive(Debug, Clone, Copy)]
pub struct Sightline {
    /// From mm to pixels of that image.
    pub projection: Projection,
    /// Where the thing is in the image.
    pub pixel: [f64; 2],
    /// Where it is to be, mm, as this camera has it.
    pub target: [f64; 3],
}

/// How far a thing is from where it is to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Miss {
    /// mm: its place minus the target.
    pub off: [f64; 3],
    /// Root of the mean square of the errors in the images, pixels.
    pub pixels: f64,
}

impl Miss {
    /// mm on the level.
    #[must_use]
    pub fn level(&self) -> f64 {
        self.off[0].hypot(self.off[1])
    }

    /// mm.
    #[must_use]
    pub fn distance(&self) -> f64 {
        self.level().hypot(self.off[2])
    }
}

/// How far it is; `expected` with its deviations, mm, is what was thought before, and counts where the images do not
/// tell. None without an image.
#[must_use]
pub fn miss(lines: &[Sightline], expected: [f64; 3], deviation: [f64; 3]) -> Option<Miss> {
    if lines.is_empty() {
        return None;
    }
    let expected = Vector3::from(expected);
    let mut off = expected;
    for _ in 0..5 {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for i in 0..3 {
            let weight = deviation[i].max(1e-6).powi(-2);
            normal[(i, i)] += weight;
            right[i] += weight * (off[i] - expected[i]);
        }
        for line in lines {
            let (error, slopes) = linear(line, &off)?;
            for (error, slope) in error.iter().zip(slopes) {
                normal += slope * slope.transpose() * NOISE.powi(-2);
                right += slope * (error * NOISE.powi(-2));
            }
        }
        let step = normal.cholesky()?.solve(&right);
        off -= step;
        if step.norm() < 1e-4 {
            break;
        }
    }
    let mut sum = 0.0;
    for line in lines {
        let [u, v] = line.projection.project(line.target)?;
        sum += (line.pixel[0] - u).powi(2) + (line.pixel[1] - v).powi(2);
    }
    let found = Miss {
        off: off.into(),
        pixels: (sum / lines.len() as f64).sqrt(),
    };
    found.off.iter().all(|part| part.is_finite()).then_some(found)
}

/// The expected minus the seen place in the image, and the rows of the interaction matrix there.
fn linear(line: &Sightline, off: &Vector3<f64>) -> Option<([f64; 2], [Vector3<f64>; 2])> {
    const STEP: f64 = 0.1;
    let at = Vector3::from(line.target) + off;
    let here = line.projection.project(at.into())?;
    let mut slopes = [Vector3::zeros(); 2];
    for i in 0..3 {
        let mut moved = at;
        moved[i] += STEP;
        let there = line.projection.project(moved.into())?;
        for (k, slope) in slopes.iter_mut().enumerate() {
            slope[i] = (there[k] - here[k]) / STEP;
        }
    }
    Some(([here[0] - line.pixel[0], here[1] - line.pixel[1]], slopes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::turned;

    /// One metre above the table, and one metre above and before it.
    fn cameras() -> [Projection; 2] {
        let above = [
            500.0, 0.0, -320.0, 320_000.0, 0.0, -500.0, -240.0, 240_000.0, 0.0, 0.0, -1.0, 1000.0,
        ];
        let slanting = [
            500.0,
            226.274,
            -226.274,
            452_548.3, //
            0.0,
            -183.848,
            -523.259,
            339_411.3, //
            0.0,
            0.707,
            -0.707,
            1_414.213_6,
        ];
        [above, slanting].map(|numbers| Projection::new(numbers).unwrap())
    }

    #[test]
    fn two_cameras_tell_three_directions() {
        let (target, off) = ([20.0, -30.0, 40.0], [15.0, -8.0, 25.0]);
        let lines = cameras().map(|projection| Sightline {
            projection,
            pixel: projection
                .project(std::array::from_fn(|i| target[i] + off[i]))
                .unwrap(),
            target,
        });
        let found = miss(&lines, [0.0; 3], [1000.0; 3]).unwrap();
        for (found, off) in found.off.iter().zip(off) {
            assert!((found - off).abs() < 1e-3, "{found} {off}");
        }
        assert!(miss(&[], [0.0; 3], [1.0; 3]).is_none());
    }

    /// The target is where the turned camera sees the block that the thing is to be at: a shift is in both.
    #[test]
    fn a_turned_camera_is_right_where_the_error_is_none() {
        let turn = Vector3::new(0.04, -0.03, 0.0);
        let lines = cameras().map(|projection| {
            let wrong = turned(&projection, &turn).unwrap();
            // Found at the height of the table's blocks by the wrong matrix.
            let pixel = projection.project([50.0, 20.0, 20.0]).unwrap();
            let line = Sightline {
                projection: wrong,
                pixel,
                target: [50.0, 20.0, 20.0],
            };
            let local = miss(&[line], [0.0; 3], [1e3, 1e3, 1e-3]).unwrap().off;
            Sightline {
                target: [50.0 + local[0], 20.0 + local[1], 20.0],
                ..line
            }
        });
        assert!(miss(&lines, [0.0; 3], [1000.0; 3]).unwrap().distance() < 0.1);
    }
}
