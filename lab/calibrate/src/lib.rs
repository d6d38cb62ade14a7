//! Calibrates a camera of the lab by driving the arm (M55).
//!
//! The arm carries a coloured ball. In each of some twenty poses, the pose says where the ball is, and the image where
//! it is seen; from these pairs the 3×4 projection matrix is computed, from millimetres to pixels: [`marker::find`] finds the ball,
//! [`dlt`] estimates the matrix, [`refine`](refine::refine) makes the distances in the image small, and
//! [`calibrate`] does both and leaves out what does not agree. None of them does any IO.
//!
//! [`verb`] is `mom calibrate`: an ordinary peer, which asks for the robot's token, drives, looks, computes, and tells
//! the camera its matrix. [`agent`] does the same for a peer that lends it the token, such as a person at the console.

pub mod agent;
mod camera;
pub mod dlt;
mod error;
pub mod experiment;
mod fit;
mod observation;
pub mod poses;
pub mod refine;
pub mod residuals;
pub mod verb;

pub use error::CalibrationError;
pub use fit::{Calibration, Residual, calibrate};
pub use mom_vision::marker::{self, COLOUR, MARKER, RADIUS};
pub use mom_vision::{Picture, Projection};
pub use observation::Observation;
