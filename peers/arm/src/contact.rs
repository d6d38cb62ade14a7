//! Contacts of the hand. The controller knows a contact only by the overload of its motors
//! (M49), so each ends in a `torque-overload`.
//!
//! The hand is two fingers and a palm. The fingers are round, 8 mm thick, and reach from the
//! fingertips [`FINGER_LENGTH`] back to the palm. With a block in the jaws, that block can run into
//! the table and into others as well; the fingertips themselves cannot go below the table, because
//! the jaw line is level and the workspace ends there.

use crate::blocks::Blocks;
use crate::error::{ArmError, ErrorName};
use crate::motion::Posture;
use crate::pose::along;
use crate::upright_box::{GIVE, UprightBox};

/// mm from the fingertips back to the palm.
pub const FINGER_LENGTH: f64 = 60.0;
/// mm of a finger's thickness.
pub const FINGER_THICKNESS: f64 = 8.0;
/// mm of the palm along the jaw line.
pub const PALM_WIDTH: f64 = 100.0;
/// mm of the palm across the jaw line.
pub const PALM_DEPTH: f64 = 40.0;

/// A motion that ends early, against something.
#[derive(Debug, Clone, PartialEq)]
pub struct Contact {
    /// The last posture in which nothing new is touched.
    pub last: Posture,
    /// What the controller reports when it is reached.
    pub error: ArmError,
}

/// The first contact on the straight way between two postures, if there is one.
///
/// A body touched at the beginning may be left: it counts only when it is touched again.
/// `grasping` is the block that the closing jaws are to take, which they may touch.
#[must_use]
pub fn first(blocks: &Blocks, from: &Posture, to: &Posture, grasping: Option<usize>) -> Option<Contact> {
    if let (true, Some(held), Some(rider)) = (from.pose != to.pose, blocks.held(), blocks.rider()) {
        let words = format!(
            "block {} lies on block {}, and the arm carries one block",
            rider.name, held.name
        );
        return Some(Contact {
            last: *from,
            error: overload(&words),
        });
    }
    let way = from.pose.distance(&to.pose).max(from.pose.turn(&to.pose));
    let steps = way.max((to.opening - from.opening).abs()).ceil();
    let mut last = *from;
    let mut before = touched(blocks, from, grasping);
    let mut step = 1.0;
    while step <= steps {
        let posture = from.between(to, step / steps);
        let now = touched(blocks, &posture, grasping);
        if let Some(touch) = now
            .iter()
            .find(|touch| before.iter().all(|known| known.body != touch.body))
        {
            return Some(Contact {
                last,
                error: overload(&touch.words(blocks)),
            });
        }
        (last, before) = (posture, now);
        step += 1.0;
    }
    None
}

/// A part of the hand against a body.
struct Touch {
    part: &'static str,
    body: Obstacle,
}

#[derive(PartialEq)]
enum Obstacle {
    Table,
    Block(usize),
}

impl Touch {
    fn words(&self, blocks: &Blocks) -> String {
        let part = match blocks.held() {
            Some(held) if self.part == HELD => format!("block {} in the jaws", held.name),
            _ => self.part.to_owned(),
        };
        match self.body {
            Obstacle::Table => format!("{part} met the table"),
            Obstacle::Block(index) => format!("{part} met block {}", blocks.all()[index].name),
        }
    }
}

const HELD: &str = "held";

/// Everything that the hand and what it holds touch in a posture.
fn touched(blocks: &Blocks, posture: &Posture, grasping: Option<usize>) -> Vec<Touch> {
    let mut touches = Vec::new();
    let held = blocks.held_at(&posture.pose).map(|block| block.solid());
    if held.is_some_and(|held| held.bottom() < -GIVE) {
        touches.push(Touch {
            part: HELD,
            body: Obstacle::Table,
        });
    }
    for (index, block) in blocks.all().iter().enumerate() {
        if Some(index) == blocks.held_index() || Some(index) == grasping {
            continue;
        }
        let solid = block.solid();
        let part = if held.is_some_and(|held| held.overlaps(&solid)) {
            HELD
        } else if solid.is_farther(posture.pose.position(), HAND_RADIUS) {
            continue;
        } else if finger_in(posture, &solid) {
            "a finger"
        } else if palm_in(posture, &solid) {
            "the palm"
        } else {
            continue;
        };
        touches.push(Touch {
            part,
            body: Obstacle::Block(index),
        });
    }
    touches
}

/// mm around the fingertips that hold the whole hand; what is farther need not be tested point by point.
const HAND_RADIUS: f64 = 90.0;

/// mm between the points of a hand's part that are tested; below any block's size.
const SPACING: f64 = 20.0;

fn finger_in(posture: &Posture, solid: &UprightBox) -> bool {
    let (tip, frame) = (posture.pose.position(), posture.pose.frame());
    let aside = (posture.opening + FINGER_THICKNESS) / 2.0;
    [-aside, aside].into_iter().any(|aside| {
        let tip = along(tip, frame.jaw, aside);
        grid(0.0, FINGER_LENGTH)
            .any(|back| solid.contains(along(tip, frame.approach, -back), FINGER_THICKNESS / 2.0))
    })
}

