//! How far the hand is from the blocks: two fingers and a palm, as the simulated arm has them, against cubes.

use mom_arm::Pose;
use mom_arm::blocks::Block;
use mom_arm::contact::{FINGER_LENGTH, FINGER_THICKNESS, PALM_DEPTH, PALM_WIDTH};
use mom_arm::motion::MAX_OPENING;
use mom_arm::pose::Xyz;

/// mm between the points of a finger's axis and of the palm from which distances are taken.
const SPACING: f64 = 5.0;
/// mm and degrees between the poses of a leg at which distances are taken.
const STEP: f64 = 2.0;
/// mm around the tips that hold the whole hand.
const RADIUS: f64 = 90.0;

/// mm between the hand with open jaws and the nearest block; 0 where they touch.
pub(super) fn clearance(pose: &Pose, blocks: &[Block]) -> f64 {
    let solids: Vec<Solid> = blocks.iter().map(Solid::of).collect();
    nearest(pose, &solids, f64::INFINITY)
}

/// The least of it along a straight leg.
pub(super) fn clearance_along(from: &Pose, to: &Pose, blocks: &[Block]) -> f64 {
    let solids: Vec<Solid> = blocks.iter().map(Solid::of).collect();
    let steps = (from.distance(to).max(from.turn(to)) / STEP).ceil().max(1.0);
    let mut least = nearest(to, &solids, f64::INFINITY);
    let mut at = 0.0;
    while at < steps && least > 0.0 {
        let here = nearest(&from.between(to, at / steps), &solids, least);
        // In a step no part of the hand comes nearer by more than 2.6 times its length: 1 by the way, and 1.6 by a turn of as many degrees
        // 90 mm off.
        at += ((here - least).max(0.0) / (2.6 * STEP)).floor().max(1.0);
        least = least.min(here);
    }
    least
}

/// The clearance; where it is more than `most`, a number between the two.
fn nearest(pose: &Pose, solids: &[Solid], most: f64) -> f64 {
    let tip = pose.position();
    let (mut nearest, mut bound) = (f64::INFINITY, f64::INFINITY);
    for solid in solids {
        // Not nearer than that for any part of the hand.
        let at_least = solid.distance(tip) - RADIUS;
        if at_least >= most.min(nearest) {
            bound = bound.min(at_least);
            continue;
        }
        for (point, margin) in points(pose) {
            nearest = nearest.min((solid.distance(point) - margin).max(0.0));
        }
    }
    nearest.min(bound)
}

/// Points of the hand, and how thick it is around them.
fn points(pose: &Pose) -> impl Iterator<Item = (Xyz, f64)> {
    let (tip, frame) = (pose.position(), pose.frame());
    let from = move |jaw: f64, across: f64, back: f64| {
        std::array::from_fn(|axis| {
            tip[axis] + frame.jaw[axis] * jaw + frame.across[axis] * across - frame.approach[axis] * back
        })
    };
    let aside = (MAX_OPENING + FINGER_THICKNESS) / 2.0;
    let finger = move |jaw: f64| {
        grid(0.0, FINGER_LENGTH).map(move |back| (from(jaw, 0.0, back), FINGER_THICKNESS / 2.0))
    };
    let palm = grid(-PALM_WIDTH / 2.0, PALM_WIDTH / 2.0).flat_map(move |jaw| {
        grid(-PALM_DEPTH / 2.0, PALM_DEPTH / 2.0).map(move |across| (from(jaw, across, FINGER_LENGTH), 0.0))
    });
    finger(-aside).chain(finger(aside)).chain(palm)
}

/// An upright cube.
struct Solid {
    centre: Xyz,
    half: f64,
    sin: f64,
    cos: f64,
}

impl Solid {
    fn of(block: &Block) -> Solid {
        let (sin, cos) = block.yaw.to_radians().sin_cos();
        Solid {
            centre: [block.x, block.y, block.z],
            half: block.size / 2.0,
            sin,
            cos,
        }
    }

    /// mm from a point; 0 inside.
    fn distance(&self, point: Xyz) -> f64 {
        let [x, y, z]: Xyz = std::array::from_fn(|axis| point[axis] - self.centre[axis]);
        let out = |offset: f64| (offset.abs() - self.half).max(0.0);
        let along = out(self.cos * x + self.sin * y);
        let across = out(self.cos * y - self.sin * x);
        (along * along + across * across + out(z) * out(z)).sqrt()
    }
}

fn grid(low: f64, high: f64) -> impl Iterator<Item = f64> {
    std::iter::successors(Some(low), |at| Some(at + SPACING)).take_while(move |at| *at <= high)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block() -> [Block; 1] {
        [Block::new("one", [0; 3], 0.0, 0.0, 0.0)]
    }

    #[test]
    fn distances_of_fingers_and_palm() {
        // The jaw line along y: fingers 44 mm to either side, 4 mm thick around their axis, the palm 60 mm above the tips.
        for (x, y, z, want) in [
            (-50.0, 0.0, 10.0, 30.0_f64.hypot(20.0)),
            (-50.0, 44.0, 10.0, 26.0),
            (0.0, 0.0, 60.0, 20.0_f64.hypot(24.0) - 4.0),
            (0.0, 44.0, 60.0, 16.0),
            (0.0, 44.0, 42.0, 0.0),
            (0.0, 0.0, 0.0, 20.0),
        ] {
            let found = clearance(&Pose::new(x, y, z, 90.0, 0.0), &block());
            let palm = (z + FINGER_LENGTH - 40.0).hypot((x.abs() - 40.0).max(0.0));
            assert!((found - f64::min(want, palm)).abs() < 0.5, "{x} {y} {z}: {found}");
        }
        assert_eq!(clearance(&Pose::new(0.0, 0.0, 9.0, 0.0, 0.0), &[]), f64::INFINITY);
    }

    #[test]
    fn the_least_on_the_way() {
        let at = |x, z| Pose::new(x, 0.0, z, 0.0, 0.0);
        let along = clearance_along(&at(-200.0, 70.0), &at(200.0, 70.0), &block());
        assert!((along - 26.0).abs() < 0.3, "{along}");
        let through = clearance_along(&at(-200.0, 20.0), &at(200.0, 20.0), &block());
        assert_eq!(through, 0.0);
        let stands = clearance_along(&at(-100.0, 70.0), &at(-100.0, 70.0), &block());
        assert_eq!(stands, clearance(&at(-100.0, 70.0), &block()));
    }
}
