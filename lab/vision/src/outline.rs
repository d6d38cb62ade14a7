//! Convex outlines in an image.

/// A convex polygon with its inside to the left of each edge.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Outline {
    corners: Vec<[f64; 2]>,
}

impl Outline {
    /// None if there is nothing inside.
    pub(crate) fn new(corners: Vec<[f64; 2]>) -> Option<Outline> {
        (corners.len() >= 3).then_some(Outline { corners })
    }

    fn edges(&self) -> impl Iterator<Item = ([f64; 2], [f64; 2])> {
        let next = self.corners.iter().cycle().skip(1);
        self.corners.iter().copied().zip(next.copied())
    }

    /// How far a point is outside, pixels; negative inside.
    pub(crate) fn distance(&self, point: [f64; 2]) -> f64 {
        let (mut outside, mut inside) = (f64::INFINITY, f64::NEG_INFINITY);
        for (a, b) in self.edges() {
            let (way, from) = (minus(b, a), minus(point, a));
            let length = way[0].hypot(way[1]).max(1e-12);
            inside = inside.max(-cross(way, from) / length);
            let part = ((way[0] * from[0] + way[1] * from[1]) / (length * length)).clamp(0.0, 1.0);
            outside = outside.min((from[0] - part * way[0]).hypot(from[1] - part * way[1]));
        }
        if inside > 0.0 { outside } else { inside }
    }

    /// The least and the greatest coordinates.
    pub(crate) fn bounds(&self) -> ([f64; 2], [f64; 2]) {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for corner in &self.corners {
            for axis in 0..2 {
                low[axis] = low[axis].min(corner[axis]);
                high[axis] = high[axis].max(corner[axis]);
            }
        }
        (low, high)
    }

    /// The area within it and within so many pixels around it.
    pub(crate) fn area(&self, around: f64) -> f64 {
        let (mut twice, mut length) = (0.0, 0.0);
        for (a, b) in self.edges() {
            twice += cross(a, b);
            length += (b[0] - a[0]).hypot(b[1] - a[1]);
        }
        twice / 2.0 + around * length
    }
}

/// The convex hull, its inside to the left of each edge (Andrew's monotone chain).
pub(crate) fn hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let mut chain = half_hull(points.iter());
    chain.extend(half_hull(points.iter().rev()));
    chain
}

/// One side of it; its last point is the first of the other side.
fn half_hull<'a>(points: impl Iterator<Item = &'a [f64; 2]>) -> Vec<[f64; 2]> {
    let mut side: Vec<[f64; 2]> = Vec::new();
    for &point in points {
        while let [.., a, b] = side[..] {
            if cross(minus(b, a), minus(point, a)) > 0.0 {
                break;
            }
            side.pop();
        }
        side.push(point);
    }
    side.pop();
    side
}

fn minus(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] - b[0], a[1] - b[1]]
}

fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_from_a_square() {
        let points = vec![
            [0.0, 0.0],
            [4.0, 4.0],
            [4.0, 0.0],
            [2.0, 1.0],
            [0.0, 4.0],
            [2.0, 0.0],
        ];
        let square = Outline::new(hull(points)).unwrap();
        assert_eq!(square.corners.len(), 4);
        for (point, expected) in [
            ([2.0, 2.0], -2.0),
            ([1.0, 2.0], -1.0),
            ([4.0, 1.0], 0.0),
            ([6.0, 1.0], 2.0),
            ([7.0, 8.0], 5.0),
        ] {
            assert!((square.distance(point) - expected).abs() < 1e-12, "{point:?}");
        }
        assert_eq!((square.area(0.0), square.area(0.5)), (16.0, 24.0));
    }

    #[test]
    fn a_line_has_no_inside() {
        let line = hull(vec![[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]);
        assert_eq!(Outline::new(line), None);
    }
}
