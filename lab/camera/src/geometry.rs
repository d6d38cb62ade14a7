//! The pinhole camera: from millimetres on the table to pixels in the image, and clipping.
//!
//! World: millimetres, right-handed, origin at the middle of the table's surface, z up. Camera: x right, y down,
//! z forward. Image: pixels, origin at the upper left corner, the middle of the first pixel at (0.5, 0.5).

use nalgebra::{Matrix3, Point3, Vector3};

/// A point in the world, mm.
pub(crate) type Point = Point3<f64>;
/// A direction in the world, or a point in the camera's frame, mm.
pub(crate) type Direction = Vector3<f64>;
/// A point in the image, pixels.
pub(crate) type Pixel = (f32, f32);

/// Nothing nearer to the camera than this is drawn, mm.
const NEAR: f64 = 10.0;
/// Lines end this far outside the image, so that their ends and joins are not seen, pixels.
const MARGIN: f64 = 16.0;

/// A pinhole camera with square pixels and the principal point in the middle of the image.
///
/// ```
/// use mom_camera::{DrawnPose, View};
///
/// let camera = View::Top.camera(&DrawnPose::default(), 640, 480);
/// let pixel = camera.project([0.0, 0.0, 0.0]).unwrap();
/// assert!((pixel[0] - 320.0).abs() < 1e-9 && (pixel[1] - 240.0).abs() < 1e-9);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Where the pinhole is, mm.
    position: Point,
    /// The camera's right, down and forward directions as rows.
    rotation: Matrix3<f64>,
    /// Focal length, pixels.
    focal: f64,
    width: f64,
    height: f64,
}

impl Camera {
    /// A camera at `position` that looks at `target` with `up` upwards in the image.
    ///
    /// `focal` is the focal length in pixels. A direction that is not defined (target at the position, `up` along
    /// the view) is replaced by one that is.
    pub(crate) fn look(
        position: Point,
        target: Point,
        up: Direction,
        focal: f64,
        size: (u32, u32),
    ) -> Camera {
        let forward = (target - position).try_normalize(1e-9).unwrap_or(-Direction::z());
        let right = forward
            .cross(&up)
            .try_normalize(1e-9)
            .or_else(|| forward.cross(&Direction::y()).try_normalize(1e-9))
            .unwrap_or(Direction::x());
        let down = forward.cross(&right);
        let rotation = Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()]);
        Camera {
            position,
            rotation,
            focal,
            width: size.0.into(),
            height: size.1.into(),
        }
    }

    /// The 3×4 projection matrix, row by row: world mm to pixels, homogeneous (M55).
    ///
    /// It is scaled so that the third component of the product is the depth in mm: positive in front of the camera.
    pub fn matrix(&self) -> [f64; 12] {
        let intrinsic = Matrix3::new(
            self.focal,
            0.0,
            self.width / 2.0, //
            0.0,
            self.focal,
            self.height / 2.0, //
            0.0,
            0.0,
            1.0,
        );
        let left = intrinsic * self.rotation;
        let last = -(left * self.position.coords);
        std::array::from_fn(|i| {
            if i % 4 == 3 {
                last[i / 4]
            } else {
                left[(i / 4, i % 4)]
            }
        })
    }

    /// The pixel of a point in mm, or `None` if it is behind the camera or within 10 mm of it.
    ///
    /// The pixel may lie outside the image.
    pub fn project(&self, point: [f64; 3]) -> Option<[f64; 2]> {
        let p = self.to_camera(&Point::from(point));
        (p.z >= NEAR).then(|| {
            [
                self.focal * p.x / p.z + self.width / 2.0,
                self.focal * p.y / p.z + self.height / 2.0,
            ]
        })
    }

    /// The middle of the lens, mm.
    pub(crate) fn position(&self) -> &Point {
        &self.position
    }

    /// The distance of a point along the line of sight, mm; negative behind the camera.
    pub(crate) fn depth(&self, point: &Point) -> f64 {
        self.to_camera(point).z
    }

    /// How many pixels one mm is at this point, 0 behind the camera.
    pub(crate) fn scale_at(&self, point: &Point) -> f64 {
        let depth = self.depth(point);
        if depth >= NEAR { self.focal / depth } else { 0.0 }
    }

    /// The polygon in the image, clipped at the near plane and a little outside the image's borders.
    ///
    /// Empty if nothing of it is seen.
    pub(crate) fn polygon(&self, points: &[Point]) -> Vec<Pixel> {
        let mut polygon: Vec<Direction> = points.iter().map(|p| self.to_camera(p)).collect();
        for plane in self.planes() {
            if polygon.iter().any(|p| plane.distance(p) < 0.0) {
                polygon = clip_polygon(&polygon, &plane);
            }
        }
        if polygon.len() < 3 {
            return Vec::new();
        }
        polygon.iter().map(|p| self.to_pixel(p)).collect()
    }

    /// The line in the image, clipped like a polygon.
    pub(crate) fn line(&self, from: &Point, to: &Point) -> Option<(Pixel, Pixel)> {
        let (mut a, mut b) = (self.to_camera(from), self.to_camera(to));
        for plane in self.planes() {
            let (da, db) = (plane.distance(&a), plane.distance(&b));
            match (da < 0.0, db < 0.0) {
                (true, true) => return None,
                (true, false) => a = crossing(&a, da, &b, db),
                (false, true) => b = crossing(&a, da, &b, db),
                (false, false) => {}
            }
        }
        Some((self.to_pixel(&a), self.to_pixel(&b)))
    }

    fn to_camera(&self, point: &Point) -> Direction {
        self.rotation * (point - self.position)
    }

    /// Only for points that have passed the near plane.
    fn to_pixel(&self, p: &Direction) -> Pixel {
        let depth = p.z.max(NEAR / 2.0);
        let x = self.focal * p.x / depth + self.width / 2.0;
        let y = self.focal * p.y / depth + self.height / 2.0;
        (x as f32, y as f32)
    }

    /// The near plane and the four sides of the pyramid that is seen.
    fn planes(&self) -> [Plane; 5] {
        let (across, along) = (self.width / 2.0 + MARGIN, self.height / 2.0 + MARGIN);
        let side = |x: f64, y: f64, z: f64| Plane {
            normal: Direction::new(x, y, z),
            offset: 0.0,
        };
        [
            Plane {
                normal: Direction::z(),
                offset: NEAR,
            },
            side(self.focal, 0.0, across),
            side(-self.focal, 0.0, across),
            side(0.0, self.focal, along),
            side(0.0, -self.focal, along),
        ]
    }
}

