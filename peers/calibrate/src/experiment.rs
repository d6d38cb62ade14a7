//! The calibration of a simulated camera, for experiments: how its error depends on the number of poses and on noise.

use crate::poses::spread;
use crate::{CalibrationError, Observation, Projection, calibrate};

/// The matrix of the lab's camera x at 640×480, rounded: an example.
pub const LAB_X: [f64; 12] = [
    -302.44, 832.0, -101.09, 560_733.0, //
    -25.8, 0.0, -887.6, 715_856.0, //
    -0.945_12, 0.0, -0.315_92, 1_752.29,
];

/// Where the marker sits in the gripper's frame, and its radius, mm.
const MARKER: ([f64; 3], f64) = (crate::MARKER, crate::RADIUS);
/// The workspace of M50 at the marker, where the error is measured, mm.
const SPACE: [(f64, f64); 3] = [(-300.0, 300.0), (-300.0, 300.0), (0.0, 450.0)];
/// How many points of it.
const POINTS: usize = 500;

/// Calibrates a camera whose matrix is known and says how far off the result is: the root of the mean squared distance
/// of points all over the workspace, pixels.
///
/// The marker is measured in so many poses, each with a normal error of deviation `noise` pixels in both
/// directions. The same arguments give the same number.
///
/// # Errors
///
/// [`CalibrationError`] if the matrix is that of no camera, or the poses are too few.
///
/// ```
/// use mom_calibrate::experiment::{LAB_X, rms};
///
/// assert!(rms(LAB_X, 20, 0.0, 1)? < 1e-6);
/// assert!(rms(LAB_X, 20, 1.0, 1)? > 0.1);
/// # Ok::<(), mom_calibrate::CalibrationError>(())
/// ```
pub fn rms(matrix: [f64; 12], poses: usize, noise: f64, seed: u64) -> Result<f64, CalibrationError> {
    let camera = Projection::new(matrix).ok_or(CalibrationError::NoCamera("its matrix has no depth"))?;
    let mut random = fastrand::Rng::with_seed(seed);
    let (offset, radius) = MARKER;
    let observations: Vec<Observation> = spread(poses, seed)
        .iter()
        .filter_map(|pose| {
            let world = pose.place(offset);
            let [u, v] = camera.project_ball(world, radius)?;
            let [a, b] = normal(&mut random);
            Some(Observation {
                world,
                pixel: [u + noise * a, v + noise * b],
            })
        })
        .collect();
    let measured = calibrate(&observations, radius)?.projection;
    let mut squares = 0.0;
    let mut count = 0.0;
    for _ in 0..POINTS {
        let point = SPACE.map(|(low, high)| low + random.f64() * (high - low));
        if let (Some(truth), Some(found)) = (camera.project(point), measured.project(point)) {
            squares += (truth[0] - found[0]).powi(2) + (truth[1] - found[1]).powi(2);
            count += 1.0;
        }
    }
    Ok((squares / f64::max(count, 1.0)).sqrt())
}

/// Two independent normal numbers of deviation 1 (Box and Muller).
fn normal(random: &mut fastrand::Rng) -> [f64; 2] {
    let radius = (-2.0 * (1.0 - random.f64()).ln()).sqrt();
    let (sin, cos) = (std::f64::consts::TAU * random.f64()).sin_cos();
    [radius * cos, radius * sin]
}
