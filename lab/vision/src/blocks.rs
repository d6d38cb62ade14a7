//! Coloured blocks in an image: where their pixels are, and their rim to a part of a pixel.
//!
//! A side of a block that is turned from the light is darker, but its colour differs from grey in the same direction:
//! a pixel belongs to a block if that direction is near the block's, whatever its length. Lines and letters of
//! the same colour are too thin to be a block.

use crate::Picture;
use crate::mask::Mask;
use crate::outline::Outline;

/// A block to be looked for.
#[derive(Debug, Clone, PartialEq)]
pub struct Coloured {
    /// What it is called.
    pub name: String,
    /// Red, green and blue, in full light.
    pub colour: [u8; 3],
}

/// The pixels of one colour that may be a block.
///
/// Pixels are counted from the image's upper left corner; the middle of the first is (0.5, 0.5).
#[derive(Debug, Clone, PartialEq)]
pub struct Sighting {
    /// How many pixels there are.
    pub area: f64,
    /// Their mean.
    pub middle: [f64; 2],
    /// The least coordinates.
    pub low: [f64; 2],
    /// The greatest ones.
    pub high: [f64; 2],
    /// Variance along the image's x, along its y, and covariance, square pixels.
    pub moments: [f64; 3],
    /// Whether a part may be outside the image.
    pub at_border: bool,
    /// The outline, in no order.
    pub rim: Vec<RimPoint>,
    /// What is in the image there and nearby.
    pub(crate) around: Surroundings,
}

/// The labels of the pixels at a block and nearby.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Surroundings {
    /// The upper left pixel.
    corner: [usize; 2],
    /// Whether a pixel is grey, row by row.
    grey: Vec<Vec<bool>>,
}

impl Surroundings {
    /// The part of an outline's inside that is grey; what is outside the image is not, nor is the thin line where two
    /// colours mix.
    pub(crate) fn grey_within(&self, outline: &Outline) -> f64 {
        let (low, high) = outline.bounds();
        let mut grey = 0.0;
        // Beyond what is known, nothing is grey.
        let size = [self.grey.first().map_or(0, Vec::len), self.grey.len()];
        let pixels = |axis: usize| {
            let (start, end) = (self.corner[axis], self.corner[axis] + size[axis]);
            let within = |place: f64| (place.max(0.0) as usize).clamp(start, end);
            within(low[axis].floor())..within(high[axis].ceil())
        };
        for y in pixels(1) {
            for x in pixels(0) {
                // Pixels at the rim are of both colours.
                if outline.distance([x as f64 + 0.5, y as f64 + 0.5]) < -1.0 {
                    let mut near = (0..9).map(|i| ((x + i % 3).checked_sub(1), (y + i / 3).checked_sub(1)));
                    let all = near.all(|near| matches!(near, (Some(x), Some(y)) if self.is_grey(x, y)));
                    grey += f64::from(u8::from(all));
                }
            }
        }
        grey / outline.area(-1.0).max(1.0)
    }

    fn is_grey(&self, x: usize, y: usize) -> bool {
        let row = y.checked_sub(self.corner[1]).and_then(|row| self.grey.get(row));
        let cell = row.and_then(|row| row.get(x.checked_sub(self.corner[0])?));
        cell.copied().unwrap_or(false)
    }
}

/// A point of the outline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RimPoint {
    /// Where half a pixel's colour is the block's, pixels.
    pub at: [f64; 2],
    /// Whether the block itself may go on behind what is there: another colour, or the image's border.
    pub covered: bool,
}

/// The least share of a block's chroma that a pixel needs: the darkest side has more than half.
const SHARE: f64 = 0.3;
/// Cosine of the greatest angle between a pixel's direction from grey and its block's: 16 degrees.
const HUE: f64 = 0.961;
/// The same of two blocks' colours that cannot be told apart: 32 degrees.
const ALIKE: f64 = 0.848;
/// Colours nearer to grey than this are none, of 255.
const GREY: f64 = 30.0;
/// Half the width that a block has everywhere, pixels: thinner things of its colour are none.
const THICK: usize = 2;
/// How far around its thick parts a block goes on, pixels: a little further than its corners were cut.
const REGAINED: usize = THICK + 1;
/// A piece with less than this part of the largest is not a part of the block.
const PIECE: f64 = 0.2;

