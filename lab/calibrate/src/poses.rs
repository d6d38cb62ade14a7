//! Where the arm is driven, and where the marker is then.

use mom_drive::Pose;

/// Each number's range: mm and degrees. Clear of what stands on the table, away from the limits of the workspace, and
/// turned so that the marker on its stalk is towards the
/// lab's cameras, and in their images.
const RANGES: [(f64, f64); 5] = [
    (-270.0, 220.0),
    (-150.0, 270.0),
    (130.0, 430.0),
    (-20.0, 80.0),
    (-20.0, 15.0),
];
/// A prime for each number.
const BASES: [u32; 5] = [2, 3, 5, 7, 11];

/// So many poses, spread evenly over the workspace, in an order of short ways.
///
/// They are points of Halton's sequence, which leaves no holes and no heaps, shifted by the seed; 0 shifts nothing.
#[must_use]
pub fn spread(count: usize, seed: u64) -> Vec<Pose> {
    let mut random = fastrand::Rng::with_seed(seed);
    let shift: [f64; 5] = std::array::from_fn(|_| match seed {
        0 => 0.0,
        _ => random.f64(),
    });
    let mut left: Vec<Pose> = (1..=count).map(|index| pose(index, &shift)).collect();
    let mut order = Vec::with_capacity(count);
    let mut at = Pose {
        x: 0.0,
        y: 0.0,
        z: 300.0,
        spin: 0.0,
        tilt: 0.0,
    };
    while let Some(next) =
        (0..left.len()).min_by(|&a, &b| at.distance(&left[a]).total_cmp(&at.distance(&left[b])))
    {
        at = left.swap_remove(next);
        order.push(at);
    }
    order
}

/// In whole mm and degrees, so that a command reads well.
fn pose(index: usize, shift: &[f64; 5]) -> Pose {
    let number = |axis: usize| {
        let (low, high) = RANGES[axis];
        let part = (radical_inverse(index, BASES[axis]) + shift[axis]).fract();
        (low + part * (high - low)).round()
    };
    Pose {
        x: number(0),
        y: number(1),
        z: number(2),
        spin: number(3),
        tilt: number(4),
    }
}

/// The digits of a number in this base, behind the point in the other direction.
fn radical_inverse(number: usize, base: u32) -> f64 {
    let (mut left, mut digit, mut part) = (number, 1.0, 0.0);
    while left > 0 {
        digit /= f64::from(base);
        part += digit * (left % base as usize) as f64;
        left /= base as usize;
    }
    part
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dlt::{self, CONDITION};
    use crate::{Observation, Projection};

    /// From any number of poses a camera can be computed, and never with a condition near the limit.
    #[test]
    fn poses_are_well_spread_and_inside() {
        let camera = Projection::new(crate::experiment::LAB_X).expect("a camera");
        for (count, seed) in (6..=50)
            .map(|count| (count, 0))
            .chain((1..30).map(|seed| (8, seed)))
        {
            let poses = spread(count, seed);
            assert_eq!(poses.len(), count);
            let observations: Vec<Observation> = poses
                .iter()
                .map(|pose| {
                    let world = pose.place([0.0, -140.0, 75.0]);
                    Observation {
                        world,
                        pixel: camera.project(world).expect("in front"),
                    }
                })
                .collect();
            let inside = |pose: &Pose| {
                let within = |(number, (low, high)): (&f64, &(f64, f64))| (*low..=*high).contains(number);
                pose.numbers().iter().zip(&RANGES).all(within)
            };
            assert!(poses.iter().all(inside), "{count}: {poses:?}");
            let condition = dlt::estimate(&observations).expect("determined").condition;
            assert!(
                condition < CONDITION / 4.0,
                "{count} poses, seed {seed}: {condition}"
            );
        }
    }

    #[test]
    fn the_order_is_that_of_short_ways() {
        let way = |poses: &[Pose]| {
            poses
                .windows(2)
                .map(|pair| pair[0].distance(&pair[1]))
                .sum::<f64>()
        };
        let ordered = spread(20, 0);
        let plain: Vec<Pose> = (1..=20).map(|index| pose(index, &[0.0; 5])).collect();
        assert!(
            way(&ordered) < 0.7 * way(&plain),
            "{} {}",
            way(&ordered),
            way(&plain)
        );
        assert_eq!(ordered[0].command().split(' ').count(), 6);
    }
}
