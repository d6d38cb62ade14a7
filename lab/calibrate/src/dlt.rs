//! The direct linear transformation, normalised (Hartley 1997): the first estimate of the matrix.

use nalgebra::{DMatrix, Matrix3, Matrix3x4, Matrix4, Vector3};

use crate::{CalibrationError, Observation, Projection};

/// The fewest observations: two equations each for 11 unknowns.
pub const LEAST: usize = 6;
/// Thinner than this part of their width, the places of the marker count as a plane.
pub const FLAT: f64 = 0.03;
/// The most condition of the normalised equations that is trusted. Well spread poses have 5 to 50.
pub const CONDITION: f64 = 2000.0;

/// Coordinates about the middle, at a mean distance of √3 in the world and √2 in the image. Without them pixels and mm
/// would stand in the equations beside products of both, and rounding would decide.
#[derive(Debug, Clone)]
pub(crate) struct Normalised {
    pub(crate) world: Vec<[f64; 3]>,
    pub(crate) pixels: Vec<[f64; 2]>,
    /// How much longer a mm is than the world's unit.
    pub(crate) world_scale: f64,
    pub(crate) pixel_scale: f64,
    world_middle: Vector3<f64>,
    pixel_middle: [f64; 2],
}

/// The estimate.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// The matrix.
    pub projection: Projection,
    /// The largest singular value of the equations over the smallest that is not that of the solution.
    pub condition: f64,
}

/// Estimates the matrix from all observations alike.
///
/// # Errors
///
/// [`CalibrationError`] if they do not determine a camera.
pub fn estimate(observations: &[Observation]) -> Result<Estimate, CalibrationError> {
    if observations.len() < LEAST {
        return Err(CalibrationError::TooFew {
            found: observations.len(),
            least: LEAST,
        });
    }
    let ratio = thickness(observations);
    // Not a number is as bad as too thin.
    if !matches!(ratio.partial_cmp(&FLAT), Some(std::cmp::Ordering::Greater)) {
        return Err(CalibrationError::Flat { ratio, least: FLAT });
    }
    let normalised = Normalised::new(observations);
    let (matrix, condition) = solve(&normalised)?;
    let matrix = normalised.to_pixels(&matrix);
    let projection = facing(matrix, observations)?;
    Ok(Estimate {
        projection,
        condition,
    })
}

/// The smallest singular value of the places about their middle, over the largest.
fn thickness(observations: &[Observation]) -> f64 {
    let middle = mean(observations.iter().map(|seen| seen.world));
    let spread: Matrix3<f64> = observations
        .iter()
        .map(|seen| {
            let away = Vector3::from(seen.world) - middle;
            away * away.transpose()
        })
        .sum();
    let values = spread.symmetric_eigenvalues();
    // The eigenvalues of a product with itself are squares.
    (values.min().max(0.0) / values.max()).sqrt()
}

/// The equations' solution of length 1, and their condition.
fn solve(normalised: &Normalised) -> Result<(Matrix3x4<f64>, f64), CalibrationError> {
    let mut equations = DMatrix::zeros(2 * normalised.world.len(), 12);
    for (i, ([x, y, z], [u, v])) in normalised.world.iter().zip(&normalised.pixels).enumerate() {
        for (k, number) in [*x, *y, *z, 1.0].into_iter().enumerate() {
            equations[(2 * i, k)] = number;
            equations[(2 * i, 8 + k)] = -u * number;
            equations[(2 * i + 1, 4 + k)] = number;
            equations[(2 * i + 1, 8 + k)] = -v * number;
        }
    }
    let lost = |condition| CalibrationError::Ambiguous {
        condition,
        most: CONDITION,
    };
    let svd = equations
        .try_svd(false, true, f64::EPSILON, 1000)
        .ok_or(lost(f64::INFINITY))?;
    let condition = svd.singular_values[0] / svd.singular_values[10];
    let right = svd.v_t.filter(|_| condition < CONDITION).ok_or(lost(condition))?;
    Ok((
        Matrix3x4::from_fn(|row, column| right[(11, 4 * row + column)]),
        condition,
    ))
}

