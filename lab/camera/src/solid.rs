//! Convex solids, of which the whole scene is built, and the order in which they hide each other.

use crate::geometry::{Camera, Direction, Point};
use crate::scene::Colour;

/// Solids that touch count as apart when they overlap by less than this, mm.
const TOUCH: f64 = 0.5;

/// A convex solid: two parallel rings of corners and the faces between them.
#[derive(Debug, Clone)]
pub(crate) struct Solid {
    pub(crate) corners: Vec<Point>,
    pub(crate) faces: Vec<Face>,
    pub(crate) colour: Colour,
    /// Whether the sides stand for one round face, which has no edges along it.
    pub(crate) round: bool,
    /// The ball that is drawn in place of the faces, which only tell what hides what.
    pub(crate) ball: Option<Ball>,
}

/// A ball that shines: of one colour without shades.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ball {
    pub(crate) middle: Point,
    /// mm.
    pub(crate) radius: f64,
}

/// A flat face; its corners run counter-clockwise seen from outside.
#[derive(Debug, Clone)]
pub(crate) struct Face {
    pub(crate) corners: Vec<usize>,
    pub(crate) normal: Direction,
    /// Whether it closes a ring rather than joining the two.
    pub(crate) cap: bool,
}

impl Solid {
    /// The solid between two rings of equally many corners, both counter-clockwise seen from beyond `to`.
    pub(crate) fn loft(from: &[Point], to: &[Point], colour: Colour) -> Solid {
        let n = from.len().min(to.len());
        let corners: Vec<Point> = from[..n].iter().chain(&to[..n]).copied().collect();
        let sides = (0..n).map(|i| (vec![i, (i + 1) % n, n + (i + 1) % n, n + i], false));
        let caps = [((0..n).rev().collect(), true), ((n..2 * n).collect(), true)];
        let faces = sides
            .chain(caps)
            .filter_map(|(face, cap)| Face::new(&corners, face, cap))
            .collect();
        Solid {
            corners,
            faces,
            colour,
            round: false,
            ball: None,
        }
    }

