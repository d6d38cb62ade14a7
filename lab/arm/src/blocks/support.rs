//! What a block lies on, and whether it stands there.

use crate::upright_box::{GIVE, UprightBox, Xy, level_dot};

use super::{Block, Blocks, FLOOR, TABLE};

/// mm by which a weight may be beyond the edge of what bears it, for rounding.
const ROUNDING: f64 = 1e-6;

/// How a block stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Stand {
    /// On something that bears it.
    Firm,
    /// On nothing.
    Floats,
    /// Its weight is beyond an edge of what it lies on.
    Tips {
        /// The way it goes over, along one of its own level axes.
        direction: Xy,
        /// mm from its middle to the edge in that direction, negative where the middle is beyond it.
        edge: f64,
    },
}

/// The table's top as a body of no height.
fn table() -> UprightBox {
    UprightBox {
        centre: [0.0, 0.0, 0.0],
        yaw: 0.0,
        half: [TABLE, TABLE, 0.0],
    }
}

impl Blocks {
    /// The height of the highest surface under a block: of another block, the table, or the floor.
    pub(super) fn surface_below(&self, index: usize) -> f64 {
        let solid = self.all[index].solid();
        let others = self.all.iter().enumerate().filter(|(other, _)| *other != index);
        let under = others
            .map(|(_, other)| other.solid())
            .chain([table()])
            .filter(|other| other.top() <= solid.bottom() + GIVE && other.overlaps_level(&solid));
        under.map(|other| other.top()).fold(FLOOR, f64::max)
    }

    /// The blocks that lie on this one, and those on them.
    pub(crate) fn load_on(&self, index: usize) -> Vec<usize> {
        let mut load = vec![index];
        let mut next = 0;
        while let Some(&below) = load.get(next) {
            next += 1;
            for above in 0..self.all.len() {
                if !load.contains(&above) && self.bearer(above) == Some(below) {
                    load.push(above);
                }
            }
        }
        load.remove(0);
        load
    }

    /// The block that bears most of this one; none if the hand does.
    fn bearer(&self, index: usize) -> Option<usize> {
        if self.is_carried(index) {
            return None;
        }
        let solid = self.all[index].solid();
        let area = |(other, block): (usize, &Block)| {
            let below = block.solid();
            let lies_on = other != index && lies_on(&solid, &below);
            lies_on.then(|| (other, area(&clip(&solid, &below))))
        };
        let bearers = self.all.iter().enumerate().filter_map(area);
        let most = bearers.reduce(|a, b| if b.1 > a.1 { b } else { a });
        most.map(|(other, _)| other)
    }

    /// How a resting block stands, with the weight of what lies on it.
    pub(super) fn stand(&self, index: usize) -> Stand {
        let block = &self.all[index];
        let solid = block.solid();
        if (solid.bottom() - FLOOR).abs() <= GIVE {
            return Stand::Firm;
        }
        let others = self.all.iter().enumerate().filter(|(other, _)| *other != index);
        let below = others.map(|(_, other)| other.solid()).chain([table()]);
        let points: Vec<Xy> = below
            .filter(|below| lies_on(&solid, below))
            .flat_map(|below| clip(&solid, &below))
            .collect();
        if points.is_empty() {
            return Stand::Floats;
        }
        let edges = hull(points.clone());
        let Some(out) = way_beyond(&edges, self.centre_of_load(index)) else {
            return Stand::Firm;
        };
        let axes = solid.axes();
        let ways = [
            axes[0],
            axes[1],
            axes[0].map(|part| -part),
            axes[1].map(|part| -part),
        ];
        let direction = ways.into_iter().reduce(|a, b| {
            if level_dot(b, out) > level_dot(a, out) {
                b
            } else {
                a
            }
        });
        let direction = direction.unwrap_or([1.0, 0.0]);
        let middle = [block.x, block.y];
        let edge = points
            .iter()
            .map(|point| level_dot(apart(*point, middle), direction));
        Stand::Tips {
            direction,
            edge: edge.fold(f64::NEG_INFINITY, f64::max),
        }
    }

    /// Where the weight of a block and of all that lies on it acts.
    fn centre_of_load(&self, index: usize) -> Xy {
        let mut load = self.load_on(index);
        load.push(index);
        let (mut weight, mut sum) = (0.0, [0.0, 0.0]);
        for block in load.into_iter().map(|index| &self.all[index]) {
            let own = block.size.powi(3);
            weight += own;
            sum = [sum[0] + own * block.x, sum[1] + own * block.y];
        }
        sum.map(|sum| sum / weight)
    }
}

/// Whether the upper box touches the lower one's top.
fn lies_on(upper: &UprightBox, lower: &UprightBox) -> bool {
    (upper.bottom() - lower.top()).abs() <= GIVE && upper.overlaps_level(lower)
}

/// The part of the upper box's shadow that is over the lower one: a polygon, counter-clockwise.
fn clip(upper: &UprightBox, lower: &UprightBox) -> Vec<Xy> {
    let mut polygon = upper.footprint().to_vec();
    let centre = [lower.centre[0], lower.centre[1]];
    for (axis, half) in lower.axes().into_iter().zip(lower.half) {
        for side in [axis, axis.map(|part| -part)] {
            let beyond = |point: Xy| level_dot(apart(point, centre), side) - half;
            let mut kept = Vec::with_capacity(polygon.len() + 1);
            for (i, &point) in polygon.iter().enumerate() {
                let next = polygon[(i + 1) % polygon.len()];
                let (here, there) = (beyond(point), beyond(next));
                if here <= 0.0 {
                    kept.push(point);
                }
                if here * there < 0.0 {
                    let part = here / (here - there);
                    kept.push([0, 1].map(|k| point[k] + (next[k] - point[k]) * part));
                }
            }
            polygon = kept;
        }
    }
    polygon
}