/// Finds each of these colours, in their order; `None` for what is not seen.
///
/// A block that something thin divides is one sighting. Colours of nearly the same hue cannot be told from each
/// other: what is as near to two of them goes to the first. A colour without a hue is never found.
///
/// ```
/// use mom_vision::Picture;
/// use mom_vision::blocks::{Coloured, find};
///
/// let pixels = (0..40 * 30).map(|i| match (i % 40, i / 40) {
///     (10..20, 8..18) => [160, 32, 32],
///     _ => [230, 230, 230],
/// });
/// let picture = Picture { width: 40, height: 30, pixels: pixels.collect() };
/// let wanted = [("red", [200, 40, 40]), ("blue", [40, 80, 190])]
///     .map(|(name, colour)| Coloured { name: name.to_owned(), colour });
/// let [red, blue] = &find(&picture, &wanted)[..] else { panic!() };
/// assert_eq!(red.as_ref().unwrap().middle, [15.0, 13.0]);
/// assert!(blue.is_none());
/// ```
#[must_use]
pub fn find(picture: &Picture, colours: &[Coloured]) -> Vec<Option<Sighting>> {
    let tints: Vec<Tint> = colours.iter().map(|wanted| Tint::of(wanted.colour)).collect();
    let labels = Labels::of(picture, &tints);
    let indices = 0..tints.len();
    indices
        .map(|index| labels.block(index).and_then(|pixels| labels.measure(&pixels)))
        .collect()
}

impl Coloured {
    /// Whether it can be told from grey things.
    #[must_use]
    pub fn has_hue(&self) -> bool {
        Tint::of(self.colour).chroma >= GREY
    }

    /// Whether the two have hues so near that one may be taken for the other.
    #[must_use]
    pub fn is_like(&self, other: &Coloured) -> bool {
        let (a, b) = (Tint::of(self.colour), Tint::of(other.colour));
        a.dot(&b) > ALIKE * a.chroma * b.chroma
    }
}

/// What a colour has beyond grey.
#[derive(Debug, Clone, Copy)]
struct Tint {
    parts: [f64; 3],
    /// Its length.
    chroma: f64,
}

impl Tint {
    fn of(colour: [u8; 3]) -> Tint {
        let colour = colour.map(f64::from);
        let grey = colour.iter().sum::<f64>() / 3.0;
        let parts = colour.map(|part| part - grey);
        let chroma = parts.iter().map(|part| part * part).sum::<f64>().sqrt();
        Tint { parts, chroma }
    }

    fn dot(&self, other: &Tint) -> f64 {
        self.parts.iter().zip(other.parts).map(|(a, b)| a * b).sum()
    }
}

/// Which colour each pixel has, if any.
struct Labels<'a> {
    picture: &'a Picture,
    tints: &'a [Tint],
    labels: Vec<Label>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Label {
    Grey,
    /// A colour that nobody looks for.
    Other,
    Block(usize),
}