    /// A box: `middle` and three half edges that form a right-handed frame.
    pub(crate) fn cuboid(middle: Point, half: [Direction; 3], colour: Colour) -> Solid {
        let ring = |end: Direction| {
            [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                .map(|(a, b)| middle + end + half[0] * a + half[1] * b)
        };
        Solid::loft(&ring(-half[2]), &ring(half[2]), colour)
    }

    /// A beam from `from` to `to`; `across` is the direction of its width, and each end has half a width and half a
    /// height, mm.
    pub(crate) fn beam(
        from: (Point, [f64; 2]),
        to: (Point, [f64; 2]),
        across: Direction,
        colour: Colour,
    ) -> Solid {
        let axis = (to.0 - from.0).try_normalize(1e-9).unwrap_or(Direction::z());
        let up = axis.cross(&across);
        let ring = |(middle, [width, height]): (Point, [f64; 2])| {
            [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                .map(|(a, b)| middle + across * (a * width) + up * (b * height))
        };
        Solid::loft(&ring(from), &ring(to), colour)
    }

    /// A cylinder or the stump of a cone, from one middle and radius to the other, mm.
    pub(crate) fn cylinder(from: (Point, f64), to: (Point, f64), colour: Colour) -> Solid {
        const SIDES: u32 = 20;
        let axis = (to.0 - from.0).try_normalize(1e-9).unwrap_or(Direction::z());
        let ring = |(middle, radius): (Point, f64)| Solid::ring(middle, &axis, radius, SIDES);
        Solid {
            round: true,
            ..Solid::loft(&ring(from), &ring(to), colour)
        }
    }

    /// Corners on a circle, counter-clockwise seen from beyond the axis.
    fn ring(middle: Point, axis: &Direction, radius: f64, corners: u32) -> Vec<Point> {
        let helper = if axis.z.abs() < 0.9 {
            Direction::z()
        } else {
            Direction::x()
        };
        let p = helper.cross(axis).normalize();
        let q = axis.cross(&p);
        let corner = |i| {
            let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / f64::from(corners)).sin_cos();
            middle + (p * cos + q * sin) * radius
        };
        (0..corners).map(corner).collect()
    }

    /// A ball, as long along `axis` as across it.
    pub(crate) fn ball(ball: Ball, axis: Direction, colour: Colour) -> Solid {
        let end = |sign: f64| (ball.middle + axis * (sign * ball.radius), ball.radius);
        Solid {
            ball: Some(ball),
            ..Solid::cylinder(end(-1.0), end(1.0), colour)
        }
    }

    /// The corners of a face.
    pub(crate) fn outline(&self, face: &Face) -> Vec<Point> {
        face.corners.iter().map(|&i| self.corners[i]).collect()
    }

    /// How far a point is outside a face's plane, mm.
    fn outside(&self, face: &Face, point: &Point) -> f64 {
        face.normal.dot(&(point - self.corners[face.corners[0]]))
    }

    /// Whether the face is turned to the eye.
    pub(crate) fn faces_eye(&self, face: &Face, eye: &Point) -> bool {
        self.outside(face, eye) > 0.0
    }

    /// Looks for one of this solid's planes with all of `other` beyond it, and gives which of the two can hide the
    /// other: the one on the eye's side of the plane is in front.
    fn is_in_front(&self, other: &Solid, eye: &Point) -> Option<bool> {
        let apart = |face: &&Face| other.corners.iter().all(|p| self.outside(face, p) > -TOUCH);
        self.faces
            .iter()
            .find(apart)
            .map(|face| self.outside(face, eye) <= 0.0)
    }
}

impl Ball {
    /// The circle on which lines from the eye touch it; empty if the eye is inside.
    pub(crate) fn outline(&self, eye: &Point) -> Vec<Point> {
        const CORNERS: u32 = 64;
        let way = eye - self.middle;
        let (distance, radius) = (way.norm(), self.radius);
        if distance <= radius {
            return Vec::new();
        }
        let near = self.middle + way * (radius / distance).powi(2);
        let wide = radius * (1.0 - (radius / distance).powi(2)).sqrt();
        Solid::ring(near, &(way / distance), wide, CORNERS)
    }
}

impl Face {
    /// `None` if the corners lie on a line or a point.
    fn new(corners: &[Point], face: Vec<usize>, cap: bool) -> Option<Face> {
        let at = |i: usize| corners[face[i]];
        // Diagonals rather than edges, so that one edge of no length does no harm.
        let half = face.len() / 2;
        let quarter = face.len() / 4;
        let a = at(half) - at(0);
        let b = at((half + quarter) % face.len()) - at(quarter);
        let normal = a.cross(&b).try_normalize(1e-9)?;
        Some(Face {
            corners: face,
            normal,
            cap,
        })
    }
}

/// The order in which the solids are to be painted so that what is in front covers what is behind.
///
/// A plane of either solid with the other beyond it settles a pair. Pairs that no plane parts, because they push
/// into each other, go by their nearest corner.
pub(crate) fn painting_order(solids: &[Solid], camera: &Camera) -> Vec<usize> {
    let eye = camera.position();
    let nearest = |s: &Solid| {
        s.corners
            .iter()
            .map(|p| camera.depth(p))
            .fold(f64::INFINITY, f64::min)
    };
    let depths: Vec<f64> = solids.iter().map(nearest).collect();
    let frames: Vec<ImageRect> = solids.iter().map(|s| ImageRect::new(s, camera)).collect();
    let mut waits_for = vec![0_usize; solids.len()];
    let mut releases: Vec<Vec<usize>> = vec![Vec::new(); solids.len()];
    for i in 0..solids.len() {
        for j in i + 1..solids.len() {
            if !frames[i].meets(&frames[j]) {
                continue;
            }
            let (a, b) = (&solids[i], &solids[j]);
            let first_in_front = a
                .is_in_front(b, eye)
                .or_else(|| b.is_in_front(a, eye).map(|front| !front));
            if let Some(first_in_front) = first_in_front {
                let (behind, front) = if first_in_front { (j, i) } else { (i, j) };
                waits_for[front] += 1;
                releases[behind].push(front);
            }
        }
    }
    let mut left: Vec<usize> = (0..solids.len()).collect();
    left.sort_by(|&a, &b| depths[b].total_cmp(&depths[a]).then(a.cmp(&b)));
    let mut order = Vec::with_capacity(left.len());
    while !left.is_empty() {
        // Solids can hide each other in a ring; then the farthest goes first.
        let next = left.iter().position(|&i| waits_for[i] == 0).unwrap_or(0);
        let painted = left.remove(next);
        for &front in &releases[painted] {
            waits_for[front] = waits_for[front].saturating_sub(1);
        }
        order.push(painted);
    }
    order
}

/// The rectangle around a solid in the image; unbounded if part of it is behind the camera.
struct ImageRect {
    low: [f64; 2],
    high: [f64; 2],
}

impl ImageRect {
    fn new(solid: &Solid, camera: &Camera) -> ImageRect {
        let empty = ImageRect {
            low: [f64::INFINITY; 2],
            high: [f64::NEG_INFINITY; 2],
        };
        let all = ImageRect {
            low: [f64::NEG_INFINITY; 2],
            high: [f64::INFINITY; 2],
        };
        let grown = solid.corners.iter().try_fold(empty, |frame, corner| {
            let [u, v] = camera.project((*corner).into())?;
            Some(ImageRect {
                low: [frame.low[0].min(u), frame.low[1].min(v)],
                high: [frame.high[0].max(u), frame.high[1].max(v)],
            })
        });
        grown.unwrap_or(all)
    }

