//! The 3×4 projection matrix: from millimetres on the table to pixels (M55).

use nalgebra::{Matrix3x4, Vector3, Vector4};

/// A projection matrix, scaled so that the third component of a product is the depth in mm.
///
/// ```
/// use mom_vision::Projection;
///
/// // One metre above the table, looking down, with a focal length of 500 pixels.
/// let down = [500.0, 0.0, -320.0, 320_000.0, 0.0, -500.0, -240.0, 240_000.0, 0.0, 0.0, -1.0, 1000.0];
/// let camera = Projection::new(down).unwrap();
/// assert_eq!(camera.project([0.0, 0.0, 0.0]), Some([320.0, 240.0]));
/// assert_eq!(camera.project([100.0, 100.0, 0.0]), Some([370.0, 190.0]));
/// assert_eq!(camera.project([0.0, 0.0, 2000.0]), None);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    matrix: Matrix3x4<f64>,
}

impl Projection {
    /// A matrix, row by row, at any scale but of this sign; none if it is not finite or gives no depth.
    #[must_use]
    pub fn new(numbers: [f64; 12]) -> Option<Projection> {
        Projection::of(Matrix3x4::from_row_slice(&numbers))
    }

    /// A matrix at any scale but of this sign; none if it is not finite or gives no depth.
    #[must_use]
    pub fn of(matrix: Matrix3x4<f64>) -> Option<Projection> {
        let scale = forward(&matrix).norm();
        let usable = scale.is_normal() && matrix.iter().all(|number| number.is_finite());
        usable.then(|| Projection {
            matrix: matrix / scale,
        })
    }

    /// The 12 numbers, row by row.
    #[must_use]
    pub fn numbers(&self) -> [f64; 12] {
        std::array::from_fn(|i| self.matrix[(i / 4, i % 4)])
    }

    /// The distance of a point along the line of sight, mm; negative behind the camera.
    #[must_use]
    pub fn depth(&self, point: [f64; 3]) -> f64 {
        (self.matrix * homogeneous(point)).z
    }

    /// The pixel of a point in mm, or none if it is not in front of the camera.
    #[must_use]
    pub fn project(&self, point: [f64; 3]) -> Option<[f64; 2]> {
        self.project_ball(point, 0.0)
    }

    /// The middle of the picture of a ball, in pixels; none if it is not in front of the camera.
    ///
    /// The picture of a ball is an ellipse, whose middle lies a little further from the image's middle than the
    /// picture of the ball's: by 0.01 pixels for a ball of 10 mm radius at 1.4 m near the border. The outline is
    /// the dual conic `P Q Pᵀ` of the ball's dual quadric `Q`, and its middle stands in that matrix's last column.
    #[must_use]
    pub fn project_ball(&self, middle: [f64; 3], radius: f64) -> Option<[f64; 2]> {
        (self.depth(middle) > radius)
            .then(|| ball(&self.matrix, &homogeneous(middle), radius).pixel())
            .filter(|pixel| pixel.iter().all(|number| number.is_finite()))
    }

    /// Whether it sees what is on the right to the right: a matrix of the other sign is that of a mirror.
    #[must_use]
    pub fn is_mirrored(&self) -> bool {
        self.matrix.fixed_columns::<3>(0).determinant() < 0.0
    }
}

/// The direction of the line of sight, as long as the matrix's scale.
fn forward(matrix: &Matrix3x4<f64>) -> Vector3<f64> {
    Vector3::new(matrix[(2, 0)], matrix[(2, 1)], matrix[(2, 2)])
}

/// A point of the world with a fourth coordinate of 1.
#[must_use]
pub fn homogeneous([x, y, z]: [f64; 3]) -> Vector4<f64> {
    Vector4::new(x, y, z, 1.0)
}

/// The last column of the dual conic of a ball's outline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outline {
    /// The first two entries: the middle times `scale`.
    pub middle: [f64; 2],
    /// The third.
    pub scale: f64,
}

impl Outline {
    /// The middle of the outline, pixels.
    #[must_use]
    pub fn pixel(&self) -> [f64; 2] {
        self.middle.map(|number| number / self.scale)
    }
}

/// The outline of a ball at any scale of the matrix.
#[must_use]
pub fn ball(matrix: &Matrix3x4<f64>, middle: &Vector4<f64>, radius: f64) -> Outline {
    let seen = matrix * middle;
    let left = matrix.fixed_columns::<3>(0);
    let square = radius * radius;
    let entry = |row: usize| seen[row] * seen.z - square * left.row(row).dot(&left.row(2));
    Outline {
        middle: [entry(0), entry(1)],
        scale: entry(2),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Looks along y from 1 m, 800 pixels focal length.
    fn camera() -> Projection {
        Projection::new([
            800.0, 320.0, 0.0, 320_000.0, //
            0.0, 240.0, -800.0, 240_000.0, //
            0.0, 1.0, 0.0, 1000.0,
        ])
        .unwrap()
    }

    /// The outline's extent follows from the angle at which the ball is seen.
    #[test]
    fn the_middle_of_a_balls_outline() {
        for (x, radius) in [(0.0, 20.0), (300.0, 12.0), (-200.0, 100.0_f64)] {
            let distance = f64::hypot(1000.0, x);
            let (angle, half) = (f64::atan2(x, 1000.0), (radius / distance).asin());
            let expected = 320.0 + 400.0 * ((angle + half).tan() + (angle - half).tan());
            let [u, v] = camera().project_ball([x, 0.0, 0.0], radius).unwrap();
            assert!(
                (u - expected).abs() < 1e-9 && (v - 240.0).abs() < 1e-9,
                "{x}: {u} {v}"
            );
            let [point, _] = camera().project([x, 0.0, 0.0]).unwrap();
            assert!(
                (u - point).abs() < 5.0 && (x == 0.0) == (u == point),
                "{u} {point}"
            );
        }
    }

    #[test]
    fn what_is_no_matrix_is_none() {
        assert_eq!(Projection::new([0.0; 12]), None);
        assert_eq!(Projection::new([f64::NAN; 12]), None);
        let mut numbers = camera().numbers();
        numbers[3] = f64::INFINITY;
        assert_eq!(Projection::new(numbers), None);
        assert_eq!(camera().project([0.0, -1000.0, 0.0]), None);
        assert!(!camera().is_mirrored());
    }
}
