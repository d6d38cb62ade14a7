//! From observations, of which some may be wrong, to the matrix and how well it fits.

use crate::dlt::{self, Estimate, LEAST};
use crate::{CalibrationError, Observation, Projection, refine};

/// So many observations are needed beyond the fewest before one of them can be called wrong.
const EXTRA_OBSERVATIONS: usize = 2;
/// A residual of so many standard deviations is an outlier.
const DEVIATIONS: f64 = 4.0;
/// Nothing nearer than this is an outlier, pixels: so well a marker is found at best.
const OUTLIER_FLOOR_PX: f64 = 0.25;
/// Where all are as near as this nothing is wrong, pixels.
const GOOD_FIT_PX: f64 = 0.5;
/// The most rounds of fitting and leaving out.
const ROUNDS: usize = 8;
/// A part has to fit so many times better than the whole: a few of many measurements always fit somewhat better.
const REQUIRED_GAIN: f64 = 4.0;
/// How many random parts are tried where the whole does not fit. With a fifth of wrong ones and parts of eight,
/// one in six parts is right.
const PARTS: usize = 120;
/// How many observations a part has.
const PART: usize = 8;

/// A measured matrix.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// The matrix.
    pub projection: Projection,
    /// The root of the mean squared distance between the measured pixels and those of the matrix, pixels.
    pub rms: f64,
    /// The largest of these distances, pixels.
    pub max: f64,
    /// The condition of the linear equations of the observations that were used.
    pub condition: f64,
    /// Every observation, in their order.
    pub residuals: Vec<Residual>,
}

/// How far an observation is from what the matrix says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual {
    /// The observation.
    pub observation: Observation,
    /// From where the matrix has it to where it was measured, pixels.
    pub error: [f64; 2],
    /// Whether it was used; otherwise it is an outlier.
    pub used: bool,
}

impl Calibration {
    /// How many observations were used.
    #[must_use]
    pub fn used(&self) -> usize {
        self.residuals.iter().filter(|residual| residual.used).count()
    }

    /// The deviation of a measurement in one direction that these residuals tell of: a matrix takes 11 freedoms.
    fn deviation(&self) -> f64 {
        let used = self.used() as f64;
        self.rms * (used / (2.0 * used - 11.0)).sqrt()
    }

    /// How many were left out because they do not agree with the others.
    #[must_use]
    pub fn outliers(&self) -> usize {
        self.residuals.len() - self.used()
    }
}

impl Residual {
    /// Its length in pixels.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.error[0].hypot(self.error[1])
    }
}

/// Computes the matrix from observations of the middle of a ball's outline; `radius` is the ball's in mm.
///
/// # Errors
///
/// [`CalibrationError`] if they do not determine a camera, or do not agree on one.
///
/// ```
/// use mom_calibrate::{CalibrationError, calibrate};
///
/// assert_eq!(calibrate(&[], 12.0), Err(CalibrationError::TooFew { found: 0, least: 6 }));
/// ```
pub fn calibrate(observations: &[Observation], radius: f64) -> Result<Calibration, CalibrationError> {
    let all = vec![true; observations.len()];
    // What is wrong with all of them together is wrong with every part.
    let start =
        dlt::estimate(observations).and_then(|start| refine::refine(&start.projection, observations, radius));
    let whole = start.and_then(|start| settle(start, &all, observations, radius));
    let good = |fit: &Calibration| fit.outliers() == 0 && fit.max <= GOOD_FIT_PX;
    if whole.as_ref().is_ok_and(good) || observations.len() < LEAST + EXTRA_OBSERVATIONS {
        return whole;
    }
    // A measurement that is far off bends the whole until none stands out.
    match (whole, by_parts(observations, radius)) {
        (Ok(whole), Some(parts)) if parts.deviation() < whole.deviation() / REQUIRED_GAIN => Ok(parts),
        (Err(CalibrationError::NoCamera(_) | CalibrationError::Inconsistent { .. }), Some(parts)) => {
            Ok(parts)
        }
        (whole, _) => whole,
    }
}

