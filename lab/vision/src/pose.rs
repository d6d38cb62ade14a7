//! Where a block lies, from its outline in images of calibrated cameras.
//!
//! The outline of a cube is the convex hull of its eight projected corners. Place and turn are those for which the
//! points of the seen outlines are nearest to the predicted ones (Levenberg and Marquardt). Points at which
//! another thing hides the block do not count, and those that are far from the prediction count less and less, so
//! that a block that is partly hidden is still found by what is seen of it.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::Projection;
use crate::blocks::Sighting;
use crate::outline::{Outline, hull};

/// One camera's image of a block.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// From mm on the table to pixels of that image.
    pub projection: &'a Projection,
    /// What is seen there.
    pub sighting: &'a Sighting,
}

/// A block that lies flat.
#[derive(Debug, Clone, PartialEq)]
pub struct BlockPose {
    /// Its middle, mm.
    pub place: [f64; 3],
    /// About the vertical, degrees from 0 to 90, counter-clockwise seen from above: a cube has no front.
    pub yaw: f64,
    /// The standard deviation of its place, mm, as far as the outlines tell.
    pub error: f64,
    /// The same of its turn, degrees.
    pub yaw_error: f64,
    /// The root of the mean square distance between seen and predicted outlines, pixels.
    pub rms: f64,
    /// Of each view, the part of the block that is seen, 0 to about 1; 0 too for one that disagrees with the others.
    pub seen: Vec<f64>,
}

impl BlockPose {
    /// Whether a part of it is hidden in each of the views.
    #[must_use]
    pub fn is_partly_hidden(&self) -> bool {
        self.seen.iter().all(|&part| part < WHOLE)
    }
}

/// Why views give no pose.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum PoseError {
    /// No views, or lines of sight that do not meet in front of the cameras.
    NoPlace,
    /// Too little of the outline is seen to say where the block lies.
    Hidden,
    /// What is seen has no outline of such a block.
    NoBlock,
}

/// More of the predicted area than this is a block that is seen whole.
const WHOLE: f64 = 0.85;
/// The least part of a block by which it is found.
const LEAST_SEEN: f64 = 0.15;
/// The least number of points of outlines.
const LEAST_POINTS: usize = 12;
/// The least part of the points that agree.
const AGREE: f64 = 0.55;
/// The largest part of a block that grey things cover.
const UNEXPLAINED: f64 = 0.04;
/// Beyond this, pixels, a point counts less.
const NEAR: f64 = 1.0;
/// Beyond this, pixels, a point does not count.
const FAR: f64 = 3.0;
/// A larger root of the mean square distance is not a block, pixels.
const RMS: f64 = 0.8;
/// The same for a block that lies where it lay: 1 mm is about half a pixel.
const STILL: f64 = 0.6;
/// A place known worse than this is unknown, mm.
const UNKNOWN: f64 = 8.0;
/// The least deviation of a point, pixels, and how many neighbours err alike.
const NOISE: f64 = 0.25;
const ALIKE: f64 = 4.0;
/// How much larger a drawn or blurred outline is than the block's, pixels: the mean and the deviation expected.
const BLOOM: [f64; 2] = [0.3, 0.5];
/// How far a height that is given may be wrong, mm.
const GIVEN: f64 = 0.5;

/// x, y, z, yaw in radians times the size, and how much larger the outline is in pixels.
type Unknowns = SVector<f64, 5>;
type Normal = SMatrix<f64, 5, 5>;

