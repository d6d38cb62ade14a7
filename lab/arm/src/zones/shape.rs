//! Where zones are, and what of the arm is in them.

use mom_client::Value;

use super::Mount;
use crate::pose::{Pose, Xyz, minus};
use crate::reach;

/// mm around the line from the fingertips to the wrist that hold the hand, and a block in the jaws.
pub const HAND_RADIUS: f64 = 60.0;
/// mm around the line from the wrist to the elbow that hold the forearm.
pub const FOREARM_RADIUS: f64 = 80.0;
/// mm between the points of a part that are looked at.
const SPACING: f64 = 10.0;
/// mm by which the arm may come nearer between two such poses.
pub(super) const MARGIN: f64 = 10.0;

/// A box along the axes of the zones' frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ZoneBox {
    /// The corner with the smaller numbers, mm.
    pub from: Xyz,
    /// The other one, mm.
    pub to: Xyz,
}

impl ZoneBox {
    /// `{from: [x, y, z], to: [x, y, z]}`; none if it is not a box.
    pub(super) fn read(content: &Value) -> Option<Self> {
        let map = content.as_map()?;
        let corner = |key: &str| -> Option<Xyz> {
            let numbers: Option<Vec<f64>> = map.get(key)?.as_list()?.iter().map(number).collect();
            numbers?.try_into().ok()
        };
        let bounds = Self {
            from: corner("from")?,
            to: corner("to")?,
        };
        (0..3)
            .all(|axis| bounds.from[axis] < bounds.to[axis])
            .then_some(bounds)
    }

    /// Whether a part of the arm is in it, or near, as for legs: where it may stay it may also leave.
    pub(super) fn holds(&self, mount: &Mount, pose: &Pose) -> bool {
        parts(mount, pose).is_none_or(|parts| parts.iter().any(|part| part.enters(self, &[])))
    }

    /// What both have in common.
    fn common(&self, other: &Self) -> Option<Self> {
        let both = Self {
            from: std::array::from_fn(|axis| self.from[axis].max(other.from[axis])),
            to: std::array::from_fn(|axis| self.to[axis].min(other.to[axis])),
        };
        (0..3).all(|axis| both.from[axis] < both.to[axis]).then_some(both)
    }

    /// Whether these boxes together cover it.
    pub(super) fn is_covered(&self, boxes: &[Self]) -> bool {
        let Some((first, rest)) = boxes.split_first() else {
            return false;
        };
        let Some(common) = self.common(first) else {
            return self.is_covered(rest);
        };
        // What is left of it beside the first, slice by slice.
        let mut left = *self;
        (0..3).all(|axis| {
            let (mut below, mut above) = (left, left);
            below.to[axis] = common.from[axis];
            above.from[axis] = common.to[axis];
            (left.from[axis], left.to[axis]) = (common.from[axis], common.to[axis]);
            [below, above]
                .into_iter()
                .filter(|slice| slice.from[axis] < slice.to[axis])
                .all(|slice| slice.is_covered(rest))
        })
    }
}

/// A part of the arm: all that is near a line, in the frame of the zones.
#[derive(Debug, Clone, Copy)]
pub(super) struct Part {
    from: Xyz,
    to: Xyz,
    /// mm.
    radius: f64,
}

/// Hand and forearm; none where no joints can hold the pose, so that nobody knows where they are.
pub(super) fn parts(mount: &Mount, pose: &Pose) -> Option<[Part; 2]> {
    let links = reach::links(&reach::joints(pose).ok()?);
    let [tip, wrist, forearm] = [links.tip, links.wrist, links.forearm].map(|point| mount.place(point));
    let part = |from, to, radius| Part { from, to, radius };
    Some([
        part(tip, wrist, HAND_RADIUS),
        part(wrist, forearm, FOREARM_RADIUS),
    ])
}

impl Part {
    /// Whether some of it, or of what is near, is in a zone, and not in one of these.
    pub(super) fn enters(&self, zone: &ZoneBox, own: &[ZoneBox]) -> bool {
        // Balls around the points hold what is between them, and boxes are looked at in their place.
        let reach = self.radius + MARGIN + SPACING / 2.0;
        // Most zones are far away.
        let around = ZoneBox {
            from: std::array::from_fn(|axis| self.from[axis].min(self.to[axis]) - reach),
            to: std::array::from_fn(|axis| self.from[axis].max(self.to[axis]) + reach),
        };
        if around.common(zone).is_none() {
            return false;
        }
        let way = minus(self.to, self.from);
        let pieces = (way[0].hypot(way[1]).hypot(way[2]) / SPACING).ceil().max(1.0);
        let mut piece = 0.0;
        while piece <= pieces {
            let at: Xyz = std::array::from_fn(|axis| self.from[axis] + way[axis] * piece / pieces);
            let near = ZoneBox {
                from: at.map(|number| number - reach),
                to: at.map(|number| number + reach),
            };
            if near.common(zone).is_some_and(|inside| !inside.is_covered(own)) {
                return true;
            }
            piece += 1.0;
        }
        false
    }
}

fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Double(number) => Some(*number).filter(|number| number.is_finite()),
        Value::Int(number) => Some(*number as f64),
        _ => None,
    }
}