/// Fits and leaves out what is far off, until both agree.
fn settle(
    start: Projection,
    begin: &[bool],
    observations: &[Observation],
    radius: f64,
) -> Result<Calibration, CalibrationError> {
    let (mut projection, mut used) = (start, begin.to_vec());
    for _ in 0..ROUNDS {
        let lengths: Vec<f64> = observations
            .iter()
            .map(|seen| length(&projection, seen, radius))
            .collect();
        let kept = near(&lengths);
        if kept == used {
            break;
        }
        used = kept;
        let part = chosen(observations, &used);
        if part.len() < LEAST + EXTRA_OBSERVATIONS - 1 || 3 * part.len() < 2 * observations.len() {
            return Err(CalibrationError::Inconsistent {
                agree: part.len(),
                found: observations.len(),
            });
        }
        projection = refine::refine(&projection, &part, radius)?;
    }
    summarise(projection, &used, observations, radius)
}

/// Which residuals are no outliers, by the median of their lengths, which half of them can be wrong without spoiling.
fn near(lengths: &[f64]) -> Vec<bool> {
    let count = lengths.len();
    if count < LEAST + EXTRA_OBSERVATIONS {
        return vec![true; count];
    }
    let mut sorted = lengths.to_vec();
    sorted.sort_by(f64::total_cmp);
    // The median length of errors that are normal in both directions is 1.177 of their deviation. The fit has taken
    // a part of them: 11 of 2n freedoms.
    let shrunk = (1.0 - 11.0 / (2.0 * count as f64)).sqrt();
    let deviation = sorted[count / 2] / 1.177 / shrunk;
    let far = (DEVIATIONS * deviation).max(OUTLIER_FLOOR_PX);
    lengths.iter().map(|length| *length <= far).collect()
}

/// The best fit that begins with a random part of the observations: where wrong ones spoil the whole, some part has
/// none of them.
fn by_parts(observations: &[Observation], radius: f64) -> Option<Calibration> {
    let mut random = fastrand::Rng::with_seed(observations.len() as u64);
    let mut order: Vec<usize> = (0..observations.len()).collect();
    let mut best: Option<(f64, Projection)> = None;
    for _ in 0..PARTS {
        random.shuffle(&mut order);
        let part: Vec<Observation> = order.iter().take(PART).map(|&i| observations[i]).collect();
        let Ok(Estimate { projection, .. }) = dlt::estimate(&part) else {
            continue;
        };
        let mut lengths: Vec<f64> = observations
            .iter()
            .map(|seen| length(&projection, seen, radius))
            .collect();
        lengths.sort_by(f64::total_cmp);
        let median = lengths[lengths.len() / 2];
        if best.as_ref().is_none_or(|(least, _)| median < *least) {
            best = Some((median, projection));
        }
    }
    let (_, start) = best?;
    settle(start, &[], observations, radius).ok()
}

fn chosen(observations: &[Observation], used: &[bool]) -> Vec<Observation> {
    let pairs = observations.iter().zip(used);
    pairs.filter(|(_, used)| **used).map(|(seen, _)| *seen).collect()
}

/// Infinite where the matrix has no picture of it.
fn length(projection: &Projection, seen: &Observation, radius: f64) -> f64 {
    error(projection, seen, radius).map_or(f64::INFINITY, |[u, v]| u.hypot(v))
}

fn error(projection: &Projection, seen: &Observation, radius: f64) -> Option<[f64; 2]> {
    let [u, v] = projection.project_ball(seen.world, radius)?;
    Some([seen.pixel[0] - u, seen.pixel[1] - v])
}

fn summarise(
    projection: Projection,
    used: &[bool],
    observations: &[Observation],
    radius: f64,
) -> Result<Calibration, CalibrationError> {
    let part = chosen(observations, used);
    let condition = dlt::estimate(&part)?.condition;
    let residual = |(seen, used): (&Observation, &bool)| Residual {
        observation: *seen,
        error: error(&projection, seen, radius).unwrap_or([f64::INFINITY; 2]),
        used: *used,
    };
    let residuals: Vec<Residual> = observations.iter().zip(used).map(residual).collect();
    let lengths = || {
        residuals
            .iter()
            .filter(|residual| residual.used)
            .map(Residual::length)
    };
    if lengths().any(|length| !length.is_finite()) {
        return Err(CalibrationError::NoCamera("it is inside the marker"));
    }
    let squares: f64 = lengths().map(|length| length * length).sum();
    Ok(Calibration {
        projection,
        rms: (squares / part.len() as f64).sqrt(),
        max: lengths().fold(0.0, f64::max),
        condition,
        residuals,
    })
}