/// Estimates the pose of a cube with edges of `size` mm from one or several views; `height` is that of its middle, mm,
/// if it is known. One view alone tells a height only by how large the block seems.
///
/// If three views or more disagree, it is the pose that all but one of them agree on.
///
/// # Errors
///
/// [`PoseError`] if they do not tell where it lies.
pub fn locate(size: f64, views: &[View<'_>], height: Option<f64>) -> Result<BlockPose, PoseError> {
    let whole = fit(size, views, height);
    let (Err(error), 3..) = (&whole, views.len()) else {
        return whole;
    };
    let without = |out: usize| {
        let others: Vec<View<'_>> = (0..views.len()).filter(|&i| i != out).map(|i| views[i]).collect();
        let mut pose = fit(size, &others, height).ok()?;
        pose.seen.insert(out, 0.0);
        // Hardly anything is left that could contradict, unless it is another thing that is seen there.
        (!pose.is_partly_hidden() || is_another(size, &pose, &views[out])).then_some(pose)
    };
    let found = (0..views.len()).filter_map(without);
    found.min_by(|a, b| a.error.total_cmp(&b.error)).ok_or(*error)
}

/// Whether a view shows a cube of this size at this place, turned by so many degrees: as cheap as a glance, where a
/// block lies still.
#[must_use]
pub fn agrees(size: f64, place: [f64; 3], yaw: f64, view: &View<'_>) -> bool {
    let unknowns = Unknowns::new(place[0], place[1], place[2], yaw.to_radians() * size, BLOOM[0]);
    let views = std::slice::from_ref(view);
    let alone = Fit {
        size,
        views,
        height: None,
    };
    let Some(expected) = alone.expect(&unknowns) else {
        return false;
    };
    let distances = alone.distances(&expected);
    let near: Vec<f64> = distances.iter().copied().filter(|d| d.abs() < FAR).collect();
    let square = near.iter().map(|d| d * d).sum::<f64>() / near.len().max(1) as f64;
    // What looks like another place, seen as well as this one, is not a glance but a measurement.
    near.len() >= LEAST_POINTS && near.len() as f64 >= AGREE * distances.len() as f64 && square.sqrt() < STILL
}

/// The pose that agrees with all views.
fn fit(size: f64, views: &[View<'_>], height: Option<f64>) -> Result<BlockPose, PoseError> {
    let fit = Fit { size, views, height };
    let start = fit.start().ok_or(PoseError::NoPlace)?;
    let yaws = (0..6).map(|i| f64::from(i) * std::f64::consts::FRAC_PI_2 / 6.0);
    let mut best: Option<(f64, Unknowns)> = None;
    for yaw in yaws {
        let unknowns = Unknowns::new(start[0], start[1], start[2], yaw * size, BLOOM[0]);
        let found = fit.refine(unknowns, 8, huber);
        let cost = fit.cost(&found).ok_or(PoseError::NoPlace)?;
        if best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, found));
        }
    }
    let (_, found) = best.ok_or(PoseError::NoPlace)?;
    fit.judge(&fit.refine(found, 12, tukey))
}

struct Fit<'a> {
    size: f64,
    views: &'a [View<'a>],
    height: Option<f64>,
}

/// The outlines that are expected of a pose.
struct Expected {
    outlines: Vec<Outline>,
    bloom: f64,
}

