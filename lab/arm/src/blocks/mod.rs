//! The wooden blocks: on the table, on each other, in the jaws, or on their way down.
//!
//! The model is simple: blocks are cubes that turn about the vertical and lean about one axis, pushes are slow (nothing slides on by
//! itself), nothing bounces, and the hand does not feel what falls on it. A block moves because the hand pushes it, or by gravity. It
//! stands as long as its weight, and the weight on it, is above what it lies on; otherwise it topples over the nearest edge, or falls. What
//! leaves the table ends on the floor, and stays there until the lab is put back.
//!
//! Jaws hold by friction. Closing, they turn and shift what lies between them until its faces are parallel to them; then they carry it with
//! all that lies on it. That slides off when the carried block leans by more than the friction of wood on wood allows.

use serde::{Deserialize, Serialize};

use crate::motion::Posture;
use crate::pose::{Pose, Xyz, along, dot, minus};
use crate::upright_box::UprightBox;

mod fall;
mod push;
mod support;

use fall::Motion;
pub(crate) use push::meeting_point;

/// mm of a standard block's edges.
pub const BLOCK_SIZE: f64 = 40.0;
/// mm across the jaw line by which a block may lie off the fingertips and still be taken.
pub const GRASP_ACROSS: f64 = 12.0;
/// mm along the fingers by which a block's middle may lie off the fingertips and still be taken.
pub const GRASP_ALONG: f64 = 15.0;
/// Half an edge of the table, mm. It is wider than the workspace.
pub const TABLE: f64 = 375.0;
/// mm of the floor's height above the table.
pub const FLOOR: f64 = -400.0;
/// Degrees by which a block may lean before another slides off it: friction of wood on wood, about 0.5.
pub const FRICTION_ANGLE: f64 = 26.6;

/// A cube, with the place of its middle in the table's frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Block {
    /// What people call it.
    pub name: String,
    /// Red, green and blue, 0 to 255 each (sRGB).
    pub colour: [u8; 3],
    /// mm of its edges.
    pub size: f64,
    /// mm.
    pub x: f64,
    /// mm.
    pub y: f64,
    /// mm; half its size when it lies on the table.
    pub z: f64,
    /// Degrees about the vertical, counter-clockwise seen from above.
    pub yaw: f64,
    /// Degrees about its own first level axis; 0 unless it is carried or topples.
    pub tilt: f64,
}

impl Block {
    /// A standard block at a place on the table.
    #[must_use]
    pub fn new(name: &str, colour: [u8; 3], x: f64, y: f64, yaw: f64) -> Self {
        let size = BLOCK_SIZE;
        Self {
            name: name.to_owned(),
            colour,
            size,
            x,
            y,
            z: size / 2.0,
            yaw,
            tilt: 0.0,
        }
    }

    /// The three blocks of the lab.
    #[must_use]
    pub fn lab() -> Vec<Self> {
        vec![
            Self::new("red", [200, 40, 40], -150.0, 100.0, 0.0),
            Self::new("green", [40, 150, 60], 0.0, 150.0, 20.0),
            Self::new("blue", [40, 80, 190], 150.0, 100.0, 0.0),
        ]
    }

    /// The upright box around the block.
    pub(crate) fn solid(&self) -> UprightBox {
        let (sin, cos) = self.tilt.to_radians().sin_cos();
        let half = self.size / 2.0;
        let leaning = half * (sin.abs() + cos.abs());
        UprightBox {
            centre: [self.x, self.y, self.z],
            yaw: self.yaw,
            half: [half, leaning, leaning],
        }
    }

    /// The place of its middle.
    pub(crate) fn place(&self) -> Xyz {
        [self.x, self.y, self.z]
    }

    fn put(&mut self, [x, y, z]: Xyz) {
        (self.x, self.y, self.z) = (x, y, z);
    }
}

/// All blocks, how they move, and which of them the jaws hold.
///
/// ```
/// use mom_arm::{Block, blocks::Blocks};
///
/// let same_place = |name| Block::new(name, [0, 0, 0], 10.0, 0.0, 0.0);
/// let blocks = Blocks::new([same_place("lower"), same_place("upper")]);
/// assert_eq!(blocks.all()[1].z, 60.0);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Blocks {
    all: Vec<Block>,
    /// How each of them moves by itself.
    motions: Vec<Motion>,
    /// The block in the jaws, and behind it those that lie on it.
    carried: Vec<Carried>,
}

