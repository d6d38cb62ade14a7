//! The wooden blocks: on the table, on each other, or in the jaws, and never in two places.
//!
//! The model is simple, and says where. A block lies flat where it falls and does not topple, even
//! if only an edge of it is supported. Closing jaws square the block they take: its faces turn
//! parallel to them and its middle comes between them.

use serde::{Deserialize, Serialize};

use crate::motion::Posture;
use crate::pose::{Pose, along, dot, minus};
use crate::upright_box::{GIVE, UprightBox};

/// mm of a standard block's edges.
pub const BLOCK_SIZE: f64 = 40.0;
/// mm across the jaw line by which a block may lie off the fingertips and still be taken.
pub const GRASP_ACROSS: f64 = 12.0;
/// mm along the fingers by which a block's middle may lie off the fingertips and still be taken.
pub const GRASP_ALONG: f64 = 15.0;

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
    /// Degrees about its own first level axis; 0 unless it is carried.
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

    fn put(&mut self, [x, y, z]: [f64; 3]) {
        (self.x, self.y, self.z) = (x, y, z);
    }
}

/// All blocks, and which of them the jaws hold.
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
    held: Option<Grasp>,
}

/// How a block lies in the jaws; it keeps this while it is carried.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Grasp {
    index: usize,
    /// mm from the fingertips, across the jaw line.
    across: f64,
    /// mm from the fingertips, the way the fingers point.
    along: f64,
    /// The hand's tilt when it took the block.
    tilt: f64,
}

impl Blocks {
    /// Blocks put down one after the other: each lies on the table or on those before it.
    #[must_use]
    pub fn new(blocks: impl IntoIterator<Item = Block>) -> Self {
        let mut all: Vec<Block> = Vec::new();
        for mut block in blocks {
            block.tilt = 0.0;
            block.z = support(&block, &all) + block.size / 2.0;
            all.push(block);
        }
        Self { all, held: None }
    }

    /// Every block, always in the same order.
    #[must_use]
    pub fn all(&self) -> &[Block] {
        &self.all
    }

    /// The block in the jaws.
    #[must_use]
    pub fn held(&self) -> Option<&Block> {
        self.held.map(|held| &self.all[held.index])
    }

    /// The place in [`Blocks::all`] of the block in the jaws.
    #[must_use]
    pub fn held_index(&self) -> Option<usize> {
        self.held.map(|held| held.index)
    }

    /// The block that the jaws would take if they closed here: it lies between them, near enough to
    /// the fingertips, and nothing is in its way when the jaws square it.
    #[must_use]
    pub fn within_jaws(&self, posture: &Posture) -> Option<usize> {
        let (tip, frame) = (posture.pose.position(), posture.pose.frame());
        let takes = |block: &Block| {
            let offset = minus([block.x, block.y, block.z], tip);
            let (sin, cos) = (block.yaw - posture.pose.spin).to_radians().sin_cos();
            let width = block.size * (sin.abs() + cos.abs());
            dot(offset, frame.jaw).abs() + width / 2.0 <= posture.opening / 2.0
                && dot(offset, frame.across).abs() <= GRASP_ACROSS
                && dot(offset, frame.approach).abs() <= GRASP_ALONG
        };
        (0..self.all.len()).find(|&index| {
            let block = &self.all[index];
            takes(block) && self.is_free(index, &squared(block, &posture.pose).solid())
        })
    }

    /// The jaws close on a block and hold it.
    pub(crate) fn grasp(&mut self, index: usize, pose: &Pose) {
        let block = squared(&self.all[index], pose);
        let offset = minus([block.x, block.y, block.z], pose.position());
        let frame = pose.frame();
        let (across, along) = (dot(offset, frame.across), dot(offset, frame.approach));
        self.all[index] = block;
        self.held = Some(Grasp {
            index,
            across,
            along,
            tilt: pose.tilt,
        });
        self.settle();
    }

    /// The held block goes where the hand goes.
    pub(crate) fn carry(&mut self, pose: &Pose) {
        if let (Some(held), Some(block)) = (self.held, self.held_at(pose)) {
            self.all[held.index] = block;
        }
    }

    /// The jaws open: what they held falls straight down, onto the table or onto the blocks below.
    pub(crate) fn release(&mut self) {
        if let Some(held) = self.held.take() {
            self.all[held.index].tilt = 0.0;
            self.settle();
        }
    }