fn area(polygon: &[Xy]) -> f64 {
    let pairs = polygon.iter().zip(polygon.iter().cycle().skip(1));
    pairs.map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum::<f64>() / 2.0
}

/// The convex hull, counter-clockwise (Andrew's monotone chain).
fn hull(mut points: Vec<Xy>) -> Vec<Xy> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let half = |points: &mut dyn Iterator<Item = Xy>| {
        let mut chain: Vec<Xy> = Vec::new();
        for point in points {
            while let [.., a, b] = chain[..] {
                let (ab, ap) = (apart(b, a), apart(point, a));
                if ab[0] * ap[1] - ab[1] * ap[0] > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut all = half(&mut points.iter().copied());
    all.extend(half(&mut points.iter().rev().copied()));
    all
}

/// From the nearest point of a convex polygon to a point outside it; none for one inside.
fn way_beyond(hull: &[Xy], point: Xy) -> Option<Xy> {
    let edges = hull.iter().zip(hull.iter().cycle().skip(1));
    let outside = edges.clone().any(|(a, b)| {
        let (ab, ap) = (apart(*b, *a), apart(point, *a));
        let length = ab[0].hypot(ab[1]).max(f64::MIN_POSITIVE);
        (ab[0] * ap[1] - ab[1] * ap[0]) / length < -ROUNDING
    });
    if !outside {
        return None;
    }
    let ways = edges.map(|(a, b)| {
        let (ab, ap) = (apart(*b, *a), apart(point, *a));
        let part = level_dot(ap, ab) / level_dot(ab, ab).max(f64::MIN_POSITIVE);
        let part = part.clamp(0.0, 1.0);
        [ap[0] - ab[0] * part, ap[1] - ab[1] * part]
    });
    ways.reduce(|a, b| if level_dot(b, b) < level_dot(a, a) { b } else { a })
}

fn apart(a: Xy, b: Xy) -> Xy {
    [a[0] - b[0], a[1] - b[1]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tower(offsets: &[(f64, f64)]) -> Blocks {
        Blocks::new(
            offsets
                .iter()
                .map(|(x, y)| Block::new("tower", [0; 3], *x, *y, 0.0)),
        )
    }

    #[test]
    fn a_block_stands_while_its_weight_is_above_what_bears_it() {
        for (offset, firm) in [(0.0, true), (19.9, true), (20.1, false), (-20.1, false)] {
            let blocks = tower(&[(0.0, 0.0), (offset, 0.0)]);
            assert_eq!(blocks.all()[1].z, 60.0);
            let want = match firm {
                true => Stand::Firm,
                false => Stand::Tips {
                    direction: [offset.signum(), 0.0],
                    edge: 20.0 - offset.abs(),
                },
            };
            match (blocks.stand(1), want) {
                (
                    Stand::Tips { direction, edge },
                    Stand::Tips {
                        direction: way,
                        edge: at,
                    },
                ) => {
                    assert_eq!(direction[0], way[0]);
                    assert!((edge - at).abs() < 1e-9, "{edge} {at}");
                }
                (got, want) => assert_eq!(got, want, "{offset}"),
            }
        }
    }

    #[test]
    fn two_that_stand_apart_bear_a_third_between_them() {
        let blocks = tower(&[(-30.0, 0.0), (30.0, 0.0), (0.0, 0.0)]);
        assert_eq!((blocks.all()[2].z, blocks.stand(2)), (60.0, Stand::Firm));
    }

    /// The stairs of n blocks of which each stands on the one below, while all together do not.
    #[test]
    fn what_lies_on_a_block_can_tip_it() {
        let stairs = tower(&[(0.0, 0.0), (15.0, 0.0), (30.0, 0.0)]);
        assert_eq!(stairs.stand(2), Stand::Firm);
        assert!(matches!(stairs.stand(1), Stand::Tips { direction, .. } if direction == [1.0, 0.0]));
        assert_eq!(stairs.load_on(0), [1, 2]);
    }

    #[test]
    fn the_table_ends() {
        let at = |x| tower(&[(x, 0.0)]).stand(0);
        assert_eq!(at(374.0), Stand::Firm);
        assert!(matches!(at(376.0), Stand::Tips { direction, .. } if direction == [1.0, 0.0]));
        let floor = tower(&[(400.0, 0.0)]);
        assert_eq!((floor.all()[0].z, floor.stand(0)), (FLOOR + 20.0, Stand::Firm));
    }

    #[test]
    fn a_hull_has_no_point_inside() {
        let square = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]];
        let points = square.iter().copied().chain([[1.0, 1.0], [1.0, 0.0], [0.5, 1.5]]);
        assert_eq!(hull(points.collect()), square);
        assert_eq!(area(&square), 4.0);
        assert_eq!(way_beyond(&square, [3.0, 1.0]), Some([1.0, 0.0]));
        assert_eq!(way_beyond(&square, [2.0, 1.0]), None);
    }
}