/// How a block lies in the hand; it keeps this while it is carried.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Carried {
    index: usize,
    /// mm from the fingertips: along the jaw line, across it, and the way the fingers point.
    offset: Xyz,
    /// Degrees between the jaw line and the block's first level axis.
    yaw: f64,
    /// The hand's tilt when it took the block.
    tilt: f64,
}

impl Blocks {
    /// Blocks put down one after the other: each lies on the table or on those before it.
    #[must_use]
    pub fn new(blocks: impl IntoIterator<Item = Block>) -> Self {
        let mut all = Self {
            all: Vec::new(),
            motions: Vec::new(),
            carried: Vec::new(),
        };
        for mut block in blocks {
            block.tilt = 0.0;
            let top = all
                .all
                .iter()
                .map(|other| other.solid().top())
                .fold(0.0, f64::max);
            block.z = top + block.size / 2.0;
            all.all.push(block);
            all.motions.push(Motion::Rests);
            let index = all.all.len() - 1;
            let below = all.surface_below(index);
            all.all[index].z = below + all.all[index].size / 2.0;
        }
        all
    }

    /// Every block, always in the same order.
    #[must_use]
    pub fn all(&self) -> &[Block] {
        &self.all
    }

    /// The block in the jaws.
    #[must_use]
    pub fn held(&self) -> Option<&Block> {
        self.carried.first().map(|held| &self.all[held.index])
    }

    /// The place in [`Blocks::all`] of the block in the jaws.
    #[must_use]
    pub fn held_index(&self) -> Option<usize> {
        self.carried.first().map(|held| held.index)
    }

    /// Whether the hand carries it: in the jaws, or on what is in the jaws.
    pub(crate) fn is_carried(&self, index: usize) -> bool {
        self.carried.iter().any(|carried| carried.index == index)
    }

    /// The blocks that lie where they are: neither carried nor on their way down.
    pub(crate) fn resting(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.all.len()).filter(|index| !self.is_carried(*index) && self.motions[*index] == Motion::Rests)
    }

    /// The carried blocks, the held one first.
    pub(crate) fn carried(&self) -> impl Iterator<Item = usize> + '_ {
        self.carried.iter().map(|carried| carried.index)
    }

    /// The block that the jaws would take if they closed here: it lies between them, near enough to
    /// the fingertips, and nothing is in its way when the jaws square it.
    #[must_use]
    pub fn within_jaws(&self, posture: &Posture) -> Option<usize> {
        let (tip, frame) = (posture.pose.position(), posture.pose.frame());
        let takes = |block: &Block| {
            let offset = minus(block.place(), tip);
            dot(offset, frame.jaw).abs() + width(block, block.yaw - posture.pose.spin) / 2.0
                <= posture.opening / 2.0
                && dot(offset, frame.across).abs() <= GRASP_ACROSS
                && dot(offset, frame.approach).abs() <= GRASP_ALONG
        };
        self.resting().find(|&index| {
            let block = &self.all[index];
            takes(block) && self.is_free(index, &squared(block, &posture.pose, 0.0).solid())
        })
    }

    /// The jaws have come so near that they turn and shift the block between them. What lies on it goes along, and is between the jaws
    /// itself as far as the fingers reach.
    pub(crate) fn square(&mut self, index: usize, posture: &Posture, reach: f64) {
        let block = squared(&self.all[index], &posture.pose, posture.opening);
        let old = std::mem::replace(&mut self.all[index], block);
        self.follow(index, &old);
        let (tip, frame) = (posture.pose.position(), posture.pose.frame());
        for rider in self.load_on(index) {
            let block = &mut self.all[rider];
            let offset = minus(block.place(), tip);
            let half = block.size / 2.0;
            if dot(offset, frame.approach) - half > -reach && dot(offset, frame.across).abs() < half {
                *block = squared(block, &posture.pose, posture.opening);
            }
        }
    }

    /// The jaws are closed on a block and hold it, and what lies on it.
    pub(crate) fn grasp(&mut self, index: usize, pose: &Pose) {
        let size = self.all[index].size;
        let closed = Posture {
            pose: *pose,
            opening: size,
        };
        self.square(index, &closed, 0.0);
        let mut carried = vec![index];
        carried.extend(self.load_on(index));
        let frame = pose.frame();
        self.carried = carried
            .into_iter()
            .map(|index| {
                let block = &mut self.all[index];
                // A cube turned by a quarter is the same cube; so it leans about the jaw line, or nearly so.
                block.yaw -= ((block.yaw - pose.spin) / 90.0).round() * 90.0;
                self.motions[index] = Motion::Rests;
                let offset = minus(block.place(), pose.position());
                Carried {
                    index,
                    offset: [frame.jaw, frame.across, frame.approach].map(|axis| dot(offset, axis)),
                    yaw: block.yaw - pose.spin,
                    tilt: pose.tilt,
                }
            })
            .collect();
    }

    /// What is carried goes where the hand goes. What lies on a block that leans too far is left to fall.
    pub(crate) fn carry(&mut self, pose: &Pose) {
        let Some(held) = self.carried.first() else { return };
        if (pose.tilt - held.tilt).abs() > FRICTION_ANGLE {
            self.carried.truncate(1);
        }
        for carried in &self.carried {
            carried.put(&mut self.all[carried.index], pose);
        }
    }

    /// The jaws open: what they held is on its own.
    pub(crate) fn release(&mut self) {
        for carried in std::mem::take(&mut self.carried) {
            self.motions[carried.index] = Motion::Rests;
        }
    }

    /// Whether the place is free of all blocks but one and those on it.
    fn is_free(&self, except: usize, place: &UprightBox) -> bool {
        let load = self.load_on(except);
        let others = (0..self.all.len()).filter(|index| *index != except && !load.contains(index));
        others
            .into_iter()
            .all(|other| !self.all[other].solid().overlaps(place))
    }

    /// What lies on a block goes along with it, as if it were fixed to it; `old` is where the block was.
    fn follow(&mut self, index: usize, old: &Block) {
        let new = self.all[index].clone();
        let turn = new.yaw - old.yaw;
        let (sin, cos) = turn.to_radians().sin_cos();
        // Who lies on it is told by where it was.
        let mut before = self.clone();
        before.all[index] = old.clone();
        for rider in before.load_on(index) {
            let block = &mut self.all[rider];
            let (x, y) = (block.x - old.x, block.y - old.y);
            (block.x, block.y) = (new.x + cos * x - sin * y, new.y + sin * x + cos * y);
            block.yaw += turn;
        }
    }
}