/// A plane in the camera's frame; what has a negative distance is not seen.
struct Plane {
    normal: Direction,
    offset: f64,
}

impl Plane {
    fn distance(&self, p: &Direction) -> f64 {
        self.normal.dot(p) - self.offset
    }
}

/// Sutherland and Hodgman's clipping of a polygon at one plane.
fn clip_polygon(polygon: &[Direction], plane: &Plane) -> Vec<Direction> {
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    for (i, b) in polygon.iter().enumerate() {
        let a = &polygon[(i + polygon.len() - 1) % polygon.len()];
        let (da, db) = (plane.distance(a), plane.distance(b));
        if (da < 0.0) != (db < 0.0) {
            kept.push(crossing(a, da, b, db));
        }
        if db >= 0.0 {
            kept.push(*b);
        }
    }
    kept
}

/// Where the line from `a` to `b` meets the plane at the distances `da` and `db`, of which one is negative.
fn crossing(a: &Direction, da: f64, b: &Direction, db: f64) -> Direction {
    a + (b - a) * (da / (da - db))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At (0, -1000, 0), looking along y, 100 pixels focal length, 200×100 pixels.
    fn camera() -> Camera {
        Camera::look(
            Point::new(0.0, -1000.0, 0.0),
            Point::origin(),
            Direction::z(),
            100.0,
            (200, 100),
        )
    }

    fn by_matrix(m: &[f64; 12], p: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|row| {
            let r = &m[row * 4..row * 4 + 4];
            r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + r[3]
        })
    }

    #[test]
    fn known_points_fall_on_known_pixels() {
        let check = |point: [f64; 3], expected: Option<[f64; 2]>| {
            assert_eq!(camera().project(point), expected, "{point:?}");
            if let Some(expected) = expected {
                let [u, v, w] = by_matrix(&camera().matrix(), point);
                let got = [u / w, v / w];
                assert!(
                    got.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9),
                    "{point:?}: {got:?}"
                );
                assert!(
                    (w - (point[1] + 1000.0)).abs() < 1e-9,
                    "depth of {point:?} is {w}"
                );
            }
        };
        check([0.0, 0.0, 0.0], Some([100.0, 50.0]));
        check([500.0, 0.0, 0.0], Some([150.0, 50.0]));
        check([-500.0, 0.0, 0.0], Some([50.0, 50.0]));
        check([0.0, 0.0, 250.0], Some([100.0, 25.0]));
        check([0.0, -500.0, 250.0], Some([100.0, 0.0]));
        check([500.0, 1000.0, 500.0], Some([125.0, 25.0]));
        check([5000.0, 0.0, 0.0], Some([600.0, 50.0]));
        check([0.0, -1000.0, 0.0], None);
        check([0.0, -995.0, 0.0], None);
        check([0.0, -2000.0, 0.0], None);
    }

    #[test]
    fn what_is_behind_the_camera_is_clipped() {
        let seen = |y0: f64, y1: f64| {
            let square =
                [(-50.0, y0), (50.0, y0), (50.0, y1), (-50.0, y1)].map(|(x, y)| Point::new(x, y, -20.0));
            camera().polygon(&square)
        };
        assert_eq!(seen(-500.0, 0.0).len(), 4);
        assert!(seen(-3000.0, -1500.0).is_empty());
        let half = seen(-3000.0, 0.0);
        assert!(half.len() >= 4, "{half:?}");
        for (x, y) in half {
            assert!(
                (-16.1..216.1).contains(&x) && (-16.1..116.1).contains(&y),
                "{x} {y}"
            );
        }
        let line = |y0, y1| camera().line(&Point::new(0.0, y0, -20.0), &Point::new(0.0, y1, -20.0));
        assert_eq!(line(-3000.0, -1500.0), None);
        let on_the_lens = Point::new(0.1, -995.0, 0.1);
        assert_eq!(camera().line(&on_the_lens, &on_the_lens), None);
        let ((_, below), (_, far)) = line(-3000.0, 0.0).unwrap();
        assert!(
            (below - 116.0).abs() < 0.1 && (far - 52.0).abs() < 0.1,
            "{below} {far}"
        );
    }

    #[test]
    fn a_camera_that_looks_straight_down_has_a_direction() {
        let up = Point::new(0.0, 0.0, 500.0);
        for target in [Point::origin(), up] {
            let camera = Camera::look(up, target, Direction::z(), 100.0, (64, 48));
            assert!(camera.matrix().iter().all(|v| v.is_finite()));
            assert_eq!(camera.project([0.0, 0.0, 0.0]), Some([32.0, 24.0]));
        }
    }
}
