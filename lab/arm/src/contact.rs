//! What the hand meets: it pushes blocks aside, and cannot push them down.
//!
//! The hand is two fingers and a palm. The fingers are round, 8 mm thick, and reach from the
//! fingertips [`FINGER_LENGTH`] back to the palm. What the jaws hold, and what lies on it, meets the
//! table and other blocks as well; the fingertips themselves cannot go below the table, because
//! the jaw line is level and the workspace ends there.
//!
//! The controller knows a contact only by the overload of its motors (M49): a block that slides away on the table is not felt, one that is
//! pressed down, or caught, ends the motion with a `torque-overload`.

use crate::blocks::{Blocks, meeting_point};
use crate::motion::Posture;
use crate::pose::{Xyz, along};
use crate::upright_box::{GIVE, UprightBox, Xy, level_dot};
use mom_device::{DeviceError, ErrorName};

/// mm from the fingertips back to the palm.
pub const FINGER_LENGTH: f64 = 60.0;
/// mm of a finger's thickness.
pub const FINGER_THICKNESS: f64 = 8.0;
/// mm of the palm along the jaw line.
pub const PALM_WIDTH: f64 = 100.0;
/// mm of the palm across the jaw line.
pub const PALM_DEPTH: f64 = 40.0;

/// mm by which two bodies can come to overlap in one tick of the simulation. A deeper overlap did not arise in this tick (a block fell onto
/// the hand), and is ignored until they part.
const DEEPEST: f64 = 6.0;
/// mm of a push that is worth it.
const LEAST_PUSH: f64 = 0.01;
/// mm around the fingertips that hold the whole hand; what is farther need not be tested point by point.
const HAND_RADIUS: f64 = 90.0;
/// mm between the points of a hand's part that are tested; below any block's size.
const SPACING: f64 = 20.0;

/// A part of the hand, or what it carries, in a body.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Touch {
    /// In plain words.
    part: String,
    body: Body,
    pub(crate) way: Way,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Body {
    Table,
    Block(usize),
}

/// How two bodies would get apart by the shortest way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Way {
    /// One is pressed on the other.
    Pressed,
    /// The block yields on the level.
    Aside {
        block: usize,
        at: Xy,
        direction: Xy,
        depth: f64,
    },
}

impl Touch {
    /// What the controller reports.
    pub(crate) fn overload(&self, blocks: &Blocks) -> DeviceError {
        let body = match self.body {
            Body::Table => "the table".to_owned(),
            Body::Block(index) => format!("block {}", blocks.all()[index].name),
        };
        let text = format!("the motors are overloaded: {} met {body}", self.part);
        DeviceError::new(ErrorName::TorqueOverload, text)
    }
}

/// What the hand, and what it carries, is in. `grasping` is the block that the closing jaws are to take, which they may touch,
/// as they may what lies on it.
pub(crate) fn touches(blocks: &Blocks, posture: &Posture, grasping: Option<usize>) -> Vec<Touch> {
    let mut touches = Vec::new();
    let parts = hand(posture);
    let carried: Vec<usize> = blocks.carried().collect();
    let mut taken = grasping.map_or(Vec::new(), |index| blocks.load_on(index));
    taken.extend(grasping);
    if let Some(held) = blocks.held()
        && held.solid().bottom() < -GIVE
    {
        touches.push(Touch {
            part: format!("block {} in the jaws", held.name),
            body: Body::Table,
            way: Way::Pressed,
        });
    }
    for index in blocks.resting() {
        let solid = blocks.all()[index].solid();
        let by_load = carried.iter().filter_map(|carried| {
            let carried = &blocks.all()[*carried];
            let way = between_boxes(&carried.solid(), &solid, index)?;
            Some((format!("block {} in the jaws", carried.name), way))
        });
        let near = !taken.contains(&index) && !solid.is_farther(posture.pose.position(), HAND_RADIUS);
        let by_hand = parts.iter().filter(|_| near).filter_map(|part| {
            let way = part.within(&solid, index)?;
            Some((part.name.to_owned(), way))
        });
        touches.extend(by_load.chain(by_hand).map(|(part, way)| Touch {
            part,
            body: Body::Block(index),
            way,
        }));
    }
    touches
}

