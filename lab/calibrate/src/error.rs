//! Why no matrix could be computed.

use mom_drive::VerbFailure;

/// Why observations give no projection matrix.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrationError {
    /// A projection matrix has 11 unknowns, and each pose gives two equations.
    #[error("the marker was measured in {found} poses, and a matrix takes at least {least}")]
    TooFew {
        /// How many there are.
        found: usize,
        /// How many there must be.
        least: usize,
    },
    /// All places of the marker lie in a plane, or nearly: infinitely many cameras see them alike.
    #[error(
        "the marker's places lie nearly in a plane: they are {ratio:.4} times as thick as wide, and it takes {least}"
    )]
    Flat {
        /// The smallest singular value of the places about their middle, over the largest.
        ratio: f64,
        /// The least ratio.
        least: f64,
    },
    /// The equations hardly tell one camera from another.
    #[error(
        "the poses hardly tell one camera from another: the equations' condition is {condition:.0}, and at most {most:.0} is trusted"
    )]
    Ambiguous {
        /// The largest singular value over the smallest that is not that of the solution.
        condition: f64,
        /// The most that is trusted.
        most: f64,
    },
    /// What fits is not a camera: it has the marker behind it, or sees a mirror's picture.
    #[error("the fitted matrix is not a valid camera: {0}")]
    NoCamera(&'static str),
    /// No camera agrees with enough of the measurements.
    #[error("only {agree} of {found} measurements agree on a camera")]
    Inconsistent {
        /// How many agree.
        agree: usize,
        /// How many there are.
        found: usize,
    },
}

impl CalibrationError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            CalibrationError::TooFew { .. } => {
                "ask for more poses with --poses, and see that nothing hides the marker from the camera"
            }
            CalibrationError::Flat { .. } | CalibrationError::Ambiguous { .. } => {
                "let the poses differ in all three directions, in height too, and ask for more with --poses"
            }
            CalibrationError::NoCamera(_) | CalibrationError::Inconsistent { .. } => {
                "see that --marker is where the marker sits in the gripper's frame, and that nothing else has its colour"
            }
        }
    }
}

/// As the command line tells it.
pub(crate) fn no_calibration(error: &CalibrationError) -> VerbFailure {
    VerbFailure::new(
        format!("no calibration: {error}; nothing was told to the camera"),
        error.hint(),
    )
}