impl Fit<'_> {
    /// Where the lines of sight through the middles meet, or meet the given height or the table.
    fn start(&self) -> Option<[f64; 3]> {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        let mut add = |row: Vector3<f64>, value: f64| {
            normal += row * row.transpose();
            right += row * value;
        };
        for view in self.views {
            let m = view.projection.numbers();
            for (axis, place) in view.sighting.middle.into_iter().enumerate() {
                let row = |i: usize| m[axis * 4 + i] - place * m[8 + i];
                // In mm rather than in pixels times mm.
                let length = Vector3::new(row(0), row(1), row(2)).norm();
                add(Vector3::new(row(0), row(1), row(2)) / length, -row(3) / length);
            }
        }
        let weight = match (self.height, self.views.len()) {
            (Some(_), _) => 1e3,
            (None, 0 | 1) => 1e-3,
            (None, _) => 0.0,
        };
        add(
            Vector3::z() * weight,
            weight * self.height.unwrap_or(self.size / 2.0),
        );
        let place = normal.cholesky()?.solve(&right);
        let place = [place.x, place.y, place.z];
        let is_ahead = |view: &View<'_>| view.projection.depth(place) > self.size;
        (place.iter().all(|number| number.is_finite()) && self.views.iter().all(is_ahead)).then_some(place)
    }

    fn expect(&self, unknowns: &Unknowns) -> Option<Expected> {
        let corners = corners(self.size, unknowns);
        let outlines = self.views.iter().map(|view| {
            let pixels: Option<Vec<[f64; 2]>> = corners
                .iter()
                .map(|&corner| view.projection.project(corner))
                .collect();
            Outline::new(hull(pixels?))
        });
        Some(Expected {
            outlines: outlines.collect::<Option<_>>()?,
            bloom: unknowns[4],
        })
    }

    /// The distance of each point that counts from the outline that is expected.
    fn distances(&self, expected: &Expected) -> Vec<f64> {
        let pairs = self.views.iter().zip(&expected.outlines);
        pairs
            .flat_map(|(view, outline)| {
                let points = view.sighting.rim.iter().filter(|point| !point.covered);
                points.map(|point| outline.distance(point.at) - expected.bloom)
            })
            .collect()
    }

    /// What is expected of the unknowns themselves: the index, the difference and its deviation.
    fn priors(&self, unknowns: &Unknowns) -> Vec<(usize, f64, f64)> {
        let mut priors = vec![(4, unknowns[4] - BLOOM[0], BLOOM[1])];
        if let Some(height) = self.height {
            priors.push((2, unknowns[2] - height, GIVEN));
        }
        priors
    }

    fn cost(&self, unknowns: &Unknowns) -> Option<f64> {
        let distances = self.distances(&self.expect(unknowns)?);
        let points: f64 = distances.iter().map(|d| d * d * huber(*d)).sum();
        let priors: f64 = self
            .priors(unknowns)
            .iter()
            .map(|(_, off, sd)| (off / sd).powi(2))
            .sum();
        Some(points + priors)
    }

    fn refine(&self, start: Unknowns, steps: usize, weight: fn(f64) -> f64) -> Unknowns {
        let mut unknowns = start;
        for _ in 0..steps {
            let Some((normal, right)) = self.equations(&unknowns, weight) else {
                break;
            };
            // A little damping, where the views do not tell all.
            let damped = normal + Normal::from_diagonal(&(normal.diagonal() * 1e-3).add_scalar(1e-6));
            let Some(step) = damped.cholesky().map(|cholesky| cholesky.solve(&right)) else {
                break;
            };
            // Outlines are nearly linear only nearby.
            let step = step * (self.size / 2.0 / step.norm().max(1e-12)).min(1.0);
            unknowns -= step;
            if step.norm() < 1e-4 {
                break;
            }
        }
        unknowns
    }

    /// The normal equations of a step.
    fn equations(&self, unknowns: &Unknowns, weight: fn(f64) -> f64) -> Option<(Normal, Unknowns)> {
        const STEP: f64 = 1e-3;
        let distances = self.distances(&self.expect(unknowns)?);
        let mut columns = Vec::with_capacity(5);
        for i in 0..5 {
            let mut moved = *unknowns;
            moved[i] += STEP;
            columns.push(self.distances(&self.expect(&moved)?));
        }
        let (mut normal, mut right) = (Normal::zeros(), Unknowns::zeros());
        for (row, &distance) in distances.iter().enumerate() {
            let slope = Unknowns::from_fn(|i, _| (columns[i][row] - distance) / STEP);
            let weight = weight(distance);
            normal += slope * slope.transpose() * weight;
            right += slope * (distance * weight);
        }
        for (index, off, deviation) in self.priors(unknowns) {
            let weight = deviation.powi(-2);
            normal[(index, index)] += weight;
            right[index] += weight * off;
        }
        Some((normal, right))
    }

    /// Whether the result may be believed, and how far.
    fn judge(&self, unknowns: &Unknowns) -> Result<BlockPose, PoseError> {
        let expected = self.expect(unknowns).ok_or(PoseError::NoPlace)?;
        let distances = self.distances(&expected);
        let near: Vec<f64> = distances.iter().copied().filter(|d| d.abs() < FAR).collect();
        if near.len() < LEAST_POINTS {
            return Err(PoseError::Hidden);
        }
        let rms = (near.iter().map(|d| d * d).sum::<f64>() / near.len() as f64).sqrt();
        let pairs = self.views.iter().zip(&expected.outlines);
        let seen: Vec<f64> = pairs
            .map(|(view, outline)| view.sighting.area / outline.area(expected.bloom).max(1.0))
            .collect();
        let agree = near.len() as f64 / distances.len() as f64;
        if rms > RMS || agree < AGREE || seen.iter().any(|&part| part > 1.0 / WHOLE) {
            return Err(PoseError::NoBlock);
        }
        // What covers it is grey, so that the block's own rim and that of what covers it look alike.
        let mut pairs = self.views.iter().zip(&expected.outlines);
        let is_grey =
            |(view, outline): (&View<'_>, &Outline)| view.sighting.around.grey_within(outline) > UNEXPLAINED;
        if seen.iter().all(|&part| part < LEAST_SEEN) || pairs.any(is_grey) {
            return Err(PoseError::Hidden);
        }
        let (normal, _) = self.equations(unknowns, tukey).ok_or(PoseError::NoPlace)?;
        let spread = normal.try_inverse().ok_or(PoseError::Hidden)? * rms.max(NOISE).powi(2) * ALIKE;
        let error = (spread[(0, 0)] + spread[(1, 1)] + spread[(2, 2)]).sqrt();
        let doubtful = if seen.iter().all(|&part| part < WHOLE) {
            2.0
        } else {
            1.0
        };
        let pose = BlockPose {
            place: [unknowns[0], unknowns[1], unknowns[2]],
            yaw: (unknowns[3] / self.size).to_degrees().rem_euclid(90.0),
            error: error * doubtful,
            yaw_error: (spread[(3, 3)].sqrt() / self.size).to_degrees(),
            rms,
            seen,
        };
        let is_known = pose.error.is_finite() && pose.error < UNKNOWN;
        is_known.then_some(pose).ok_or(PoseError::Hidden)
    }
}