/// How a carried box and a block get apart; none if they are, or have been one in the other for long.
fn between_boxes(carried: &UprightBox, solid: &UprightBox, block: usize) -> Option<Way> {
    if !carried.overlaps(solid) {
        return None;
    }
    let (direction, depth) = carried.way_out(solid)?;
    let height = (carried.top() - solid.bottom()).min(solid.top() - carried.bottom());
    if depth.min(height) > DEEPEST {
        return None;
    }
    Some(match depth <= height {
        true => Way::Aside {
            block,
            at: meeting_point(carried, solid),
            direction,
            depth,
        },
        false => Way::Pressed,
    })
}

/// Points of a part of the hand.
struct Part {
    name: &'static str,
    points: Vec<Xyz>,
    /// mm around each of them on the level.
    margin: f64,
}

/// The two fingers and the palm.
fn hand(posture: &Posture) -> [Part; 3] {
    let (tip, frame) = (posture.pose.position(), posture.pose.frame());
    let aside = (posture.opening + FINGER_THICKNESS) / 2.0;
    let finger = |aside: f64| {
        let tip = along(tip, frame.jaw, aside);
        let back = grid(0.0, FINGER_LENGTH).map(|back| along(tip, frame.approach, -back));
        Part {
            name: "a finger",
            points: back.collect(),
            margin: FINGER_THICKNESS / 2.0,
        }
    };
    let middle = along(tip, frame.approach, -FINGER_LENGTH);
    let row = |aside: f64| {
        let row = along(middle, frame.jaw, aside);
        grid(-PALM_DEPTH / 2.0, PALM_DEPTH / 2.0).map(move |across| along(row, frame.across, across))
    };
    let palm = Part {
        name: "the palm",
        points: grid(-PALM_WIDTH / 2.0, PALM_WIDTH / 2.0).flat_map(row).collect(),
        margin: 0.0,
    };
    [finger(-aside), finger(aside), palm]
}

impl Part {
    /// How it gets out of a block; none if it is outside, or has been inside for long.
    fn within(&self, solid: &UprightBox, block: usize) -> Option<Way> {
        let axes = solid.axes();
        let half = [solid.half[0] + self.margin, solid.half[1] + self.margin];
        let level = |point: &Xyz| {
            let offset = [point[0] - solid.centre[0], point[1] - solid.centre[1]];
            axes.map(|axis| level_dot(offset, axis))
        };
        let inside: Vec<&Xyz> = self
            .points
            .iter()
            .filter(|point| {
                let at = level(point);
                point[2] < solid.top()
                    && point[2] > solid.bottom()
                    && at[0].abs() < half[0]
                    && at[1].abs() < half[1]
            })
            .collect();
        let (low, high) = inside.iter().fold((f64::MAX, f64::MIN), |(low, high), point| {
            (low.min(point[2]), high.max(point[2]))
        });
        let height = (solid.top() - low).min(high - solid.bottom());
        let ways = [0, 1]
            .into_iter()
            .flat_map(|k| [(k, 1.0), (k, -1.0)])
            .map(|(k, sign)| {
                let deepest = inside.iter().map(|point| half[k] + sign * level(point)[k]);
                (axes[k].map(|part| part * sign), deepest.fold(0.0, f64::max))
            });
        let (direction, depth) = ways.reduce(|a, b| if b.1 < a.1 { b } else { a })?;
        if inside.is_empty() || depth.min(height) > DEEPEST {
            return None;
        }
        if height < depth {
            return (height > GIVE).then_some(Way::Pressed);
        }
        let count = inside.len() as f64;
        let at = [0, 1].map(|k| inside.iter().map(|point| point[k]).sum::<f64>() / count);
        (depth > LEAST_PUSH).then_some(Way::Aside {
            block,
            at,
            direction,
            depth,
        })
    }
}

/// The numbers from `low` to `high`, [`SPACING`] apart.
fn grid(low: f64, high: f64) -> impl Iterator<Item = f64> {
    std::iter::successors(Some(low), |at| Some(at + SPACING)).take_while(move |at| *at <= high)
}