fn palm_in(posture: &Posture, solid: &UprightBox) -> bool {
    let frame = posture.pose.frame();
    let middle = along(posture.pose.position(), frame.approach, -FINGER_LENGTH);
    grid(-PALM_WIDTH / 2.0, PALM_WIDTH / 2.0).any(|aside| {
        let row = along(middle, frame.jaw, aside);
        grid(-PALM_DEPTH / 2.0, PALM_DEPTH / 2.0)
            .any(|across| solid.contains(along(row, frame.across, across), 0.0))
    })
}

/// The numbers from `low` to `high`, [`SPACING`] apart.
fn grid(low: f64, high: f64) -> impl Iterator<Item = f64> {
    std::iter::successors(Some(low), |at| Some(at + SPACING)).take_while(move |at| *at <= high)
}

fn overload(words: &str) -> ArmError {
    ArmError::new(
        ErrorName::TorqueOverload,
        format!("the motors are overloaded: {words}"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blocks::Block;
    use crate::motion::MAX_OPENING;
    use crate::pose::Pose;

    fn at(x: f64, y: f64, z: f64, opening: f64) -> Posture {
        Posture {
            pose: Pose::new(x, y, z, 0.0, 0.0),
            opening,
        }
    }

    fn check(blocks: &Blocks, from: Posture, to: Posture, want: Option<(&str, f64)>) {
        let got = first(blocks, &from, &to, None);
        match (&got, want) {
            (None, None) => {}
            (Some(contact), Some((words, z))) => {
                assert_eq!(contact.error.name(), ErrorName::TorqueOverload);
                assert!(contact.error.text().contains(words), "{}", contact.error);
                assert!((contact.last.pose.z - z).abs() <= 1.5, "{:?}", contact.last);
            }
            _ => panic!("{from:?} to {to:?}: {got:?}, not {want:?}"),
        }
    }

    #[test]
    fn a_hand_that_comes_down() {
        let blocks = Blocks::new(Block::lab());
        for (x, opening, to, want) in [
            (-150.0, MAX_OPENING, 20.0, None),
            (-150.0, MAX_OPENING, 0.0, None),
            (-150.0, 0.0, 20.0, Some(("a finger met block red", 39.0))),
            (-190.0, MAX_OPENING, 20.0, Some(("a finger met block red", 39.0))),
            (-220.0, MAX_OPENING, 0.0, None),
            (-50.0, MAX_OPENING, 0.0, None),
        ] {
            check(
                &blocks,
                at(x, 100.0, 300.0, opening),
                at(x, 100.0, to, opening),
                want,
            );
        }
    }

    #[test]
    fn the_palm_is_above_the_fingers() {
        let tower = (0..3).map(|_| Block::new("tower", [0; 3], 0.0, 0.0, 0.0));
        let blocks = Blocks::new(tower);
        let down = |z| at(0.0, 0.0, z, MAX_OPENING);
        check(&blocks, down(300.0), down(61.0), None);
        check(
            &blocks,
            down(300.0),
            down(20.0),
            Some(("the palm met block tower", 59.0)),
        );
    }

    #[test]
    fn a_held_block_meets_table_and_blocks() {
        let mut blocks = Blocks::new(Block::lab());
        blocks.grasp(0, &at(-150.0, 100.0, 20.0, 40.0).pose);
        blocks.carry(&at(0.0, 0.0, 300.0, 40.0).pose);
        for (x, y, z, want) in [
            (0.0, 0.0, 20.0, None),
            (0.0, 0.0, 0.0, Some(("block red in the jaws met the table", 19.0))),
            (150.0, 100.0, 60.0, None),
            (
                150.0,
                100.0,
                20.0,
                Some(("block red in the jaws met block blue", 59.0)),
            ),
        ] {
            check(&blocks, at(x, y, 300.0, 40.0), at(x, y, z, 40.0), want);
        }
    }

    #[test]
    fn what_is_touched_at_the_beginning_may_be_left() {
        let blocks = Blocks::new(Block::lab());
        let inside = at(-150.0, 100.0, 20.0, 0.0);
        check(&blocks, inside, at(-150.0, 100.0, 200.0, 0.0), None);
        check(
            &blocks,
            inside,
            at(150.0, 100.0, 20.0, 0.0),
            Some(("block blue", 20.0)),
        );
    }

    #[test]
    fn two_blocks_are_too_heavy() {
        let stack = ["lower", "upper"].map(|name| Block::new(name, [0; 3], 0.0, 0.0, 0.0));
        let mut blocks = Blocks::new(stack);
        let from = at(0.0, 0.0, 20.0, 40.0);
        blocks.grasp(0, &from.pose);
        check(
            &blocks,
            from,
            at(0.0, 0.0, 30.0, 40.0),
            Some(("block upper lies on block lower", 20.0)),
        );
        check(&blocks, from, at(0.0, 0.0, 20.0, MAX_OPENING), None);
    }
}
