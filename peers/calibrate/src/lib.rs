//! Calibrates a camera of the lab by driving the arm (M55).
//!
//! The arm carries a coloured ball. In each of some twenty poses, the pose says where the ball is, and the image where
//! it is seen; from these pairs the 3×4 projection matrix is computed, from millimetres to pixels: [`marker::find`] finds the ball,
//! [`dlt`] estimates the matrix, [`refine`](refine::refine) makes the distances in the image small, and
//! [`calibrate`] does both and leaves out what does not agree. None of them does any IO.
//!
//! [`verb`] is `mom calibrate`: an ordinary peer, which asks for the robot's token, drives, looks, computes, and tells
//! the camera its matrix.

mod asking;
mod camera;
pub mod dlt;
mod error;
pub mod experiment;
mod failure;
mod fit;
pub mod marker;
mod picture;
pub mod poses;
mod projection;
pub mod refine;
pub mod residuals;
mod robot;
pub mod verb;

pub use error::CalibrationError;
pub use failure::VerbFailure;
pub use fit::{Calibration, Residual, calibrate};
pub use picture::Picture;
pub use poses::Pose;
pub use projection::{Observation, Projection};

/// Where the middle of the lab's marker is in the gripper's frame, mm: along the jaw line, across it, and from the tip
/// towards the wrist.
pub const MARKER: [f64; 3] = [0.0, -140.0, 75.0];
/// The radius of the lab's marker, mm.
pub const RADIUS: f64 = 12.0;
/// The colour of the lab's marker: red, green and blue.
pub const COLOUR: [u8; 3] = [255, 0, 255];
