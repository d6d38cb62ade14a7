//! Shadows on the table under an overhead light: they lie exactly below what casts them, so that a person sees in
//! a flat picture how far a thing is away.

use super::canvas::{Canvas, Ink, solid};
use super::table::{INK, TABLE};
use crate::geometry::{Direction, Point};
use crate::scene::{DrawnBlock, DrawnPose};
use crate::solid::Solid;

/// How far the shadow of a block reaches beyond it, mm: without it a block would seem to float.
const RIM: f64 = 5.0;
const SHADE: Ink = solid(30, 40, 60);

/// Draws the shadows of the blocks, of the gripper and, fainter, of the arm, and marks the spot under the tip.
pub(crate) fn shadows(
    canvas: &mut Canvas<'_>,
    blocks: &[DrawnBlock],
    gripper: &[Solid],
    arm: &[Solid],
    pose: &DrawnPose,
) {
    let below = |solids: &[Solid]| -> Vec<Vec<Point>> {
        solids
            .iter()
            .map(|s| on_table(hull(s.corners.iter().map(|p| [p.x, p.y]))))
            .collect()
    };
    canvas.fill_all(&below(arm), SHADE.at(0.10));
    let contact: Vec<Vec<Point>> = blocks.iter().map(|block| on_table(footprint(block))).collect();
    canvas.fill_all(&contact, SHADE.at(0.22));
    canvas.fill_all(&below(gripper), SHADE.at(0.30));
    let tip = Point::new(pose.x, pose.y, 0.0);
    let arm = |direction: Direction| (tip - direction * 14.0, tip + direction * 14.0);
    canvas.lines(&[arm(Direction::x()), arm(Direction::y())], INK.at(0.8), 1.3);
}

/// What the block covers, with a rim.
fn footprint(block: &DrawnBlock) -> Vec<[f64; 2]> {
    let (sin, cos) = block.yaw.to_radians().sin_cos();
    let half = [block.size[0] / 2.0 + RIM, block.size[1] / 2.0 + RIM];
    [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
        .map(|(a, b)| {
            let (x, y) = (a * half[0], b * half[1]);
            [block.x + x * cos - y * sin, block.y + x * sin + y * cos]
        })
        .to_vec()
}

/// The convex hull, counter-clockwise (Andrew's monotone chain).
fn hull(points: impl Iterator<Item = [f64; 2]>) -> Vec<[f64; 2]> {
    let mut points: Vec<[f64; 2]> = points.collect();
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let chain = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for p in points {
            while let [.., a, b] = chain[..] {
                if (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(p);
        }
        // The last point is the first of the other chain.
        chain.pop();
        chain
    };
    let mut hull = chain(&mut points.iter().copied());
    hull.extend(chain(&mut points.iter().rev().copied()));
    hull
}

/// The part of a convex outline that is on the table, as points of the world.
fn on_table(mut outline: Vec<[f64; 2]>) -> Vec<Point> {
    for (axis, sign) in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)] {
        let inside = |p: &[f64; 2]| TABLE - sign * p[axis];
        let mut kept = Vec::with_capacity(outline.len() + 1);
        for (i, b) in outline.iter().enumerate() {
            let a = &outline[(i + outline.len() - 1) % outline.len()];
            let (da, db) = (inside(a), inside(b));
            if (da < 0.0) != (db < 0.0) {
                let part = da / (da - db);
                kept.push([a[0] + (b[0] - a[0]) * part, a[1] + (b[1] - a[1]) * part]);
            }
            if db >= 0.0 {
                kept.push(*b);
            }
        }
        outline = kept;
    }
    outline.into_iter().map(|[x, y]| Point::new(x, y, 0.0)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hull_runs_around_the_outermost_points() {
        let points = [
            [0.0, 0.0],
            [2.0, 0.0],
            [1.0, 1.0],
            [2.0, 2.0],
            [0.0, 2.0],
            [1.0, 0.0],
        ];
        assert_eq!(
            hull(points.into_iter()),
            [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]
        );
        assert!(hull([[1.0, 1.0]].into_iter()).is_empty());
        assert!(hull([].into_iter()).is_empty());
    }

    #[test]
    fn a_shadow_ends_at_the_edge_of_the_table() {
        let check = |x: f64, expected: Option<(f64, f64)>| {
            let square = [
                [x - 50.0, -50.0],
                [x + 50.0, -50.0],
                [x + 50.0, 50.0],
                [x - 50.0, 50.0],
            ];
            let kept = on_table(square.to_vec());
            let xs = kept.iter().map(|p| p.x);
            let range = (!kept.is_empty()).then(|| {
                (
                    xs.clone().fold(f64::INFINITY, f64::min),
                    xs.fold(f64::NEG_INFINITY, f64::max),
                )
            });
            assert_eq!(range, expected, "at {x}");
        };
        check(0.0, Some((-50.0, 50.0)));
        check(TABLE, Some((TABLE - 50.0, TABLE)));
        check(-TABLE - 20.0, Some((-TABLE, 30.0 - TABLE)));
        check(TABLE + 100.0, None);
    }
}