/// Whether what is seen in a view is not where the block is.
fn is_another(size: f64, pose: &BlockPose, view: &View<'_>) -> bool {
    let [x, y, z] = pose.place;
    let unknowns = Unknowns::new(x, y, z, pose.yaw.to_radians() * size, 0.0);
    let views = std::slice::from_ref(view);
    let alone = Fit {
        size,
        views,
        height: None,
    };
    let expected = alone.expect(&unknowns);
    expected.is_none_or(|expected| expected.outlines[0].distance(view.sighting.middle) > FAR)
}

/// The corners of the block, mm.
fn corners(size: f64, unknowns: &Unknowns) -> [[f64; 3]; 8] {
    let (sin, cos) = (unknowns[3] / size).sin_cos();
    let half = size / 2.0;
    std::array::from_fn(|i| {
        let sign = |bit: usize| if i & bit == 0 { -half } else { half };
        let (a, b) = (sign(1), sign(2));
        [
            unknowns[0] + a * cos - b * sin,
            unknowns[1] + a * sin + b * cos,
            unknowns[2] + sign(4),
        ]
    })
}

/// The weight of a point: those far away pull no more than those nearby.
fn huber(distance: f64) -> f64 {
    NEAR / distance.abs().max(NEAR)
}

/// The weight of a point: those far away do not count.
fn tukey(distance: f64) -> f64 {
    (1.0 - (distance / FAR).powi(2)).max(0.0).powi(2)
}