    fn meets(&self, other: &ImageRect) -> bool {
        (0..2).all(|i| self.low[i] <= other.high[i] && other.low[i] <= self.high[i])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(x: f64, y: f64, z: f64, half: f64) -> Solid {
        let edges = [
            Direction::x() * half,
            Direction::y() * half,
            Direction::z() * half,
        ];
        Solid::cuboid(Point::new(x, y, z), edges, Colour::default())
    }

    #[test]
    fn faces_point_outwards() {
        let up = (Point::new(3.0, 4.0, 50.0), 20.0);
        let solids = [
            block(10.0, 20.0, 30.0, 5.0),
            Solid::cylinder((Point::new(3.0, 4.0, 5.0), 30.0), up, Colour::default()),
            Solid::cylinder(up, (Point::new(90.0, 4.0, 5.0), 30.0), Colour::default()),
            Solid::beam(
                (Point::origin(), [20.0, 30.0]),
                (Point::new(100.0, 0.0, 20.0), [10.0, 15.0]),
                Direction::y(),
                Colour::default(),
            ),
        ];
        for solid in &solids {
            let sum: Direction = solid.corners.iter().map(|p| p.coords).sum();
            let middle = Point::from(sum / solid.corners.len() as f64);
            for face in &solid.faces {
                assert!(solid.outside(face, &middle) < -1.0, "{face:?} of {solid:?}");
                let flat = solid
                    .outline(face)
                    .iter()
                    .all(|p| solid.outside(face, p).abs() < 1e-6);
                assert!(flat, "{face:?}");
            }
        }
    }

    #[test]
    fn a_solid_of_no_length_has_no_broken_faces() {
        let point = (Point::origin(), 0.0);
        assert!(Solid::cylinder(point, point, Colour::default()).faces.is_empty());
    }

    #[test]
    fn what_is_in_front_is_painted_last() {
        let camera = Camera::look(
            Point::new(0.0, -1000.0, 400.0),
            Point::origin(),
            Direction::z(),
            500.0,
            (640, 480),
        );
        let check = |solids: &[Solid], expected: &[usize]| {
            assert_eq!(painting_order(solids, &camera), expected);
        };
        let (back, front) = (block(0.0, 100.0, 20.0, 20.0), block(0.0, -100.0, 20.0, 20.0));
        check(&[back.clone(), front.clone()], &[0, 1]);
        check(&[front, back], &[1, 0]);
        let (lower, upper) = (block(0.0, 0.0, 20.0, 20.0), block(0.0, 0.0, 60.0, 20.0));
        check(&[upper.clone(), lower.clone()], &[1, 0]);
        check(&[lower, upper], &[0, 1]);
        // The long block is nearer by its corner and by its middle, yet it lies under the small one.
        let long = Solid::cuboid(
            Point::new(0.0, -100.0, 20.0),
            [
                Direction::x() * 20.0,
                Direction::y() * 300.0,
                Direction::z() * 20.0,
            ],
            Colour::default(),
        );
        check(&[block(0.0, 100.0, 50.0, 10.0), long], &[1, 0]);
    }
}
