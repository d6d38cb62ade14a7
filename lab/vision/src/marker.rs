//! The marker in an image: the middle of its spot, to a small part of a pixel.
//!
//! A pixel at the rim is partly the marker's and partly that of what is behind. Its share is its weight, and the weighted
//! middle of all pixels is that of the spot itself, as far as the image keeps colours: a lossless one does.

use crate::Picture;

/// Where the middle of the lab's marker is in the gripper's frame, mm: along the jaw line, across it, and from the tip
/// towards the wrist.
pub const MARKER: [f64; 3] = [0.0, -140.0, 75.0];
/// The radius of the lab's marker, a ball, mm.
pub const RADIUS: f64 = 12.0;
/// The colour of the lab's marker: red, green and blue.
pub const COLOUR: [u8; 3] = [255, 0, 255];

/// The spot of the marker.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spot {
    /// Its middle, pixels from the image's upper left corner; the middle of the first pixel is (0.5, 0.5).
    pub middle: [f64; 2],
    /// How many pixels it covers.
    pub area: f64,
}

/// Why an image is not used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MarkerError {
    /// Nothing of its colour, or too little.
    #[error("not seen")]
    NotSeen,
    /// A part of it may be outside the image.
    #[error("cut by the image's border")]
    AtBorder,
    /// Which one is it?
    #[error("{0} spots of its colour")]
    Several(usize),
    /// The spot has no shape of a ball's picture.
    #[error("partly hidden")]
    Hidden,
}

/// A share of the colour above which a pixel is the marker's beyond doubt.
const CORE: f64 = 0.5;
/// Fewer pixels are no marker.
const LEAST: usize = 9;
/// A spot with less than this part of the largest is a reflection or a speck.
const SPECK: f64 = 0.2;
/// How far the core is from the border at least, pixels: its rim, and what is looked at beside that.
const ROOM: usize = 4;
/// The least variance across over that along: that of a ball's picture 25 degrees beside the middle is 0.82.
const ROUND: f64 = 0.8;
/// How much of an ellipse with the same variances the spot fills: a whole one 1, half of one 0.95.
const FULL: std::ops::RangeInclusive<f64> = 0.965..=1.035;

/// Finds a marker of this colour.
///
/// # Errors
///
/// [`MarkerError`] if it is not seen whole, or not alone.
pub fn find(picture: &Picture, colour: [u8; 3]) -> Result<Spot, MarkerError> {
    let shares = Shares::of(picture, colour);
    let mut spots = shares.spots();
    spots.retain(|spot| spot.pixels >= LEAST);
    let largest = spots
        .iter()
        .map(|spot| spot.pixels)
        .max()
        .ok_or(MarkerError::NotSeen)?;
    spots.retain(|spot| spot.pixels as f64 >= SPECK * largest as f64);
    match spots[..] {
        [core] => shares.measure(&core),
        _ => Err(MarkerError::Several(spots.len())),
    }
}

/// How much of the marker's colour each pixel has: 0 to about 1.
struct Shares<'a> {
    picture: &'a Picture,
    colour: [f64; 3],
    width: usize,
    height: usize,
    shares: Vec<f64>,
}

/// A connected set of pixels: the rectangle around it, ends included.
#[derive(Debug, Clone, Copy)]
struct Core {
    pixels: usize,
    low: [usize; 2],
    high: [usize; 2],
}

