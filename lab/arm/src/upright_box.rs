//! Boxes that stand upright, turned about the vertical: the shape of all obstacles.

use crate::pose::{Xyz, dot, minus};

/// mm by which two bodies may press into each other before the motors feel it. Blocks that lie on
/// or beside each other touch, and rounding must not make that a collision.
pub(crate) const GIVE: f64 = 1.0;

/// A vector on the level: x and y in mm, or without a unit for a direction.
pub(crate) type Xy = [f64; 2];

/// An upright box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct UprightBox {
    pub(crate) centre: Xyz,
    /// Degrees of its first level axis from x.
    pub(crate) yaw: f64,
    /// Half its size along its first level axis, its second, and upward.
    pub(crate) half: Xyz,
}

impl UprightBox {
    pub(crate) fn top(&self) -> f64 {
        self.centre[2] + self.half[2]
    }

    pub(crate) fn bottom(&self) -> f64 {
        self.centre[2] - self.half[2]
    }

    /// Whether all of the box is certainly farther from the point than this, in mm.
    pub(crate) fn is_farther(&self, point: Xyz, distance: f64) -> bool {
        let offset = minus(self.centre, point);
        let reach = distance + self.half.into_iter().sum::<f64>();
        dot(offset, offset) > reach * reach
    }

    /// Whether the two boxes overlap by more than [`GIVE`].
    pub(crate) fn overlaps(&self, other: &Self) -> bool {
        self.top() - GIVE > other.bottom() && other.top() - GIVE > self.bottom() && self.overlaps_level(other)
    }

    /// Whether the two boxes, seen from above, overlap by more than [`GIVE`].
    ///
    /// Two rectangles are apart exactly if they are apart along one of their four axes.
    pub(crate) fn overlaps_level(&self, other: &Self) -> bool {
        let offset = [other.centre[0] - self.centre[0], other.centre[1] - self.centre[1]];
        self.axes().into_iter().chain(other.axes()).all(|axis| {
            level_dot(offset, axis).abs() < self.extent_along(axis) + other.extent_along(axis) - GIVE
        })
    }

    /// The shortest way on the level on which the other box gets out of this one: its direction and mm; none if they are apart.
    pub(crate) fn way_out(&self, other: &Self) -> Option<(Xy, f64)> {
        let offset = [other.centre[0] - self.centre[0], other.centre[1] - self.centre[1]];
        let way = |axis: Xy| {
            let apart = level_dot(offset, axis);
            let depth = self.extent_along(axis) + other.extent_along(axis) - apart.abs();
            (axis.map(|part| part * 1.0_f64.copysign(apart)), depth)
        };
        let ways = self.axes().into_iter().chain(other.axes()).map(way);
        let shortest = ways.reduce(|a, b| if b.1 < a.1 { b } else { a });
        shortest.filter(|(_, depth)| *depth > 0.0)
    }

    /// Its four corners seen from above, counter-clockwise.
    pub(crate) fn footprint(&self) -> [Xy; 4] {
        let [a, b] = self.axes();
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(i, j)| [0, 1].map(|k| self.centre[k] + i * self.half[0] * a[k] + j * self.half[1] * b[k]))
    }

    /// Half the length of the box's shadow on a level axis.
    fn extent_along(&self, axis: [f64; 2]) -> f64 {
        self.axes()
            .into_iter()
            .zip(self.half)
            .map(|(own, half)| level_dot(own, axis).abs() * half)
            .sum()
    }

    /// Its two level axes.
    pub(crate) fn axes(&self) -> [Xy; 2] {
        let (sin, cos) = self.yaw.to_radians().sin_cos();
        [[cos, sin], [-sin, cos]]
    }
}

pub(crate) fn level_dot(a: Xy, b: Xy) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube(x: f64, y: f64, z: f64, yaw: f64) -> UprightBox {
        UprightBox {
            centre: [x, y, z],
            yaw,
            half: [20.0; 3],
        }
    }

    #[test]
    fn overlap_of_two_cubes() {
        let middle = cube(0.0, 0.0, 20.0, 0.0);
        for (other, level, whole) in [
            (cube(0.0, 0.0, 20.0, 30.0), true, true),
            (cube(38.0, 0.0, 20.0, 0.0), true, true),
            (cube(39.5, 0.0, 20.0, 0.0), false, false),
            (cube(40.0, 40.0, 20.0, 0.0), false, false),
            // A corner points at the side: half a diagonal is 28.3 mm.
            (cube(46.0, 0.0, 20.0, 45.0), true, true),
            (cube(48.0, 0.0, 20.0, 45.0), false, false),
            // Turned corner to corner, apart only along a slanted axis.
            (cube(36.0, 36.0, 20.0, 45.0), false, false),
            (cube(0.0, 0.0, 60.0, 0.0), true, false),
            (cube(0.0, 0.0, 58.0, 0.0), true, true),
        ] {
            assert_eq!(middle.overlaps_level(&other), level, "{other:?}");
            assert_eq!(other.overlaps_level(&middle), level, "{other:?}");
            assert_eq!(middle.overlaps(&other), whole, "{other:?}");
        }
    }

    #[test]
    fn the_shortest_way_out() {
        let middle = cube(0.0, 0.0, 20.0, 0.0);
        for (other, want) in [
            (cube(30.0, 5.0, 20.0, 0.0), Some(([1.0, 0.0], 10.0))),
            (cube(-30.0, 5.0, 20.0, 0.0), Some(([-1.0, 0.0], 10.0))),
            (cube(3.0, -39.0, 20.0, 0.0), Some(([0.0, -1.0], 1.0))),
            (cube(41.0, 0.0, 20.0, 0.0), None),
        ] {
            assert_eq!(middle.way_out(&other), want, "{other:?}");
        }
    }
}
