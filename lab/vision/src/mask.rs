//! Which pixels of a rectangle belong to something. Everything here costs so much for each pixel, whatever lies there.

/// The pixels, row by row.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Mask {
    width: usize,
    height: usize,
    cells: Vec<bool>,
}

impl Mask {
    /// A rectangle with the pixels of which this is true, by their column and row.
    pub(crate) fn new([width, height]: [usize; 2], is_in: impl Fn(usize, usize) -> bool) -> Mask {
        let rows = 0..height;
        Mask {
            width,
            height,
            cells: rows
                .flat_map(|y| (0..width).map(move |x| (x, y)))
                .map(|(x, y)| is_in(x, y))
                .collect(),
        }
    }

    /// The pixels at most so far from one of these, along both axes.
    pub(crate) fn grown(&self, far: usize) -> Mask {
        let (width, height) = (self.width, self.height);
        let (mut along, mut both) = (self.cells.clone(), self.cells.clone());
        for y in 0..height {
            let row = (0..width).map(|x| y * width + x);
            mark(&self.cells, &mut along, row.clone(), far);
            mark(&self.cells, &mut along, row.rev(), far);
        }
        for x in 0..width {
            let column = (0..height).map(|y| y * width + x);
            mark(&along, &mut both, column.clone(), far);
            mark(&along, &mut both, column.rev(), far);
        }
        Mask { cells: both, ..*self }
    }

    /// The pixels that are further than so far from all others; what is outside does not count.
    pub(crate) fn shrunk(&self, far: usize) -> Mask {
        self.inverse().grown(far).inverse()
    }

    /// The pixels that both have; they are of the same size.
    pub(crate) fn and(&self, other: &Mask) -> Mask {
        let pairs = self.cells.iter().zip(&other.cells);
        Mask {
            cells: pairs.map(|(a, b)| *a && *b).collect(),
            ..*self
        }
    }

    fn inverse(&self) -> Mask {
        Mask {
            cells: self.cells.iter().map(|cell| !cell).collect(),
            ..*self
        }
    }

    /// The connected parts, by the columns and rows of their pixels. Those that touch at a corner are one.
    pub(crate) fn pieces(mut self) -> Vec<Vec<[usize; 2]>> {
        let mut pieces = Vec::new();
        for start in 0..self.cells.len() {
            if !std::mem::take(&mut self.cells[start]) {
                continue;
            }
            let mut piece = vec![[start % self.width, start / self.width]];
            let mut next = 0;
            while let Some(&[x, y]) = piece.get(next) {
                next += 1;
                for near_y in y.saturating_sub(1)..=(y + 1).min(self.height - 1) {
                    for near_x in x.saturating_sub(1)..=(x + 1).min(self.width - 1) {
                        if std::mem::take(&mut self.cells[near_y * self.width + near_x]) {
                            piece.push([near_x, near_y]);
                        }
                    }
                }
            }
            pieces.push(piece);
        }
        pieces
    }
}

/// Marks what is at most so far behind a pixel on a line.
fn mark(from: &[bool], to: &mut [bool], line: impl Iterator<Item = usize>, far: usize) {
    let mut left = 0;
    for pixel in line {
        if from[pixel] {
            left = far + 1;
        }
        if left > 0 {
            to[pixel] = true;
            left -= 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(rows: &[&str]) -> Mask {
        Mask::new([rows[0].len(), rows.len()], |x, y| rows[y].as_bytes()[x] == b'#')
    }

    #[test]
    fn grown_and_shrunk() {
        let thing = mask(&["......", ".###..", ".###..", ".###.#", "......"]);
        assert_eq!(
            thing.shrunk(1),
            mask(&["......", "......", "..#...", "......", "......"])
        );
        assert_eq!(
            mask(&["......", "......", "#....."]).grown(2),
            mask(&["###...", "###...", "###..."])
        );
        // It may go on where the rectangle ends.
        assert_eq!(mask(&["###", "###"]).shrunk(2), mask(&["###", "###"]));
    }

    #[test]
    fn pieces_are_connected_at_corners_too() {
        let pieces = mask(&["##...", "..#.#", "....#"]).pieces();
        assert_eq!(pieces, [vec![[0, 0], [1, 0], [2, 1]], vec![[4, 1], [4, 2]]]);
        assert!(Mask::new([0, 0], |_, _| true).pieces().is_empty());
    }
}