impl Shares<'_> {
    /// The share is linear in the colour, so that mixing two colours mixes their shares: the part along the
    /// marker's colour of what differs from grey.
    fn of(picture: &Picture, colour: [u8; 3]) -> Shares<'_> {
        let hue = tint(colour);
        let square: f64 = hue.iter().map(|part| part * part).sum();
        let share = |pixel: &[u8; 3]| {
            let parts = tint(*pixel);
            parts.iter().zip(hue).map(|(a, b)| a * b).sum::<f64>() / square.max(1.0)
        };
        Shares {
            picture,
            colour: hue,
            width: picture.width,
            height: picture.height,
            shares: picture.pixels.iter().map(share).collect(),
        }
    }

    fn at(&self, x: usize, y: usize) -> f64 {
        self.shares[y * self.width + x]
    }

    /// The connected sets of pixels with the colour, corners included.
    fn spots(&self) -> Vec<Core> {
        let mut seen = vec![false; self.shares.len()];
        let mut spots = Vec::new();
        for start in 0..self.shares.len() {
            if seen[start] || self.shares[start] < CORE {
                continue;
            }
            seen[start] = true;
            let mut core = Core {
                pixels: 0,
                low: [usize::MAX; 2],
                high: [0; 2],
            };
            let mut reached = vec![start];
            while let Some(pixel) = reached.pop() {
                let at = [pixel % self.width, pixel / self.width];
                core.pixels += 1;
                for (axis, place) in at.into_iter().enumerate() {
                    core.low[axis] = core.low[axis].min(place);
                    core.high[axis] = core.high[axis].max(place);
                }
                for y in at[1].saturating_sub(1)..=(at[1] + 1).min(self.height - 1) {
                    for x in at[0].saturating_sub(1)..=(at[0] + 1).min(self.width - 1) {
                        let next = y * self.width + x;
                        if !seen[next] && self.shares[next] >= CORE {
                            seen[next] = true;
                            reached.push(next);
                        }
                    }
                }
            }
            spots.push(core);
        }
        spots
    }

    fn measure(&self, core: &Core) -> Result<Spot, MarkerError> {
        let size = [self.width, self.height];
        if (0..2).any(|axis| core.low[axis] < ROOM || core.high[axis] + ROOM >= size[axis]) {
            return Err(MarkerError::AtBorder);
        }
        let mut moments = Moments::default();
        for y in core.low[1] - 1..=core.high[1] + 1 {
            for x in core.low[0] - 1..=core.high[0] + 1 {
                if self.is_spot(x, y) {
                    moments.add(x as f64 + 0.5, y as f64 + 0.5, self.weight(x, y));
                }
            }
        }
        moments.spot()
    }

    /// Whether a pixel is in the core or beside it, where the rim is.
    fn is_spot(&self, x: usize, y: usize) -> bool {
        around(x, y, 1).any(|(x, y)| self.at(x, y) >= CORE)
    }

    /// How much of a pixel the marker covers: how far its colour is on the way from what is behind, which is the mean of
    /// what is near, to the marker's. Grey is left out of all, so that light and dark behind the rim are one.
    fn weight(&self, x: usize, y: usize) -> f64 {
        let near = around(x, y, 2).filter(|&(x, y)| !self.is_spot(x, y));
        let (sum, count) = near.fold(([0.0; 3], 0.0), |(sum, count), (x, y)| {
            let colour = self.colour_at(x, y);
            (std::array::from_fn(|i| sum[i] + colour[i]), count + 1.0)
        });
        if count == 0.0 {
            return 1.0;
        }
        let behind = sum.map(|part| part / count);
        let away = |colour: [f64; 3]| std::array::from_fn::<f64, 3, _>(|i| colour[i] - behind[i]);
        let (way, own) = (away(self.colour), away(self.colour_at(x, y)));
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        (dot(own, way) / dot(way, way).max(1.0)).clamp(0.0, 1.0)
    }

    fn colour_at(&self, x: usize, y: usize) -> [f64; 3] {
        tint(self.picture.pixels[y * self.width + x])
    }
}

/// The pixels at most so far away; they exist, since a spot near the border is left out.
fn around(x: usize, y: usize, far: usize) -> impl Iterator<Item = (usize, usize)> {
    (y - far..=y + far).flat_map(move |y| (x - far..=x + far).map(move |x| (x, y)))
}

/// What a pixel's colour has beyond grey.
fn tint(colour: [u8; 3]) -> [f64; 3] {
    let colour = colour.map(f64::from);
    let grey = colour.iter().sum::<f64>() / 3.0;
    colour.map(|part| part - grey)
}

#[derive(Default)]
struct Moments {
    weight: f64,
    sum: [f64; 2],
    squares: [f64; 3],
}

impl Moments {
    fn add(&mut self, x: f64, y: f64, weight: f64) {
        self.weight += weight;
        for (sum, number) in self.sum.iter_mut().zip([x, y]) {
            *sum += weight * number;
        }
        for (sum, number) in self.squares.iter_mut().zip([x * x, y * y, x * y]) {
            *sum += weight * number;
        }
    }

    fn spot(&self) -> Result<Spot, MarkerError> {
        let middle @ [x, y] = self.sum.map(|sum| sum / self.weight);
        // A pixel is not a point but a square, which adds its own variance.
        let square = 1.0 / 12.0;
        let variance = |index: usize, product: f64| self.squares[index] / self.weight - product;
        let (xx, yy, xy) = (
            variance(0, x * x) - square,
            variance(1, y * y) - square,
            variance(2, x * y),
        );
        let (mean, half) = ((xx + yy) / 2.0, ((xx - yy) / 2.0).hypot(xy));
        let (across, along) = (mean - half, mean + half);
        let ellipse = 4.0 * std::f64::consts::PI * (across * along).max(0.0).sqrt();
        if across < ROUND * along || !FULL.contains(&(self.weight / ellipse)) {
            return Err(MarkerError::Hidden);
        }
        Ok(Spot {
            middle,
            area: self.weight,
        })
    }
}