impl Labels<'_> {
    fn of<'a>(picture: &'a Picture, tints: &'a [Tint]) -> Labels<'a> {
        let label = |pixel: &[u8; 3]| {
            let (low, high) = (pixel.iter().min(), pixel.iter().max());
            // Most pixels are grey, and this is the cheap way to see it.
            if high
                .zip(low)
                .is_none_or(|(high, low)| high - low < (GREY * 0.8) as u8)
            {
                return Label::Grey;
            }
            nearest(&Tint::of(*pixel), tints)
        };
        Labels {
            picture,
            tints,
            labels: picture.pixels.iter().map(label).collect(),
        }
    }

    /// The pixels of a block, in their order.
    fn block(&self, index: usize) -> Option<Vec<usize>> {
        let own = Label::Block(index);
        let width = self.picture.width;
        let ([left, top], size) = self.box_of(own)?;
        let coloured = Mask::new(size, |x, y| self.labels[(top + y) * width + left + x] == own);
        let whole = coloured.shrunk(THICK).grown(REGAINED).and(&coloured);
        let mut pieces: Vec<Vec<usize>> = whole
            .pieces()
            .into_iter()
            .map(|piece| piece.iter().map(|[x, y]| (top + y) * width + left + x).collect())
            .collect();
        pieces.sort_by_key(|piece| std::cmp::Reverse(piece.len()));
        let largest = pieces.first()?.len() as f64;
        let reach = 2.0 * largest.sqrt();
        let (low, high) = self.bounds(&pieces[0]);
        let belongs = |piece: &&Vec<usize>| {
            let (other_low, other_high) = self.bounds(piece);
            let gap = |axis: usize| (other_low[axis] - high[axis]).max(low[axis] - other_high[axis]);
            piece.len() as f64 >= PIECE * largest && gap(0).max(gap(1)) < reach
        };
        let mut pixels: Vec<usize> = pieces.iter().filter(belongs).flatten().copied().collect();
        pixels.sort_unstable();
        Some(pixels)
    }

    /// The upper left pixel and the size of the part of the image that has a label, with room for what is around it.
    fn box_of(&self, label: Label) -> Option<([usize; 2], [usize; 2])> {
        let (width, height) = (self.picture.width, self.picture.height);
        let mut ends: Option<[(usize, usize); 2]> = None;
        for (pixel, _) in self
            .labels
            .iter()
            .enumerate()
            .filter(|(_, other)| **other == label)
        {
            let place = [pixel % width, pixel / width];
            let known = ends.get_or_insert(place.map(|at| (at, at)));
            for (end, at) in known.iter_mut().zip(place) {
                *end = (end.0.min(at), end.1.max(at));
            }
        }
        let [(left, right), (top, bottom)] = ends?;
        let (left, top) = (left.saturating_sub(REGAINED), top.saturating_sub(REGAINED));
        let (right, bottom) = (
            (right + REGAINED + 1).min(width),
            (bottom + REGAINED + 1).min(height),
        );
        Some(([left, top], [right - left, bottom - top]))
    }

    fn bounds(&self, pixels: &[usize]) -> ([f64; 2], [f64; 2]) {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for &pixel in pixels {
            for (axis, place) in self.middle_of(pixel).into_iter().enumerate() {
                low[axis] = low[axis].min(place - 0.5);
                high[axis] = high[axis].max(place + 0.5);
            }
        }
        (low, high)
    }

    fn middle_of(&self, pixel: usize) -> [f64; 2] {
        let width = self.picture.width;
        [(pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5]
    }

    fn measure(&self, pixels: &[usize]) -> Option<Sighting> {
        let Label::Block(index) = self.labels[*pixels.first()?] else {
            return None;
        };
        let area = pixels.len() as f64;
        let mean = |of: &dyn Fn([f64; 2]) -> f64| {
            pixels.iter().map(|&pixel| of(self.middle_of(pixel))).sum::<f64>() / area
        };
        let middle @ [x, y] = [mean(&|[x, _]| x), mean(&|[_, y]| y)];
        // A pixel is not a point but a square, which adds its own variance.
        let square = 1.0 / 12.0;
        let moments = [
            mean(&|[u, _]| (u - x).powi(2)) + square,
            mean(&|[_, v]| (v - y).powi(2)) + square,
            mean(&|[u, v]| (u - x) * (v - y)),
        ];
        let (low, high) = self.bounds(pixels);
        let size = [self.picture.width as f64, self.picture.height as f64];
        Some(Sighting {
            area,
            middle,
            low,
            high,
            moments,
            at_border: (0..2).any(|axis| low[axis] < 2.0 || high[axis] > size[axis] - 2.0),
            rim: self.rim(pixels, index),
            around: self.surroundings(low, high),
        })
    }

    fn surroundings(&self, low: [f64; 2], high: [f64; 2]) -> Surroundings {
        let size = [self.picture.width, self.picture.height];
        let margin = (high[0] - low[0]).max(high[1] - low[1]);
        let ends = [0, 1].map(|axis| {
            let end = (high[axis] + margin) as usize;
            ((low[axis] - margin).max(0.0) as usize, end.min(size[axis]))
        });
        let row = |y: usize| {
            let labels = &self.labels[y * size[0] + ends[0].0..y * size[0] + ends[0].1];
            labels.iter().map(|&label| label == Label::Grey).collect()
        };
        Surroundings {
            corner: ends.map(|(start, _)| start),
            grey: (ends[1].0..ends[1].1).map(row).collect(),
        }
    }

    fn rim(&self, pixels: &[usize], index: usize) -> Vec<RimPoint> {
        let mut rim = Vec::new();
        let mut inside = vec![false; self.labels.len()];
        for &pixel in pixels {
            inside[pixel] = true;
        }
        for &pixel in pixels {
            for way in [[1, 0], [-1, 0], [0, 1], [0, -1]] {
                let beyond = self.step(pixel, way, 1);
                if beyond.is_some_and(|beyond| inside[beyond]) {
                    continue;
                }
                rim.push(self.rim_point(pixel, way, index));
            }
        }
        rim
    }

    /// The pixel so many steps away, unless that is outside.
    fn step(&self, pixel: usize, way: [isize; 2], steps: isize) -> Option<usize> {
        let (width, height) = (self.picture.width, self.picture.height);
        let x = (pixel % width).checked_add_signed(way[0] * steps)?;
        let y = (pixel / width).checked_add_signed(way[1] * steps)?;
        (x < width && y < height).then_some(y * width + x)
    }

    /// Where, from two pixels inside to two beyond, the share of the colour falls below the mean of both ends.
    fn rim_point(&self, pixel: usize, way: [isize; 2], index: usize) -> RimPoint {
        let [x, y] = self.middle_of(pixel);
        let at = |steps: f64| [x + way[0] as f64 * steps, y + way[1] as f64 * steps];
        let own = Label::Block(index);
        let steps = [-2, -1, 0, 1, 2].map(|steps| self.step(pixel, way, steps));
        let [Some(_), Some(_), Some(_), Some(_), Some(last)] = steps else {
            return RimPoint {
                at: at(0.5),
                covered: true,
            };
        };
        let shares = steps.map(|pixel| pixel.map_or(0.0, |pixel| self.share(pixel, index)));
        let level = (shares[0].max(shares[1]) + shares[4]) / 2.0;
        let crossing = (1..4).find_map(|i| {
            let (before, after) = (shares[i], shares[i + 1]);
            (before >= level && after < level)
                .then(|| (i as f64 - 2.0) + (before - level) / (before - after).max(1e-9))
        });
        // What is beyond, as far as the colours of an image run into each other.
        let ends = [Some(last), self.step(pixel, way, 3)];
        let is_coloured = |end: &Option<usize>| {
            end.is_none_or(|end| !matches!(self.labels[end], Label::Grey) && self.labels[end] != own)
        };
        RimPoint {
            at: at(crossing.unwrap_or(0.5).clamp(-1.0, 1.5)),
            covered: ends.iter().any(is_coloured),
        }
    }

    /// How much of a block's colour a pixel has, 0 to about 1; linear, so that mixing colours mixes their shares.
    fn share(&self, pixel: usize, index: usize) -> f64 {
        let tint = &self.tints[index];
        Tint::of(self.picture.pixels[pixel]).dot(tint) / tint.chroma.powi(2).max(1.0)
    }
}

/// The block whose colour is nearest.
fn nearest(pixel: &Tint, tints: &[Tint]) -> Label {
    if pixel.chroma < GREY {
        return Label::Grey;
    }
    let mut best = (HUE, Label::Other);
    for (index, tint) in tints.iter().enumerate() {
        if tint.chroma < GREY {
            continue;
        }
        let along = pixel.dot(tint) / tint.chroma;
        let cosine = along / pixel.chroma;
        if cosine > best.0 && along >= SHARE * tint.chroma {
            best = (cosine, Label::Block(index));
        }
    }
    best.1
}
