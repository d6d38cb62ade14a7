//! Blocks that are pushed on the level, slowly: they stop when the hand does, and friction turns those that are pushed off their middle.

use crate::upright_box::{UprightBox, Xy, level_dot};

use super::Blocks;

/// The most blocks that push each other in a row.
const LONGEST_ROW: usize = 16;
/// The ratio of the largest torque of friction to the largest force, for a square that lies flat, in parts of its edge (the mean distance
/// of its points from its middle): how much a push off the middle turns a block.
const TURNING: f64 = 0.3826;

/// Something that cannot be pushed was in the way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stuck;

impl Blocks {
    /// Pushes a block by `depth` mm in a direction, at a point, with what lies on it; it pushes what it meets. After an error blocks may
    /// have moved.
    ///
    /// Under an isotropic limit surface a frictionless push moves the middle along the push, and turns the block by its moment; their sum
    /// at the point is the depth (Howe and Cutkosky, Practical Force-Motion Models for Sliding Manipulation, 1996).
    ///
    /// # Errors
    ///
    /// [`Stuck`] where a block that the hand carries is in the way, or too many blocks are.
    pub(crate) fn push(&mut self, index: usize, at: Xy, direction: Xy, depth: f64) -> Result<(), Stuck> {
        self.push_row(index, at, direction, depth, LONGEST_ROW)
    }

    fn push_row(
        &mut self,
        index: usize,
        at: Xy,
        direction: Xy,
        depth: f64,
        left: usize,
    ) -> Result<(), Stuck> {
        if left == 0 || self.is_carried(index) {
            return Err(Stuck);
        }
        let old = self.all[index].clone();
        let arm = [at[0] - old.x, at[1] - old.y];
        let moment = arm[0] * direction[1] - arm[1] * direction[0];
        let square = (TURNING * old.size).powi(2);
        let way = depth / (1.0 + moment * moment / square);
        let block = &mut self.all[index];
        block.x += way * direction[0];
        block.y += way * direction[1];
        block.yaw += (way * moment / square).to_degrees();
        self.follow(index, &old);
        self.push_neighbours(index, left)
    }

    /// Pushes what a block that has moved, and what lies on it, now overlap.
    fn push_neighbours(&mut self, index: usize, left: usize) -> Result<(), Stuck> {
        let mut moved = self.load_on(index);
        moved.push(index);
        for &mover in &moved {
            for other in 0..self.all.len() {
                if moved.contains(&other) {
                    continue;
                }
                let (solid, neighbour) = (self.all[mover].solid(), self.all[other].solid());
                if !solid.overlaps(&neighbour) {
                    continue;
                }
                let Some((direction, depth)) = solid.way_out(&neighbour) else {
                    continue;
                };
                let at = meeting_point(&solid, &neighbour);
                self.push_row(other, at, direction, depth, left - 1)?;
            }
        }
        Ok(())
    }

    /// A block that has come down pushes its neighbours away; where it cannot, it comes to lie on them.
    pub(super) fn make_room(&mut self, index: usize) {
        let before = self.clone();
        if self.push_neighbours(index, LONGEST_ROW).is_ok() {
            return;
        }
        *self = before;
        let solid = self.all[index].solid();
        let others = self.all.iter().enumerate().filter(|(other, _)| *other != index);
        let in_the_way = others
            .map(|(_, other)| other.solid())
            .filter(|other| other.overlaps(&solid));
        if let Some(top) = in_the_way.map(|other| other.top()).reduce(f64::max) {
            self.all[index].z = top + solid.half[2];
        }
    }
}

/// Where two boxes that overlap meet: the middle of those corners of each that are in the other, on the level.
pub(crate) fn meeting_point(one: &UprightBox, other: &UprightBox) -> Xy {
    let inside = |point: &Xy, solid: &UprightBox| {
        let offset = [point[0] - solid.centre[0], point[1] - solid.centre[1]];
        let level = solid.axes().into_iter().zip(solid.half);
        level
            .into_iter()
            .all(|(axis, half)| level_dot(offset, axis).abs() <= half)
    };
    let corners: Vec<Xy> = one
        .footprint()
        .into_iter()
        .filter(|corner| inside(corner, other))
        .chain(other.footprint().into_iter().filter(|corner| inside(corner, one)))
        .collect();
    match corners.len() {
        // Edge across edge: through the middle.
        0 => [other.centre[0], other.centre[1]],
        count => [0, 1].map(|k| corners.iter().map(|corner| corner[k]).sum::<f64>() / count as f64),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blocks::Block;

    fn blocks(places: &[(f64, f64)]) -> Blocks {
        Blocks::new(
            places
                .iter()
                .map(|(x, y)| Block::new("block", [0; 3], *x, *y, 0.0)),
        )
    }

    fn places(blocks: &Blocks) -> Vec<(f64, f64)> {
        let round = |mm: f64| (mm * 10.0).round() / 10.0;
        blocks
            .all()
            .iter()
            .map(|block| (round(block.x), round(block.y)))
            .collect()
    }

    #[test]
    fn a_push_at_the_middle_does_not_turn_and_one_beside_it_does() {
        let mut middle = blocks(&[(0.0, 0.0)]);
        middle.push(0, [-20.0, 0.0], [1.0, 0.0], 5.0).unwrap();
        assert_eq!((places(&middle), middle.all()[0].yaw), (vec![(5.0, 0.0)], 0.0));
        let mut beside = blocks(&[(0.0, 0.0)]);
        beside.push(0, [-20.0, 15.0], [1.0, 0.0], 1.0).unwrap();
        let Block { x, yaw, .. } = beside.all()[0];
        assert!(x > 0.4 && x < 0.6, "{x}");
        assert!(
            yaw < -1.0 && yaw > -3.0,
            "pushed on its left side it turns right: {yaw}"
        );
    }

    #[test]
    fn a_row_is_pushed_whole_and_takes_what_lies_on_it_along() {
        let mut row = blocks(&[(0.0, 0.0), (45.0, 0.0), (90.0, 0.0), (92.0, 3.0)]);
        assert_eq!(row.all()[3].z, 60.0);
        row.push(0, [-20.0, 0.0], [1.0, 0.0], 20.0).unwrap();
        assert_eq!(
            places(&row),
            [(20.0, 0.0), (60.0, 0.0), (100.0, 0.0), (102.0, 3.0)]
        );
    }

    #[test]
    fn a_carried_block_does_not_yield() {
        let mut blocks = blocks(&[(0.0, 0.0), (41.0, 0.0)]);
        blocks.grasp(1, &crate::pose::Pose::new(41.0, 0.0, 20.0, 0.0, 0.0));
        assert_eq!(blocks.push(0, [-20.0, 0.0], [1.0, 0.0], 10.0), Err(Stuck));
    }
}