impl Carried {
    fn put(&self, block: &mut Block, pose: &Pose) {
        let frame = pose.frame();
        let [jaw, across, approach] = self.offset;
        let place = along(along(pose.position(), frame.jaw, jaw), frame.across, across);
        block.put(along(place, frame.approach, approach));
        block.yaw = pose.spin + self.yaw;
        block.tilt = pose.tilt - self.tilt;
    }
}

/// mm that a block takes between jaws from which it is turned by so many degrees.
fn width(block: &Block, turned: f64) -> f64 {
    let (sin, cos) = turned.to_radians().sin_cos();
    block.size * (sin.abs() + cos.abs())
}

/// The block as jaws would turn and shift it that have closed to this opening.
fn squared(block: &Block, pose: &Pose, opening: f64) -> Block {
    let mut block = block.clone();
    let turned = block.yaw - pose.spin;
    let nearest = (turned / 90.0).round() * 90.0;
    let rest = turned - nearest;
    if width(&block, rest) > opening {
        // s (sin a + cos a) = s √2 sin(a + 45°), which is the opening.
        let fits = opening / (block.size * std::f64::consts::SQRT_2);
        let allowed = (fits.clamp(0.0, 1.0).asin().to_degrees() - 45.0).max(0.0);
        block.yaw = pose.spin + nearest + rest.clamp(-allowed, allowed);
    }
    let jaw = pose.frame().jaw;
    let aside = dot(minus(block.place(), pose.position()), jaw);
    let room = ((opening - width(&block, block.yaw - pose.spin)) / 2.0).max(0.0);
    let place = along(block.place(), jaw, aside.clamp(-room, room) - aside);
    block.put(place);
    block
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::MAX_OPENING;

    fn lab_with(extra: Option<Block>) -> Blocks {
        Blocks::new(Block::lab().into_iter().chain(extra))
    }

    fn over_red(x: f64, y: f64, z: f64, spin: f64) -> Posture {
        Posture {
            pose: Pose::new(-150.0 + x, 100.0 + y, z, spin, 0.0),
            opening: MAX_OPENING,
        }
    }

    #[test]
    fn jaws_take_what_lies_between_them() {
        let blocks = lab_with(None);
        for (posture, want) in [
            (over_red(0.0, 0.0, 20.0, 0.0), Some(0)),
            (over_red(19.0, 0.0, 20.0, 0.0), Some(0)),
            (over_red(21.0, 0.0, 20.0, 0.0), None),
            (over_red(0.0, 11.0, 20.0, 0.0), Some(0)),
            (over_red(0.0, 13.0, 20.0, 0.0), None),
            (over_red(0.0, 19.0, 20.0, 90.0), Some(0)),
            (over_red(0.0, 0.0, 34.0, 0.0), Some(0)),
            (over_red(0.0, 0.0, 36.0, 0.0), None),
            // Turned by 45° the block is 56.6 mm wide between the jaws.
            (over_red(11.0, 0.0, 20.0, 45.0), Some(0)),
            (over_red(12.0, 12.0, 20.0, 45.0), None),
            (
                Posture {
                    opening: 39.0,
                    ..over_red(0.0, 0.0, 20.0, 0.0)
                },
                None,
            ),
        ] {
            assert_eq!(blocks.within_jaws(&posture), want, "{posture:?}");
        }
    }

    #[test]
    fn a_neighbour_in_the_way_of_squaring_keeps_the_block_out_of_the_jaws() {
        let beside = lab_with(Some(Block::new("black", [0; 3], -150.0, 141.0, 0.0)));
        assert_eq!(beside.within_jaws(&over_red(0.0, 0.0, 20.0, 0.0)), Some(0));
        assert_eq!(beside.within_jaws(&over_red(0.0, 0.0, 20.0, 45.0)), None);
    }

    #[test]
    fn a_held_block_keeps_its_place_in_the_hand() {
        let mut blocks = lab_with(None);
        blocks.grasp(0, &over_red(10.0, 5.0, 25.0, 0.0).pose);
        let squared = blocks.held().unwrap();
        assert_eq!((squared.x, squared.y, squared.z), (-140.0, 100.0, 20.0));
        blocks.carry(&Pose::new(0.0, 0.0, 200.0, 90.0, 45.0));
        let carried = blocks.held().unwrap();
        // 5 mm behind the fingertips and 5 mm below, turned with the hand.
        let (level, down) = (carried.x, 200.0 - carried.z);
        assert!(
            level.abs() < 1e-9 && (down - 50.0_f64.sqrt()).abs() < 1e-9,
            "{carried:?}"
        );
        assert_eq!((carried.yaw, carried.tilt), (90.0, 45.0));
    }

    #[test]
    fn a_block_taken_by_a_tilted_hand_leans_when_the_hand_is_upright() {
        let mut blocks = lab_with(None);
        let leaning = Pose {
            tilt: 30.0,
            ..over_red(0.0, 0.0, 20.0, 0.0).pose
        };
        blocks.grasp(0, &leaning);
        for (tilt, want) in [(30.0, 0.0), (0.0, -30.0), (-45.0, -75.0)] {
            blocks.carry(&Pose {
                tilt,
                z: 100.0,
                ..leaning
            });
            assert_eq!(blocks.held().unwrap().tilt, want);
        }
    }

    /// Lets time pass until all is at rest; so many seconds at most.
    fn settle(blocks: &mut Blocks) {
        let mut ticks = 0;
        while !blocks.at_rest() {
            blocks.fall(0.005);
            ticks += 1;
            assert!(ticks < 1000, "it never comes to rest: {blocks:?}");
        }
    }

    #[test]
    fn a_released_block_falls_on_what_is_below_and_topples_off_an_edge() {
        for (pose, x, z) in [
            (Pose::new(0.0, 0.0, 300.0, 30.0, 20.0), 0.0, 20.0),
            (Pose::new(150.0, 100.0, 300.0, 10.0, 0.0), 150.0, 60.0),
            (Pose::new(165.0, 100.0, 300.0, 0.0, 0.0), 165.0, 60.0),
            // Less than half of it is over the blue one: it goes over the edge and comes to lie beside it.
            (Pose::new(180.0, 100.0, 300.0, 0.0, 0.0), 190.0, 20.0),
            (Pose::new(192.0, 100.0, 300.0, 0.0, 0.0), 192.0, 20.0),
        ] {
            let mut blocks = lab_with(None);
            blocks.grasp(0, &over_red(0.0, 0.0, 20.0, 0.0).pose);
            blocks.carry(&pose);
            blocks.release();
            blocks.fall(0.005);
            assert!(!blocks.at_rest(), "a fall takes time");
            settle(&mut blocks);
            let red = &blocks.all()[0];
            assert!(
                (red.x - x).abs() < 1e-6 && (red.y - pose.y).abs() < 1e-6,
                "{pose:?}: {red:?}"
            );
            assert!((red.z - z).abs() < 1e-6 && red.tilt == 0.0, "{pose:?}: {red:?}");
            assert_eq!(blocks.held(), None);
        }
    }

    /// The hand stops where it touches something, a little way in.
    #[test]
    fn an_edge_that_is_a_little_in_the_table_comes_out_as_the_block_lies_flat() {
        let mut blocks = lab_with(None);
        let hand = over_red(0.0, 0.0, 20.0, 0.0).pose;
        blocks.grasp(0, &hand);
        blocks.carry(&Pose { tilt: -2.7, ..hand });
        assert!(blocks.all()[0].solid().bottom() < -0.9);
        blocks.release();
        settle(&mut blocks);
        let red = &blocks.all()[0];
        assert!((red.z - 20.0).abs() < 1e-9 && red.tilt == 0.0, "{red:?}");
    }

    #[test]
    fn a_fall_of_196_mm_takes_a_fifth_of_a_second() {
        let mut blocks = Blocks::new([Block::new("red", [0; 3], 0.0, 0.0, 0.0)]);
        blocks.all[0].z += 196.2;
        let mut ticks = 0;
        while !blocks.at_rest() {
            blocks.fall(0.005);
            ticks += 1;
        }
        assert!((39..=42).contains(&ticks), "{ticks}");
    }

    #[test]
    fn what_lies_on_the_held_block_goes_along_until_it_leans_too_far() {
        let black = Block::new("black", [0; 3], -145.0, 100.0, 0.0);
        let mut blocks = lab_with(Some(black));
        assert_eq!(blocks.all()[3].z, 60.0);
        blocks.grasp(0, &over_red(0.0, 0.0, 20.0, 0.0).pose);
        assert_eq!(blocks.carried().collect::<Vec<_>>(), [0, 3]);
        let turned = Pose::new(0.0, 0.0, 200.0, 90.0, 20.0);
        blocks.carry(&turned);
        let black = &blocks.all()[3];
        let above = blocks.all()[0].place();
        assert!((minus(black.place(), above)[1] - 40.0 * 20_f64.to_radians().sin() - 5.0).abs() < 15.0);
        assert_eq!(black.tilt, 20.0);
        blocks.carry(&Pose { tilt: 30.0, ..turned });
        assert_eq!(blocks.carried().collect::<Vec<_>>(), [0]);
        settle(&mut blocks);
        assert_eq!(blocks.all()[3].z, 20.0);
    }

    #[test]
    fn stairs_that_lean_too_far_come_down() {
        let step = |x| Block::new("step", [0; 3], x, 0.0, 0.0);
        let mut stairs = Blocks::new([step(0.0), step(15.0), step(30.0), step(45.0)]);
        assert!(!stairs.at_rest());
        settle(&mut stairs);
        let heights: Vec<f64> = stairs.all().iter().map(|block| block.z.round()).collect();
        assert!(
            heights[0] == 20.0 && heights.contains(&20.0) && heights[3] < 140.0,
            "{heights:?}"
        );
        for (index, block) in stairs.all().iter().enumerate() {
            for other in &stairs.all()[..index] {
                assert!(!block.solid().overlaps(&other.solid()), "{block:?} {other:?}");
            }
        }
    }

    #[test]
    fn what_leaves_the_table_ends_on_the_floor() {
        let mut blocks = Blocks::new([Block::new("red", [0; 3], 350.0, 0.0, 0.0)]);
        blocks.push(0, [330.0, 0.0], [1.0, 0.0], 24.0).unwrap();
        assert!(blocks.at_rest(), "its middle is above the table");
        blocks.push(0, [354.0, 0.0], [1.0, 0.0], 2.0).unwrap();
        settle(&mut blocks);
        let red = &blocks.all()[0];
        assert_eq!(red.z, FLOOR + 20.0);
        assert!(red.x > TABLE, "{red:?}");
    }
}
