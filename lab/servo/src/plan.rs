//! How the hand is turned to take a block and to put it down, and whether there is room.

use crate::memory::{Local, Memory};
use crate::task::{NAMES, SIZE, Task};

/// Spins at which the marker is towards the cameras, degrees: below the first and not above the second.
const SPINS: [f64; 2] = [-45.0, 135.0];
/// From the fingertips to the middle of an open finger along the jaw line, mm.
const FINGER: f64 = 44.0;
/// Half a finger along the jaw line and across, with some room, mm.
const HALF_FINGER: [f64; 2] = [7.0, 10.0];
/// Two blocks whose middles are so near may touch, mm.
const TOUCH: f64 = 50.0;

/// How a task is carried out, in degrees counter-clockwise from x, seen from above.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    /// From the second block to the place.
    pub axis: f64,
    /// Of the jaw line when the block is taken.
    pub pick: f64,
    /// Of the jaw line when it is put down.
    pub place: f64,
}

impl Plan {
    /// A plan for what is seen.
    ///
    /// # Errors
    /// In words: what is in the way.
    pub fn new(task: &Task, memory: &Memory) -> Result<Plan, String> {
        let known = |block: usize| {
            let place = memory.place(block);
            place.ok_or_else(|| format!("{} is not seen whole", NAMES[block].0))
        };
        let (first, second) = (known(task.first)?, known(task.second)?);
        let others: Vec<(usize, Local)> = (0..NAMES.len())
            .filter(|block| *block != task.first && *block != task.second)
            .filter_map(|block| Some((block, memory.place(block)?)))
            .collect();
        let axis = faced(second.yaw, task.side.degrees());
        // The jaws open along the faces, or they would push the second block away.
        let place = Plan::visible(axis + 90.0);
        let plan = Plan {
            axis,
            pick: place,
            place,
        };
        let goal = plan.goal(second.place, task.gap);
        for (other, at) in &others {
            let name = NAMES[*other].0;
            if apart(goal, at.place) < TOUCH {
                let side = task.side;
                let second = NAMES[task.second].0;
                return Err(format!("{name} is in the way, at the {side} of {second}"));
            }
            if meets(goal, place, at) {
                return Err(format!("{name} is in the way of the jaws when they open"));
            }
        }
        // Either pair of faces will do; that with room for the fingers, and of two the one that is turned less.
        let mut picks = [first.yaw, first.yaw + 90.0].map(Plan::visible);
        picks.sort_by(|a, b| (a - place).abs().total_cmp(&(b - place).abs()));
        let all = others.iter().map(|(_, at)| *at).chain([second]);
        let all: Vec<Local> = all.collect();
        let free = picks
            .into_iter()
            .find(|pick| !all.iter().any(|other| meets(first.place, *pick, other)));
        let Some(pick) = free else {
            return Err(format!(
                "there is no room for the jaws around {}",
                NAMES[task.first].0
            ));
        };
        Ok(Plan { pick, ..plan })
    }

    /// The place of the first block's middle beside the second one's.
    #[must_use]
    pub fn goal(&self, second: [f64; 2], gap: f64) -> [f64; 2] {
        let (sin, cos) = self.axis.to_radians().sin_cos();
        [second[0] + cos * (SIZE + gap), second[1] + sin * (SIZE + gap)]
    }

    /// A jaw line has two spins: this is the one in which the marker is towards the cameras.
    fn visible(spin: f64) -> f64 {
        SPINS[0] + (spin - SPINS[0]).rem_euclid(SPINS[1] - SPINS[0])
    }
}

/// The direction of the face of a block with this yaw that looks most this way.
fn faced(yaw: f64, way: f64) -> f64 {
    yaw + 90.0 * ((way - yaw) / 90.0).round()
}

fn apart(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Whether the open fingers of a hand there would meet a block.
fn meets(hand: [f64; 2], spin: f64, block: &Local) -> bool {
    let (sin, cos) = spin.to_radians().sin_cos();
    let (x, y) = (block.place[0] - hand[0], block.place[1] - hand[1]);
    let (along, across) = (x * cos + y * sin, -x * sin + y * cos);
    let (turn_sin, turn_cos) = (block.yaw - spin).to_radians().sin_cos();
    let half = SIZE / 2.0 * (turn_sin.abs() + turn_cos.abs());
    (along.abs() - FINGER).abs() < half + HALF_FINGER[0] && across.abs() < half + HALF_FINGER[1]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_face_that_looks_most_that_way() {
        for (yaw, way, expected) in [
            (20.0, 0.0, 20.0),
            (80.0, 0.0, -10.0),
            (20.0, 90.0, 110.0),
            (20.0, 180.0, 200.0),
            (80.0, 270.0, 260.0),
        ] {
            assert_eq!(faced(yaw, way), expected, "{yaw} {way}");
        }
        assert_eq!(Plan::visible(110.0), 110.0);
        assert_eq!(Plan::visible(200.0), 20.0);
        assert_eq!(Plan::visible(-50.0), 130.0);
    }

    #[test]
    fn fingers_beside_a_block_and_not_across() {
        let block = Local {
            place: [60.0, 0.0],
            error: 0.5,
            yaw: 0.0,
            yaw_error: 1.0,
        };
        assert!(meets([0.0, 0.0], 0.0, &block));
        assert!(!meets([0.0, 0.0], 90.0, &block));
        assert!(!meets([-60.0, 0.0], 0.0, &block));
    }
}