    /// The held block as it would be with the hand in this pose.
    pub(crate) fn held_at(&self, pose: &Pose) -> Option<Block> {
        let held = self.held?;
        let frame = pose.frame();
        let mut block = self.all[held.index].clone();
        block.put(along(
            along(pose.position(), frame.across, held.across),
            frame.approach,
            held.along,
        ));
        block.yaw = pose.spin;
        block.tilt = pose.tilt - held.tilt;
        Some(block)
    }

    /// A block that lies on the held one.
    pub(crate) fn rider(&self) -> Option<&Block> {
        let held = self.held?.index;
        let below = self.all[held].solid();
        self.all.iter().enumerate().find_map(|(index, block)| {
            let solid = block.solid();
            let lies_on = (solid.bottom() - below.top()).abs() <= GIVE && solid.overlaps_level(&below);
            (index != held && lies_on).then_some(block)
        })
    }

    /// Whether the place is free of all blocks but one.
    fn is_free(&self, except: usize, place: &UprightBox) -> bool {
        let others = self.all.iter().enumerate().filter(|(index, _)| *index != except);
        others
            .into_iter()
            .all(|(_, other)| !other.solid().overlaps(place))
    }

    /// Lets every block that nothing holds fall as far as it can, the lowest first.
    fn settle(&mut self) {
        let mut order: Vec<usize> = (0..self.all.len()).collect();
        order.sort_by(|a, b| self.all[*a].z.total_cmp(&self.all[*b].z));
        let mut settled: Vec<Block> = Vec::with_capacity(order.len());
        for index in order {
            let block = &mut self.all[index];
            if Some(index) != self.held.map(|held| held.index) {
                block.z = support(block, &settled) + block.size / 2.0;
            }
            settled.push(block.clone());
        }
    }
}

/// The height of what a block would come to lie on.
fn support(block: &Block, below: &[Block]) -> f64 {
    let solid = block.solid();
    let under = below
        .iter()
        .map(Block::solid)
        .filter(|other| other.overlaps_level(&solid));
    under.map(|other| other.top()).fold(0.0, f64::max)
}

/// The block as the closing jaws would turn and shift it.
fn squared(block: &Block, pose: &Pose) -> Block {
    let jaw = pose.frame().jaw;
    let place = [block.x, block.y, block.z];
    let aside = dot(minus(place, pose.position()), jaw);
    let mut block = Block {
        yaw: pose.spin,
        ..block.clone()
    };
    block.put(along(place, jaw, -aside));
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

    #[test]
    fn a_block_that_loses_its_support_falls() {
        let mut blocks = lab_with(Some(Block::new("black", [0; 3], -188.0, 100.0, 0.0)));
        assert_eq!(blocks.all()[3].z, 60.0);
        blocks.grasp(0, &over_red(10.0, 0.0, 20.0, 0.0).pose);
        assert_eq!((blocks.all()[3].z, blocks.rider()), (20.0, None));
    }

    #[test]
    fn a_released_block_falls_flat_on_what_is_below() {
        for (pose, z) in [
            (Pose::new(0.0, 0.0, 300.0, 30.0, 20.0), 20.0),
            (Pose::new(150.0, 100.0, 300.0, 10.0, 0.0), 60.0),
            // Only an edge of it is over the blue one.
            (Pose::new(188.0, 100.0, 300.0, 0.0, 0.0), 60.0),
            (Pose::new(190.0, 100.0, 300.0, 0.0, 0.0), 20.0),
        ] {
            let mut blocks = lab_with(None);
            blocks.grasp(0, &over_red(0.0, 0.0, 20.0, 0.0).pose);
            blocks.carry(&pose);
            assert_eq!(blocks.rider(), None);
            blocks.release();
            let red = &blocks.all()[0];
            assert_eq!((red.x, red.y, red.tilt), (pose.x, pose.y, 0.0));
            assert_eq!((red.z, blocks.held()), (z, None), "{pose:?}");
        }
    }

    #[test]
    fn a_block_on_the_held_one_is_its_rider() {
        let mut blocks = lab_with(Some(Block::new("black", [0; 3], -140.0, 100.0, 0.0)));
        assert_eq!(blocks.all()[3].z, 60.0);
        blocks.grasp(0, &over_red(0.0, 0.0, 20.0, 0.0).pose);
        assert_eq!(blocks.rider().map(|block| block.name.as_str()), Some("black"));
    }
}