/// The matrix with the sign that has the places in front of the camera.
pub(crate) fn facing(
    matrix: Matrix3x4<f64>,
    observations: &[Observation],
) -> Result<Projection, CalibrationError> {
    let no_camera = CalibrationError::NoCamera;
    let projection = Projection::of(matrix).ok_or(no_camera("its matrix has no depth"))?;
    let ahead = |camera: &Projection| {
        observations
            .iter()
            .filter(|seen| camera.depth(seen.world) > 0.0)
            .count()
    };
    let turned = match 2 * ahead(&projection) < observations.len() {
        true => Projection::of(-matrix).ok_or(no_camera("its matrix has no depth"))?,
        false => projection,
    };
    if ahead(&turned) < observations.len() {
        return Err(no_camera("a part of the marker's places is behind it"));
    }
    if turned.is_mirrored() {
        return Err(no_camera("its image is mirrored"));
    }
    Ok(turned)
}

impl Normalised {
    pub(crate) fn new(observations: &[Observation]) -> Normalised {
        let world_middle = mean(observations.iter().map(|seen| seen.world));
        let middle = mean(
            observations
                .iter()
                .map(|seen| [seen.pixel[0], seen.pixel[1], 0.0]),
        );
        let count = observations.len().max(1) as f64;
        let scale = |length: f64, distances: f64| match distances > 0.0 {
            true => length * count / distances,
            false => 1.0,
        };
        let away = |seen: &Observation| (Vector3::from(seen.world) - world_middle).norm();
        let world_scale = scale(3.0_f64.sqrt(), observations.iter().map(away).sum());
        let off = |seen: &Observation| f64::hypot(seen.pixel[0] - middle.x, seen.pixel[1] - middle.y);
        let pixel_scale = scale(2.0_f64.sqrt(), observations.iter().map(off).sum());
        Normalised {
            world: observations
                .iter()
                .map(|seen| ((Vector3::from(seen.world) - world_middle) * world_scale).into())
                .collect(),
            pixels: observations
                .iter()
                .map(|seen| {
                    let [u, v] = seen.pixel;
                    [(u - middle.x) * pixel_scale, (v - middle.y) * pixel_scale]
                })
                .collect(),
            world_scale,
            pixel_scale,
            world_middle,
            pixel_middle: [middle.x, middle.y],
        }
    }

    /// The matrix from mm to pixels of one between the normalised coordinates.
    pub(crate) fn to_pixels(&self, matrix: &Matrix3x4<f64>) -> Matrix3x4<f64> {
        let [u, v] = self.pixel_middle;
        let back = Matrix3::new(
            1.0 / self.pixel_scale,
            0.0,
            u, //
            0.0,
            1.0 / self.pixel_scale,
            v, //
            0.0,
            0.0,
            1.0,
        );
        back * matrix * self.world_transform()
    }

    /// The matrix between the normalised coordinates of one from mm to pixels.
    pub(crate) fn of_pixels(&self, matrix: &Matrix3x4<f64>) -> Matrix3x4<f64> {
        let ([u, v], scale) = (self.pixel_middle, self.pixel_scale);
        let there = Matrix3::new(
            scale,
            0.0,
            -u * scale, //
            0.0,
            scale,
            -v * scale, //
            0.0,
            0.0,
            1.0,
        );
        let mut back = Matrix4::new_scaling(1.0 / self.world_scale);
        back.fixed_view_mut::<3, 1>(0, 3).copy_from(&self.world_middle);
        there * matrix * back
    }

    fn world_transform(&self) -> Matrix4<f64> {
        let mut there = Matrix4::new_scaling(self.world_scale);
        let moved = -self.world_middle * self.world_scale;
        there.fixed_view_mut::<3, 1>(0, 3).copy_from(&moved);
        there
    }
}

fn mean(points: impl ExactSizeIterator<Item = [f64; 3]>) -> Vector3<f64> {
    let count = points.len().max(1) as f64;
    points.map(Vector3::from).sum::<Vector3<f64>>() / count
}
