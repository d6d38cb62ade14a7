//! Eyes: from images of calibrated cameras to where coloured blocks lie.
//!
//! [`Picture`] is an image's pixels, and [`Projection`] the 3×4 matrix that takes millimetres on the table to them
//! (M55). [`marker::find`] finds the ball on the gripper, [`blocks::find`] finds blocks by their colours, and
//! [`pose::locate`] says where one lies, by its outline in one image or several. None of it does any IO.

pub mod blocks;
pub mod marker;
mod mask;
mod outline;
mod picture;
pub mod pose;
pub mod projection;

pub use picture::Picture;
pub use projection::Projection;
